"""Recordings are found where they are, by any of fsspec's names for it, and known again by their listing."""

from __future__ import annotations

import os
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.local import LocalFileSystem

from orchestrator.fleet import Source, find_sources, sources_below
from orchestrator.fleet._content import content_sha256, local_copy
from orchestrator.importing import ENDINGS
from protocols import InputError
from tests.orchestrator.fleet.small import small_recordings


def found_below(place: str | Path, **how: bool) -> list[Source]:
    return list(sources_below(str(place), **how))


def test_every_recording_below_a_folder_is_found_with_the_folder_it_lies_in(tmp_path: Path) -> None:
    made = [*small_recordings(tmp_path, 1), *small_recordings(tmp_path / "lot-7", 2)]
    inner = made[0] / "results" / "copy"
    inner.mkdir(parents=True)
    (inner / "recording.json").write_text("{}")
    found = found_below(tmp_path)
    assert sorted(source.url for source in found) == sorted(map(str, made))
    assert {source.batch for source in found} == {None, "lot-7"}
    assert [source.url for source in found_below(made[0])] == [str(made[0])]


def test_what_changed_looks_different_and_what_did_not_does_not(tmp_path: Path) -> None:
    (path,) = small_recordings(tmp_path, 1)
    before = found_below(tmp_path)
    assert found_below(tmp_path) == before
    capture = next((path / "captures").iterdir())
    os.utime(capture, (1.0, 1.0))
    assert found_below(tmp_path)[0].fingerprint != before[0].fingerprint


def test_another_store_is_listed_like_a_folder(tmp_path: Path) -> None:
    small_recordings(tmp_path, 2)
    memory = fsspec.filesystem("memory")
    memory.put(str(tmp_path), "/bench", recursive=True)
    assert [source.url for source in found_below("memory://bench")] == ["memory:///bench/r000", "memory:///bench/r001"]


def test_measurement_files_are_found_by_their_endings(tmp_path: Path) -> None:
    for name in ("a.csv", "b.MAT", "notes.md"):
        (tmp_path / name).write_text("")
    assert [Path(source.url).name for source in found_below(tmp_path, files=True)] == ["a.csv", "b.MAT"]


def test_every_kind_of_file_that_an_import_reads_is_found(tmp_path: Path) -> None:
    for ending in ENDINGS:
        (tmp_path / f"log{ending}").write_text("")
    assert len(found_below(tmp_path, files=True)) == len(ENDINGS)


def test_values_that_lie_beside_their_description_belong_to_it(tmp_path: Path) -> None:
    """COMTRADE: without its .dat, two captures with one .cfg would be the same, and a fetched one empty."""
    for name, values in (("a", "1"), ("B", "2")):
        cfg, dat = (".CFG", ".DAT") if name.isupper() else (".cfg", ".dat")
        (tmp_path / f"{name}{cfg}").write_text("station")
        (tmp_path / f"{name}{dat}").write_text(values)
    one, other = found_below(tmp_path, files=True)
    assert [Path(source.url).name for source in (one, other)] == ["B.CFG", "a.cfg"]
    assert content_sha256(Path(one.url)) != content_sha256(Path(other.url))
    os.utime(tmp_path / "a.dat", (1.0, 1.0))
    assert found_below(tmp_path, files=True)[1].fingerprint != other.fingerprint
    memory = fsspec.filesystem("memory")
    memory.put(str(tmp_path), "/captures", recursive=True)
    fetched = [source for source in found_below("memory://captures", files=True) if source.url.endswith("a.cfg")]
    with local_copy(fetched[0], keep=False) as path:
        assert sorted(file.name for file in path.parent.iterdir() if file.is_file()) == ["a.cfg", "a.dat"]


def test_what_overlaps_is_found_once_and_a_limit_is_kept(tmp_path: Path) -> None:
    small_recordings(tmp_path, 3)
    places = [str(tmp_path), str(tmp_path / "r001")]
    assert len(find_sources(places, files=False, limit=None, tell=lambda _: None)) == 3
    assert len(find_sources(places, files=False, limit=2, tell=lambda _: None)) == 2


def test_a_folder_that_cannot_be_listed_is_not_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small_recordings(tmp_path / "bench", 2)
    (tmp_path / "closed").mkdir()
    listed = LocalFileSystem.ls

    def ls(self: LocalFileSystem, path: str, detail: bool = False, **options: object) -> object:
        if path.endswith("closed"):
            raise PermissionError(13, "Permission denied", path)
        return listed(self, path, detail=detail, **options)

    monkeypatch.setattr(LocalFileSystem, "ls", ls)
    with pytest.raises(InputError, match=r"cannot be listed: PermissionError: .*closed"):
        find_sources([str(tmp_path)], files=False, limit=None, tell=lambda _: None)


@pytest.mark.parametrize("place", ["nowhere", "quux://bench", "."])
def test_a_place_without_recordings_is_one_line(tmp_path: Path, place: str) -> None:
    where = place if "://" in place else str(tmp_path / place)
    with pytest.raises(InputError) as raised:
        find_sources([where], files=False, limit=None, tell=lambda _: None)
    assert where in str(raised.value)
    assert "\n" not in str(raised.value)

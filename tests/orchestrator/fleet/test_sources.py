"""Recordings are found where they are, by any of fsspec's names for it, and known again by their listing."""

from __future__ import annotations

import os
from pathlib import Path

import fsspec
import pytest

from orchestrator.fleet import Source, find_sources, sources_below
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


def test_what_overlaps_is_found_once_and_a_limit_is_kept(tmp_path: Path) -> None:
    small_recordings(tmp_path, 3)
    places = [str(tmp_path), str(tmp_path / "r001")]
    assert len(find_sources(places, files=False, limit=None, tell=lambda _: None)) == 3
    assert len(find_sources(places, files=False, limit=2, tell=lambda _: None)) == 2


@pytest.mark.parametrize("place", ["nowhere", "quux://bench", "."])
def test_a_place_without_recordings_is_one_line(tmp_path: Path, place: str) -> None:
    where = place if "://" in place else str(tmp_path / place)
    with pytest.raises(InputError) as raised:
        find_sources([where], files=False, limit=None, tell=lambda _: None)
    assert where in str(raised.value)
    assert "\n" not in str(raised.value)

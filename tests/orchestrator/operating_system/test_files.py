"""Files are replaced at once, also where a reader has one open for a moment as Windows does not allow."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from orchestrator.operating_system.files import replace, sync_content, sync_folder


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Replacing is refused twice, as by a virus scanner; the files that it was tried with."""
    tried: list[Path] = []
    plain = Path.replace

    def stubborn(self: Path, target: Path) -> Path:
        tried.append(self)
        if len(tried) <= 2:
            raise PermissionError(13, "Access is denied")
        return plain(self, target)

    monkeypatch.setattr(Path, "replace", stubborn)
    return tried


def test_windows_replaces_a_file_when_its_reader_has_closed_it(
    tmp_path: Path, refused: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    new, old = tmp_path / "new", tmp_path / "old"
    new.write_bytes(b"new")
    old.write_bytes(b"old")
    monkeypatch.setattr("orchestrator.operating_system.files.IS_WINDOWS", True)
    replace(new, old)
    assert old.read_bytes() == b"new"
    assert refused == [new] * 3


def test_elsewhere_a_refusal_is_final(tmp_path: Path, refused: list[Path]) -> None:
    with pytest.raises(PermissionError):
        replace(tmp_path / "new", tmp_path / "old")
    assert len(refused) == 1


def test_content_reaches_the_disk_where_there_is_no_fdatasync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.delattr(os, "fdatasync")
    monkeypatch.setattr(os, "fsync", synced.append)
    sync_content(7)
    assert synced == [7]


def test_a_folder_that_cannot_be_opened_needs_no_sync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError):
        sync_folder(tmp_path / "none")
    monkeypatch.delattr(os, "O_DIRECTORY")
    sync_folder(tmp_path / "none")

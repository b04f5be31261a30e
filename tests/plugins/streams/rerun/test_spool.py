"""The file of a library that may not be let near a disk that fails."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
import rerun as rr

from plugins.streams.rerun._spool import Spool
from plugins.streams.rerun._tape import ALWAYS, Tape, entry
from protocols import StorageError


def written(file: Path, data: bytes) -> Spool:
    spool = Spool(file)
    with Path(spool.entrance).open("wb", buffering=0) as library:
        spool.opened()
        library.write(data)
    return spool


def test_what_goes_in_is_in_the_file_when_it_is_closed(tmp_path: Path) -> None:
    data = os.urandom(300_000)
    written(tmp_path / "view.rrd", data).close()
    assert (tmp_path / "view.rrd").read_bytes() == data


def test_who_writes_never_waits_for_a_full_disk_and_closing_tells_of_it() -> None:
    spool = written(Path("/dev/full"), bytes(1_000_000))
    with pytest.raises(StorageError, match=r"/dev/full: cannot be written: No space left on device$"):
        spool.close()


def test_an_error_when_the_file_is_let_go_of_is_reported_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    close = os.close

    def failing(descriptor: int) -> None:
        is_file = os.path.realpath(f"/proc/self/fd/{descriptor}") == str(tmp_path / "view.rrd")
        close(descriptor)
        if is_file:
            raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "close", failing)
    with pytest.raises(StorageError, match=r"view\.rrd: cannot be written: Input/output error$"):
        written(tmp_path / "view.rrd", b"abc").close()


def test_a_file_that_cannot_be_opened_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"no/view\.rrd: cannot be written: No such file or directory$"):
        Spool(tmp_path / "no" / "view.rrd")


def test_a_tape_on_a_full_disk_takes_entries_to_the_end_and_then_says_so() -> None:
    tape = Tape(Path("/dev/full"), name="full")
    for _ in range(20):
        tape.put([entry("log", ALWAYS, rr.TextLog("x" * 10_000))])
    with pytest.raises(StorageError, match="No space left on device"):
        tape.close()

"""The file that takes what is drawn, and what is left of its writer."""

from __future__ import annotations

from pathlib import Path

import pytest
import rerun as rr

from plugins.streams.rerun._tape import ALWAYS, FILE_NAME, Tape, entry

TASKS = Path("/proc/self/task")
WRITER = "RecordingStream"
"""What the library calls a stream's thread."""


def writers() -> list[str]:
    return [task.name for task in TASKS.iterdir() if (task / "comm").read_text().startswith(WRITER)]


@pytest.mark.skipif(not TASKS.is_dir(), reason="threads are counted on Linux")
def test_a_closed_tape_leaves_no_thread(tmp_path: Path) -> None:
    before = writers()
    tape = Tape(tmp_path / FILE_NAME)
    tape.put([entry("log", ALWAYS, rr.TextLog("anything"))])
    assert len(writers()) == len(before) + 1
    tape.close()
    assert writers() == before

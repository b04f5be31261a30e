"""A lock belongs to one holder, hides no content, and ends with its process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.operating_system.locks import is_locked, locked_file

HOLD = """
import sys, time
from pathlib import Path
from orchestrator.operating_system.locks import locked_file
with locked_file(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.mark.usefixtures("system")
def test_a_file_has_one_holder_at_a_time(tmp_path: Path) -> None:
    file = tmp_path / ".lock"
    with locked_file(file):
        assert is_locked(file)
        with pytest.raises(BlockingIOError), locked_file(file):
            pass
    assert not is_locked(file)
    with locked_file(file):
        assert is_locked(file)


@pytest.mark.usefixtures("system")
def test_what_a_holder_writes_is_read_by_others(tmp_path: Path) -> None:
    file = tmp_path / ".lock"
    with locked_file(file) as descriptor:
        os.write(descriptor, b"pid 17\n")
        assert file.read_bytes() == b"pid 17\n"


@pytest.mark.usefixtures("system")
def test_a_file_that_is_not_there_is_not_locked(tmp_path: Path) -> None:
    assert not is_locked(tmp_path / ".lock")


def test_a_lock_ends_with_its_process(tmp_path: Path) -> None:
    file = tmp_path / ".lock"
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(file)], stdout=subprocess.PIPE)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"locked\n"
        assert is_locked(file)
    finally:
        holder.kill()
        holder.communicate()
    assert not is_locked(file)

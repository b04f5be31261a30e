"""Places that the user named and nothing can be written to: exit code 2 and one line; a failing disk keeps 3."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from orchestrator.interface.cli._running import _explain, run_app
from orchestrator.recording import storage_error
from orchestrator.runs import refuse_file
from protocols import DriveFault, FaultCause, InputError

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"


@pytest.mark.parametrize(
    ("number", "code"), [(errno.EISDIR, 2), (errno.ENOENT, 2), (errno.EROFS, 2), (errno.ENOSPC, 3), (errno.EIO, 3)]
)
def test_a_wrong_place_is_bad_input_and_a_failing_disk_is_none(
    number: int, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    error = OSError(number, os.strerror(number), "out")
    found = storage_error(Path("out"), error)
    found.__cause__ = error
    assert _explain(found, []) == code
    line = capsys.readouterr().err
    assert line.startswith(f"fluxbench: out: cannot be written: {os.strerror(number)}")
    assert line.endswith("; name another file or folder\n") == (code == 2)
    assert line.count("\n") == 1


def test_a_port_that_is_not_there_stays_a_fault_of_the_drive() -> None:
    fault = DriveFault(FaultCause.LINK_LOST, "could not open port /dev/ttyACM9")
    fault.__cause__ = FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "/dev/ttyACM9")
    assert _explain(fault, []) == 3


def test_a_read_only_folder_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda place, _: Path(place) != tmp_path)
    with pytest.raises(InputError, match=f"^{tmp_path}: the folder is read-only for you: name another place"):
        refuse_file(tmp_path / "new" / "deep")
    refuse_file(tmp_path / "new", writes=False)


@pytest.mark.parametrize("command", ["diagnose", "discover", "add"])
def test_commands_refuse_a_read_only_folder_at_once(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "access", lambda place, _: Path(place) != tmp_path)
    words = [command, str(DATA), *(["dead_time"] if command == "add" else []), "--out", str(tmp_path / "new")]
    assert run_app(words) == 2
    assert "read-only" in capsys.readouterr().err

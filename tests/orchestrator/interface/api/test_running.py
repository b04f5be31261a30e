"""Runs from Python: what is handed in wrong leaves nothing behind, what ends in a fault is kept and raised."""

from __future__ import annotations

import platform
import socket
import threading
from pathlib import Path

import pytest
import yaml

from orchestrator.config import load_procedure
from orchestrator.interface.api import Measurements, as_overrides, run, run_directory
from protocols import DriveFault, InputError, ProcedureError
from tests.support.tiny import STAGES, tiny_document


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A procedure of a second that estimates no more than it has to."""
    file = tmp_path / "tiny.yaml"
    stages = [*STAGES[:-1], {"kind": "estimate", "estimators": ["resistance"]}]
    file.write_text(yaml.safe_dump(tiny_document(stages=stages)))
    return file


def test_a_run_is_open_when_it_is_done(tiny: Path, tmp_path: Path) -> None:
    done = run(tiny, settings={"seed": 3}, out=tmp_path / "run", streams=())
    assert isinstance(done, Measurements)
    assert done.path == (tmp_path / "run").resolve()
    assert done.estimates.resistance is not None
    assert not (tmp_path / "run" / "report.html").exists()


def test_a_run_needs_no_main_thread(tiny: Path, tmp_path: Path) -> None:
    done: list[Measurements] = []
    worker = threading.Thread(target=lambda: done.append(run(tiny, out=tmp_path / "run", streams=())))
    worker.start()
    worker.join()
    assert len(done[0].segments) > 5


def test_what_is_wrong_leaves_nothing_behind(tiny: Path, tmp_path: Path) -> None:
    with pytest.raises(ProcedureError, match=r"limits\.current"):
        run(tiny, settings={"limits.current": 1.0}, out=tmp_path / "run")
    with pytest.raises(InputError, match="is loaded already"):
        run(load_procedure(str(tiny)), settings={"seed": 1}, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_fault_is_raised_and_the_run_kept(tiny: Path, tmp_path: Path) -> None:
    fault = [{"kind": "trip", "at_excitation": 3, "cause": "overtemperature"}]
    with pytest.raises(DriveFault) as caught:
        run(tiny, settings={"drive.faults": fault}, out=tmp_path / "run", streams=())
    assert caught.value.__notes__ == [f"the run is kept in {tmp_path / 'run'}"]
    assert (tmp_path / "run" / "journal.jsonl").is_file()


def test_a_run_has_a_folder_of_its_own(tmp_path: Path) -> None:
    assert run_directory("demo", None).parent == Path("runs")
    with pytest.raises(InputError, match="expected a folder of its own"):
        run_directory("demo", Path("/"))


def test_settings_are_the_words_of_set() -> None:
    assert as_overrides({"limits.current_a": 3.0, "drive.plant": {"effects": {}}, "seed": None}) == [
        "limits.current_a=3.0", 'drive.plant={"effects": {}}', "seed=null",
    ]  # fmt: skip


def test_what_a_run_keeps_tells_neither_who_ran_it_nor_where(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HOME", "USER", "LOGNAME", "SECRET_TOKEN"):
        monkeypatch.setenv(name, f"/home/canary-{name}")
    for module, name in ((platform, "node"), (socket, "gethostname")):
        monkeypatch.setattr(module, name, lambda: "canary-host")
    done = run(tiny, out=tmp_path / "canary-folder" / "run", streams=("report", "rerun"))
    kept = [file for file in done.path.rglob("*") if file.is_file()]
    assert len(kept) > 10
    assert [file.name for file in kept if b"canary" in file.read_bytes()] == []

"""`fluxbench run --from`: a finished run goes on with what its diagnosis asks for."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from orchestrator.diagnosis import Diagnosis, save_diagnosis
from orchestrator.diagnosis.selection.search_state import SearchResult
from orchestrator.experiment_design.proposal import next_experiment
from orchestrator.interface.cli._further import continuation
from protocols import Compared, Diagnosed, InputError, PointDone, StagesAppended
from tests.plugins.streams.report.example_diagnosis import WORDS, a_comparison, a_diagnosis
from tests.support.processes import called, start_fluxbench, wait_until
from tests.support.tiny import STAGES, messages_of, run_tiny, tiny_document, tiny_file

EXPERIMENT: dict[str, Any] = {
    "kind": "resistance",
    "points_a": [[0.1, 0.0], [-0.1, 0.0], [1.0, 0.0], [2.0, 0.0]],
    "pwm_frequencies_hz": [10000.0, 20000.0],
    "settle_s": 0.15,
    "duration_s": 0.05,
}
PLANT = {"sensors": {"noise_a": 0.005}, "effects": {"dead_time": {"voltage_v": 0.8}}}


def diagnosis_in(run: Path, experiment: dict[str, Any] | None) -> None:
    proposal = None
    if experiment is not None:
        proposal = {"stage": experiment, "separates": ["dead_time", "device_drop"], "minutes": 0.1}
    save_diagnosis(run, a_diagnosis(next_experiment=proposal), WORDS, ())


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run, its diagnosis beside it, which nobody changes."""
    folder = tmp_path_factory.mktemp("measured")
    assert run_tiny(folder, drive={"plant": PLANT}, stages=STAGES[:-1]).outcome.ending == "finished"
    diagnosis_in(folder / "run", EXPERIMENT)
    return folder / "run"


@pytest.fixture
def run(measured: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(measured, tmp_path / "run")
    shutil.copytree(measured.with_name("run.sealed"), tmp_path / "run.sealed")
    return tmp_path / "run"


def test_the_experiment_is_measured_into_the_run_and_diagnosed_again(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What a second diagnosis says of such a recording is the engine's tests': here it is that there is one.
    again = Diagnosed(round=0, report=a_diagnosis(next_experiment=None), words=WORDS)
    monkeypatch.setattr("plugins.stages.diagnose.compared", lambda *_: Compared(report=a_comparison()))
    monkeypatch.setattr("plugins.stages.diagnose.diagnosed", lambda *_: (again, None))
    done = called("run", "--from", run / "results" / "diagnosis.json")
    assert done.returncode == 0, done.stderr
    messages = messages_of(run)
    assert [m.by for m in messages if isinstance(m, StagesAppended)] == [None]
    assert len([m for m in messages if isinstance(m, PointDone)]) == 19 + 8
    assert "has the rotor been held" in done.stdout.lower()
    (diagnosed,) = (m for m in messages if isinstance(m, Diagnosed))
    assert diagnosed == again
    (run / "results" / "diagnosis.json").unlink()
    done = called("run", "--from", run)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "nothing to decide" in done.stderr


def test_a_run_without_a_diagnosis_is_diagnosed_with_a_proposal(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def diagnose(recording: object, effects: object, *, propose: object) -> Diagnosis:
        assert propose is next_experiment
        return Diagnosis(a_diagnosis(next_experiment=None), None, SearchResult([]), ())

    monkeypatch.setattr("orchestrator.interface.cli._further.diagnose_recording", diagnose)
    (run / "results" / "diagnosis.json").unlink()
    with pytest.raises(InputError, match="nothing to decide"):
        continuation(run, 1)


def test_an_experiment_on_an_own_effect_is_diagnosed_with_its_file(run: Path, tmp_path: Path) -> None:
    proposal = {"stage": EXPERIMENT, "separates": ["leg_gain", "device_drop"], "minutes": 0.1}
    save_diagnosis(run, a_diagnosis(next_experiment=proposal), WORDS, ())
    with pytest.raises(InputError, match="about leg_gain, which is not installed: give its file by --effects FILE"):
        continuation(run, 1)
    mine = tmp_path / "mine.py"
    further = continuation(run, 1, mine)
    assert further.effects == mine
    diagnosis_in(run, EXPERIMENT)
    whole = continuation(run, 1)
    assert whole.effects is None
    assert [*further.stages, whole.stages[-1]] == [*whole.stages]
    assert whole.stages[-1].kind == "diagnose"


def test_where_nothing_is_to_be_decided_nothing_is_energised(run: Path) -> None:
    diagnosis_in(run, None)
    before = (run / "journal.jsonl").read_bytes()
    done = called("run", "--from", run)
    assert done.returncode == 2
    assert "nothing to decide" in done.stderr
    assert (run / "journal.jsonl").read_bytes() == before


def test_a_foreign_recording_gets_the_stage_to_paste_into_a_procedure(run: Path, tmp_path: Path) -> None:
    (run / "run.json").unlink()
    done = called("run", "--from", run)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "run.json" in done.stderr
    assert "fluxbench import --merge" in done.stderr
    stages = yaml.safe_load(done.stdout)
    assert stages == [EXPERIMENT]
    mine = tmp_path / "mine.yaml"
    mine.write_text(yaml.safe_dump({**tiny_document(), "stages": [STAGES[0], *stages]}))
    assert called("check", mine).returncode == 0


def test_an_experiment_that_is_no_stage_is_named(run: Path) -> None:
    diagnosis_in(run, {"kind": "resistance", "points": []})
    done = called("run", "--from", run)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "next_experiment" in done.stderr


@pytest.mark.parametrize("words", [("demo",), ("--out", "x"), ("--drive", "simulated"), ("--set", "seed=2")])
def test_a_run_goes_on_with_its_own_procedure_only(words: tuple[str, ...], tmp_path: Path) -> None:
    done = called("run", "--from", tmp_path, *words)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--from" in done.stderr


@pytest.mark.slow
def test_a_run_killed_within_an_appended_stage_goes_on_exactly_there(tmp_path: Path) -> None:
    drive = {"plant": PLANT, "realtime_factor": 6.0}
    procedure = tiny_file(tmp_path, drive=drive, stages=[*STAGES, {"kind": "diagnose", "rounds": 1}])
    run = tmp_path / "run"
    process = start_fluxbench("run", procedure, "--out", run)

    def points() -> list[str]:
        if not (run / "journal.jsonl").exists():
            return []
        return [message.id for message in messages_of(run) if isinstance(message, PointDone)]

    wait_until(lambda: len(points()) >= 19 + 5 or process.poll() is not None, timeout_s=90.0)
    process.kill()
    process.communicate()
    before = points()
    assert 19 + 5 <= len(before) < 19 + 16
    done = called("resume", run)
    assert done.returncode == 0, done.stderr
    assert points()[: len(before)] == before
    assert len(points()) == len(set(points())) == 19 + 16
    last = [message for message in messages_of(run) if isinstance(message, Diagnosed)][-1]
    assert [effect.name for effect in last.report.effects] == ["dead_time"]

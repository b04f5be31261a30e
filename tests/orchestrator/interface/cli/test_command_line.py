"""The command line from outside: what is printed, what is left behind, and the exit codes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.estimation import save_flux_map
from orchestrator.recording import open_recording
from protocols import shipped_procedures
from tests.orchestrator.flux_maps.exporting.machines import saturated_map
from tests.support.cases import few
from tests.support.processes import FLUXBENCH, called, start_fluxbench
from tests.support.tiny import STAGES, run_tiny, tiny_file


def assert_one_line(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    assert done.returncode == code, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("fluxbench: ")
    for word in words:
        assert word in done.stderr
    assert "Traceback" not in done.stdout + done.stderr


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom orchestrator.interface.cli._running import run_app\nrun_app(['--help'])\n"
        "print(sorted({'numpy', 'pydantic', 'numba', 'scipy', 'pyarrow', 'rich.progress'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "Commission a motor end to end" in done.stdout


@pytest.mark.parametrize("name", shipped_procedures())
def test_every_shipped_procedure_passes_its_own_check(name: str, tmp_path: Path) -> None:
    done = called("check", name, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["points"] > 0
    assert summary["energy_j"] > 0
    assert not list(tmp_path.iterdir())


def test_check_prints_a_table_of_the_stages(tmp_path: Path) -> None:
    done = called("check", tiny_file(tmp_path))
    assert done.returncode == 0
    for word in ("lock_check", "classical", "injection", "points", "peak current"):
        assert word in done.stdout


def test_a_procedure_can_be_printed_changed_and_used(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(called("procedures", "demo").stdout)
    assert called("check", mine).returncode == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "dmo"], ["dmo", "demo"]),
        (["run", "demo", "--set", "limits.current_a=4 V"], ["limits.current_a"]),
        (["run", "demo", "--set", "limits.currant_a=4"], ["currant_a", "current_a"]),
        (["run", "demo", "--set", "limits.current_a=.nan"], ["limits.current_a"]),
        (["run", "demo", "--set", "limits.current_a=400"], ["current"]),
        (["run", "demo", "--set", "stages.0.kind=gates_of"], ["gates_off"]),
        (["run", "demo", "--drive", "simulate"], ["simulate", "simulated"]),
        (["run", "demo", "--set", "drive.plnt=1"], ["plnt", "plant"]),
        (["run", "demo", "--set", "drive.watchdog_s=null"], ["watchdog"]),
        (["run", "demo", "--nonsense"], ["--nonsense"]),
        (["check", "nowhere.yaml"], ["nowhere.yaml"]),
        (["estimate", "nowhere"], ["nowhere"]),
        (["resume", "nowhere"], ["nowhere"]),
        (["schema", "recordin"], ["recording"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_left_behind(words: list[str], message: list[str], tmp_path: Path) -> None:
    assert_one_line(called(*words, cwd=tmp_path), 2, *message)
    assert not list(tmp_path.rglob("*.json*"))


def test_a_procedure_for_another_motor_is_refused(tmp_path: Path) -> None:
    procedure = tiny_file(tmp_path, drive={"plant": {"magnetics": {"kind": "map", "name": "baldor-5k6"}}})
    assert_one_line(called("check", procedure), 2, "400 W test PMSM")


@pytest.mark.usefixtures("undrawn")
def test_a_run_ends_with_its_numbers_and_where_they_are(tmp_path: Path) -> None:
    done = called("run", tiny_file(tmp_path), "--out", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout
    assert str(tmp_path / "run") in done.stdout
    for name in ("run.json", "journal.jsonl", "recording.json", "report.html", "results/flux_map.nc"):
        assert (tmp_path / "run" / name).is_file(), name
    report = json.loads((tmp_path / "run" / "results" / "estimates.json").read_text())
    assert report["resistance"]["value_ohm"] == pytest.approx(4.25, rel=0.1)
    assert report["method"] in ("energy", "injection")


def test_a_fault_ends_with_3_and_one_line(tmp_path: Path) -> None:
    procedure = tiny_file(tmp_path, drive={"faults": [{"kind": "trip", "cause": "overcurrent", "at_excitation": 5}]})
    done = called("run", procedure, "--out", tmp_path / "run", "--quiet")
    assert_one_line(done, 3, "overcurrent", f"fluxbench resume {tmp_path / 'run'}")


@pytest.mark.slow
def test_an_estimate_of_a_recording_that_may_not_be_written_goes_elsewhere(tmp_path: Path) -> None:
    source = Path(__file__).parents[3] / "data" / "pm400-reduced"
    copy = tmp_path / "read-only"
    shutil.copytree(source, copy)
    before = sorted(path.relative_to(copy) for path in copy.rglob("*"))
    done = called("estimate", copy, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "results" / "flux_map.nc").is_file()
    assert sorted(path.relative_to(copy) for path in copy.rglob("*")) == before


def test_a_damaged_capture_is_named(tmp_path: Path) -> None:
    run_tiny(tmp_path, stages=STAGES[:-1])
    capture = tmp_path / "run" / "captures" / "injection-002.parquet"
    capture.write_bytes(capture.read_bytes()[:-100])
    assert_one_line(called("estimate", tmp_path / "run"), 2, "injection-002.parquet")
    assert not (tmp_path / "run" / "results").exists()


def test_plugins_are_listed_with_where_they_are_from() -> None:
    rows = json.loads(called("plugins", "--json").stdout)
    assert all(row["loads"] for row in rows), rows
    assert all(row["summary"].endswith(".") for row in rows if row["kind"] == "effects")
    assert {"simulated", "injection", "classical", "resistance", "console", "report"} <= {row["name"] for row in rows}


@pytest.mark.parametrize("name", ["procedure", "motor", "recording", "mapping", "run", "estimates", "drive simulated"])
def test_schemas_are_json_schemas(name: str) -> None:
    schema = json.loads(called("schema", *name.split()).stdout)
    assert schema["type"] == "object"
    assert schema["properties"]


@pytest.mark.usefixtures("undrawn")
def test_a_plugin_s_command_is_one_of_the_commands(tmp_path: Path) -> None:
    assert "report" in called("--help").stdout
    assert "Write the report of a run" in called("report", "--help").stdout
    data = Path(__file__).parents[3] / "data" / "pm400-reduced"
    done = called("report", data, "--out", tmp_path / "page.html")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "page.html").read_text().startswith("<!DOCTYPE html>")
    assert_one_line(called("report", tmp_path / "nowhere"), 2, "nowhere")


def test_a_command_that_is_named_waits_for_no_description_of_the_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def described(_: object) -> str:
        raise AssertionError("described")

    monkeypatch.setattr("orchestrator.interface.cli._foreign.described", described)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))  # where the traceback goes
    assert called("procedures").returncode == 0
    assert "AssertionError: described" in called("--help").stderr


def test_an_effect_in_a_file_of_one_s_own_is_held_against_the_contract(tmp_path: Path) -> None:
    data = Path(__file__).parents[3] / "data" / "pm400-reduced"
    mine = tmp_path / "mine.py"
    mine.write_text("class Half:\n    name = 'half'\n\n    def correct(self, signals, p):\n        return signals\n")
    assert_one_line(called("compare", data, "--effects", mine, "--out", tmp_path), 2, "mine.py", "summary")
    mine.write_text("raise SystemExit('boom')\n")
    assert_one_line(called("compare", data, "--effects", mine, "--out", tmp_path), 2, "mine.py", "boom")


@pytest.mark.parametrize("command", ["compare", "diagnose"])
def test_an_effect_s_method_that_nothing_calls_ends_a_command_in_one_line(command: str, tmp_path: Path) -> None:
    data = Path(__file__).parents[3] / "data" / "pm400-reduced"
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT_WITH_A_METHOD.format(method="random_direction"))
    reported = ("plugin 'mine'", "mine.py", "'random_direction' is never called", "did you mean 'random_directions'?")
    assert_one_line(called(command, data, "--effects", mine, "--out", tmp_path), 2, *reported)


EFFECT_WITH_A_METHOD = """
from protocols import Correction, EffectLayer, EffectParameters, amplitude


class Mine:
    name = summary = signature = gauge = "mine"
    layer = EffectLayer.INVERTER
    needs = ()

    class Parameters(EffectParameters):
        offset_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-5.0, high=5.0)

    def correct(self, signals, p):
        return Correction()

    def {method}(self, signals, p):
        return [Correction()]
"""


def test_a_comparison_is_the_contract_s_json(tmp_path: Path) -> None:
    data = Path(__file__).parents[3] / "data" / "pm400-reduced"
    done = called("compare", data, "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    names = ("recording", "model", "noise_floor", "chi2", "stages", "worst", "parity", "crossings", "notes")
    assert set(names) <= set(report)
    assert report["chi2"] < 2


@pytest.mark.usefixtures("undrawn")
def test_a_map_leaves_and_comes_back(tmp_path: Path) -> None:
    motor = tmp_path / "motor.yaml"
    motor.write_text("motor: {name: test, pole_pairs: 2}\n")
    flux_map = tmp_path / "flux_map.nc"
    save_flux_map(flux_map, saturated_map(nodes=9), motor="test")
    done = called("export", flux_map, "--motor", motor, "--format", "csv", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "flux_map.csv").is_file()
    assert_one_line(called("export", flux_map, "--out", tmp_path / "out"), 2, "--motor")
    files = ("--repair", tmp_path / "repaired.nc", "--picture", tmp_path / "map.svg")
    audited = json.loads(called("audit", flux_map, *files, "--json").stdout)
    assert {"faults", "reciprocity_percent", "non_convex", "repair"} <= set(audited)
    assert "no fault found" in called("audit", tmp_path / "repaired.nc").stdout
    assert (tmp_path / "map.svg").read_text().startswith("<?xml")
    assert_one_line(called("audit", flux_map, "--picture", tmp_path / "map.gif"), 2, "--picture")


@pytest.mark.slow
def test_two_runs_into_one_directory_leave_one_of_them_whole(tmp_path: Path) -> None:
    procedure = tiny_file(tmp_path, stages=STAGES[:1])
    runs = [start_fluxbench("run", procedure, "--out", tmp_path / "run", "--quiet") for _ in range(2)]
    message = [run.communicate(timeout=120)[1] for run in runs]
    assert {run.returncode for run in runs} == {0, 2}, message
    assert len(open_recording(tmp_path / "run").segments()) == 1


def test_a_run_prints_its_estimates_as_json(tmp_path: Path) -> None:
    stages = [*STAGES[:6], {"kind": "estimate", "estimators": ["resistance"]}]
    done = called("run", tiny_file(tmp_path, stages=stages), "--out", tmp_path / "run", "--json")
    found = json.loads(done.stdout)
    assert found["outcome"] == "finished"
    assert found["estimates"]["resistance"]["value_ohm"] == pytest.approx(4.25, rel=0.1)


def test_a_run_whose_journal_or_procedure_was_tampered_with_is_not_resumed(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run_tiny(tmp_path, stages=STAGES[:1])
    record = (run / "run.json").read_text()
    (run / "run.json").write_text(record.replace('"current_a": 4.5', '"current_a": 6.5'))
    assert_one_line(called("resume", run), 2, "procedure_sha256")
    (run / "run.json").write_text(record)
    (run / "journal.jsonl").unlink()
    assert_one_line(called("resume", run), 2, "journal.jsonl")


def test_with_out_nothing_is_written_into_a_run(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run_tiny(tmp_path, stages=[*STAGES[:4], *STAGES[5:7]])
    (run / "recording.json").unlink()
    before = sorted(run.rglob("*"))
    words = ("--estimator", "resistance", "--estimator", "injection")
    assert called("estimate", run, *words, "--out", tmp_path / "elsewhere").returncode == 0
    assert sorted(run.rglob("*")) == before


def test_check_numbers_stages_as_a_run_does_and_says_how_they_are_written(tmp_path: Path) -> None:
    lines = called("check", tiny_file(tmp_path)).stdout.splitlines()
    (line,) = [line for line in lines if "injection" in line]
    assert line.split()[:3] == ["8", "injection", "stages.7"]
    settings = ("--set", "stages.7.amplitudes_v=[20]")
    assert called("check", tiny_file(tmp_path), *settings).returncode == 0


@few(
    "unbuffered, words",
    [
        ("", ("procedures",)),
        ("1", ("procedures",)),
        *(
            pytest.param(unbuffered, words, marks=pytest.mark.slow)
            for unbuffered in ("", "1")
            for words in (("check", "demo"), ("plugins", "--json"))
        ),
    ],
)
def test_an_output_that_cannot_be_written_is_one_line(unbuffered: str, words: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [FLUXBENCH, *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )
    assert (done.returncode, done.stderr.count("\n")) == (3, 1), done.stderr
    assert "standard output" in done.stderr


@pytest.mark.parametrize("out", ["file", "file/below"])
def test_a_run_into_a_file_is_refused(out: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    done = called("run", tiny_file(tmp_path), "--out", tmp_path / out)
    assert_one_line(done, 2, str(tmp_path / "file"), "not a directory")
    (tmp_path / "runs").write_text("mine")
    assert_one_line(called("run", tiny_file(tmp_path), cwd=tmp_path), 2, "runs", "not a directory")


@pytest.mark.slow
def test_results_that_are_a_file_are_refused(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run_tiny(tmp_path, stages=STAGES[:-1])
    (run / "results").write_text("mine")
    assert_one_line(called("estimate", run), 2, "results", "not a directory")


def test_a_manifest_that_is_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "recording.json")
    assert_one_line(called("estimate", tmp_path), 2, "recording.json", "not a plain file")


@pytest.mark.parametrize(
    "setting",
    ["motor.d_inductance_h=2e-8", "motor.rated_current_rms_a=2e-3", "motor.stator_resistance_ohm=9e4"],
)
def test_a_nameplate_that_makes_no_motor_is_one_line_of_bad_input(setting: str, tmp_path: Path) -> None:
    assert_one_line(called("check", "demo", "--set", setting, cwd=tmp_path), 2)


def test_a_finished_run_has_nothing_left_to_resume(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run_tiny(tmp_path, stages=STAGES[:1])
    done = called("resume", run)
    assert (done.returncode, done.stderr) == (0, "")
    assert "nothing left to do" in done.stdout


def test_linear_algebra_gets_one_thread_unless_the_user_says_otherwise() -> None:
    code = "import os, sys, orchestrator.interface.cli as c; sys.argv = ['fluxbench', '--version']\ntry: c.main()\n"
    code += "except SystemExit: pass\nprint(os.environ['OPENBLAS_NUM_THREADS'])"
    for given, expected in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")):
        kept = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
        done = subprocess.run([sys.executable, "-c", code], env={**kept, **given}, capture_output=True, text=True)
        assert done.stdout.split()[-1] == expected, done.stderr

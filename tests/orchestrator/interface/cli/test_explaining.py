"""`fluxbench explain` from outside, and the reasons that `fluxbench diagnose` prints."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from orchestrator.diagnosis import SavedDiagnosis, judge, save_diagnosis
from orchestrator.diagnosis.fitting.progress import SearchRecorder
from orchestrator.formatting.sentences import typographic
from orchestrator.interface.cli import _diagnosis
from orchestrator.interface.cli._running import run_app
from plugins.streams.report._collect import Material, Paths
from plugins.streams.report._next_steps import next_steps
from protocols import DiagnosisReport, Remark, Usability
from tests.orchestrator.diagnosis.judgement.test_judge import a_record
from tests.plugins.streams.report.example_diagnosis import WORDS, a_comparison, a_diagnosis


def a_report() -> DiagnosisReport:
    recorder, record = SearchRecorder(), a_record()
    recorder.record("screen", ["dead_time"], measure="chi2", score=60000.0, threshold=32.0)
    recorder.record("add", ["dead_time"], measure="log_evidence", score=812.0, threshold=16.0, taken=True)
    judgement = judge(record)
    return a_diagnosis(
        reasons=judgement.reasons, verdict_record=record, search=recorder.events, reproduces_current_percent=0.4,
        map_error_percent=0.12,
    )  # fmt: skip


@pytest.fixture
def diagnosed(tmp_path: Path) -> Path:
    save_diagnosis(tmp_path, a_report(), WORDS, ())
    (tmp_path / "run.json").write_text("{}")
    return tmp_path


def test_without_options_the_search_is_a_sentence_for_each_decisive_step(
    diagnosed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app(["explain", str(diagnosed)]) == 0
    out = capsys.readouterr().out
    assert "  2. dead time is added" in out
    assert f"`fluxbench explain {diagnosed} --steps` lists all 2 steps" in out
    assert "needed" not in out


def test_the_reasons_come_first_then_the_search_then_each_effect(
    diagnosed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app(["explain", str(diagnosed), "--steps"]) == 0
    out = capsys.readouterr().out
    first, second, *_ = out.splitlines()
    assert first.startswith(f"{diagnosed}: explained")
    assert (
        second
        == "  chi2 per degree of freedom of the fitted stages fell from 900 to 1.01; noise alone makes up to 1.08."
    )
    rows = [" ".join(line.split()) for line in out.splitlines()]
    assert "step move recording effects gain needed chi2 outcome" in rows
    assert "2 add whole dead time 812 nat 16 nat – accepted" in rows
    assert "log evidence in nat: 5 nat are odds of 150 to 1; each sample adds to it" in out
    assert "screen: the fall of chi2 that each absent effect promises" in out
    assert "above 100 %" not in out
    assert out.index("812 nat") < out.index("indistinguishable from") < out.rindex("device drop")


def test_what_to_do_now_is_what_the_report_says(diagnosed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved = SavedDiagnosis(a_report(), WORDS, ())
    lines = next_steps(Material(diagnosed, None, None, (), None, {}, Paths(), saved, ()))
    assert run_app(["explain", str(diagnosed)]) == 0
    said = capsys.readouterr().out.partition("what to do now:\n")[2].replace(str(diagnosed), diagnosed.name)
    assert said == "".join(f"  {line.label.lower()}: {line.text}\n" for line in lines)


def test_a_map_that_is_not_usable_is_not_advised_to_be_tuned_with(
    diagnosed: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    why = Remark(code="uncertain_map", text="the model's map is uncertain")
    poor = SimpleNamespace(
        usable=False, usability=Usability.NOT_USABLE, model=None, estimators=None, method="model", remarks=(why,)
    )
    monkeypatch.setattr("orchestrator.estimation.load_estimates", lambda _: poor)
    assert run_app(["explain", str(diagnosed)]) == 0
    out = capsys.readouterr().out
    assert "the map: do not rely on it: the model's map is uncertain." in typographic(out).replace("’", "'")
    assert "`fluxbench tune" not in out


def test_what_the_whole_recording_separates_is_said_beside_the_evidence(
    diagnosed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    remark = Remark(code="separated", text="voltage delay and current filter are separated, by 6 sigma")
    save_diagnosis(diagnosed, a_report().model_copy(update={"remarks": (remark,)}), WORDS, ())
    assert run_app(["explain", str(diagnosed)]) == 0
    assert "note: voltage delay and current filter are separated, by 6 sigma" in capsys.readouterr().out


def test_a_share_above_the_whole_error_is_explained_below_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    effect = a_report().effects[0].model_copy(update={"share": 2.29})
    save_diagnosis(tmp_path, a_report().model_copy(update={"effects": (effect,)}), WORDS, ())
    assert run_app(["explain", str(tmp_path)]) == 0
    assert "note: error without it above 100 %: without this effect" in capsys.readouterr().out


def test_what_an_effect_remarks_is_told_and_a_folder_of_results_names_the_recording(
    diagnosed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    remark = Remark.of("leg_differs", "leg b's is 33 % longer").by("dead_time")
    save_diagnosis(diagnosed, a_report().model_copy(update={"remarks": (remark,)}), WORDS, ())
    (diagnosed / "run.json").unlink()
    assert run_app(["explain", str(diagnosed)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "note: dead_time: leg b's is 33 % longer" in out
    assert "the map: none yet: `fluxbench estimate RECORDING` makes it" in out
    assert f"RECORDING is that of {a_report().recording!r}" in out


def test_programs_get_verdict_reasons_record_and_search(diagnosed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["explain", str(diagnosed), "--json"]) == 0
    result, report = json.loads(capsys.readouterr().out), a_report().model_dump(mode="json")
    for name in ("verdict", "reasons", "verdict_record"):
        assert result[name] == report[name]
    assert [event["move"] for event in result["search"]] == ["screen", "add"]
    assert result["effects"][0]["steps"] == [2]


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ("runs/first", "has no diagnosis yet; run `fluxbench diagnose"),
        ("runs/first.sealed", "neither a run nor a recording: it has no run.json and no recording.json"),
        ("runs", "a folder of runs, not a run; `fluxbench runs --folder"),
        ("nowhere", "no such directory"),
    ],
)
def test_without_a_diagnosis_there_is_one_line(
    place: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("first", "first.sealed"):
        (tmp_path / "runs" / name).mkdir(parents=True)
    (tmp_path / "runs" / "first" / "run.json").write_text("{}")
    assert run_app(["explain", str(tmp_path / place)]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.count("\n") == 1
    assert problem in err


def test_a_diagnosis_of_an_older_version_says_that_it_has_no_reasons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_diagnosis(tmp_path, a_diagnosis(), WORDS, ())
    assert run_app(["explain", str(tmp_path)]) == 0
    assert "kept no reasons" in capsys.readouterr().out


def test_an_output_without_unicode_gets_a_table_all_the_same(
    diagnosed: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with (tmp_path / "out").open("w", encoding="ascii") as narrow:
        monkeypatch.setattr("sys.stdout", narrow)
        assert run_app(["explain", str(diagnosed), "--steps"]) == 0
    assert "812 nat" in (tmp_path / "out").read_text("ascii")
    assert "?" not in (tmp_path / "out").read_text("ascii")


def test_diagnose_prints_the_reasons_below_the_verdict_and_how_well_the_model_does(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _diagnosis._print_diagnosis(Path("runs/mine"), a_report(), WORDS)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "runs/mine: explained"
    assert lines[1].startswith("  chi2 per degree of freedom of the fitted stages fell from 900 to 1.01")
    assert any("0.4 % of its range" in line for line in lines)
    assert any("±0.12 % of the rated flux" in line for line in lines)


def test_an_effect_that_is_no_cause_has_its_parameters_in_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    small = a_report().effects[0].model_copy(update={"name": "eddy_currents"})
    _diagnosis._print_diagnosis(Path("runs/mine"), a_report().model_copy(update={"minor": (small,)}), WORDS)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["eddy_currents", "voltage", "400.0", "mV", "399.0", "to", "401.0"] in rows


def test_compare_says_what_chi2_is_and_that_its_currents_are_means(capsys: pytest.CaptureFixture[str]) -> None:
    _diagnosis._print_comparison(Path("runs/mine"), a_comparison())
    out = capsys.readouterr().out
    assert "chi2 is the squared error over the noise's variance: 1 is noise alone. Slow errors weigh most" in out
    assert ["worst", "PWM", "mean", "i_d", "mean", "i_q", "rms", "error", "noise", "floor"] in map(
        str.split, out.splitlines()
    )


def test_compare_has_the_noise_beside_each_error_and_over_all_stages(capsys: pytest.CaptureFixture[str]) -> None:
    report = a_comparison()
    stages = [
        stage.model_copy(update={"noise_rms_v": 0.0005, "pwm_frequency_hz": 1e4, "chi2_of_noise": 6.91})
        for stage in report.stages
    ]
    _diagnosis._print_comparison(
        Path("mine"), report.model_copy(update={"rms_v": 1.9, "heldout_rms_v": 1.8, "stages": tuple(stages)})
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[4].split() == ["injection", "10", "kHz", "1.7", "V", "500", "µV", "40000", "6.91", "60", "mA"]
    assert "over all stages: error 1.9 V, noise floor 3.45 mV, chi2 54890" in lines
    assert "of these, the stages that are not fitted (held out) have the error 1.8 V" in lines

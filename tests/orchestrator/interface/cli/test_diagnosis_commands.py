"""`compare`, `diagnose`, `add` and `remove` from outside: wrong words, wrong files and what cannot be kept."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from orchestrator.interface.cli._running import run_app
from tests.support.cases import few

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"
EFFECT = """
from protocols import Correction, EffectLayer, EffectParameters, amplitude

class Mine:
    name = "mine"
    summary = signature = "mine"
    layer = EffectLayer.INVERTER
    needs = ()
    gauge = ""

    class Parameters(EffectParameters):
        offset_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-5.0, high=5.0)

    def correct(self, signals, p):
        {body}
"""


UNDER_WAY = (
    "reading ", "checking signs", "estimating the noise", "fitting the", "testing a finer map",
    "computing the intervals",
)  # fmt: skip
"""How lines begin that a command may have printed before it is refused; none of them is a result."""


def refused(capsys: pytest.CaptureFixture[str], code: int, *words: str | Path) -> str:
    """Run a command that is refused with this exit code; its one line, beside what it says is under way."""
    assert run_app(list(map(str, words))) == code
    out, err = capsys.readouterr()
    assert all(line.startswith(UNDER_WAY) for line in out.splitlines())
    assert err.startswith("fluxbench: ")
    assert err.count("\n") == 1
    return err


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A directory with a `model.json` that could be right."""
    model = {
        "format": "fluxbench-model", "version": 2, "recording": "r", "baseline": {"kind": "saturated"}, "r_s_ohm": 4.0,
        "motor": {"name": "m", "pole_pairs": 2}, "pm_flux_wb": 0.3, "effects": [],
        "ladder": [{"added": None, "chi2": 1.0, "rms_v": 1.0, "heldout_rms_v": 1.0, "current_rms_a": 1.0}],
        "magnetics": {"d_low_a": -3.0, "d_high_a": 3.0, "q_high_a": 3.0, "d_intervals": 1, "q_intervals": 1,
                      "coefficients_j": [0.0] * 18},
    }  # fmt: skip
    (tmp_path / "model.json").write_text(json.dumps(model))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["add", DATA, "dead_tme"], "dead_tme: no such effect; did you mean 'dead_time'?"),
        (["add", DATA, "xyz"], "no such effect; valid: "),
        (["add", DATA, "dead_time,xyz"], "xyz: no such effect"),
        (["add", DATA, ","], "expected names of effects, separated by spaces or commas"),
        (["diagnose", DATA, "--without", "dead_tme"], "no such effect; did you mean 'dead_time'?"),
        (["diagnose", "nowhere"], "nowhere"),
        (["diagnose", DATA / "recording.json" / "x"], "x"),
        (["diagnose", Path(__file__)], "is a file; expected the directory of a run or recording"),
        (["compare", "/dev/null"], "is a file"),
        (["diagnose"], "RECORDING"),
        (["diagnose", DATA, "--out", Path(__file__)], "is not a directory"),
        (["diagnose", DATA, "--model", "staurated"], "neither linear, saturated nor a file; did you mean 'saturated'?"),
        (["compare", DATA, "--model", "free"], "nor a file; a file ends in .nc"),
        (["diagnose", DATA, "--effects", "nowhere.py"], "nowhere.py"),
        (
            ["check", "demo", "--drive", "serial"],
            "`--set drive.port=/dev/ttyUSB0` gives it, and `fluxbench probe` lists",
        ),
        (["check", "demo", "--drive", "can"], "`--set drive.channel=can0` gives it"),
    ],
)
def test_wrong_words_are_one_line(words: list[str | Path], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert message in refused(capsys, 2, *words)


def test_an_empty_directory_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "recording.json" in refused(capsys, 2, "diagnose", tmp_path)
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "run.json").write_text("{}")
    assert "a folder of runs, not a run" in refused(capsys, 2, "diagnose", tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"r_s_ohm": "four"}, "model.json: r_s_ohm: expected a number"),
        ({"r_s_ohm": float("nan")}, "model.json: broken JSON: NaN is not a number here"),
        ({"baseline": "saturated"}, "model.json: baseline"),
        ({"baseline": {"kind": "saturatd"}}, "model.json: baseline.kind: unknown kind 'saturatd'; did you mean"),
        ({"ladder": []}, "model.json: ladder"),
        ({"magnetics": {}}, "model.json: magnetics.d_low_a: missing"),
        ({"ladder": [{"added": 1}]}, "model.json: ladder.0"),
        ({"colour": "red"}, "model.json: colour: unknown key"),
        ({"version": 1}, "model.json: version: version 2 can be read, got 1; `fluxbench diagnose` writes it again"),
    ],
)
def test_a_field_of_model_json_is_named(
    change: dict[str, object], message: str, kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = kept / "model.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    assert message in refused(capsys, 2, "remove", DATA, "dead_time", "--out", kept)


@pytest.mark.parametrize(
    ("text", "message"),
    [("{", "model.json:1: broken JSON"), ("[1]", "expected a JSON object, got list"), ("\xff", "not UTF-8 at byte 0")],
)
def test_a_model_json_that_is_none_is_stated(
    text: str, message: str, kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (kept / "model.json").write_bytes(text.encode("latin-1"))
    assert message in refused(capsys, 2, "remove", DATA, "dead_time", "--out", kept)


@pytest.mark.slow
def test_what_cannot_be_kept_was_not_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "model.json").mkdir()
    assert "model.json was not written" in refused(capsys, 3, "add", DATA, "dead_time", "--out", tmp_path)


@pytest.mark.slow
def test_compare_says_where_there_is_no_model_to_take(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["compare", str(DATA), "--out", str(tmp_path)]) == 0
    assert f"no model.json in {tmp_path}" in capsys.readouterr().out


def test_an_effect_that_writes_into_the_recording_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body="signals.v_ab[:] = 0.0\n        return Correction(v_ab=signals.v_ab)"))
    message = refused(capsys, 2, "add", DATA, "mine", "--effects", mine, "--out", tmp_path / "out")
    assert "mine: correct: writes into the signals" in message
    assert not (tmp_path / "out").exists()


@few(
    "body, message",
    [
        ("raise SystemExit(7)", "correct: SystemExit: 7"),
        ("return None", "returned NoneType"),
        ("return signals", "returned Signals"),
        ("return Correction(v_ab=signals.v_ab[:5])", "v_ab has shape (5, 2)"),
        ("return Correction(v_ab=signals.v_ab * float('nan'))", "v_ab is not finite"),
        ("return Correction(v_ab=signals.v_ab * 1j)", "v_ab is of type complex128"),
        ("return Correction(v_ab=signals.v_ab.tolist())", "v_ab has shape None"),
    ],
)
def test_an_effect_that_returns_no_correction_is_named(
    body: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body=body))
    assert message in refused(capsys, 2, "add", DATA, "mine", "--effects", mine, "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('name = "mine"', 'name = "dead_time"'), "dead_time: an effect of that name exists already"),
        (('name = "mine"', 'name = "saturation"'), "saturation: an effect of that name exists already"),
        (('name = "mine"', 'name = "my-own"'), "my-own: a name has lower-case letters, digits and underscores"),
        (("typical=0.15", "typical=0.0"), "Mine.Parameters.offset_v: typical 0"),
        (('"V"', '"kV"'), "Mine.Parameters.offset_v: unit 'kV' cannot be scaled to a machine; expected a product"),
        (
            ("gauge = ", "def __init__(self):\n        raise OSError(5, 'no')\n\n    gauge = "),
            "cannot be created: OSError",
        ),
    ],
)
def test_an_effect_that_makes_no_candidate_is_named(
    change: tuple[str, str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body="return Correction()").replace(*change))
    assert message in refused(capsys, 2, "compare", DATA, "--effects", mine)


@pytest.mark.parametrize("command", ["compare", "diagnose", "estimate"])
def test_a_recording_that_cannot_be_a_motor_s_is_refused(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(DATA, copy)
    manifest = json.loads((copy / "recording.json").read_text())
    manifest["motor"]["rated_current_rms_a"] = 1e-3
    (copy / "recording.json").write_text(json.dumps(manifest))
    assert "times the rated current" in refused(capsys, 2, command, copy)
    assert not (copy / "results").exists()
    assert not (copy / "model.json").exists()


def test_an_own_effect_in_the_model_already_may_have_another_file_now(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body="return Correction()"))
    model = json.loads((kept / "model.json").read_text())
    voltage = {"value": 0.8, "low": 0.7993, "high": 0.801, "unit": "V", "fitted": True}
    model["effects"] = [
        {"name": "mine", "parameters": {"offset_v": voltage}, "relative_size": 0.14, "log_evidence": 9.0}
    ]
    (kept / "model.json").write_text(json.dumps(model))
    monkeypatch.setattr("orchestrator.diagnosis._refit.open_for_refit", None)  # a refit would fail
    assert run_app(["add", str(DATA), "mine", "--effects", str(mine), "--out", str(kept)]) == 0
    out = capsys.readouterr().out
    assert "file has changed since: `fluxbench remove` it first, then `add` fits it again" in " ".join(out.split())


def test_what_is_in_the_model_already_is_said_without_a_refit(
    kept: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = json.loads((kept / "model.json").read_text())
    voltage = {"value": 0.8, "low": 0.7993, "high": 0.801, "unit": "V", "fitted": True}
    model["effects"] = [
        {"name": "dead_time", "parameters": {"voltage_v": voltage}, "relative_size": 0.14, "log_evidence": 9.0}
    ]
    (kept / "model.json").write_text(json.dumps(model))
    before = (kept / "model.json").read_bytes()
    monkeypatch.setattr("orchestrator.diagnosis._refit.open_for_refit", None)  # a refit would fail
    assert run_app(["add", str(DATA), "dead_time", "--out", str(kept)]) == 0
    out = capsys.readouterr().out
    assert "dead time is in the model already: voltage 800.0 mV (95 %: 799.3 to 801.0); nothing was fitted" in out
    assert (kept / "model.json").read_bytes() == before


@pytest.mark.slow
def test_a_model_is_held_against_a_recording_and_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["add", str(DATA), "voltage_bias", "--model", "linear", "--out", str(tmp_path)]) == 0
    file = str(tmp_path / "model.json")
    capsys.readouterr()
    assert run_app(["compare", str(DATA), "--model", file, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    kept = json.loads((tmp_path / "model.json").read_text())
    assert report["model"] == "linear + voltage_bias"
    assert [isinstance(effect["helps"], bool) for effect in kept["effects"]] == [True]
    assert report["chi2"] == pytest.approx(kept["ladder"][-1]["chi2"], rel=1e-9)
    assert run_app(["export", file, "--format", "csv", "--out", str(tmp_path / "export"), "--json"]) == 0
    assert 20.0 < json.loads(capsys.readouterr().out)["measured_percent"] < 100.0
    assert "none.json: cannot be read" in refused(capsys, 2, "compare", DATA, "--model", tmp_path / "none.json")


def test_an_effect_s_error_names_file_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body="return 1 / 0"))
    line = mine.read_text().splitlines().index("        return 1 / 0") + 1
    message = refused(capsys, 2, "add", DATA, "mine", "--effects", mine, "--out", tmp_path / "out")
    assert f"ZeroDivisionError: division by zero ({mine}, line {line})" in message


@few(
    "change, at, message",
    [
        (('"V"', '"Vs^x"'), "    class Parameters", "unit 'Vs^x' cannot be scaled"),
        (("BODY", "return Correction(v_ab=signals.v_ab[:, :1])"), "    def correct", "v_ab has shape"),
        (("BODY", "return signals"), "    def correct", "returned Signals, no Correction"),
        (('    gauge = ""', ""), "class Mine", "attribute 'gauge' is missing"),
    ],
    fast=2,
)
def test_an_effect_s_fault_names_its_line_in_the_file(
    change: tuple[str, str], at: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body="BODY").replace(*change))
    line = 1 + next(k for k, text in enumerate(mine.read_text().splitlines()) if text.startswith(at))
    problem = refused(capsys, 2, "add", DATA, "mine", "--effects", mine, "--out", tmp_path / "out")
    assert message in problem
    assert f"({mine}, line {line})" in problem
    assert "?" not in problem
    assert "protocols" not in problem


@pytest.mark.slow
def test_a_comparison_says_whether_a_candidate_helps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(EFFECT.format(body="return Correction(v_ab=signals.v_ab - [p.offset_v, 0.0])"))
    assert run_app(["compare", str(DATA), "--effects", str(mine), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert {"helps", "does_not_help"} & {remark["code"] for remark in report["remarks"]}

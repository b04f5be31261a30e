"""`fluxbench discover` from outside: what it prints, what it stores, and how `diagnose` offers it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from orchestrator.discovery import Discovery, FoundForm, FoundLaw, Learned, load_discovery, save_discovery
from orchestrator.discovery.report import Constant, CurvePoint, RankedHypothesis
from orchestrator.interface import api
from orchestrator.interface.cli import _diagnosis
from orchestrator.interface.cli._running import run_app
from protocols import InputError, RecordingError
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis


def a_law() -> FoundLaw:
    size = Constant(name="size_v", value=0.3, low=0.29, high=0.31, unit="V")
    knee = Constant(name="scale_a", value=0.4, low=0.39, high=0.41, unit="A")
    form = FoundForm(
        name="tanh", formula="a tanh(i / b)", constants=(size, knee), chi2=1.02, heldout=1.01, heldout_rms_v=4e-3,
        log_evidence=0.0,
    )  # fmt: skip
    return FoundLaw(
        name="mine", sentence="A voltage that each leg loses, as a function of its own current.", place="leg_voltage",
        quantity="phase_currents", phase="", unit="V", quantity_unit="A", symbol="i", forms=(form,),
        curve=tuple(CurvePoint(x=x, y=0.1 * x, std=0.01) for x in (-1.0, 0.0, 1.0)),
        as_well=("device drop of the library",), gauge="A part counts as R_s.",
        to_decide="measure at its own current = 6 A",
    )  # fmt: skip


def a_discovery(**changes: Any) -> Discovery:
    ranked = RankedHypothesis(
        place="leg_voltage", quantity="phase_currents", phase="", kind="odd", log_evidence=812.0, share=0.99
    )
    found = Discovery(
        recording="first", outcome="law", reason="the held-out error falls from 9 to 1.01 times its noise",
        verdict="unknown_remains", before=9.0, after=1.01, before_rms_v=0.09, after_rms_v=4e-3, floor_rms_v=3.9e-3,
        chi2_before=80.0, chi2_after=1.02, laws=(a_law(),), ranking=(ranked,), kept_effects=(), seconds=1.0,
    )  # fmt: skip
    return found.model_copy(update=changes)


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the command asks of the Python door; `result` is what it gets."""
    called: dict[str, Any] = {"result": a_discovery()}

    def discover(place: Path, **options: Any) -> Discovery:
        called.update(options, place=place)
        result: Discovery = called["result"]
        return result

    monkeypatch.setattr(api, "discover", discover)
    return called


def test_it_prints_where_the_law_is_its_form_and_the_fall_of_the_error(
    found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app(["discover", "runs/first", "--write", "mine.py", "--name", "knee"]) == 0
    assert (found["place"], found["write"], found["name"]) == (Path("runs/first"), Path("mine.py"), "knee")
    out = capsys.readouterr().out
    rows = [" ".join(line.split()) for line in out.splitlines()]
    assert "runs/first: a law that no effect of the library has" in rows
    assert "leg voltage phase currents all odd 812 99.0 %" in rows
    assert "y = a tanh(i / b) size_v 300 mV, scale_a 400 mA 1.01 1.02" in rows
    assert "before 90 mV 9 80" in rows
    assert "with the law 4 mV 1.01 1.02" in rows
    assert "note: as well: device drop of the library" in rows
    assert "note: A part counts as R_s." in rows
    assert "note: to decide: measure at its own current = 6 A" in rows
    assert out.endswith("`fluxbench add runs/first mine --effects mine.py` adds it to the model\n")


def test_effects_that_stood_in_for_the_law_are_to_be_removed_after_it_is_added(
    found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    found["result"] = a_discovery(stood_in=("bus_sag",))
    assert run_app(["discover", "runs/first", "--write", "mine.py"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "adds it to the model; then `fluxbench remove runs/first bus_sag --effects mine.py`: the law stands" in out


def test_a_first_row_that_is_not_the_law_has_its_reason(
    found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    ranked = found["result"].ranking[0]
    assert run_app(["discover", "runs/first"]) == 0
    assert "was kept" not in capsys.readouterr().out
    found["result"] = a_discovery(ranking=(ranked.model_copy(update={"quantity": "time"}), ranked))
    assert run_app(["discover", "runs/first"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    kept = "leg voltage over phase currents in all phases was kept instead of leg voltage over time in all phases"
    assert f"As formulas on the whole of it, {kept}: it leaves less" in out


def test_a_law_of_other_phases_than_the_first_row_has_its_reason_too(
    found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    ranked = found["result"].ranking[0]
    found["result"] = a_discovery(ranking=(ranked.model_copy(update={"phase": "a"}),))
    assert run_app(["discover", "runs/first"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "in all phases was kept instead of leg voltage over phase currents in phase a: it leaves less" in out


def test_without_write_it_says_how_to_write(found: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["discover", "runs/first"]) == 0
    assert "`fluxbench discover runs/first --write FILE.py` writes it as an effect." in capsys.readouterr().out


@pytest.mark.parametrize(("outcome", "words"), [("nothing_to_learn", "nothing to learn"), ("no_law", "no law found")])
def test_without_a_law_it_says_why_and_prints_no_form(
    outcome: str, words: str, found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    found["result"] = a_discovery(outcome=outcome, reason="noise explains it", laws=())
    assert run_app(["discover", "runs/first", "--write", "mine.py"]) == 0
    out = capsys.readouterr().out
    assert f"runs/first: {words}" in out
    assert "Noise explains it." in out
    assert out.endswith("mine.py was not written: there is no law to write\n")


def test_programs_get_the_report(found: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["discover", "runs/first", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == a_discovery().model_dump(mode="json")


def test_report_and_picture_are_stored_and_an_old_picture_does_not_stay(tmp_path: Path) -> None:
    save_discovery(tmp_path, Learned(a_discovery(), "text"))
    stored = (tmp_path / "results" / "discovery.json").read_text(encoding="utf-8")
    assert Discovery.model_validate_json(stored) == load_discovery(tmp_path) == a_discovery()
    assert (tmp_path / "results" / "discovery.svg").read_bytes().lstrip().startswith(b"<?xml")
    save_discovery(tmp_path, Learned(a_discovery(outcome="no_law", laws=())))
    assert not (tmp_path / "results" / "discovery.svg").exists()


def test_a_report_that_is_damaged_is_refused_and_one_that_is_missing_is_none(tmp_path: Path) -> None:
    assert load_discovery(tmp_path) is None
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "discovery.json").write_text("{", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"discovery\.json.*writes it anew"):
        load_discovery(tmp_path)


def test_a_diagnosis_offers_it_only_where_something_unknown_remains(capsys: pytest.CaptureFixture[str]) -> None:
    offer = "`fluxbench discover runs/mine` looks for the law that is missing, and writes it as an effect."
    report = a_diagnosis()
    _diagnosis._print_diagnosis(Path("runs/mine"), report.model_copy(update={"verdict": "explained"}), WORDS)
    assert offer not in capsys.readouterr().out
    _diagnosis._print_diagnosis(Path("runs/mine"), report.model_copy(update={"verdict": "unknown_remains"}), WORDS)
    assert capsys.readouterr().out.endswith(offer + "\n")


def test_a_file_in_the_place_of_the_results_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.py"):
        api.discover(tmp_path, write=tmp_path / "mine.txt")


def test_the_next_command_keeps_the_options_and_what_the_library_has_is_named(
    found: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found["result"] = a_discovery(laws=(a_law().model_copy(update={"library": ("device_drop",)}),))
    given = ["--without", "dead_time", "--out", str(tmp_path)]
    assert run_app(["discover", "first", *given]) == 0
    out = capsys.readouterr().out
    assert f"`fluxbench discover first --write FILE.py --without dead_time --out {tmp_path}` writes it" in out
    assert f"like device drop, which the library has: `fluxbench add first device_drop --out {tmp_path}` first" in out
    assert run_app(["discover", "first", *given, "--write", "mine.py"]) == 0
    assert f"`fluxbench add first mine --effects mine.py --out {tmp_path}` adds it" in capsys.readouterr().out


def test_without_a_law_it_says_what_to_measure_and_to_try(
    found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    found["result"] = a_discovery(outcome="no_law", laws=())
    assert run_app(["discover", "first"]) == 0
    out = capsys.readouterr().out
    assert "no place fits: the first row, leg voltage over phase currents, removes 99 % of the error" in out
    assert "to measure next" not in out
    assert "`fluxbench new effect NAME`" in out
    first = found["result"].ranking[0]
    rival = first.model_copy(update={"phase": "b", "share": 0.8})
    found["result"] = a_discovery(outcome="no_law", laws=(), ranking=(first, rival))
    assert run_app(["discover", "first"]) == 0
    out = capsys.readouterr().out
    assert "to measure next: the rotor locked at a second angle" in out
    assert "that tells the first row from leg voltage over phase currents in phase b" in out


def test_where_a_verdict_is_explained_a_doubted_cause_can_be_left_out(
    found: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    found["result"] = a_discovery(outcome="nothing_to_learn", laws=(), kept_effects=("eddy_currents", "dead_time"))
    assert run_app(["discover", "first"]) == 0
    out = capsys.readouterr().out
    assert "if you doubt a named cause (eddy currents and dead time): `fluxbench discover first --without eddy" in out

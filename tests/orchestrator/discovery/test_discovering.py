"""A hidden law is found, written and named rightly; where there is nothing to learn, nothing is written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fluxbench
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import fit_baseline
from orchestrator.discovery import Learned, discover_laws, require_name, write_law
from orchestrator.discovery.discover import decisive_index
from orchestrator.discovery.search import SearchOutcome, learn_laws
from orchestrator.interface.api import chosen_effects
from orchestrator.recording import open_recording
from protocols import (
    DiagnosisReport,
    FluxbenchError,
    InputError,
    MotorModel,
    NoiseFloor,
    PluginError,
    StorageError,
)
from tests.laws.bench import record
from tests.laws.hidden import Hidden
from tests.laws.plant import GAIN_SETTLES, LOG_LEG, RESOLVER

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data" / "pm400-reduced"
LAWS = {
    "logarithm_in_one_leg": Hidden(LOG_LEG, "leg_voltage", "phase_currents", "b", (0.25, 0.2)),
    "one_gain_settles": Hidden(GAIN_SETTLES, "reading_gain", "time", "b", (0.02, 15.0)),
    "resolver_error": Hidden(RESOLVER, "angle", "rotor_angle", "", (0.03, 2.0)),
}


def learned_from(directory: Path, name: str) -> SearchOutcome:
    """What is learned beside R_s and map from a recording of the plant."""
    path = record(directory, LAWS[name], seed=3)
    setup = open_for_diagnosis(open_recording(path))
    return learn_laws(setup, fit_baseline(setup).model, (), "learned_law", lambda _: None)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["logarithm_in_one_leg", "one_gain_settles", "resolver_error"],
)
def test_a_hidden_law_is_found_at_its_place_over_its_quantity(name: str, tmp_path: Path) -> None:
    hidden = LAWS[name]
    outcome = learned_from(tmp_path, name)
    (law,) = outcome.laws
    best = law.best
    assert best.hypothesis.place.name == hidden.place
    assert best.hypothesis.quantity.name == hidden.quantity
    assert best.hypothesis.phases == {"": (1.0, 1.0, 1.0), "b": (0.0, 1.0, 0.0)}[hidden.phase]
    assert best.chi2 < 1.1
    assert best.error < 1.2
    values = [p.value for p in best.law.parameters] if best.law is not None else []
    if name == "resolver_error":
        # A phase and half a turn less is the negative size.
        values = [-values[0], values[1] + math.pi] if values[0] < 0.0 else values
        values[1] %= 2.0 * math.pi
    assert values == pytest.approx(list(hidden.constants), rel=0.05)


def _diagnosed(verdict: str) -> tuple[MotorModel, DiagnosisReport]:
    """What a diagnosis stored, as far as it is read where there is nothing to learn."""
    report: dict[str, Any] = {"recording": "pm400", "verdict": verdict, "effects": (), "ladder": ()}
    model: dict[str, Any] = {"effects": ()}
    return MotorModel.model_construct(**model), DiagnosisReport.model_construct(
        **report, noise_floor=NoiseFloor(rms_v=0.01)
    )


@pytest.mark.parametrize("verdict", ["clean", "explained", "explained_in_another_form"])
def test_an_explained_recording_teaches_nothing_and_nothing_is_written(verdict: str, tmp_path: Path) -> None:
    model, report = _diagnosed(verdict)
    found = discover_laws(open_recording(DATA), chosen_effects(), model, report)
    assert found.report.outcome == "nothing_to_learn"
    assert f"the verdict is {verdict.replace('_', ' ')}" in found.report.reason
    write_law(tmp_path / "mine.py", found)
    assert list(tmp_path.iterdir()) == []
    assert json.loads(found.report.model_dump_json())["laws"] == []


def test_a_recording_without_a_model_teaches_nothing() -> None:
    _, report = _diagnosed("convention")
    found = discover_laws(open_recording(DATA), chosen_effects(), None, report)
    assert found.report.reason == "nothing to learn here: the verdict is convention"


def test_a_law_is_written_to_its_file(tmp_path: Path) -> None:
    model, report = _diagnosed("clean")
    found = discover_laws(open_recording(DATA), chosen_effects(), model, report)
    write_law(tmp_path / "there" / "mine.py", Learned(found.report, "text"))
    assert (tmp_path / "there" / "mine.py").read_text(encoding="utf-8") == "text"


@pytest.mark.parametrize(
    ("name", "target", "words"),
    [
        ("mine", Path("mine.txt"), "its name ends in .py"),
        ("My Law", None, "no name for an effect"),
        ("2nd", None, "no name for an effect"),
        ("class", None, "no keyword of Python"),
        ("a" * 81, None, "more than 80 letters"),
        ("dead_time", None, "an effect of that name exists already"),
        ("mine", Path("/dev/null/mine.py"), "/dev/null is no folder to write to"),
        ("mine", Path("a" * 300 + "/mine.py"), "cannot be written: File name too long"),
    ],
)
def test_a_name_that_cannot_be_an_effects_is_refused(name: str, target: Path | None, words: str) -> None:
    with pytest.raises(InputError, match=words):
        require_name(name, target, {"dead_time"})


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="this system has no /proc")
def test_a_folder_that_takes_no_files_is_refused_whatever_its_permissions() -> None:
    with pytest.raises(InputError, match="/proc is no folder to write to"):
        require_name("mine", Path("/proc/none/mine.py"))


def test_a_file_that_exists_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        require_name("mine", tmp_path / "mine.py")


def test_a_link_to_nowhere_or_to_itself_is_no_target(tmp_path: Path) -> None:
    (tmp_path / "mine.py").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="exists already"):
        require_name("mine", tmp_path / "mine.py")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError, match="Too many levels of symbolic links"):
        require_name("mine", tmp_path / "loop" / "mine.py")


def test_a_file_that_another_made_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    model, report = _diagnosed("clean")
    found = discover_laws(open_recording(DATA), chosen_effects(), model, report)
    (tmp_path / "mine.py").write_text("another's")
    with pytest.raises(StorageError, match="exists already"):
        write_law(tmp_path / "mine.py", Learned(found.report, "text"))
    assert (tmp_path / "mine.py").read_text() == "another's"


def test_the_library_s_names_and_unknown_ones_are_refused_before_any_diagnosis(tmp_path: Path) -> None:
    for name in ("dead_time", "saturation"):
        with pytest.raises(InputError, match="exists already"):
            fluxbench.discover(DATA, name=name, out=tmp_path)
    with pytest.raises(PluginError, match="no such effect"):
        fluxbench.discover(DATA, without=["nothing_such"], out=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_recording_is_refused_in_one_line() -> None:
    with pytest.raises(FluxbenchError, match="nowhere"):
        fluxbench.discover("nowhere")


def test_forms_that_differ_by_less_than_their_size_is_known_are_not_to_be_decided() -> None:
    x = np.linspace(0.0, 1.0, 11)
    assert decisive_index(x, x + 0.01 * x**2, relative_error=0.02) is None
    assert decisive_index(x, x + 0.1 * x**2, relative_error=0.02) == 10

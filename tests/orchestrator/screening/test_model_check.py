"""Whether a model of few effects explains a recording, and has the map that was estimated from it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording, load_flux_map
from orchestrator.interface.api import chosen_effects
from orchestrator.screening import check_model
from plugins.effects.inverter import DeadTime
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import Capture, CheckOutcome, Estimator, FluxMap, MapCriteria, Usability, UsabilityCheck
from tests.plugins.estimators.recordings import behind_dead_time, classical_of, clean
from tests.support.rewriting import Rewritten


def checked(recording: Rewritten, flux_map: FluxMap) -> UsabilityCheck:
    return check_model(chosen_effects(), recording, flux_map, MapCriteria())


@cache
def right() -> Rewritten:
    return Rewritten.of(clean())


def late(c: Capture) -> dict[str, np.ndarray]:
    i = c.i_ab.copy()
    i[1:, 0] = i[:-1, 0]
    return {"i_ab": i}


def test_a_map_whose_recording_a_bare_model_explains_is_usable() -> None:
    check = checked(right(), classical_of(False).map)
    assert check.outcome is CheckOutcome.PASSED, check.remark.text
    assert check.value is not None
    assert check.value < 0.5
    assert "R_s and a map alone explain the recording" in check.remark.text


@pytest.mark.slow
def test_a_recording_with_a_current_a_sample_late_is_not_judged() -> None:
    check = checked(right().captured(late), classical_of(False).map)
    assert check.outcome is CheckOutcome.NOT_POSSIBLE
    assert check.required
    assert check.remark.text.startswith("not judged, `fluxbench diagnose` decides: ")
    assert "\n" not in check.remark.text


@pytest.mark.slow
def test_an_inverter_that_the_model_knows_leaves_the_map_usable() -> None:
    check = checked(Rewritten.of(behind_dead_time()), classical_of(True).map)
    assert check.outcome is CheckOutcome.PASSED, check.remark.text
    assert "dead time explain" in check.remark.text


@pytest.mark.slow
def test_another_map_than_that_of_the_model_is_not_judged() -> None:
    known = classical_of(False).map
    other = known.model_copy(update={"psi_q": 1.03 * known.psi_q})
    check = checked(right(), other)
    assert check.outcome is CheckOutcome.NOT_POSSIBLE
    assert "the model that explains the recording has another map" in check.remark.text


def test_what_is_too_little_for_a_model_is_not_judged() -> None:
    few = right().manifest.segments[:2]
    little = replace(right(), manifest=right().manifest.model_copy(update={"segments": few}))
    check = checked(little, classical_of(False).map)
    assert check.outcome is CheckOutcome.NOT_POSSIBLE
    assert "\n" not in check.remark.text


class Broken(DeadTime):
    """An effect that raises."""

    name = "broken"

    def shows_in(self, signals: object) -> bool:
        raise RuntimeError("of its own")


def test_a_broken_effect_leaves_the_map_not_judged() -> None:
    check = check_model([Broken()], right(), classical_of(False).map, MapCriteria())
    assert check.outcome is CheckOutcome.NOT_POSSIBLE
    assert "shows_in: RuntimeError: of its own" in check.remark.text


@pytest.mark.slow
def test_an_estimation_is_usable_by_its_model_and_not_judged_without_one(tmp_path: Path) -> None:
    estimators: list[Estimator] = [ResistanceEstimator(), EnergyEstimator()]
    unjudged = estimate_recording(right(), estimators, tmp_path)
    assert (unjudged.usable, unjudged.usability) == (False, Usability.NOT_JUDGED)
    report = estimate_recording(right(), estimators, tmp_path, check_model=partial(check_model, chosen_effects()))
    assert (report.usable, report.usability) == (True, Usability.USABLE)
    assert load_flux_map(tmp_path / "results" / "flux_map.nc").method == report.method

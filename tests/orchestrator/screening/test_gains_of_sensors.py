"""Sensors and voltages of unequal gain: what a few effects explain is not usable where its map may be another's."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest

from orchestrator.diagnosis.judgement.contributions import mean_currents
from orchestrator.interface.api import chosen_effects
from orchestrator.screening.common_gain import common_gain_wb, unequal_gains
from orchestrator.screening.model_check import _screened as screened
from tests.orchestrator.analysis.plant import flux_for, saturated_current
from tests.plugins.estimators.recordings import RATED_WB, clean
from tests.support.rewriting import Rewritten, gain


def noisy(recording: Rewritten, std_a: float = 0.02) -> Rewritten:
    draw = np.random.default_rng(3)
    return recording.captured(lambda c: {"i_ab": (c.i_ab + std_a * draw.normal(size=c.i_ab.shape)).astype(np.float32)})


def along_a(name: Literal["i_ab", "v_ab"], factor: float) -> Rewritten:
    """A recording whose currents or voltages have another gain along phase a than across it."""
    return noisy(Rewritten.of(clean()).mapped(name, np.diag([factor, 1.0])))


def band_and_error_percent(recording: Rewritten) -> tuple[float, float]:
    """The band of a model with unequal resistances, and the error of its map [% of the rated flux]."""
    model = screened(recording, [e for e in chosen_effects() if e.name == "phase_resistance_imbalance"])
    names, chi2 = model.fit.model.names, model.fit.chi2_per_dof
    assert names == ("phase_resistance_imbalance",)
    assert chi2 < 1.08, "explained it is"
    currents = mean_currents(model.fit)
    off = model.fit.model.magnetics.flux_and_inductance(currents)[0] - flux_for(currents, saturated_current)
    error_wb = math.sqrt(float(np.mean(np.sum((off - off.mean(axis=0)) ** 2, axis=1))))
    return 100.0 * model.band_wb / RATED_WB, 100.0 * error_wb / RATED_WB


@pytest.mark.slow
def test_a_gain_common_to_sensors_is_as_uncertain_as_their_difference_is_large() -> None:
    model = screened(
        Rewritten.of(clean()).phases("i_ab", gain("a", 0.96), "ab"),
        [e for e in chosen_effects() if e.name == "current_gain_mismatch"],
    )
    names, stretch = model.fit.model.names, unequal_gains(model.fit)
    assert names == ("current_gain_mismatch",)
    assert stretch == pytest.approx(0.02 * 2.0 / math.sqrt(3.0), rel=0.05)  # half of 4 %, by two sensors' vector
    currents = np.array([[-2.0, 0.0], [2.0, 0.0], [0.0, 2.0]])
    common, band = (wb / RATED_WB for wb in (common_gain_wb(model.fit, currents), model.band_wb))
    assert min(common, band) > 0.01
    assert "uncertain" in model.objections


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [("i_ab", 0.95), ("v_ab", 1.04)])
def test_a_gain_that_passes_for_unequal_resistances_is_in_the_band(
    name: Literal["i_ab", "v_ab"], factor: float
) -> None:
    band, error = band_and_error_percent(along_a(name, factor))
    assert error > 1.5, "what would be called usable without"
    assert band > error


@pytest.mark.slow
def test_small_unequal_resistances_leave_the_map_known() -> None:
    band, error = band_and_error_percent(along_a("i_ab", 0.99))
    assert error < band < 0.9


@pytest.mark.slow
def test_what_noise_explains_has_a_narrow_band() -> None:
    model = screened(noisy(Rewritten.of(clean())), chosen_effects())
    names, stretch, band = model.fit.model.names, unequal_gains(model.fit), model.band_wb / RATED_WB
    assert (names, stretch) == ((), 0.0)
    assert band < 0.002

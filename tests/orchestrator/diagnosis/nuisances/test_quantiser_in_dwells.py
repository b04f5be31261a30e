"""A modulator's timer estimated from held currents: sharper than from the readings, and with what scatters."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, with_quantiser
from orchestrator.diagnosis.nuisances.quantiser_in_dwells import quantiser_of_dwells
from orchestrator.diagnosis.nuisances.segment_scatter import likelihood_of, scatter_of
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import ModelNoise, ModulatorTimer, SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    FS,
    R_S,
    Array,
    felt_through,
    fitter,
    free_model,
    many_holds,
    prepared,
    timer,
)

STEP_S, PART = 21.7e-9, 0.35
NOTHING = np.zeros((3, 3))


@cache
def _recording() -> PreparedRecording:
    return felt_through(timer(STEP_S, PART, PART), many_holds())


def _minimise(borne: ModulatorTimer, curvature: Array = NOTHING) -> tuple[ModulatorTimer, ModelNoise, ModelNoise]:
    """The timer, what scatters beside it, and without one."""
    maker = fitter(_recording())
    fit = maker.fit(free_model())
    before = scatter_of(maker, fit, []).noise
    likelihood = likelihood_of(maker, fit, [])
    free, left = quantiser_of_dwells(maker.prepared, likelihood, before, [QuantiserEstimate(borne, 0.0, curvature)])
    return free, left, before


def _off(free: ModulatorTimer) -> float:
    (at,) = free.phases
    return max(abs((part - PART + 0.5) % 1.0 - 0.5) for part in (at.rise, at.fall))


@pytest.mark.slow
def test_a_timer_that_is_roughly_known_is_reported_sharply() -> None:
    free, left, before = _minimise(timer(STEP_S * (1.0 + 3e-4), PART + 0.04, PART - 0.04))
    assert free.step_s == pytest.approx(STEP_S, rel=1e-4)
    assert _off(free) < 0.1
    with_it = fitter(with_quantiser(_recording(), free)).fit(free_model())
    without = fitter(_recording()).fit(free_model())
    assert without.chi2_per_dof > 2.0
    assert with_it.chi2_per_dof < 1.0 + 0.1 * (without.chi2_per_dof - 1.0)
    assert _volts(left) < 0.2 * _volts(before)


@pytest.mark.slow
def test_phases_that_no_reading_has_reported_are_found() -> None:
    unknown = ModulatorTimer(step_s=STEP_S, centred=True, phases=())
    free, _, _ = _minimise(unknown, NOTHING[:1, :1])
    assert [p.pwm_frequency_hz for p in free.phases] == [FS]
    assert _off(free) < 0.1


def test_readings_that_are_certain_have_the_last_word() -> None:
    borne = timer(STEP_S * (1.0 + 3e-4), 0.8, 0.8)
    free, _, _ = _minimise(borne, 1e12 * np.eye(3))
    assert free.step_s == pytest.approx(borne.step_s, rel=1e-6)
    assert free.phases[0].rise == pytest.approx(0.8, abs=1e-3)


@pytest.mark.slow
def test_of_timers_that_round_alike_the_one_that_leaves_less_is_taken() -> None:
    # Edges on one phase round just as those of twice the step do that lie half of it apart: these are not on one.
    maker = fitter(felt_through(timer(STEP_S, PART, PART + 0.25), many_holds()))
    fit = maker.fit(free_model())
    likelihood, scatter = likelihood_of(maker, fit, []), scatter_of(maker, fit, []).noise
    both = [QuantiserEstimate(timer(step_s, PART, PART), 0.0, NOTHING) for step_s in (2.0 * STEP_S, STEP_S)]
    assert quantiser_of_dwells(maker.prepared, likelihood, scatter, both)[0].step_s == pytest.approx(STEP_S, rel=1e-3)


def test_where_nothing_rests_the_readings_are_taken_at_their_word() -> None:
    moving = [p for p in many_holds() if p.stage is not SegmentStage.RESISTANCE]
    maker = fitter(prepared(moving))
    fit = maker.fit(free_model())
    borne = QuantiserEstimate(timer(STEP_S, PART, PART), 1.0, NOTHING)
    free, _ = quantiser_of_dwells(maker.prepared, likelihood_of(maker, fit, []), ModelNoise(), [borne])
    assert free == borne.timer


def _volts(noise: ModelNoise) -> float:
    """What scatters of a hold's voltage: of holds alone, readings and voltages cannot be separated."""
    return max(noise.voltage_scatter_v, R_S * noise.offset_scatter_a)

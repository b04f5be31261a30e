"""A modulator's timer estimated from every equation beside a whole model: sharp, and near the readings' own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, with_quantiser
from orchestrator.diagnosis.nuisances.quantiser_beside_fit import quantiser_beside
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import ModulatorTimer, SegmentStage, TimerPhases
from tests.orchestrator.diagnosis.pieces import (
    FS,
    PM_WB,
    Array,
    felt_through,
    fitter,
    free_model,
    many_holds,
    plan,
    timer,
)

STEP_S, RISE, FALL = 21.7e-9, 0.35, 0.62
NOTHING = np.zeros((3, 3))


@cache
def _recording() -> PreparedRecording:
    return felt_through(timer(STEP_S, RISE, FALL), plan())


def _fit(believed: ModulatorTimer | None) -> Fit:
    return fitter(with_quantiser(_recording(), believed)).fit(free_model())


def _near(believed: ModulatorTimer, curvature: Array = NOTHING) -> tuple[Fit, ModulatorTimer, float]:
    """The fit beside a timer as it is believed, the timer that it tells, and what that promises to take of chi2."""
    fit = _fit(believed)
    return fit, *quantiser_beside(fit, [QuantiserEstimate(believed, 0.0, curvature)], PM_WB)


def _off(reported: ModulatorTimer) -> float:
    """By how much both edges' mean phase is off: between jumps a command's rounding tells no more."""
    (at,) = reported.phases
    return abs((0.5 * (at.rise + at.fall - RISE - FALL) + 0.25) % 0.5 - 0.25)


@pytest.mark.parametrize("off", [0.03, -0.03])
def test_a_timer_that_is_a_little_off_is_reported_sharply(off: float) -> None:
    believed = timer(STEP_S * (1.0 + 0.01 * off), RISE + off, FALL + 0.5 * off)
    fit, reported, gain = _near(believed)
    assert gain > 0.0
    assert reported.step_s == pytest.approx(STEP_S, rel=1e-4)
    assert _off(reported) < 0.2 * abs(off)
    assert _fit(reported).chi2_per_dof < fit.chi2_per_dof


def test_what_a_timer_promises_is_kept() -> None:
    fit, reported, gain = _near(timer(STEP_S, RISE + 0.05, FALL - 0.05))
    kept = fit.objective - _fit(reported).objective
    assert gain > 100.0
    assert kept == pytest.approx(gain, rel=0.05)


def test_beside_the_right_timer_there_is_nothing_to_be_reported() -> None:
    _, reported, gain = _near(timer(STEP_S, RISE, FALL))
    assert gain < 20.0  # Chi-square of three numbers, the best of many jumps.
    assert reported.step_s == pytest.approx(STEP_S, rel=1e-4)
    assert _off(reported) < 0.01


def test_readings_that_are_certain_have_the_last_word() -> None:
    believed = timer(STEP_S, RISE + 0.05, FALL)
    _, reported, _ = _near(believed, 1e12 * np.eye(3))
    assert reported.step_s == pytest.approx(believed.step_s, rel=1e-6)
    assert reported.phases[0].rise == pytest.approx(RISE + 0.05, abs=1e-4)


def test_a_timer_of_another_frequency_has_no_say() -> None:
    nearest, other = QuantiserEstimate(timer(STEP_S, RISE, FALL), 0.0, NOTHING), timer(0.5 * STEP_S, 0.0, 0.0)
    reported, _ = quantiser_beside(_fit(nearest.timer), [QuantiserEstimate(other, 9.0, NOTHING), nearest], PM_WB)
    assert reported.step_s == pytest.approx(STEP_S, rel=1e-4)


def test_without_a_timer_there_is_none_to_be_reported() -> None:
    with pytest.raises(ValueError, match="modulator's timer"):
        quantiser_beside(_fit(None), [QuantiserEstimate(timer(STEP_S, RISE, FALL), 0.0, NOTHING)], PM_WB)


def _with_rests_at_twice_the_frequency(rise: float, fall: float) -> PreparedRecording:
    """The recording and rests at a second PWM frequency, where the same timer's step is twice as large."""
    first = _recording()
    rests = [p for p in many_holds() if p.stage is SegmentStage.RESISTANCE]
    later = felt_through(timer(2.0 * STEP_S, rise, fall), rests)
    fast = (
        replace(
            p,
            segment=p.segment.model_copy(update={"id": f"fast-{k}"}),
            signals=replace(p.signals, pwm_frequency_hz=2.0 * FS),
        )
        for k, p in enumerate(later.pieces)
    )
    return replace(first, pieces=(*first.pieces, *fast))


def test_phases_that_no_reading_has_reported_may_be_anywhere() -> None:
    made = _with_rests_at_twice_the_frequency(0.8, 0.3)

    def fit_with(rise: float, fall: float) -> Fit:
        at = (FS, RISE, FALL), (2.0 * FS, rise, fall)
        phases = tuple(TimerPhases(pwm_frequency_hz=f, rise=up, fall=down) for f, up, down in at)
        believed = ModulatorTimer(step_s=STEP_S, centred=True, phases=phases)
        return fitter(with_quantiser(made, believed)).fit(free_model())

    right, wrong = fit_with(0.8, 0.3), fit_with(0.1, 0.6)
    borne = QuantiserEstimate(timer(STEP_S, RISE, FALL), 0.0, np.diag([1e8, 1e4, 1e4]))
    reported, _ = quantiser_beside(wrong, [borne], PM_WB)
    assert [p.pwm_frequency_hz for p in reported.phases] == [FS, 2.0 * FS]
    found = fitter(with_quantiser(made, reported)).fit(free_model())
    assert found.objective - right.objective < 0.1 * (wrong.objective - right.objective)

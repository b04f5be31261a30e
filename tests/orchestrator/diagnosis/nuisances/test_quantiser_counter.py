"""A modulator's timer that counts from the carrier's turns has the phases of edges that are counted one by one."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, leg_step_of, rounded_by
from orchestrator.diagnosis.nuisances.quantiser_counter import (
    ONE_COMPARISON,
    TWO_COMPARISONS,
    CounterModel,
    counter_models,
)
from protocols import ModulatorTimer, TimerPhases
from tests.orchestrator.diagnosis.pieces import Array
from tests.support.close import assert_close

BUS_V, STEP_S = 540.0, 14.42e-9
FREQUENCIES_HZ = (10_000.0, 20_000.0)
COMMANDS = np.linspace(-3.0, 3.0, 601)[:, None] * [1.0, 0.0] + [0.0, 0.37]


def counted_one_by_one(leg_v: Array, pwm_hz: float, part: float) -> Array:
    """Mean of a leg whose two edges meet the counter's steps after the carrier's turns."""
    quarter, off = 0.25 / pwm_hz, 0.5 * leg_v / (pwm_hz * BUS_V)
    on, gone = (STEP_S * np.floor((quarter + side * off) / STEP_S + part) for side in (-1.0, 1.0))
    return BUS_V * pwm_hz * (gone - on)


def counted_once(leg_v: Array, pwm_hz: float, part: float, *, above: bool) -> Array:
    """Mean of a leg whose two edges are where an up-down counter meets one whole number; on above or below it."""
    half, off = 0.5 / (pwm_hz * STEP_S), 0.5 * leg_v / (pwm_hz * BUS_V * STEP_S)
    level = np.floor(0.5 * half + (-off if above else off) + part)
    # Of a half of the carrier's period the leg is on for that much, whose half is no voltage.
    return 2.0 * BUS_V * pwm_hz * STEP_S * ((half - level if above else level) - 0.5 * half)


def added(commands: Array, counted: Callable[[Array], Array]) -> Array:
    a, b = commands.T
    legs = np.stack([a, -0.5 * a + 0.75**0.5 * b, -0.5 * a - 0.75**0.5 * b], axis=1)
    off = counted(legs) - legs
    return np.stack([(2 * off[:, 0] - off[:, 1] - off[:, 2]) / 3, (off[:, 1] - off[:, 2]) / 3**0.5], axis=1)


def borne(phases: tuple[tuple[float, float], ...], step_s: float, known: tuple[float, ...]) -> QuantiserEstimate:
    told = tuple(
        TimerPhases(pwm_frequency_hz=f, rise=rise % 1.0, fall=fall % 1.0)
        for f, (rise, fall) in zip(FREQUENCIES_HZ, phases, strict=True)
    )
    curvature = np.diag([0.0, *np.repeat(known, 2)])
    return QuantiserEstimate(ModulatorTimer(step_s=step_s, centred=False, phases=told), 100.0, curvature)


@pytest.mark.parametrize("part", [0.0, 0.5], ids=["cut off", "rounded"])
@pytest.mark.parametrize("pwm_hz", FREQUENCIES_HZ)
def test_its_rounding_is_that_of_edges_counted_one_by_one(pwm_hz: float, part: float) -> None:
    anywhere = borne(((0.0, 0.0), (0.0, 0.0)), STEP_S, (1.0, 0.0))
    timer = CounterModel(anywhere, 10_000.0, 0.25 / (10_000.0 * STEP_S), part, part)
    (at,) = (p for p in anywhere.moved(timer.at(0.0)).phases if p.pwm_frequency_hz == pwm_hz)
    found = rounded_by(COMMANDS, leg_step_of(STEP_S, pwm_hz, BUS_V), at.rise, at.fall, centred=False)
    assert_close(found, added(COMMANDS, lambda legs: counted_one_by_one(legs, pwm_hz, part)), 1e-6)


@pytest.mark.parametrize("above", [False, True], ids=["on below", "on above"])
@pytest.mark.parametrize("part", [0.0, 0.5], ids=["cut off", "rounded"])
@pytest.mark.parametrize("pwm_hz", FREQUENCIES_HZ)
def test_with_one_comparison_its_rounding_is_that_of_both_edges_at_one_count(
    pwm_hz: float, part: float, above: bool
) -> None:
    anywhere, ways = borne(((0.0, 0.0), (0.0, 0.0)), STEP_S, (1.0, 0.0)), ONE_COMPARISON[int(above)]
    timer = CounterModel(anywhere, 10_000.0, 0.25 / (10_000.0 * STEP_S), part, part, ways)
    (at,) = (p for p in anywhere.moved(timer.at(0.0)).phases if p.pwm_frequency_hz == pwm_hz)
    assert at.rise == at.fall
    found = rounded_by(COMMANDS, leg_step_of(STEP_S, pwm_hz, BUS_V), at.rise, at.fall, centred=False)
    assert_close(found, added(COMMANDS, lambda legs: counted_once(legs, pwm_hz, part, above=above)), 1e-6)


def test_one_comparison_is_told_from_two_phases_about_it() -> None:
    n = 0.25 / (10_000.0 * STEP_S)
    told = borne(((0.5 + n - 0.05, 0.5 + n + 0.11), (0.4, 0.9)), STEP_S, (1e4, 0.0))
    truth = CounterModel(told, 10_000.0, n, 0.5, 0.5, (1, 1)).at(0.0)

    def cost(x: Array) -> float:
        return float(np.abs(x - truth).max())

    best = min((one.likeliest(cost) for one in counter_models(told, np.zeros(5))), key=cost)
    assert told.moved(best).step_s == pytest.approx(STEP_S, rel=1e-6)
    assert all(p.rise == pytest.approx(p.fall) for p in told.moved(best).phases)


def test_phases_at_one_frequency_tell_the_step_and_those_at_the_other() -> None:
    n = 0.25 / (10_000.0 * STEP_S)
    told = borne(((0.004 - n, n), (0.4, 0.9)), STEP_S * (1.0 + 2e-5), (1e4, 0.0))
    best = min(counter_models(told, np.zeros(5)), key=lambda one: abs(told.moved(one.at(0.0)).step_s - STEP_S))
    timer = told.moved(best.at(0.0))
    assert timer.step_s == pytest.approx(STEP_S, rel=2e-6)
    other = timer.phases[1]
    assert math.dist((other.rise, other.fall), (-0.5 * n % 1.0, 0.5 * n % 1.0)) < 0.003


def test_edges_that_do_not_count_alike_are_no_counters() -> None:
    n = 0.25 / (10_000.0 * STEP_S)
    apart = borne(((0.25 - n, n), (0.0, 0.0)), STEP_S, (1e4, 0.0))
    assert not [one for one in counter_models(apart, np.zeros(5)) if one.ways == TWO_COMPARISONS]


def test_at_one_frequency_there_is_none_of_two_comparisons() -> None:
    n = 0.25 / (10_000.0 * STEP_S)
    both = borne(((-n, n), (0.0, 0.0)), STEP_S, (1e4, 0.0))
    alone = QuantiserEstimate(
        both.timer.model_copy(update={"phases": both.timer.phases[:1]}), 100.0, both.curvature[:3, :3]
    )
    assert TWO_COMPARISONS in {one.ways for one in counter_models(both, np.zeros(5))}
    assert TWO_COMPARISONS not in {one.ways for one in counter_models(alone, np.zeros(3))}


def test_the_likeliest_count_is_found_near_what_the_phases_tell() -> None:
    n = 0.25 / (10_000.0 * STEP_S)
    told = borne(((0.02 - n, n + 0.01), (0.0, 0.0)), STEP_S, (1e4, 0.0))
    first = next(one for one in counter_models(told, np.zeros(5)) if one.ways == TWO_COMPARISONS)
    truth = CounterModel(told, 10_000.0, n, first.rise, first.fall).at(0.0)
    x = first.likeliest(lambda x: float(np.abs(x - truth).max()))
    assert told.moved(x).step_s == pytest.approx(STEP_S, rel=1e-6)

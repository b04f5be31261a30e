"""What a timer makes of commands: lines see whole steps, no leg is off by more than one; and where currents rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.diagnosis.nuisances.pwm_quantiser import (
    QuantiserEstimate,
    dwells,
    leg_step_of,
    nominal_leg_step_of,
    rounded_by,
    scatter_sizes,
    scatter_units,
    with_quantiser,
)
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData, mean_between
from orchestrator.numerics.frames import from_phases, to_phases
from protocols import ModelNoise, SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    FS,
    NOISE_A,
    R_S,
    Array,
    Plan,
    hold,
    piece,
    plan,
    prepared,
    ripple,
    sweep,
    timer,
)

STEP_S = 26e-9
PART = st.floats(0.0, 0.999)
VOLTS = st.floats(-100.0, 100.0)


def _lines(v_ab: Array) -> Array:
    """Voltages from leg to leg."""
    v_abc = to_phases(v_ab)
    return np.asarray(v_abc - np.roll(v_abc, 1, axis=1))


@pytest.mark.slow
@given(a=VOLTS, b=VOLTS, step_v=st.floats(0.05, 1.0), part=PART, centred=st.booleans())
def test_where_one_comparison_makes_both_edges_lines_see_whole_steps(
    a: float, b: float, step_v: float, part: float, centred: bool
) -> None:
    command = from_phases(np.array([[a, b, -a - b]]))
    off = rounded_by(command, step_v, part, part, centred=centred)
    steps = _lines(command + off) / step_v
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert np.abs(_lines(off)).max() <= step_v * (1.0 + 1e-9)


@given(a=VOLTS, b=VOLTS, step_v=st.floats(0.05, 1.0), rise=PART, fall=PART)
def test_of_two_comparisons_lines_see_the_mean(a: float, b: float, step_v: float, rise: float, fall: float) -> None:
    command = from_phases(np.array([[a, b, -a - b]]))
    both = rounded_by(command, step_v, rise, fall, centred=True)
    each = [rounded_by(command, step_v, part, part, centred=True) for part in (rise, fall)]
    np.testing.assert_allclose(both, 0.5 * (each[0] + each[1]), atol=1e-12)


@given(step_v=st.floats(0.05, 1.0), rise=PART, fall=PART)
def test_commands_all_over_a_step_are_met_on_average(step_v: float, rise: float, fall: float) -> None:
    x = step_v * (np.arange(1000) + 0.5) / 1000.0
    off = rounded_by(from_phases(np.stack([x, np.zeros(1000), -x], axis=1)), step_v, rise, fall, centred=True)
    # Leg b stands still; a and c go through a step in opposite directions.
    mean = to_phases(off.mean(axis=0)[None])[0]
    assert abs(mean[0] - mean[2]) < 0.003 * step_v


def _campaign() -> PreparedRecording:
    return prepared(plan(sparse=True))


def test_a_recording_gets_the_voltages_that_its_timer_lets_through_once() -> None:
    made = _campaign()
    once = with_quantiser(made, timer(STEP_S, 0.3, 0.6))
    twice = with_quantiser(once, timer(STEP_S, 0.3, 0.6))
    step_v = nominal_leg_step_of(STEP_S, made.manifest.drive)
    for before, after, again in zip(made.pieces, once.pieces, twice.pieces, strict=True):
        np.testing.assert_array_equal(after.signals.v_ab, again.signals.v_ab)
        moved = np.abs(_lines(after.signals.v_ab - before.signals.v_ab)).max()
        if before.stage is SegmentStage.GATES_OFF:
            assert moved == 0.0
        else:
            assert 0.0 < moved <= step_v
    assert once.quantiser == timer(STEP_S, 0.3, 0.6)


def test_where_the_phases_are_not_known_nothing_is_moved() -> None:
    made = _campaign()
    for before, after in zip(
        made.pieces, with_quantiser(made, timer(STEP_S, 0.3, 0.6, pwm_hz=2.0 * FS)).pieces, strict=True
    ):
        assert after.signals.v_ab is before.signals.v_ab


def test_it_is_the_single_commands_that_are_rounded_not_their_means() -> None:
    rng = np.random.default_rng(5)
    command = np.array([7.0, -3.0]) + rng.normal(0.0, 0.3, (1200, 2))
    step_v = 0.28
    whole = command + rounded_by(command, step_v, 0.3, 0.3, centred=True)
    piece = next(p for p in _campaign().pieces if p.stage is SegmentStage.RESISTANCE)
    slow = _averaged(piece, command, width=10)
    made = replace(_campaign(), pieces=(slow,))
    after = with_quantiser(made, timer(STEP_S, 0.3, 0.3))
    timed = command + rounded_by(command, leg_step_of(STEP_S, FS, 540.0), 0.3, 0.3, centred=True)
    np.testing.assert_allclose(after.pieces[0].signals.v_ab, mean_between(timed, 10, 0.0), atol=1e-12)
    # What trembles over several steps is dithered: of the mean nothing is off.
    assert np.abs((whole - command).mean(axis=0)).max() < 0.1 * step_v


def _averaged(piece: SegmentData, command: Array, width: int) -> SegmentData:
    rows = len(command) // width
    names = ("i_ab", "i_m_ab", "v_dc", "theta_rad", "resistance_ohm", "heat_j")
    cut = {name: getattr(piece.signals, name)[:rows] for name in names}
    signals = replace(piece.signals, v_ab=mean_between(command, width, 0.0), **cut)
    return replace(piece, signals=signals, averaged=width, command_ab=command)


@given(step=st.floats(-0.01, 0.01), phases=st.lists(st.floats(-0.49, 0.49), min_size=2, max_size=2), rise=PART)
def test_what_leads_from_one_timer_to_another_is_reported(step: float, phases: list[float], rise: float) -> None:
    borne, x = QuantiserEstimate(timer(STEP_S, rise, 0.4), 0.0, np.eye(3)), np.array([step, *phases])
    np.testing.assert_allclose(borne.to(borne.moved(x)), x, atol=1e-9)


def test_a_timer_may_meet_commands_anywhere_at_a_frequency_of_which_readings_tell_nothing() -> None:
    borne = QuantiserEstimate(timer(STEP_S, 0.2, 0.4), 1.0, np.eye(3)).at([FS, 2.0 * FS])
    assert [p.pwm_frequency_hz for p in borne.timer.phases] == [FS, 2.0 * FS]
    np.testing.assert_array_equal(borne.curvature, np.diag([1.0, 1.0, 1.0, 0.0, 0.0]))


def _made(stage: SegmentStage, v_dq: Array, noise_a: float = NOISE_A) -> SegmentData:
    noise = np.random.default_rng(1).normal(0.0, noise_a, v_dq.shape)
    return piece(Plan(stage, v_dq, settings={"frequency_hz": 500.0, "rotation_hz": 4.0}), noise=noise)


def _trapezoid(up: int, dwell: int) -> Array:
    """Voltage of a current that ramps to 2.5 A, rests, ramps down, rests."""
    ramp = np.linspace(-2.5, 2.5, up)
    i_q = np.concatenate([ramp, np.full(dwell, 2.5), ramp[::-1], np.full(dwell, -2.5)])
    return np.stack([np.zeros(len(i_q)), R_S * i_q], axis=1)


def test_a_hold_rests_all_through() -> None:
    assert dwells(_made(SegmentStage.RESISTANCE, hold(2.0, 0.0))) == (slice(0, 600),)


@pytest.mark.parametrize("noise_a", [0.1 * NOISE_A, NOISE_A])
def test_a_trapezoid_rests_at_its_ends(noise_a: float) -> None:
    up, dwell = 4000, 3000
    made = _made(SegmentStage.CLASSICAL, _trapezoid(up, dwell), noise_a)
    found, window = dwells(made), made.windows.step
    assert len(found) == 2
    for stretch, start in zip(found, (up, 2 * up + dwell), strict=True):
        # The current follows the voltage some time constants later: within a rest all of it has settled.
        assert start - window <= stretch.start <= start + 800
        assert abs(stretch.stop - (start + dwell)) <= 2 * window


def test_what_moves_all_the_time_does_not_rest() -> None:
    assert dwells(_made(SegmentStage.CLASSICAL, sweep(1, 2.5, 0.0))) == ()
    assert dwells(_made(SegmentStage.INJECTION, ripple(1.0, 0.0, 40.0))) == ()
    assert dwells(_made(SegmentStage.GATES_OFF, np.zeros((600, 2)))) == ()


def test_a_held_voltage_scatters_with_the_pwm_frequency_and_the_readings_zeros_do_not() -> None:
    made = _made(SegmentStage.RESISTANCE, hold(1.0, 0.0))
    noise = ModelNoise(offset_scatter_a=0.001, voltage_scatter_v=0.02)
    assert scatter_sizes(scatter_units(made), noise) == pytest.approx([0.001, 0.001, 0.02, 0.02])
    twice = replace(made, signals=replace(made.signals, pwm_frequency_hz=2.0 * made.signals.pwm_frequency_hz))
    assert scatter_sizes(scatter_units(twice), noise) == pytest.approx([0.001, 0.001, 0.04, 0.04])

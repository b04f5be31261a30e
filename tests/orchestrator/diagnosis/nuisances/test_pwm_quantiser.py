"""What a timer makes of commands: lines see whole steps, nobody is off by more than one, and on average nothing is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.diagnosis.nuisances.pwm_quantiser import (
    QuantiserEstimate,
    leg_step_of,
    nominal_leg_step_of,
    rounded_by,
    with_quantiser,
)
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData, mean_between
from orchestrator.numerics.frames import from_phases, to_phases
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import FS, Array, plan, prepared, timer

STEP_S = 26e-9
PART = st.floats(0.0, 0.999)
VOLTS = st.floats(-100.0, 100.0)


def _lines(v_ab: Array) -> Array:
    """Voltages from leg to leg."""
    v_abc = to_phases(v_ab)
    return np.asarray(v_abc - np.roll(v_abc, 1, axis=1))


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

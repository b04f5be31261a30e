"""A modulator's timer in the readings: found with its step and phases, and not where chance or a form moves them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.command_traces import command_traces
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, leg_step_of, legs_rounded_by
from orchestrator.diagnosis.nuisances.quantiser_search import PHASE_BIAS_STD, detect_quantisation
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    CRITERIA,
    FS,
    L_D,
    L_Q,
    R_S,
    Plan,
    felt_through,
    hold,
    prepared,
    ripple,
    sweep,
    timer,
)

PHASES = 0.35, 0.45


def _moving() -> list[Plan]:
    """Sweeps and injections whose commands tremble, as those of current control do."""
    settings = {"frequency_hz": FS / 20, "rotation_hz": FS / 2500, "amplitude_v": 40.0}
    points = [(a * np.cos(t), a * np.sin(t)) for a, t in zip((0.0, 1.0, 1.7, 2.2), (0.0, 1.0, 3.0, 5.0), strict=True)]
    sweeps = [Plan(SegmentStage.CLASSICAL, sweep(axis, 2.5, held, 9000)) for axis in (0, 1) for held in (0.0, 0.7)]
    injected = [Plan(SegmentStage.INJECTION, ripple(*point, 40.0, 10_000), settings=settings) for point in points]
    rng = np.random.default_rng(4)
    return [replace(p, v_dq=p.v_dq + rng.normal(0.0, 0.3, p.v_dq.shape)) for p in (*sweeps, *injected)]


@cache
def _recording(step_s: float, centred: bool) -> PreparedRecording:
    return felt_through(timer(step_s, *PHASES, centred=centred), _moving(), noise_a=0.001)


def _found(made: PreparedRecording) -> tuple[QuantiserEstimate, ...]:
    traces = command_traces(made, (L_D, L_Q), R_S)
    return detect_quantisation(traces, 540.0, CRITERIA.selection.log_evidence)


@pytest.mark.parametrize(("step_s", "centred"), [(21.7e-9, True), pytest.param(13.3e-9, False, marks=pytest.mark.slow)])
def test_a_timer_is_found_with_its_step_and_phases(step_s: float, centred: bool) -> None:
    found = _found(_recording(step_s, centred))
    assert found
    information = found[0].timer
    assert information.step_s == pytest.approx(step_s, rel=3e-4)
    assert information.centred is centred
    # To some hundredths of a step: what rests tells the rest.
    (at,) = information.phases
    for part, true in zip(sorted((at.rise, at.fall)), PHASES, strict=True):
        assert abs(part - true) < 0.08


def test_how_well_a_step_is_known_is_what_it_is_off_by() -> None:
    found = _found(_recording(21.7e-9, True))[0]
    deviation = np.sqrt(np.diag(np.linalg.inv(found.curvature)))
    assert abs(found.timer.step_s / 21.7e-9 - 1.0) < 4.0 * deviation[0] < 1e-3
    # No phase is known better than readings may be wrong, and chance adds little.
    assert (deviation[1:] >= PHASE_BIAS_STD).all()
    assert (deviation[1:] < 1.1 * PHASE_BIAS_STD).all()


def test_a_timer_that_acts_a_sample_late_is_found_as_well() -> None:
    made = _recording(21.7e-9, True)
    pieces = []
    for piece in made.pieces:
        # The same currents, of commands that were given earlier.
        earlier = np.roll(piece.command_ab, -1, axis=0)
        pieces.append(replace(piece, command_ab=earlier, delay_samples=1.0))
    found = _found(replace(made, pieces=tuple(pieces)))
    assert found
    assert found[0].timer.step_s == pytest.approx(21.7e-9, rel=3e-4)


def test_where_commands_are_met_there_is_no_timer() -> None:
    assert _found(prepared(_moving(), noise_a=0.001)) == ()


def test_a_loss_that_repeats_with_the_command_is_no_timer() -> None:
    made = prepared(_moving(), noise_a=0.001)
    pieces = []
    for piece in made.pieces:
        # Twice a volt across zero current, as dead time takes it, and a wave in the command that is no saw's.
        lost = 2.0 * np.tanh(piece.current_ab / 0.1) + 0.05 * np.sin(piece.command_ab / 3.0)
        pieces.append(replace(piece, command_ab=piece.command_ab + lost))
    assert _found(replace(made, pieces=tuple(pieces))) == ()


def test_what_one_segment_alone_bears_is_no_timer() -> None:
    made = prepared(_moving(), noise_a=0.001)
    borne = _recording(21.7e-9, True)
    assert _found(replace(made, pieces=(borne.pieces[0], *made.pieces[1:]))) == ()


def test_what_one_leg_alone_bears_is_no_timer() -> None:
    """A current control moves a leg in steps of its converters' least current; a timer has all three."""
    step_v, plans = leg_step_of(21.7e-9, FS, 540.0), _moving()
    alone = [2.0 / 3.0 * legs_rounded_by(p.v_dq, step_v, *PHASES, False)[:, :1] * [1.0, 0.0] for p in plans]
    made = prepared([replace(p, v_dq=p.v_dq + off) for p, off in zip(plans, alone, strict=True)], noise_a=0.001)
    threshold = tuple(replace(piece, command_ab=p.v_dq) for piece, p in zip(made.pieces, plans, strict=True))
    assert _found(replace(made, pieces=threshold)) == ()


def test_commands_that_only_rest_tell_nothing_and_are_not_requested() -> None:
    resting = [Plan(SegmentStage.RESISTANCE, hold(a, 0.0)) for a in (0.5, 1.0)]
    assert command_traces(prepared(resting), (L_D, L_Q), R_S) == []
    assert _found(prepared(resting)) == ()

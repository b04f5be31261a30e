"""Closing loops on a motor behind an inverter whose shape is not piecewise straight."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestrator.analysis import KNOTS, SweepTrace, VoltageLosses, close_loops, flux_from_dwells, sweep_of, trace_sweep
from tests.orchestrator.analysis.plant import R_S, SAMPLING_HZ, Array, capture_of, flux_for, saturated_current
from tests.orchestrator.analysis.test_sweep import RATED_WB, off_percent, swept
from tests.support.cases import few
from tests.support.close import assert_close

KNOTS_A = KNOTS * 3.35


@cache
def traces(inverter: bool, heating: float = 0.0, angle: float = 0.0) -> list[SweepTrace]:
    """Three sweeps one after another; R_s rises by `heating` in all, seen as a voltage that is commanded on top."""
    run = swept(inverter)
    length = run.i_dq.shape[0] / SAMPLING_HZ
    out = []
    for point in range(3):
        capture = capture_of(run, point, angle=angle, start_s=point * length)
        time = point * length + np.arange(len(capture)) / SAMPLING_HZ
        extra = heating * R_S * time / (3 * length)
        capture = capture.model_copy(update={"v_ab": capture.v_ab + extra[:, None] * capture.i_ab})
        out.append(trace_sweep(capture, angle, knots_a=KNOTS_A, where=f"classical-{point}"))
    return out


def losses_of(inverter: bool, heating: float = 0.0, angle: float = 0.0) -> VoltageLosses:
    return close_loops(traces(inverter, heating, angle), KNOTS_A)


@pytest.mark.slow
def test_the_inverters_shape_is_found() -> None:
    losses = losses_of(True)
    beyond = losses.knots_a > 0.08
    np.testing.assert_allclose(losses.error_v[beyond], np.tanh(losses.knots_a[beyond] / 0.03), atol=0.03)
    assert (np.diff(losses.error_v[losses.knots_a < 0.08]) > 0).all()


@pytest.mark.slow
def test_where_there_is_no_inverter_none_is_found() -> None:
    assert np.abs(losses_of(False).error_v).max() < 0.05


@few("inverter", [True, False], ids=["dead time", "clean"])
def test_resistance_and_its_drift_are_found(inverter: bool) -> None:
    losses = losses_of(inverter, heating=0.1)
    assert len(losses.node_ohm) == 4
    np.testing.assert_allclose(losses.node_ohm, R_S * (1.0 + 0.1 * np.arange(4) / 3), rtol=4e-3)


def test_loops_close_and_the_path_is_right() -> None:
    bare = [sweep_of(trace, flux_from_dwells(trace, R_S)) for trace in traces(True, 0.1)]
    assert max(sweep.loop_wb.max() for sweep in bare) > 0.15 * RATED_WB
    for trace in traces(True, 0.1):
        closed = sweep_of(trace, losses_of(True, 0.1).flux(trace))
        assert closed.loop_wb.max() < 0.02 * RATED_WB
        assert off_percent(closed.path) < 0.5


@pytest.mark.slow
def test_the_heat_within_a_sweep_is_reported_from_the_rise_between_sweeps() -> None:
    """Nine sweeps, R_s following the integral of the squared current; alone, it would look like more inductance."""
    slope, out, heat, start_s = 4e-3, [], 0.0, 0.0
    run = swept(False)
    for n in range(9):
        capture = capture_of(run, n % 3, start_s=start_s)
        gained = heat + np.cumsum((capture.i_ab**2).sum(axis=1)) / SAMPLING_HZ
        heat, start_s = float(gained[-1]), start_s + len(capture) / SAMPLING_HZ
        capture = capture.model_copy(update={"v_ab": capture.v_ab + slope * gained[:, None] * capture.i_ab})
        out.append(trace_sweep(capture, 0.0, knots_a=KNOTS_A, where=f"classical-{n}"))
    losses = close_loops(out, KNOTS_A)
    assert losses.resistance_per_heat == pytest.approx(slope, rel=0.1)
    aware = [off_percent(sweep_of(trace, losses.flux(trace)).path) for trace in out]
    unaware = [off_percent(sweep_of(trace, replace(losses, resistance_per_heat=0.0).flux(trace)).path) for trace in out]
    assert max(aware) < 0.3 * max(unaware)


def test_where_nothing_warms_up_no_rise_is_found() -> None:
    assert losses_of(True).resistance_per_heat == 0.0


def test_a_hysteresis_loop_is_not_taken_for_an_inverter() -> None:
    """A loop of constant width between the ends of the travel stays for the most part."""
    width = 0.02 * RATED_WB
    looped = []
    for trace in traces(False):
        play = _play(trace.travel, 0.3)
        late = width * np.outer(play, trace.axis)
        looped.append(SweepTrace(**{**vars(trace), "impulse": trace.impulse + late}))
    losses = close_loops(looped, KNOTS_A)
    assert np.abs(losses.error_v).max() < 0.06
    for trace in looped:
        left = float(np.linalg.norm(sweep_of(trace, losses.flux(trace)).loop_wb))
        assert 0.5 * width < left < 1.3 * width


def _play(x: Array, half: float) -> Array:
    """(x - play operator of x) / half: within -1 to 1, its sign that of the motion."""
    out, y = np.empty_like(x), float(x[0])
    for k, value in enumerate(x):
        y = min(max(y, value - half), value + half)
        out[k] = (value - y) / half
    return out


def test_the_frame_does_not_matter() -> None:
    straight = losses_of(True)
    # Turned by a third of a turn the phases only change their names.
    third = losses_of(True, angle=2 * np.pi / 3)
    assert_close(third.error_v, straight.error_v, 1e-6)
    truth = flux_for(np.array([[0.0, 2.0]]), saturated_current)
    sweep = sweep_of(traces(True, 0.0, 2 * np.pi / 3)[0], third.flux(traces(True, 0.0, 2 * np.pi / 3)[0]))
    at = [np.interp([-2.0, 2.0], sweep.path.current[:, 1], sweep.path.psi[:, 1])]
    assert np.ptp(at) == pytest.approx(2 * truth[0, 1], rel=0.01)

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.analysis import FluxPath, Sweep, find_dwells, flux_from_dwells, join_paths, sweep_of, trace_sweep
from protocols import Capture, NotMeasuredError
from tests.orchestrator.analysis.campaign import PERIOD_S, follow, trapezoid
from tests.orchestrator.analysis.plant import (
    R_S,
    SAMPLING_HZ,
    Array,
    Run,
    capture_of,
    flux_for,
    integrate_motor,
    saturated_current,
)
from tests.support.cases import few

BASE = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 0.0]])
SWEPT = np.array([[0.0, 1.0], [0.0, 1.0], [0.5**0.5, 0.5**0.5]])
RATED_WB = 0.14


def dead_time(v: Array, i: Array) -> Array:
    phases = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])
    taken: Array = np.tanh(i @ phases.T / 0.03) @ (2 / 3 * phases)
    return v - taken


@cache
def swept(inverter: bool = False, periods: int = 2, from_elsewhere: bool = False) -> Run:
    start = BASE + np.array([0.5, -1.0]) if from_elsewhere else BASE
    return integrate_motor(
        follow(lambda t: BASE + 3.0 * trapezoid(t) * SWEPT, R_S),
        flux_for(start, saturated_current),
        round(periods * PERIOD_S * SAMPLING_HZ),
        saturated_current,
        substeps=1,
        acts=dead_time if inverter else lambda v, _i: v,
    )


def evaluate(capture: Capture, angle_rad: float = 0.0, resistance_ohm: float | None = R_S, delay: float = 0.0) -> Sweep:
    trace = trace_sweep(capture, angle_rad, delay=delay, where="classical-3")
    return sweep_of(trace, flux_from_dwells(trace, resistance_ohm))


def off_percent(path: FluxPath) -> float:
    truth = flux_for(path.current, saturated_current)
    off = (path.psi - path.psi.mean(axis=0)) - (truth - truth.mean(axis=0))
    return 100.0 / RATED_WB * float(np.abs(off).max())


@few("point", range(3))
def test_flux_along_a_path_is_right_to_half_a_percent(point: int) -> None:
    sweep = evaluate(capture_of(swept(), point, noise_a=2e-3))
    assert off_percent(sweep.path) < 0.5


@pytest.mark.parametrize("point", range(3))
def test_a_wrong_resistance_is_put_right_by_the_rests(point: int) -> None:
    capture = capture_of(swept(), point)
    right, wrong, unknown = (evaluate(capture, resistance_ohm=r).path for r in (R_S, 1.1 * R_S, None))
    assert np.abs(wrong.psi - right.psi).max() < 5e-3 * RATED_WB
    assert np.abs(unknown.psi - right.psi).max() < 5e-3 * RATED_WB


@pytest.mark.slow
def test_both_directions_together_are_free_of_the_inverters_error() -> None:
    sweep = evaluate(capture_of(swept(inverter=True), 0))
    assert sweep.loop_wb.max() > 0.2 * RATED_WB
    assert off_percent(sweep.path) < 2.0


@pytest.mark.slow
def test_the_way_to_the_start_of_the_path_is_left_out() -> None:
    sweep = evaluate(capture_of(swept(from_elsewhere=True), 1))
    assert np.abs(sweep.path.current[:, 0] - 1.5).max() < 0.05
    assert off_percent(sweep.path) < 0.6


def test_one_period_is_enough() -> None:
    assert off_percent(evaluate(capture_of(swept(periods=1), 0)).path) < 0.6


def test_frame_and_delay_are_accounted_for() -> None:
    straight = evaluate(capture_of(swept(), 2)).path
    turned = evaluate(capture_of(swept(), 2, angle=2.2, delay=3), 2.2, delay=3.0).path
    assert np.abs(turned.psi - straight.psi).max() < 1e-3 * RATED_WB


def test_dwells_are_the_constant_stretches() -> None:
    dwells = find_dwells(capture_of(swept(), 0), 0.0)
    assert len(dwells) == 4
    np.testing.assert_allclose([d.i_ab[1] for d in dwells], [3.0, -3.0, 3.0, -3.0], atol=0.01)
    np.testing.assert_allclose([d.v_ab[1] for d in dwells], R_S * np.array([3.0, -3.0, 3.0, -3.0]), rtol=2e-3)


def test_current_that_never_comes_back_is_refused() -> None:
    ramp = np.stack([np.zeros(2000), np.linspace(0, 3, 2000)], axis=1)
    capture = Capture(
        start_s=0.0, sampling_frequency_hz=SAMPLING_HZ, i_ab=ramp, v_ab=R_S * ramp, v_dc=np.full(2000, 540.0)
    )
    with pytest.raises(NotMeasuredError, match="classical-3"):
        evaluate(capture)


def path_along(a: tuple[float, float], b: tuple[float, float], shift: float) -> FluxPath:
    current = np.linspace(a, b, 31)
    return FluxPath(current, flux_for(current, saturated_current) + shift, np.zeros(2))


def test_paths_that_cross_find_their_constants() -> None:
    paths = [path_along((-3, q), (3, q), 0.1 * q) for q in (-2.0, 0.0, 2.0)]
    paths += [path_along((d, -3), (d, 3), -0.2 * d + 0.05) for d in (-2.0, 0.5)]
    network = join_paths(paths)
    assert network.members == (0, 1, 2, 3, 4)
    assert network.misfit is not None
    assert np.abs(network.misfit).max() < 1e-4
    moved = np.concatenate([p.psi - flux_for(p.current, saturated_current) for p in network.paths])
    assert np.ptp(moved, axis=0).max() < 2e-4


def test_a_path_that_meets_no_other_is_left_out() -> None:
    crossing = [path_along((-3, 0), (3, 0), 0.0), path_along((0, -3), (0, 3), 0.0)]
    assert join_paths([*crossing, path_along((5, 5), (6, 6), 0.0)]).members == (0, 1)


def test_disagreement_at_crossings_is_reported() -> None:
    paths = [path_along((-3, q), (3, q), 0.0) for q in (-2.0, 2.0)]
    paths += [path_along((d, -3), (d, 3), 0.0) for d in (-2.0, 2.0)]
    bent = FluxPath(paths[0].current, paths[0].psi + 0.001 * paths[0].current[:, :1], paths[0].std)
    misfit = join_paths([bent, *paths[1:]]).misfit
    assert misfit is not None
    assert np.abs(misfit).max() == pytest.approx(0.001, rel=0.1)


def test_a_triangle_that_begins_at_rest_in_its_middle_is_swept_to_and_fro() -> None:
    def level(t: float) -> float:
        turns = (t - 0.2) / 0.8
        return float(2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * turns))) if 0.0 < turns < 1.0 else 0.0

    run = integrate_motor(
        follow(lambda t: BASE + 3.0 * level(t) * SWEPT, R_S),
        flux_for(BASE, saturated_current),
        round(1.1 * SAMPLING_HZ),
        saturated_current,
        substeps=1,
    )
    for point in range(3):
        path = evaluate(capture_of(run, point, noise_a=2e-3)).path
        assert off_percent(path) < 0.6
        assert np.ptp(path.current @ SWEPT[point]) > 5.9

"""What a ripple sees beside the large-signal map: inductances, saliency, and the axis that is tracked."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orchestrator.estimation.sensorless import seen_by_injection
from protocols import Basis, FluxMapEstimate, FluxPoints, IncrementalInductances, MapChecks
from tests.orchestrator.analysis.plant import Array
from tests.orchestrator.analysis.test_checks import exact_map

POINTS = np.array([[0.0, 0.0], [1.5, 1.5], [-1.5, 2.1], [2.1, -1.5]])


def slopes(current: Array) -> Array:
    """Of the exact map at points of its grid, shape (n, 3)."""
    exact = exact_map()
    at = [(int(np.abs(exact.i_d - d).argmin()), int(np.abs(exact.i_q - q).argmin())) for d, q in current]
    return np.array([[exact.l_dd[k], exact.l_dq[k], exact.l_qq[k]] for k in at])


def made(basis: Basis, *incremental: IncrementalInductances) -> FluxMapEstimate:
    return FluxMapEstimate(
        map=exact_map(basis.value).model_copy(update={"basis": basis}),
        points=FluxPoints(i_dq=np.zeros((1, 2)), psi_dq=np.zeros((1, 2)), segment=("a",)),
        checks=MapChecks(),
        incremental=incremental,
    )


def ripple(inductance: Array, current: Array = POINTS, frequency_hz: float = 500.0) -> IncrementalInductances:
    return IncrementalInductances(
        frequency_hz=frequency_hz, amplitude_v=40.0, i_dq=current, inductance=np.asarray(inductance)
    )


def test_a_ripple_that_sees_less_on_one_axis_is_reported_by_frequency() -> None:
    slow, fast = (
        ripple(slopes(POINTS) * np.array([f, f, 1.0]), frequency_hz=hz) for f, hz in ((0.98, 250), (0.95, 1e3))
    )
    seen = seen_by_injection((made(Basis.ENERGY), made(Basis.INJECTION, slow, fast), made(Basis.INTEGRATION)))
    assert [(s.method, s.frequency_hz, s.points) for s in seen] == [("energy", 250.0, 4), ("energy", 1000.0, 4)]
    assert [s.l_dd_percent for s in seen] == pytest.approx([-2.0, -5.0])
    assert [s.l_qq_percent for s in seen] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_saliency_and_the_turn_of_its_axis_are_those_of_the_ripple() -> None:
    seen_l = np.tile([0.04, 0.01, 0.06], (4, 1))
    (seen,) = seen_by_injection((made(Basis.INTEGRATION), made(Basis.INJECTION, ripple(seen_l))))
    ratio = (0.05 + math.hypot(0.01, 0.01)) / (0.05 - math.hypot(0.01, 0.01))
    assert (seen.saliency_low, seen.saliency_high) == pytest.approx((ratio, ratio))
    assert seen.angle_error_rad == pytest.approx(math.pi / 8)
    d, cross, q = slopes(POINTS).T
    assert seen.left_by_map_rad == pytest.approx(np.abs(math.pi / 8 - 0.5 * np.arctan2(cross, 0.5 * (q - d))).max())


def test_the_current_of_the_largest_turn_is_stated() -> None:
    inductance = np.tile([0.04, 0.0, 0.06], (4, 1))
    inductance[2, 1] = 0.01
    (seen,) = seen_by_injection((made(Basis.INTEGRATION), made(Basis.INJECTION, ripple(inductance))))
    assert (seen.angle_error_i_d_a, seen.angle_error_i_q_a) == tuple(POINTS[2])


def test_half_a_turn_of_the_axis_is_none() -> None:
    """On either side of the q axis an axis is the same to a hair's breadth."""
    large = made(Basis.INTEGRATION)
    tables = {"l_dd": 0.06, "l_qq": 0.04, "l_dq": 1e-6}
    large.__dict__["map"] = large.map.model_copy(update={n: np.full((41, 41), v) for n, v in tables.items()})
    (seen,) = seen_by_injection((large, made(Basis.INJECTION, ripple(np.tile([0.06, -1e-6, 0.04], (4, 1))))))
    assert seen.angle_error_rad == pytest.approx(math.pi / 2, abs=1e-3)
    assert seen.left_by_map_rad == pytest.approx(0.0, abs=2e-4)


def test_points_beyond_the_map_are_left_out() -> None:
    beyond = np.array([[0.0, 0.0], [9.0, 0.0], [-3.0, -3.0]])
    inductance = np.tile([0.04, 0.0, 0.06], (3, 1))
    (seen,) = seen_by_injection((made(Basis.INTEGRATION), made(Basis.INJECTION, ripple(inductance, beyond))))
    assert seen.points == 2
    assert (
        seen_by_injection((made(Basis.INTEGRATION), made(Basis.INJECTION, ripple(inductance[:1], beyond[1:2])))) == ()
    )


def test_without_sweeps_there_is_no_large_signal_map() -> None:
    assert seen_by_injection((made(Basis.ENERGY), made(Basis.INJECTION, ripple(slopes(POINTS))))) == ()

"""The sensors' noise: as large as it was made, and white with unit variance once it is whitened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cholesky_banded

from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import LocalMap, flux_terms, local_map, voltage_and_resistance
from orchestrator.diagnosis.weak_form.noise import (
    SensorNoise,
    Whitener,
    _correlation,
    _quietest,
    banded_covariance,
    sensor_noise,
)
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.sensor_scatter import Scatter, scatter_between
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    FS,
    L_D,
    L_Q,
    NOISE_A,
    PM_WB,
    R_S,
    TRUE_MAP,
    Array,
    Plan,
    hold,
    piece,
    ripple,
    sweep,
)
from tests.support.cases import few

HOLD = Plan(SegmentStage.RESISTANCE, hold(1.0, -0.5))
SWEEP = Plan(SegmentStage.CLASSICAL, sweep(0, 2.0, 0.5, 1200))
RIPPLE = Plan(
    SegmentStage.INJECTION,
    ripple(0.0, 1.0, 40.0, 1500, 12),
    settings={"frequency_hz": FS / 12, "rotation_hz": FS / 1500},
)
COVARIANCE = NOISE_A**2 * np.array([[1.0, 0.6], [0.6, 1.6]])


def _rows(requested: Plan, noise: Array) -> Array:
    batch = SegmentBatch.of([piece(requested, noise=noise)])
    at = local_map(batch, batch.signals, TRUE_MAP)
    known, resistance = voltage_and_resistance(batch, batch.signals, at, PM_WB)
    return known + R_S * resistance + flux_terms(batch, at)


def _local(one: SegmentData) -> LocalMap:
    batch = SegmentBatch.of([one])
    return local_map(batch, batch.signals, TRUE_MAP)


def _whitener(requested: Plan, slopes: Array | None = None) -> Whitener:
    one = piece(requested)
    at = _local(one)
    noise = SensorNoise(COVARIANCE, COVARIANCE, 0.0)
    return Whitener.of(banded_covariance(one, at, np.ones(len(one.signals.v_dc)), noise, R_S, slopes))


@few("requested", [HOLD, SWEEP, RIPPLE])
def test_whitened_noise_has_unit_covariance(requested: Plan) -> None:
    rng, draws = np.random.default_rng(1), 400
    root = np.linalg.cholesky(COVARIANCE)
    rows = np.stack([_rows(requested, rng.normal(size=requested.v_dq.shape) @ root.T) for _ in range(draws)], axis=1)
    white = _whitener(requested)(rows)
    count = len(white)
    found = white @ white.T / draws
    # Of so many draws a variance is known to sqrt(2 / n), a covariance to sqrt(1 / n); five of these.
    assert float(np.mean(white**2)) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (draws * count)))
    assert np.abs(found - np.eye(count)).max() < 5.0 * np.sqrt(2.0 / draws)


def test_variance_and_determinant_are_the_covariances_own() -> None:
    one = piece(SWEEP)
    at = _local(one)
    noise = SensorNoise(COVARIANCE, COVARIANCE, 0.0)
    banded = banded_covariance(one, at, np.ones(len(one.signals.v_dc)), noise, R_S, None)
    n = banded.shape[1]
    dense = np.diag(banded[0])
    for k in range(1, len(banded)):
        dense = dense + np.diag(banded[k, : n - k], -k) + np.diag(banded[k, : n - k], k)
    whitener = Whitener.of(banded)
    np.testing.assert_array_equal(whitener.variance, np.diag(dense))
    assert whitener.log_det == pytest.approx(float(np.linalg.slogdet(dense)[1]), rel=1e-6)
    np.testing.assert_allclose(whitener(whitener(dense).T), np.eye(n), atol=1e-6)


def test_errors_in_common_are_whitened_too() -> None:
    one = piece(SWEEP)
    at = _local(one)
    banded = banded_covariance(
        one, at, np.ones(len(one.signals.v_dc)), SensorNoise(COVARIANCE, COVARIANCE, 0.0), R_S, None
    )
    plain = Whitener.of(banded)
    n = banded.shape[1]
    common = np.sqrt(plain.variance)[:, None] * np.random.default_rng(2).normal(size=(n, 2)) * np.array([0.3, 20.0])
    whitener, u = Whitener.of(banded, common), plain(common)
    both = np.eye(n) + u @ u.T
    # (1 + U U^T)^-1/2 on both sides leaves one; what is noise alone stays the variance that is reported.
    root = plain(np.eye(n))
    half = whitener(np.eye(n)) @ np.linalg.inv(root)
    np.testing.assert_allclose(half @ both @ half.T, np.eye(n), atol=1e-8)
    assert whitener.log_det == pytest.approx(plain.log_det + float(np.linalg.slogdet(both)[1]), rel=1e-9)
    np.testing.assert_array_equal(whitener.variance, plain.variance)


def test_an_inverters_slope_multiplies_the_noise() -> None:
    ohm = 50.0
    n = len(HOLD.v_dq)
    slopes = np.ascontiguousarray(np.broadcast_to(ohm * np.eye(2), (n, 2, 2)))
    plain, steep = _whitener(HOLD).variance, _whitener(HOLD, slopes).variance
    # A reading counts by L (w_k - w_k-1) and by Ts (slope - R) w_k; the mean square of a test function is a third.
    step = piece(HOLD).windows.step
    flux = np.array([L_D, L_Q]) / step
    expected = (flux**2 + ((ohm - R_S) / FS) ** 2 / 3.0) / (flux**2 + (R_S / FS) ** 2 / 3.0)
    np.testing.assert_allclose(steep / plain, expected, rtol=0.02)


@pytest.mark.parametrize("correlation", [0.0, 0.6, -0.4])
def test_covariance_and_correlation_of_the_readings_are_found(correlation: float) -> None:
    rng = np.random.default_rng(2)
    root = np.linalg.cholesky(COVARIANCE)
    holds = []
    for _ in range(12):
        noise = rng.normal(size=HOLD.v_dq.shape) @ root.T
        for k in range(1, len(noise)):
            noise[k] = correlation * noise[k - 1] + np.sqrt(1.0 - correlation**2) * noise[k]
        holds.append(piece(HOLD, noise=noise))
    found = sensor_noise(holds)
    assert found.correlation == pytest.approx(correlation, abs=0.05)
    np.testing.assert_allclose(found.covariance, COVARIANCE, rtol=0.12)


@pytest.mark.parametrize(
    ("off", "readings", "reported"), [(-0.085, 500, 0.0), (0.1, 500, 0.1), (-0.085, 50_000, -0.085), (0.02, 200, 0.0)]
)
def test_with_the_gates_off_readings_tell_what_current_control_does_and_chance_is_none(
    off: float, readings: int, reported: float
) -> None:
    held, free = (Scatter(np.eye(2), rho, np.zeros(0), n) for rho, n in ((0.15, 10_000), (off, readings)))
    assert _correlation([held], [free]) == reported
    assert _correlation([held], []) == 0.15


def test_ripple_does_not_pass_for_noise() -> None:
    rng = np.random.default_rng(3)
    pieces = [piece(plan, noise=rng.normal(0.0, NOISE_A, plan.v_dq.shape)) for plan in (HOLD, RIPPLE)]
    found = sensor_noise(pieces)
    assert np.trace(found.ripple) == pytest.approx(2.0 * NOISE_A**2, rel=0.15)


def test_a_current_that_was_written_as_zero_says_nothing_of_the_sensors() -> None:
    """Where the current across the stepped axis was not logged."""
    noise = np.random.default_rng(1).normal(size=(4000, 2))
    whole, cleaned = 3e-3 * noise, 2e-3 * noise * [1.0, 0.0]
    v = np.repeat(np.tile([[40.0, 0.0], [-40.0, 0.0]], (100, 1)), 20, axis=0)
    scatters = [scatter_between(i, v) for i in (cleaned, whole)]
    assert float(np.sqrt(np.diag(_quietest(scatters)[0].covariance)).min()) == pytest.approx(3e-3, rel=0.1)
    alone = _quietest(scatters[:1])[0].covariance
    assert np.sqrt(np.diag(alone)) == pytest.approx([2e-3, 2e-3], rel=0.1)


@pytest.mark.parametrize("unread", [0, 1])
def test_the_axis_that_was_read_is_whitened_as_if_the_other_were_not_there(unread: int) -> None:
    one = piece(Plan(SegmentStage.CLASSICAL, sweep(1 - unread, 2.0, 0.0, 1200)), angle=0.3)
    alone = replace(one, windows=replace(one.windows, unread=unread))
    noise = SensorNoise(NOISE_A**2 * np.eye(2), NOISE_A**2 * np.eye(2), 0.0)
    local = _local(one)
    banded = banded_covariance(alone, local, np.ones(len(one.signals.v_dc)), noise, R_S, None)
    rows = np.random.default_rng(5).normal(size=alone.windows.rows)
    other = rows.copy()
    other[unread::2] *= 3.0
    white, changed = (Whitener.of(banded)(x).reshape(-1, 2) for x in (rows, other))
    np.testing.assert_array_equal(white[:, 1 - unread], changed[:, 1 - unread])
    assert np.isfinite(white).all()


def test_rows_that_share_more_than_a_covariance_can_are_whitened_all_the_same() -> None:
    """Cut off beyond its band, what a steep map makes of neighbours may be no covariance."""
    banded = np.tile(np.array([[1.0], [0.8], [0.0]]), 40)
    with pytest.raises(np.linalg.LinAlgError):
        cholesky_banded(banded, lower=True)
    whitener = Whitener.of(banded)
    np.testing.assert_array_equal(whitener.variance, np.ones(40))
    assert np.isfinite(whitener.log_det)
    assert np.isfinite(whitener(np.eye(40))).all()

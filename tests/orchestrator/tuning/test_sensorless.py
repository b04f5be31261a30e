"""Position errors of both sensorless methods agree with machines whose inductances and fluxes are formulas."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from orchestrator.numerics.frames import rotation
from orchestrator.numerics.saliency import principal
from orchestrator.numerics.types import Array
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.sensorless import MAX_POSITION_ERROR_RAD, SIGMAS, Sensorless, sensorless_limits
from protocols import FluxMap, Motor
from tests.orchestrator.tuning.machines import flux_map, linear, saturated

LARGEST_A, R_S_OHM = 4.0, 2.0
MOTORING = np.column_stack([np.zeros(5), np.linspace(0.2, 3.0, 5)])
MOTOR = Motor(name="analytic", pole_pairs=2, pm_flux_wb=0.3)


def inverter(lost_std_v: float = 0.0, bias_std_v: float = 0.0) -> Compensation:
    """A compensation that leaves these errors."""
    table = np.zeros(3)
    return Compensation(
        current_a=np.array([-10.0, 0.0, 10.0]),
        lost_v=table,
        lost_per_bus_v=table,
        lost_std_v=table + lost_std_v,
        bias_ab_v=np.zeros(2),
        bias_std_v=bias_std_v,
        current_gain=np.eye(2),
        current_offset_a=np.zeros(2),
        angle_rad=0.0,
        voltage_delay_s=0.0,
        current_delay_s=0.0,
        delay_std_s=0.0,
        sources=(),
        left_out=(),
    )


def limits(
    a_map: FluxMap,
    *,
    injection: FluxMap | None = None,
    r_s_std_ohm: float = 0.0,
    lost_std_v: float = 0.0,
    bias_std_v: float = 0.0,
    current_noise_a: float | None = None,
    motor: Motor = MOTOR,
    operating: Array = MOTORING,
    current_a: float = LARGEST_A,
    table: Callable[[Array], Array] | None = None,
) -> Sensorless:
    machine = Machine(motor, a_map, R_S_OHM, r_s_std_ohm)
    left = inverter(lost_std_v, bias_std_v)
    return sensorless_limits(
        machine, left, current_a, operating, injection=injection, current_noise_a=current_noise_a, table=table
    )


def with_axis(a_map: FluxMap, axis_rad: Callable[[Array, Array], Array], least_h: float, most_h: float) -> FluxMap:
    """The map with measured inductances whose least one lies at an angle from the d axis, at each current."""
    angle = axis_rad(*(np.asarray(x, dtype=np.float64) for x in np.meshgrid(a_map.i_d, a_map.i_q, indexing="ij")))
    turned = [rotation(float(x)) @ np.diag([least_h, most_h]) @ rotation(-float(x)) for x in angle.ravel()]
    tables = np.array(turned).reshape(*angle.shape, 2, 2)
    l_dd, l_dq, l_qq = tables[..., 0, 0], tables[..., 0, 1], tables[..., 1, 1]
    return a_map.model_copy(update={"l_dd": l_dd, "l_dq": l_dq, "l_qq": l_qq})


def about_q(gain: float, i_d: Array, i_q: Array) -> Array:
    """An axis that turns by `gain` times the turn of the current from the positive q axis."""
    return gain * np.arctan2(-i_d, np.maximum(i_q, 1e-9))


LINEAR = flux_map(linear(0.03, 0.06, 0.3), LARGEST_A, nodes=21)


def salient(i_dq: Array) -> Array:
    """A saturated, cross-coupled machine with more inductance along q."""
    return saturated()(i_dq) + linear(0.0, 0.06, 0.0)(i_dq)


SATURATED = flux_map(salient, LARGEST_A, nodes=41)


def test_without_cross_saturation_there_is_no_error_and_injection_works_everywhere() -> None:
    found = limits(LINEAR)
    assert found.ratio == pytest.approx(2.0, rel=1e-6)
    for table in (found.injection_error_rad, found.large_signal_error_rad, found.error_slope):
        assert table == pytest.approx(0.0, abs=1e-6)
    assert found.works.all()
    assert found.left_by_map_rad == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("axis_rad", [0.2, -0.1])
def test_the_error_is_the_angle_of_the_axis_of_least_inductance(axis_rad: float) -> None:
    found = limits(with_axis(LINEAR, lambda d, q: np.full_like(d, axis_rad), 0.03, 0.06))
    assert found.injection_error_rad == pytest.approx(axis_rad)


def test_with_positive_cross_inductance_the_axis_is_turned_backwards() -> None:
    found = limits(SATURATED)
    cross = SATURATED.l_dq[found.injection_error_rad < -1e-3]
    assert cross.size > 100
    assert (cross > 0.0).all()


def test_without_saliency_injection_works_nowhere_and_the_axis_is_unknown() -> None:
    round_map = flux_map(linear(0.05, 0.05, 0.3), LARGEST_A)
    found = limits(round_map.model_copy(update={"l_dq_std": np.full_like(round_map.l_dq, 1e-4)}))
    assert found.ratio == pytest.approx(1.0, rel=1e-6)
    assert not found.works.any()
    assert found.injection_error_std_rad == pytest.approx(math.pi / math.sqrt(12.0))


def test_with_an_inverted_saliency_injection_tracks_the_other_axis() -> None:
    assert not limits(flux_map(linear(0.06, 0.03, 0.3), LARGEST_A)).works.any()


def test_the_slope_is_the_errors_derivative_with_respect_to_the_estimated_angle() -> None:
    found = limits(flux_map(salient, LARGEST_A, nodes=161))
    machine = Machine(MOTOR, flux_map(salient, LARGEST_A, nodes=161), R_S_OHM, 0.0)
    for row, column in ((60, 110), (100, 120), (50, 40)):
        i_dq = np.array([found.i_d_a[row], found.i_q_a[column]])
        ahead, behind = (_axis(machine, rotation(x) @ i_dq) for x in (1e-3, -1e-3))
        assert found.error_slope[row, column] == pytest.approx((ahead - behind) / 2e-3, rel=0.02)


def _axis(machine: Machine, i_dq: Array) -> float:
    (matrix,) = machine.inductance(i_dq[None, :])
    return float(principal(*(np.array([x]) for x in (matrix[0, 0], matrix[0, 1], matrix[1, 1]))).angle_rad[0])


@pytest.mark.parametrize("gain", [-0.5, 0.6, 1.6])
def test_a_tracking_loop_converges_only_where_injection_works(gain: float) -> None:
    """At a current along q, whose axis turns by `gain` times the turn of the current."""
    fine = flux_map(linear(0.03, 0.06, 0.3), LARGEST_A, nodes=81)
    found = limits(with_axis(fine, lambda d, q: about_q(gain, d, q), 0.03, 0.06))
    row, column = 40, 64
    i_ref = np.array([found.i_d_a[row], found.i_q_a[column]])
    assert found.error_slope[row, column] == pytest.approx(gain, rel=0.01)
    error = 0.02
    for _ in range(400):
        i_true = rotation(error) @ i_ref
        error -= 0.05 * (error - float(about_q(gain, *i_true)))
    assert found.works[row, column] == (abs(error) < 1e-3)


def test_the_errors_standard_deviation_is_that_of_drawn_inductances() -> None:
    a_map = flux_map(salient, LARGEST_A, nodes=9, std=0.01)
    found = limits(a_map)
    row, column = 2, 6
    rng = np.random.default_rng(3)
    drawn = [
        getattr(a_map, name)[row, column] + getattr(a_map, f"{name}_std")[row, column] * rng.normal(size=20_000)
        for name in ("l_dd", "l_dq", "l_qq")
    ]
    expected = float(np.std(principal(*drawn).angle_rad))
    assert found.injection_error_std_rad[row, column] == pytest.approx(expected, rel=0.05)


def test_what_a_ripple_measures_is_tracked_and_the_maps_slopes_leave_the_difference() -> None:
    ripple = with_axis(LINEAR, lambda d, q: np.full_like(d, 0.05), 0.02, 0.04)
    found = limits(LINEAR, injection=ripple)
    assert found.injection_error_rad == pytest.approx(0.05)
    assert found.large_signal_error_rad == pytest.approx(0.0, abs=1e-6)
    assert found.left_by_map_rad == pytest.approx(0.05, abs=1e-6)


def test_the_drives_own_table_leaves_what_it_differs_by_and_the_error_follows_the_references() -> None:
    ripple = with_axis(LINEAR, lambda d, q: np.full_like(d, 0.05), 0.02, 0.04)
    row = [float(np.asarray(one)[0, 0]) for one in (ripple.l_dd, ripple.l_dq, ripple.l_qq)]
    found = limits(LINEAR, injection=ripple, table=lambda i_dq: np.tile(row, (len(i_dq), 1)))
    assert found.left_by_map_rad == pytest.approx(0.0, abs=1e-6)
    assert found.operating_error_rad == pytest.approx(0.05)
    assert found.operating_works.all()


def test_small_loops_that_are_flatter_in_all_directions_alike_leave_the_error_and_the_signal() -> None:
    """Hysteresis adds a constant to the inverse inductances; the ratio falls, the axis stays."""
    entries = [SATURATED.l_dd, SATURATED.l_dq, SATURATED.l_dq, SATURATED.l_qq]
    plain = np.asarray(np.stack(entries, axis=-1).reshape(41, 41, 2, 2), dtype=np.float64)
    loops = np.asarray(np.linalg.inv(np.linalg.inv(plain) + 5.0 * np.eye(2)), dtype=np.float64)
    tables = {"l_dd": loops[..., 0, 0], "l_dq": loops[..., 0, 1], "l_qq": loops[..., 1, 1]}
    without, found = limits(SATURATED), limits(SATURATED, injection=SATURATED.model_copy(update=tables))
    assert found.injection_error_rad == pytest.approx(without.injection_error_rad, abs=1e-9)
    assert (found.ratio < without.ratio).all()
    seen, by_map = (principal(x[..., 0, 0], x[..., 0, 1], x[..., 1, 1]) for x in (loops, plain))
    assert 1.0 / seen.l_min - 1.0 / seen.l_max == pytest.approx(1.0 / by_map.l_min - 1.0 / by_map.l_max)


def test_what_the_map_leaves_counts_only_where_there_is_saliency() -> None:
    salient_map = with_axis(LINEAR, lambda d, q: np.full_like(d, 0.05), 0.03, 0.06)
    faint = with_axis(LINEAR, lambda d, q: np.full_like(d, 0.4), 0.05, 0.051)
    names = ("l_dd", "l_dq", "l_qq")
    far = np.abs(LINEAR.i_q) > 1.5
    both = {name: np.where(far, getattr(faint, name), getattr(salient_map, name)) for name in names}
    assert limits(LINEAR, injection=LINEAR.model_copy(update=both)).left_by_map_rad == pytest.approx(0.05, abs=1e-3)
    assert math.isnan(limits(LINEAR, injection=faint).left_by_map_rad)


def test_beyond_the_injected_region_the_maps_own_inductances_serve() -> None:
    ripple = with_axis(LINEAR, lambda d, q: np.full_like(d, 0.05), 0.03, 0.06)
    half = {"i_q": ripple.i_q[10:]}
    names = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")
    half |= {f"{name}{end}": getattr(ripple, f"{name}{end}")[:, 10:] for name in names for end in ("", "_std")}
    found = limits(LINEAR, injection=ripple.model_copy(update=half))
    assert found.injection_error_rad[:, 10:] == pytest.approx(0.05)
    assert found.injection_error_rad[:, :10] == pytest.approx(0.0, abs=1e-6)


def test_more_noise_needs_more_saliency() -> None:
    ratios = [limits(LINEAR, current_noise_a=LARGEST_A * noise).least_ratio for noise in (1e-6, 1e-3, 3e-3)]
    assert ratios[0] == pytest.approx(1.0, abs=1e-3)
    assert 1.0 < ratios[0] < ratios[1] < ratios[2]
    lost = limits(LINEAR, current_noise_a=0.1 * LARGEST_A)
    assert math.isinf(lost.least_ratio)
    assert not lost.works.any()


def test_at_the_least_ratio_the_noise_turns_the_axis_by_the_limit() -> None:
    """Demodulated ripple at a small angle to the axis, with noise on every reading of both currents."""
    found, rng = limits(LINEAR, current_noise_a=4e-3), np.random.default_rng(1)
    injected_a, readings = 0.05 * LARGEST_A, 16
    wave = np.cos(2.0 * math.pi * np.arange(readings) / 4.0 + 0.3)
    noise = 4e-3 * rng.normal(size=(20_000, readings)) @ wave / np.sum(wave**2)
    turn = noise / (injected_a * (1.0 - 1.0 / found.least_ratio))
    assert SIGMAS * np.std(turn) == pytest.approx(MAX_POSITION_ERROR_RAD, rel=0.03)


def test_with_an_exact_resistance_and_inverter_the_observer_works_from_standstill() -> None:
    speeds = [limits(LINEAR, r_s_std_ohm=std).least_speed_rad_s for std in (0.1, 0.01, 0.0)]
    assert speeds[0] > speeds[1] > 0.0
    assert speeds[1] == pytest.approx(0.1 * speeds[0])
    assert speeds[2] == 0.0


def test_the_observers_speed_is_the_voltage_error_over_the_active_flux() -> None:
    operating = np.array([[-1.0, 2.0]])
    found = limits(LINEAR, r_s_std_ohm=0.05, operating=operating)
    active = 0.3 + (0.03 - 0.06) * -1.0
    expected = 1.96 * 0.05 * math.hypot(1.0, 2.0) / (math.radians(5.0) * active)
    assert found.least_speed_rad_s == pytest.approx(expected, rel=1e-6)


def test_the_active_flux_is_what_makes_torque_with_the_q_current() -> None:
    """T = 3/2 n psi_a i_q holds for a saturated machine too."""
    operating = np.array([[-1.5, 2.5]])
    machine = Machine(MOTOR, SATURATED, R_S_OHM, 0.05)
    active = float(machine.torque_nm(operating)[0]) / (1.5 * 2 * 2.5)
    expected = 1.96 * 0.05 * math.hypot(1.5, 2.5) / (math.radians(5.0) * active)
    assert limits(SATURATED, r_s_std_ohm=0.05, operating=operating).least_speed_rad_s == pytest.approx(expected)


def test_an_error_of_the_legs_counts_by_its_fundamental() -> None:
    found = limits(LINEAR, lost_std_v=0.1, operating=np.array([[0.0, 2.0]]))
    expected = 1.96 * 4.0 / math.pi * 0.1 / (math.radians(5.0) * 0.3)
    assert found.least_speed_rad_s == pytest.approx(expected, rel=1e-3)


def test_errors_of_the_voltage_add_in_squares() -> None:
    operating = np.array([[0.0, 2.0]])
    parts: list[dict[str, Any]] = [{"r_s_std_ohm": 0.05}, {"lost_std_v": 0.1}, {"bias_std_v": 0.08}]
    alone = [limits(LINEAR, operating=operating, **part).least_speed_rad_s for part in parts]
    together = limits(LINEAR, operating=operating, r_s_std_ohm=0.05, lost_std_v=0.1, bias_std_v=0.08)
    assert together.least_speed_rad_s == pytest.approx(math.hypot(*alone))


def test_a_winding_that_warms_unnoticed_needs_more_speed() -> None:
    found = limits(LINEAR, operating=np.array([[0.0, 2.0]]))
    expected = 0.00393 * 50.0 * R_S_OHM * 2.0 / (math.radians(5.0) * 0.3)
    assert found.least_speed_warm_rad_s == pytest.approx(expected)


def test_no_speed_removes_an_error_of_the_map() -> None:
    slight, coarse = (flux_map(linear(0.03, 0.06, 0.3), LARGEST_A, std=std) for std in (0.02, 0.2))
    exact = limits(LINEAR, r_s_std_ohm=0.05)
    assert exact.least_speed_rad_s < limits(slight, r_s_std_ohm=0.05).least_speed_rad_s < math.inf
    assert math.isinf(limits(coarse, r_s_std_ohm=0.05).least_speed_rad_s)


def test_without_the_magnets_flux_the_observers_speed_is_not_known() -> None:
    unknown = flux_map(linear(0.03, 0.06, 0.0), LARGEST_A)
    nameless = MOTOR.model_copy(update={"pm_flux_wb": None})
    assert math.isnan(limits(unknown, motor=nameless, r_s_std_ohm=0.05).least_speed_rad_s)


def test_a_reluctance_machine_has_no_active_flux_without_d_current() -> None:
    found = limits(
        flux_map(linear(0.03, 0.06, 0.0), LARGEST_A),
        motor=MOTOR.model_copy(update={"pm_flux_wb": 0.0}),
        r_s_std_ohm=0.05,
    )
    assert math.isinf(found.least_speed_rad_s)
    assert np.isfinite(found.observer_speed_rad_s[0]).all()


def test_tables_are_empty_where_nothing_was_measured() -> None:
    cut = {name: getattr(SATURATED, name).copy() for name in ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")}
    for table in cut.values():
        table[:10, :10] = np.nan
    found = limits(SATURATED.model_copy(update=cut))
    for table in (found.ratio, found.injection_error_rad, found.large_signal_error_rad, found.observer_speed_rad_s):
        assert np.isnan(table[:9, :9]).all()
        assert np.isfinite(table[12:, 12:]).all()
    assert not found.works[:9, :9].any()


def test_limits_do_not_depend_on_the_size_of_the_machine() -> None:
    """For a hundred times the current at the same voltage, inductances and R_s are a hundredth and the fluxes stay."""
    found, size = limits(SATURATED, r_s_std_ohm=0.05), 100.0
    tables = {"i_d": size * SATURATED.i_d, "i_q": size * SATURATED.i_q}
    names = [f"{name}{end}" for name in ("l_dd", "l_dq", "l_qq") for end in ("", "_std")]
    tables |= {name: getattr(SATURATED, name) / size for name in names}
    large = SATURATED.model_copy(update=tables)
    machine = Machine(MOTOR, large, R_S_OHM / size, 0.05 / size)
    scaled = sensorless_limits(machine, inverter(), size * LARGEST_A, size * MOTORING)
    for field in dataclasses.fields(Sensorless):
        factor = size if field.name in ("i_d_a", "i_q_a", "operating_dq_a") else 1.0
        expected = factor * np.asarray(getattr(found, field.name), dtype=float)
        assert np.asarray(getattr(scaled, field.name), dtype=float) == pytest.approx(expected, rel=1e-6, abs=1e-8)

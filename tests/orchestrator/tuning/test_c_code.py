from __future__ import annotations

import ctypes
import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import fsolve

from orchestrator.numerics.frames import rotation
from orchestrator.numerics.types import Array
from orchestrator.tuning.limits import VOLTAGE_RESERVE, DriveLimits
from orchestrator.tuning.references import flux_limit
from protocols import InputError
from tests.orchestrator.tuning.closed_loop import STRICT, Plant, compiler, library_of, run
from tests.orchestrator.tuning.cortex_m import CortexM, EmulatedFunctions
from tests.orchestrator.tuning.functions import Functions, HostFunctions, words
from tests.orchestrator.tuning.int32_functions import SIGNATURES, HostInt32, Int32Functions
from tests.orchestrator.tuning.tables import LIMITS, Tables, tables_of
from tests.plugins.wire.firmware.built import tool

OK, LIMITED, INVALID = 0, 1, -1
MOST_FLASH = 16 * 1024
PLANT = Plant(dead_time=1.5e-6, drop_v=0.8, drop_ohm=0.02, gain_a=1.02, gain_b=0.99, offset_a=0.1, offset_b=-0.05,
              angle_error=0.02)  # fmt: skip
PUBLIC = {
    *("psi_wb", "inductance_h", "r_s_ohm", "torque_limit_nm", "current_reference_a", "current_control_init"),
    *("current_control_v", "leg_voltage_v", "corrected_current_a", "add_bias_v", "angle_rad", "angle_ahead_rad"),
}
RELATIVE = 1e-3
"""Of the largest value: float32 against float64."""


@pytest.fixture(scope="module")
def tables() -> Tables:
    return tables_of(PLANT)


EMULATED = [
    pytest.param(name, marks=pytest.mark.slow) for name in ("cortex-m4f", "cortex-m0", "cortex-m3", "cortex-m4")
]
IN_FLOAT = ("host", "cortex-m4f")


@pytest.fixture(scope="module", params=["host", "host int32", *EMULATED])
def drive(request: pytest.FixtureRequest, tables: Tables, tmp_path_factory: pytest.TempPathFactory) -> Functions:
    """The source in float, and in int32 where a core has no floats."""
    return drive_on(request.param, tables, tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module", params=["host", EMULATED[0]])
def float_drive(request: pytest.FixtureRequest, tables: Tables, tmp_path_factory: pytest.TempPathFactory) -> Functions:
    return drive_on(request.param, tables, tmp_path_factory.mktemp("drive"))


def drive_on(name: str, tables: Tables, folder: Path) -> Functions:
    if name == "host":
        return host(tables, folder)
    if name == "host int32":
        return Int32Functions(HostInt32(library_of(tables.int32_files(), folder)))
    if name in IN_FLOAT:
        return EmulatedFunctions(CortexM(name, tables.files(), folder))
    return Int32Functions(CortexM(name, tables.int32_files(), folder))


def host(tables: Tables, folder: Path, options: Sequence[str] = ("-O2",)) -> HostFunctions:
    return HostFunctions(library_of(tables.files(), folder, options=options))


def test_a_lag_of_the_readings_turns_their_frame_back_and_not_the_voltage_s(tables: Tables, tmp_path: Path) -> None:
    late = replace(tables, compensation=replace(tables.compensation, current_delay_s=5e-5))
    plain, lagging = (host(one, tmp_path / name, ("-O0",)) for name, one in (("a", tables), ("b", late)))
    for drive, lag in ((plain, 0.0), (lagging, 5e-5)):
        assert drive.number("angle_rad", 1.0, 1000.0) == pytest.approx(1.0 + PLANT.angle_error - 1000.0 * lag, rel=1e-6)
    assert plain.number("angle_ahead_rad", 1.0, 1000.0) - lagging.number(
        "angle_ahead_rad", 1.0, 1000.0
    ) == pytest.approx(1000.0 * 5e-5, rel=1e-4)


def assert_near(actual: Array, expected: Array) -> None:
    assert np.abs(actual - expected).max() <= RELATIVE * np.abs(expected).max()


def test_flux_is_the_table_linear_between_and_beyond_its_nodes(tables: Tables, drive: Functions) -> None:
    control = tables.control
    at = np.random.default_rng(1).uniform(-40.0, 40.0, (500, 2))
    lookup = RegularGridInterpolator(
        (control.i_d_a, control.i_q_a), control.psi_wb, bounds_error=False, fill_value=None
    )
    assert_near(np.array([drive.vector("psi_wb", 2, *i)[1] for i in at]), lookup(at))


def test_inductance_is_the_table_held_at_its_ends(tables: Tables, drive: Functions) -> None:
    control = tables.control
    at = np.random.default_rng(2).uniform(-40.0, 40.0, (500, 2))
    lookup = RegularGridInterpolator((control.gain_i_d_a, control.gain_i_q_a), control.inductance_h)
    held = np.clip(at, control.gain_i_d_a[0], control.gain_i_d_a[-1])
    assert_near(np.array([drive.vector("inductance_h", 3, *i)[1] for i in at]), lookup(held))


def flux_less(i_dq: Array, psi_wb: Array) -> Array:
    return PLANT.psi(i_dq) - psi_wb


def tracked_angle(theta_rad: float, i_dq: Array) -> float:
    """Where a tracking settles that injects a flux along its d axis and turns until no ripple is across it [rad].

    The plant's current for a flux is searched; no inductance is used.
    """
    at_rest, tracked = PLANT.psi(i_dq), theta_rad
    for _ in range(60):
        ripple_wb = 1e-4 * rotation(tracked - theta_rad)[:, 0]
        currents = [fsolve(flux_less, i_dq, args=(at_rest + s * ripple_wb,)) for s in (1.0, -1.0)]
        seen = rotation(tracked - theta_rad).T @ (currents[0] - currents[1])
        tracked += 0.5 * math.atan2(seen[1], seen[0])
    return tracked


@pytest.mark.parametrize(("i_d", "i_q"), [(-6.0, 6.0), (-6.0, -12.0), (6.0, 6.0)])
def test_the_headers_line_turns_the_axis_that_injection_tracks_into_the_d_axis(
    tables: Tables, tmp_path: Path, i_d: float, i_q: float
) -> None:
    # At nodes of the table of inductances, whose interpolation is no matter of this test.
    files = tables.files()
    (line,) = re.findall(r"^ \*     (theta = .*atan2f.*;)$", files["motor_drive.h"].decode(), flags=re.MULTILINE)
    source = f"""
        #include <math.h>
        #include "motor_drive.h"
        float axis(float theta_tracked, float i_d, float i_q);
        float axis(float theta_tracked, float i_d, float i_q)
        {{ float l[3], theta; motor_inductance_h(i_d, i_q, l); {line} return theta; }}
    """
    axis = library_of(files, tmp_path, source.encode()).axis
    axis.restype = ctypes.c_float
    theta = 0.7
    tracked = tracked_angle(theta, np.array([i_d, i_q]))
    assert abs(tracked - theta) > math.radians(3.0)
    assert axis(*map(ctypes.c_float, (tracked, i_d, i_q))) == pytest.approx(theta, abs=math.radians(0.5))


def left_flux(limits: DriveLimits, r_s: float, current_2: float, torque_nm: float, omega: float) -> float:
    """|psi| [Wb] at which R_s i + j omega psi has the voltage without the reserve, at |i|^2 [A^2] and a torque.

    R_s i and j omega psi together take 2 R_s omega (i_q psi_d - i_d psi_q) from the square of the voltage.
    """
    volts = (1.0 - VOLTAGE_RESERVE) * limits.voltage_v
    cross = 2.0 * r_s * omega * torque_nm / (1.5 * PLANT.pole_pairs)
    return math.sqrt(max(volts**2 - r_s**2 * current_2 - cross, 0.0)) / abs(omega)


def test_the_header_states_the_flux_at_which_the_references_end_and_below_it_the_torque_falls_to_zero(
    tables: Tables, drive: Functions
) -> None:
    ends_wb = float(tables.references.psi_limit_wb[0])
    header = " ".join(tables.files()["motor_drive.h"].decode("ascii").replace("\n *", "").split())
    assert f"less flux than {ends_wb:.4g} Wb" in header
    r_s = tables.control.r_s_ohm
    speed = [
        flux_limit(LIMITS, r_s, LIMITS.current_a, 1.0) / (part * ends_wb)
        for part in (1.01, 1.0 - 1.01 * VOLTAGE_RESERVE)
    ]
    at_end, beyond = (drive.number("torque_limit_nm", float(w), LIMITS.bus_v, r_s) for w in speed)
    assert at_end > 0.0
    assert beyond == 0.0


def test_references_are_the_tables_within_the_voltage_at_every_speed_and_bus(tables: Tables, drive: Functions) -> None:
    rng = np.random.default_rng(3)
    torque, speed, bus, ohm = (
        rng.uniform(-12.0, 12.0, 500),
        rng.uniform(-3000.0, 3000.0, 500),
        rng.uniform(290.0, 400.0, 500),
        rng.uniform(0.8, 1.5, 500) * tables.control.r_s_ohm,
    )
    references, expected, most = tables.references, [], []
    for t, w, v, r_s in zip(torque, speed, bus, ohm, strict=True):
        limits = dataclasses.replace(LIMITS, bus_v=float(v))
        largest = flux_limit(limits, r_s, LIMITS.current_a, w)
        most.append(float(np.interp(largest, references.psi_limit_wb, references.torque_limit_nm)))
        most[-1] *= min(1.0, max(0.0, 1.0 - (1.0 - largest / references.psi_limit_wb[0]) / VOLTAGE_RESERVE))
        wanted = np.array([np.clip(t, -most[-1], most[-1])])
        rest = references.at(np.zeros(1), np.atleast_1d(largest))[0, 0]
        current_2 = rest**2 + (float(wanted[0]) / max(most[-1], 1e-9)) ** 2 * (LIMITS.current_a**2 - rest**2)
        psi = left_flux(limits, r_s, current_2, float(wanted[0]), w)
        expected.append(references.at(wanted, np.atleast_1d(psi))[0])
    found = [drive.vector("current_reference_a", 2, *x) for x in zip(torque, speed, bus, ohm, strict=True)]
    assert_near(np.array([i for _, i in found]), np.array(expected))
    assert_near(
        np.array([drive.number("torque_limit_nm", *x) for x in zip(speed, bus, ohm, strict=True)]), np.array(most)
    )
    reports = np.array([report for report, _ in found])
    clear = np.abs(np.abs(torque) - most) > 1e-3
    assert np.array_equal(reports[clear], np.where(np.abs(torque) > most, LIMITED, OK)[clear])


def test_torque_ends_where_the_voltage_is_too_low_for_the_speed(drive: Functions) -> None:
    full = drive.number("torque_limit_nm", 3000.0, 300.0, PLANT.r_s)
    assert 0.0 < drive.number("torque_limit_nm", 3000.0, 292.0, PLANT.r_s) < full
    assert drive.number("torque_limit_nm", 3000.0, 250.0, PLANT.r_s) == 0.0
    assert drive.number("torque_limit_nm", 0.0, 300.0, PLANT.r_s) > full


def test_compensation_is_the_tables_and_matrices(tables: Tables, drive: Functions) -> None:
    compensation = tables.compensation
    current = np.random.default_rng(4).uniform(-30.0, 30.0, 300)
    for bus in (250.0, 350.0):
        losses = compensation.lost_v + bus * compensation.lost_per_bus_v
        expected = np.interp(current, compensation.current_a, losses)
        assert_near(np.array([drive.number("leg_voltage_v", i, bus) for i in current]), expected)
    read, out = np.array([3.0, -4.0], dtype=np.float32), words(2)
    drive.call("corrected_current_a", read, out)
    assert_near(out.astype(np.float64), compensation.current_gain @ [3.0, -4.0] + compensation.current_offset_a)
    drive.call("corrected_current_a", read, read)
    assert np.array_equal(read, out)
    lag = tables.compensation.current_delay_s
    behind, ahead = 1.0 - 2000.0 * lag, 1.0 + 2000.0 * (tables.control.delay_s - lag)
    behind, ahead = behind + PLANT.angle_error, ahead + PLANT.angle_error
    assert drive.number("angle_rad", 1.0, 2000.0) == pytest.approx(behind, rel=1e-6)
    assert drive.number("angle_ahead_rad", 1.0, 2000.0) == pytest.approx(ahead, rel=1e-6)


def test_bias_is_added_to_the_voltage(tables: Tables, tmp_path: Path) -> None:
    compensation = dataclasses.replace(tables.compensation, bias_ab_v=np.array([0.5, -0.25]))
    v = np.array([1.0, 2.0], dtype=np.float32)
    host(dataclasses.replace(tables, compensation=compensation), tmp_path).call("add_bias_v", v)
    assert np.array_equal(v, [1.5, 1.75])


def test_resistance_is_that_of_copper_at_the_winding_s_temperature(tables: Tables, tmp_path: Path) -> None:
    """R(T) = R(20 C) (1 + 0.00393 (T - 20 C)), from wherever R_s is known."""
    warm = replace(tables, control=replace(tables.control, winding_c=60.0))
    at_60_c = host(warm, tmp_path)
    for winding_c in (20.0, 60.0, 140.0):
        expected = PLANT.r_s * (1.0 + 0.00393 * (winding_c - 20.0)) / (1.0 + 0.00393 * 40.0)
        assert at_60_c.number("r_s_ohm", winding_c) == pytest.approx(expected, rel=1e-6)
    assert at_60_c.number("r_s_ohm", math.nan) == pytest.approx(PLANT.r_s)
    assert at_60_c.number("r_s_ohm", -1e5) == pytest.approx(0.5 * PLANT.r_s)


@pytest.mark.parametrize("winding_c", [None, 20.0])
def test_a_temperature_that_nobody_gave_is_marked_as_assumed(tables: Tables, winding_c: float | None) -> None:
    held = replace(tables, control=replace(tables.control, winding_c=winding_c))
    for files, name, value in ((held.files(), "R_S_AT_C", "20.0f"), (held.int32_files(), "R_S_AT_MDEG_C", "20000")):
        header = next(text.decode() for file, text in files.items() if file.endswith(".h"))
        (line,) = (line for line in header.splitlines() if line.startswith(f"#define MOTOR_{name} "))
        assert value in line
        assert ("/* assumed: `run --ambient` states it */" in line) == (winding_c is None)


def test_an_invalid_resistance_counts_as_the_known_one(drive: Functions) -> None:
    known = drive.vector("current_reference_a", 2, 8.0, 2500.0, 300.0, PLANT.r_s)[1]
    warm = drive.vector("current_reference_a", 2, 8.0, 2500.0, 300.0, 1.5 * PLANT.r_s)[1]
    assert warm != pytest.approx(known, abs=1e-3)
    for bad in (math.nan, math.inf, 0.0, -1.0):
        assert np.array_equal(drive.vector("current_reference_a", 2, 8.0, 2500.0, 300.0, bad)[1], known)


@pytest.mark.parametrize("name", ["host", "host int32"])
def test_a_magnet_of_known_temperature_gives_the_torque_that_is_wanted(
    name: str, tables: Tables, tmp_path: Path
) -> None:
    """Within a few calls, as the current reference of one goes into the next."""
    per_k, magnet_c = -0.0011, 120.0
    motor = tables.motor.model_copy(update={"pm_flux_wb": PLANT.psi_m})
    drive = drive_on(name, replace(tables, motor=motor, magnet_per_k=per_k), tmp_path)
    warm = replace(PLANT, psi_m=PLANT.psi_m * (1.0 + per_k * (magnet_c - 20.0)))
    for torque in (-7.0, -2.0, 0.5, 4.0, 8.0):
        i_ref = words(2)
        for _ in range(6):
            wanted = drive.number("torque_reference_nm", torque, magnet_c, i_ref)
            drive.call("current_reference_a", wanted, 800.0, 300.0, PLANT.r_s, i_ref)
        assert warm.torque_nm(i_ref.astype(np.float64)) == pytest.approx(torque, abs=0.01)
        assert abs(float(PLANT.torque_nm(i_ref.astype(np.float64)))) > 1.01 * abs(torque)


def reference_control(tables: Tables) -> Callable[[complex, complex, float, float, float], complex]:
    """The same controller in complex numbers, with its state."""
    control, period = tables.control, 1.0 / LIMITS.sampling_hz
    lookup = RegularGridInterpolator((control.i_d_a, control.i_q_a), control.psi_wb)
    alpha, corner = control.bandwidth_rad_s, control.integral_rad_s
    # K + B = alpha (1 + B T), K B = alpha alpha_i (1 + B T)
    roots = np.roots([alpha * period - 1.0, alpha * (1.0 - corner * period), -alpha * corner])
    observer = float(roots.real.min())
    gain = alpha * (1.0 + observer * period) - observer
    assert gain * observer == pytest.approx(alpha * corner * (1.0 + observer * period))
    lost, given, expected = 0j, 0j, None
    count = 0

    def psi_of(i: complex) -> complex:
        return complex(*lookup([i.real, i.imag])[0])

    def within(x: complex, most: float) -> complex:
        return x if abs(x) <= most else x / abs(x) * most

    def reach(x: complex, step: complex, most: float) -> complex:
        """By bisection, as far along the step as the length stays."""
        if abs(x + step) <= most:
            return x + step
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if abs(x + middle * step) <= most else (low, middle)
        return x + low * step

    def step(i_ref: complex, i: complex, omega: float, v_dc: float, r_s: float) -> complex:
        nonlocal lost, given, expected, count
        most = v_dc / math.sqrt(3.0)
        psi, psi_ref = psi_of(i), psi_of(i_ref)
        if expected is not None:
            lost = within(lost + observer * (expected - psi), most)
        if count > 0:
            turn = 0.5j * omega * period
            expected = ((1.0 - turn) * psi + period * (given - r_s * i - lost)) / (1.0 + turn)
        hold = r_s * i + 1j * omega * (psi if expected is None else expected) + lost
        more = gain * (1.0 + 1j * omega * (control.delay_s - period)) * (psi_ref - psi)
        v = hold + more
        if abs(v) > most:
            steady = within(r_s * i_ref + 1j * omega * psi_ref + lost, most)
            v = reach(reach(steady, hold - steady, max(abs(steady), (1.0 - 0.5 * VOLTAGE_RESERVE) * most)), more, most)
        given, count = v, count + 1
        return v

    return step


@pytest.mark.parametrize("size", [2.0, 20.0])
def test_current_control_is_its_formula_within_and_at_the_limit(tables: Tables, drive: Functions, size: float) -> None:
    rng, limited = np.random.default_rng(5), 0
    for _ in range(20):
        state, formula = drive.state(), reference_control(tables)
        r_s = rng.uniform(0.8, 1.5) * PLANT.r_s
        omega = rng.uniform(-2500.0, 2500.0) if size > 10.0 else rng.uniform(-500.0, 500.0)
        for _ in range(6):
            i_ref = rng.uniform(-1.0, 1.0, 2) * size / math.sqrt(2.0) - [5.0, 0.0]
            i = i_ref + rng.normal(0.0, 0.1 * size, 2)
            report, v = drive.control(state, i_ref, i, omega, 300.0, r_s)
            expected = formula(complex(*i_ref), complex(*i), omega, 300.0, r_s)
            assert abs(complex(*v) - expected) < RELATIVE * 300.0
            assert report in (OK, LIMITED)
            limited += report == LIMITED
    assert (limited > 20) if size > 10.0 else (limited < 60)


BAD = st.sampled_from([math.nan, math.inf, -math.inf, 3e38, -2e6])
NUMBERS = st.floats(-1e3, 1e3, width=32)
ANY = st.one_of(NUMBERS, BAD, st.just(0.0))
EXAMPLES = 2 * settings().max_examples
"""Twice as many as elsewhere: one costs little."""


def usable(*values: float) -> bool:
    return all(math.isfinite(v) and abs(v) <= 1e6 for v in values)


@settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(ANY, ANY, ANY, ANY, ANY, ANY, st.one_of(ANY, st.just(300.0))), min_size=1, max_size=5))
def test_whatever_comes_the_voltage_is_finite_and_the_state_is_not_spoilt(
    float_drive: Functions, calls: list[tuple[float, float, float, float, float, float, float]]
) -> None:
    state = float_drive.state()
    for *currents, omega, r_s, v_dc in calls:
        lost = state[:2].copy()
        report, v = float_drive.control(state, currents[:2], currents[2:], omega, v_dc, r_s)
        if usable(*currents, omega, v_dc) and v_dc > 0.0:
            assert report in (OK, LIMITED)
            assert np.hypot(*v) <= v_dc / math.sqrt(3.0) * (1.0 + 1e-5)
        else:
            assert report == INVALID
            assert np.array_equal(v, [0.0, 0.0])
            assert np.array_equal(state[:2], lost)
        assert np.isfinite(state[:6]).all()
    for _ in range(3):
        report, v = float_drive.control(state, [0.0, 1.0], [0.0, 1.0], 10.0, 300.0)
        assert report in (OK, LIMITED)
        assert np.isfinite(v).all()


@settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ANY, ANY, ANY, ANY)
def test_whatever_comes_references_and_lookups_are_finite(
    float_drive: Functions, a: float, b: float, c: float, d: float
) -> None:
    report, i_ref = float_drive.vector("current_reference_a", 2, a, b, c, d)
    limit = float_drive.number("torque_limit_nm", b, c, d)
    assert np.hypot(*i_ref) <= LIMITS.current_a * 1.001
    assert 0.0 <= limit < 12.0
    assert (report == INVALID) == (not usable(a, b, c) or c <= 0.0)
    if not usable(b, c) or c <= 0.0:
        assert np.array_equal(i_ref, [0.0, 0.0])
        assert limit == 0.0
    elif not usable(a):
        assert i_ref[1] == pytest.approx(0.0, abs=1e-6)
    for name, size in (("psi_wb", 2), ("inductance_h", 3)):
        assert np.isfinite(float_drive.vector(name, size, a, b)[1]).all()
    assert math.isfinite(float_drive.number("leg_voltage_v", a, b))


def test_invalid_numbers_are_refused_with_fast_arithmetic_too(tables: Tables, tmp_path: Path) -> None:
    fast = host(tables, tmp_path, ("-O3", "-ffast-math"))
    for bad in (math.nan, math.inf):
        assert fast.control(fast.state(), [0.0, 1.0], [bad, 0.0], 10.0, 300.0)[0] == INVALID
        report, v = fast.vector("current_reference_a", 2, bad, 10.0, 300.0, PLANT.r_s)
        assert (report, v[1]) == (INVALID, 0.0)


def test_one_bad_sample_does_not_change_the_current_for_long(float_drive: Functions) -> None:
    """The integral part stays: after a NaN the next voltage is the one before it."""
    state = float_drive.state()
    for k in range(50):
        _, before = float_drive.control(state, [0.0, 5.0], [0.0, 5.0 - 0.5 * math.exp(-0.2 * k)], 100.0, 300.0)
    report, v = float_drive.control(state, [0.0, 5.0], [math.nan, 5.0], 100.0, 300.0)
    assert (report, *v) == (INVALID, 0.0, 0.0)
    _, after = float_drive.control(state, [0.0, 5.0], [0.0, 5.0], 100.0, 300.0)
    assert after == pytest.approx(before, abs=0.1)


def symbols_of(source: str, folder: Path) -> list[list[str]]:
    """Kinds and names of an object's symbols; every warning is an error."""
    run(compiler(), *STRICT, "-Wshadow", "-Os", "-fno-asynchronous-unwind-tables", "-c", source, folder=folder)
    return [line.split()[-2:] for line in run(tool("nm"), f"{source[:-2]}.o", folder=folder).splitlines()]


def declared_in(header: Path) -> set[str]:
    return set(re.findall(r"^(?:void|int|float|u?int32_t) motor_(\w+)\(", header.read_text(), re.MULTILINE))


def bytes_of(kind: str, folder: Path) -> tuple[int, ...]:
    """Code with constants, initialised and other data."""
    return tuple(int(n) for n in run(tool("size"), kind, folder=folder).splitlines()[1].split()[:3])


def test_the_source_has_the_declared_symbols_alone_and_no_mutable_data(tables: Tables, tmp_path: Path) -> None:
    for name, content in tables.files().items():
        (tmp_path / name).write_bytes(content)
    symbols = symbols_of("motor_drive.c", tmp_path)
    assert {name for kind, name in symbols if kind == "T"} == {f"motor_{name}" for name in PUBLIC}
    assert {name for kind, name in symbols if kind == "U"} <= {"sqrtf"}
    assert {kind for kind, _ in symbols} <= {"T", "t", "r", "U"}
    assert declared_in(tmp_path / "motor_drive.h") == PUBLIC
    text, *data = bytes_of("motor_drive.o", tmp_path)
    assert data == [0, 0]
    assert text < MOST_FLASH


def test_the_source_in_int32_needs_no_library_and_no_data_either(tables: Tables, tmp_path: Path) -> None:
    for name, content in tables.int32_files().items():
        (tmp_path / name).write_bytes(content)
    symbols = symbols_of("motor_drive_int32.c", tmp_path)
    public = {name for name, *_ in SIGNATURES.values()} - {"torque_reference_unm"}
    assert {name for kind, name in symbols if kind == "T"} == {f"motor_{name}" for name in public}
    assert {kind for kind, _ in symbols} <= {"T", "t", "r"}
    assert declared_in(tmp_path / "motor_drive_int32.h") == public
    assert bytes_of("motor_drive_int32.o", tmp_path)[1:] == (0, 0)


def test_nothing_in_int32_overflows_whatever_comes(tables: Tables, tmp_path: Path) -> None:
    for name, content in tables.int32_files().items():
        (tmp_path / name).write_bytes(content)
    sources = (str(Path(__file__).with_name("fuzz_int32.c")), "motor_drive_int32.c")
    trap = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
    run(compiler(), *STRICT, "-O1", *trap, "-I.", *sources, "-o", "fuzz", folder=tmp_path)
    run("./fuzz", folder=tmp_path)


def test_what_int32_does_not_hold_is_refused(tables: Tables) -> None:
    strong = replace(
        tables, references=replace(tables.references, torque_limit_nm=1e3 * tables.references.torque_limit_nm)
    )
    with pytest.raises(InputError, match=r"torque_limit_table.*more than int32 holds; use the source in float"):
        strong.int32_files()


def without(table: Array) -> Array:
    out = np.array(table, dtype=np.float64)
    out.flat[out.size // 2] = np.nan
    return out


@pytest.mark.parametrize(
    ("part", "field", "name"),
    [
        ("references", "i_dq_a", "reference_table"),
        ("references", "torque_limit_nm", "torque_limit_table"),
        ("references", "psi_limit_wb", "limit"),
        ("control", "psi_wb", "psi_table"),
        ("control", "inductance_h", "inductance_table"),
        ("control", "i_q_a", "psi_q"),
        ("compensation", "lost_v", "lost_v"),
        ("compensation", "current_gain", "gain"),
        ("compensation", "bias_ab_v", "bias"),
    ],
)
def test_a_table_with_a_hole_is_refused(tables: Tables, part: str, field: str, name: str) -> None:
    whole = getattr(tables, part)
    holed = dataclasses.replace(whole, **{field: without(getattr(whole, field))})
    with pytest.raises(InputError, match=rf"{name}.*not finite"):
        dataclasses.replace(tables, **{part: holed}).files()


def test_unusable_axes_losses_and_gains_are_refused(tables: Tables) -> None:
    control, compensation = tables.control, tables.compensation
    uneven = dataclasses.replace(control, i_d_a=np.sort(control.i_d_a**3))
    with pytest.raises(InputError, match=r"psi_d.*evenly spaced"):
        dataclasses.replace(tables, control=uneven).files()
    falling = dataclasses.replace(control, i_d_a=control.i_d_a[::-1])
    with pytest.raises(InputError, match=r"psi_d.*increasing"):
        dataclasses.replace(tables, control=falling).files()
    fast = dataclasses.replace(control, integral_rad_s=0.5 * control.bandwidth_rad_s)
    with pytest.raises(InputError, match=r"integral_rad_s.*too fast"):
        dataclasses.replace(tables, control=fast).files()
    even = dataclasses.replace(compensation, lost_v=compensation.lost_v + 0.1)
    with pytest.raises(InputError, match=r"lost_v.*odd function"):
        dataclasses.replace(tables, compensation=even).files()
    cut = {name: getattr(compensation, name)[1:] for name in ("current_a", "lost_v", "lost_per_bus_v")}
    with pytest.raises(InputError, match=r"lost_v.*odd function"):
        dataclasses.replace(tables, compensation=dataclasses.replace(compensation, **cut)).files()


def test_names_and_effects_stand_in_the_comment_and_do_not_end_it(tables: Tables) -> None:
    header = tables.files()["motor_drive.h"].decode("ascii")
    assert "of plant * / Mot?r, written" in header
    assert "corrected for: dead_time." in header
    assert header.count("*/") == header.count("/*")

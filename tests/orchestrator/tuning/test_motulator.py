"""The C code in a drive that others wrote: motulator's machine behind its switching inverter, with its mechanics.

motulator integrates the machine between the edges of a PWM with 4096 levels, and takes up the duty cycles one period
late. What it knows of a machine is its current over its flux linkage; the code is tuned from a map over currents.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from orchestrator.tuning.current_control import current_control
from orchestrator.tuning.drive_tuning import no_compensation
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.references import current_references
from protocols import Motor
from tests.orchestrator.tuning.closed_loop import library_of
from tests.orchestrator.tuning.functions import HostFunctions, words
from tests.orchestrator.tuning.machines import flux_map
from tests.orchestrator.tuning.tables import Tables

pytestmark = pytest.mark.slow

PERIOD_S = 1e-4
MAX_STEP_S = 0.03
"""Length of a step, settled in its last half: in field weakening a twentieth of the voltage moves the flux."""
MAX_TORQUE_ERROR = 0.005
"""Of the largest torque; one of 4096 levels is 0.13 V of 540 V."""


def reluctance_current(psi: complex) -> complex:
    """Current of a 6.7 kW reluctance machine, saturated and cross-saturated.

    The fit of M. Hinkkanen, P. Pescetto, E. Moelsae, S. E. Saarakkala, G. Pellegrino, R. Bojoi,
    doi:10.1109/TIA.2016.2644624.
    """
    d, q = abs(psi.real), abs(psi.imag)
    i_d = (17.4 + 373.0 * d**5 + 1120.0 / 2.0 * d * q**2) * psi.real
    i_q = (52.1 + 658.0 * q + 1120.0 / 3.0 * d**3) * psi.imag
    return i_d + 1j * i_q


def magnet_current(psi: complex) -> complex:
    """Current of a 2.2 kW machine with buried magnets, without saturation."""
    return (psi.real - 0.545) / 0.036 + 1j * psi.imag / 0.051


@dataclass(frozen=True)
class Rotating:
    """A machine of motulator and the limits of its drive."""

    name: str
    current: Callable[[complex], complex]
    r_s_ohm: float
    pole_pairs: int
    psi_m_wb: float
    inertia_kg_m2: float
    limits: DriveLimits

    def psi(self, i_dq: Array) -> Array:
        """Flux linkage [Wb] at currents [A], shapes (n, 2), by Newton's iteration."""
        psi = np.tile([self.psi_m_wb, 0.0], (len(i_dq), 1))
        for row, target in zip(psi, i_dq, strict=True):
            for _ in range(60):
                error = target - _pair(self.current(complex(*row)))
                slopes = [
                    _pair((self.current(complex(*row) + h) - self.current(complex(*row) - h)) / 2e-6)
                    for h in (1e-6, 1e-6j)
                ]
                step = np.linalg.solve(np.column_stack(slopes), error)
                row += step * min(1.0, 0.1 / max(float(np.abs(step).max()), 1e-12))
                if np.abs(step).max() < 1e-12:
                    break
        return psi

    def tables(self) -> Tables:
        motor = Motor(name=self.name, pole_pairs=self.pole_pairs, pm_flux_wb=self.psi_m_wb)
        machine = Machine(motor, flux_map(self.psi, 1.2 * self.limits.current_a, nodes=31), self.r_s_ohm, 0.0)
        references, control = current_references(machine, self.limits), current_control(machine, self.limits)
        return Tables(motor, references, control, no_compensation(self.limits.current_a), self.limits)


MACHINES = (
    Rotating(
        "reluctance", reluctance_current, 0.54, 2, 0.0, 0.015,
        DriveLimits(current_a=22.0, bus_v=540.0, speed_rad_s=1300.0, sampling_hz=1.0 / PERIOD_S, pwm_hz=1.0 / PERIOD_S),
    ),
    Rotating(
        "buried magnets", magnet_current, 3.6, 3, 0.545, 0.015,
        DriveLimits(current_a=8.0, bus_v=540.0, speed_rad_s=950.0, sampling_hz=1.0 / PERIOD_S, pwm_hz=1.0 / PERIOD_S),
    ),
)  # fmt: skip


@dataclass
class Controller:
    """The C code as motulator calls it: phase currents, speed and angle in, duty cycles out.

    Parameters
    ----------
    functions : HostFunctions
    pole_pairs : int
    torque_nm : callable
        Torque command over time and mechanical speed [rad/s].
    """

    functions: HostFunctions
    pole_pairs: int
    torque_nm: Callable[[float, float], float]
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = self.functions.state()

    def __call__(self, drive: Any) -> tuple[float, Array]:
        v_dc, speed = float(drive.converter.meas_dc_voltage()), float(drive.mechanics.meas_speed())
        omega, theta = self.pole_pairs * speed, self.pole_pairs * float(drive.mechanics.meas_position())
        a, b, c = drive.machine.meas_currents()
        i = complex((2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0))
        i *= np.exp(-1j * self.functions.number("angle_rad", theta, omega))
        torque, i_ref = self.torque_nm(drive.t0, speed), words(2)
        report = self.functions.call("current_reference_a", torque, omega, v_dc, math.nan, i_ref)
        control_report, v_dq = self.functions.control(self.state, i_ref, _pair(i), omega, v_dc)
        assert min(report, control_report) >= 0
        v = complex(*v_dq) * np.exp(1j * self.functions.number("angle_ahead_rad", theta, omega))
        legs = np.array([(v * np.exp(-2j * math.pi * k / 3.0)).real for k in range(3)])
        duty = np.clip(0.5 + (legs - 0.5 * (legs.max() + legs.min())) / v_dc, 0.0, 1.0)
        most = self.functions.number("torque_limit_nm", omega, v_dc, math.nan)
        self.rows.append((drive.t0, torque, most, float(drive.machine.tau_M), abs(i), speed))
        return PERIOD_S, duty

    def post_process(self) -> None:
        """motulator asks for it in the end."""

    @property
    def columns(self) -> Array:
        """Time, command, largest torque, torque, |i| and speed, shape (6, n)."""
        return np.array(self.rows).T


@pytest.fixture(scope="module")
def model() -> ModuleType:
    found: ModuleType = pytest.importorskip("motulator.drive.model", reason="motulator is not installed")
    return found


@pytest.fixture(scope="module", params=MACHINES, ids=lambda one: one.name)
def machine(request: pytest.FixtureRequest) -> Rotating:
    return request.param  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def functions(machine: Rotating, tmp_path_factory: pytest.TempPathFactory) -> HostFunctions:
    return HostFunctions(library_of(machine.tables().files(), tmp_path_factory.mktemp("motulator")))


def run(
    model: ModuleType,
    machine: Rotating,
    functions: HostFunctions,
    mechanics: object,
    torque_nm: Callable[[float, float], float],
    until_s: float,
) -> Array:
    parameters = SimpleNamespace(n_p=machine.pole_pairs, R_s=machine.r_s_ohm, psi_f=machine.psi_m_wb)
    drive = model.Drive(
        model.VoltageSourceConverter(u_dc=machine.limits.bus_v),
        model.SynchronousMachine(parameters, i_s=machine.current),
        mechanics,
    )
    drive.pwm = model.CarrierComparison()
    controller = Controller(functions, machine.pole_pairs, torque_nm)
    model.Simulation(drive, controller).simulate(t_stop=until_s)
    return controller.columns


def test_torque_steps_are_followed_below_and_within_field_weakening(
    model: ModuleType, machine: Rotating, functions: HostFunctions
) -> None:
    largest = functions.number("torque_limit_nm", 0.0, machine.limits.bus_v, math.nan)
    assert (
        functions.number("torque_limit_nm", machine.limits.speed_rad_s, machine.limits.bus_v, math.nan) < 0.9 * largest
    )
    shares, hold_s, ramp_s = (0.4, -0.4, 0.9, -0.9, 1.2), MAX_STEP_S, 0.02
    errors = []
    for part in (0.1, 0.5, 0.8, 1.0):
        speed = part * machine.limits.speed_rad_s / machine.pole_pairs
        mechanics = model.ExternalRotorSpeed(w_M=lambda t, w=speed: w * np.minimum(t / ramp_s, 1.0))

        def torque(t: float, _speed: float) -> float:
            k = int((t - ramp_s) / hold_s + 1e-9)
            return 0.0 if t < ramp_s else shares[min(k, len(shares) - 1)] * largest

        t, _command, most, reached, length, _ = run(
            model, machine, functions, mechanics, torque, ramp_s + hold_s * len(shares) - 1e-6
        )
        assert length.max() <= 1.03 * machine.limits.current_a
        for k, share in enumerate(shares):
            end = ramp_s + (k + 1) * hold_s
            last = (t > end - 0.5 * hold_s) & (t < end - 0.5 * PERIOD_S)
            wanted = np.clip(share * largest, -most[last], most[last])
            errors.append(float((reached[last] - wanted).mean()) / largest)
    rms, worst = float(np.sqrt(np.mean(np.square(errors)))), float(np.abs(errors).max())
    print(f"{machine.name}: torque off by {100 * rms:.3f} % rms, at most {100 * worst:.3f} % of {largest:.1f} Nm")
    assert worst <= MAX_TORQUE_ERROR


def test_load_steps_are_carried_from_standstill_into_field_weakening(
    model: ModuleType, machine: Rotating, functions: HostFunctions
) -> None:
    """A speed control asks for torque; what it asks for in the end is the load."""
    target = 0.75 * machine.limits.speed_rad_s / machine.pole_pairs
    load_nm = 0.4 * functions.number(
        "torque_limit_nm", 0.75 * machine.limits.speed_rad_s, machine.limits.bus_v, math.nan
    )
    rise_s = (
        1.3 * machine.inertia_kg_m2 * target / functions.number("torque_limit_nm", 0.0, machine.limits.bus_v, math.nan)
    )
    step_s, until_s, bandwidth = rise_s + 0.08, rise_s + 0.22, 80.0
    integral = 0.0

    def torque(_t: float, speed: float) -> float:
        nonlocal integral
        most = functions.number("torque_limit_nm", machine.pole_pairs * speed, machine.limits.bus_v, math.nan)
        gain = 2.0 * bandwidth * machine.inertia_kg_m2
        wanted = gain * (target - speed) + integral
        if abs(wanted) < most:
            integral += 0.5 * bandwidth * gain * (target - speed) * PERIOD_S
        return float(np.clip(wanted, -most, most))

    mechanics = model.StiffMechanicalSystem(J=machine.inertia_kg_m2, tau_L=lambda t: load_nm * (t > step_s))
    t, _, _, reached, length, speed = run(model, machine, functions, mechanics, torque, until_s)
    dip, last = float((target - speed[t > step_s]).max()) / target, t > until_s - 0.01
    print(
        f"{machine.name}: {target * 30.0 / math.pi:.0f}/min, load {load_nm:.1f} Nm: speed falls by {100 * dip:.2f} %, "
        f"torque in the end off by {100 * (reached[last].mean() / load_nm - 1.0):.2f} %"
    )
    assert length.max() <= 1.03 * machine.limits.current_a
    assert speed[last].mean() == pytest.approx(target, rel=0.003)
    assert reached[last].mean() == pytest.approx(load_nm, rel=0.02)
    assert dip < 0.05


def _pair(x: complex) -> Array:
    return np.array([x.real, x.imag])

"""The C code controls the plant of the simulated drive, with a driven rotor behind the averaged inverter's losses.

That drive has its own current control and only locks or spins its rotor, so its plant runs here a period at a time.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from orchestrator.tuning.current_control import current_control
from orchestrator.tuning.drive_tuning import no_compensation
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.references import current_references
from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._derive import TruePlant, bus_voltage, derive, read_nameplate
from plugins.drives.simulated._program import tune
from plugins.drives.simulated._run import GIVEN, Piece, run
from plugins.drives.simulated.truth import TrueMagnetics
from protocols import CurrentControl
from tests.orchestrator.tuning.closed_loop import library_of
from tests.orchestrator.tuning.functions import HostFunctions, words
from tests.orchestrator.tuning.machines import flux_map
from tests.orchestrator.tuning.tables import Tables
from tests.plugins.drives.simulated.conftest import PM400, options_of

DEAD_TIME_V, KNEE_A = 3.0, 0.1
PERIOD_S = 1e-4
LIMITS = DriveLimits(current_a=2.3, bus_v=394.0, speed_rad_s=950.0, sampling_hz=1.0 / PERIOD_S, pwm_hz=1.0 / PERIOD_S)
SETTLED = 400


@pytest.fixture(scope="module")
def plant() -> TruePlant:
    effects = {"dead_time": {"voltage_v": DEAD_TIME_V, "threshold_a": KNEE_A}}
    options = options_of(plant={"effects": effects, "sensors": {"noise_a": 0.0, "quantum_a": 0.0}})
    nameplate = read_nameplate(PM400)
    return derive(options, nameplate, bus_voltage(options, nameplate))


@pytest.fixture(scope="module")
def tables(plant: TruePlant) -> Tables:
    machine = Machine(PM400, flux_map(TrueMagnetics(plant.magnetics).flux, 2.6), plant.parameters.resistance_ohm, 0.0)
    x = np.linspace(-2.6, 2.6, 401)
    inside = np.clip(x / KNEE_A, -1.0, 1.0)
    compensation = dataclasses.replace(
        no_compensation(2.6),
        current_a=x,
        lost_v=DEAD_TIME_V * inside * (1.5 - 0.5 * inside**2),
        lost_per_bus_v=np.zeros(401),
        lost_std_v=np.zeros(401),
    )
    return Tables(PM400, current_references(machine, LIMITS), current_control(machine, LIMITS), compensation, LIMITS)


def torque_at(functions: HostFunctions, plant: TruePlant, speed: float, torque_nm: Array) -> Array:
    """Torque at each sample [Nm] for a command at each, at an electrical speed that is reached from standstill."""
    state, control = np.zeros(layout.STATE_LENGTH), functions.state()
    state[layout.PSI_D], state[layout.COS] = plant.magnetics.energy.psi_m, 1.0
    state[layout.MOVING] = layout.MOVING_DRIVEN
    nothing, sums, none = np.zeros((1, 2), np.float32), np.zeros(2), np.empty((0, 3), np.float32)
    own = tune(read_nameplate(PM400), CurrentControl(), 0.0, 1.0 / PERIOD_S, max_v=1e9, trip_a=1e9, overload_s=None)
    i, bus = np.zeros((1, 2), np.float32), np.zeros(1, np.float32)
    given = np.zeros((1, 2), np.float32)
    up, reached = SETTLED // 2, []
    for n, torque in enumerate(np.concatenate([np.zeros(up), torque_nm])):
        i_ref = words(2)
        theta, omega = float(state[layout.THETA]), float(state[layout.OMEGA])
        reached.append(float(state[layout.TORQUE]))
        read = complex(state[layout.I_ALPHA], state[layout.I_BETA])
        i_dq = read * np.exp(-1j * functions.number("angle_rad", theta, omega))
        functions.call("current_reference_a", float(torque), omega, LIMITS.bus_v, math.nan, i_ref)
        report, v = functions.control(control, i_ref, [i_dq.real, i_dq.imag], omega, LIMITS.bus_v)
        assert report >= 0
        turn = np.exp(1j * functions.number("angle_ahead_rad", theta, omega))
        legs = [(complex(*i_ref) * turn * np.exp(-2j * math.pi * k / 3.0)).real for k in range(3)]
        added = [functions.number("leg_voltage_v", leg, LIMITS.bus_v) for leg in legs]
        v_ab = complex(*v) * turn
        v_ab += 2.0 / 3.0 * sum(a * np.exp(2j * math.pi * k / 3.0) for k, a in enumerate(added))
        piece = Piece(GIVEN, 1, speed_step=speed / up if n < up else 0.0)
        run(
            plant.parameters, *plant.magnetics, plant.sensors, own, piece, 0, 1, state, sums, nothing, i, given, bus,
            none, None,
        )  # fmt: skip
        given = np.array([[v_ab.real, v_ab.imag]], np.float32)
    return np.array(reached[up:])


@pytest.mark.slow
def test_torque_steps_reach_their_references_at_every_speed(
    plant: TruePlant, tables: Tables, tmp_path_factory: pytest.TempPathFactory
) -> None:
    functions = HostFunctions(library_of(tables.files(), tmp_path_factory.mktemp("simulated")))
    largest = functions.number("torque_limit_nm", 0.0, LIMITS.bus_v, math.nan)
    assert functions.number("torque_limit_nm", LIMITS.speed_rad_s, LIMITS.bus_v, math.nan) < 0.9 * largest
    errors = []
    for share in (0.0, 0.3, 0.7, 1.0):
        speed = share * LIMITS.speed_rad_s
        command = np.repeat([0.2, -0.5, 1.0, -1.0], SETTLED) * largest
        torque = torque_at(functions, plant, speed, command)
        most = functions.number("torque_limit_nm", speed, LIMITS.bus_v, math.nan)
        for end in range(SETTLED, len(torque) + 1, SETTLED):
            wanted = float(np.clip(command[end - 1], -most, most))
            errors.append((float(torque[end - SETTLED // 4 : end].mean()) - wanted) / largest)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    print(f"torque off by {100 * rms:.3f} % rms, at most {100 * float(np.abs(errors).max()):.3f} %")
    assert np.abs(errors).max() <= 0.005

"""How much faster than real time the simulated drive runs; prints, and judges nothing."""

from __future__ import annotations

import time
from typing import Any

from plugins.drives.simulated import SimulatedDrive, SimulatedOptions, map_motor
from protocols import DriveSetup, Excitation, Hold, Injection, Limits, Motor

PM400 = Motor(
    name="400 W test PMSM",
    pole_pairs=2,
    rated_voltage_rms_v=139.3,
    rated_current_rms_a=1.66,
    stator_resistance_ohm=4.25,
    d_inductance_h=0.04325,
    q_inductance_h=0.06905,
    pm_flux_wb=0.30,
)
HEAT: dict[str, Any] = {"winding_heating": {"rise_per_watt": 1e-3}}
IRON: dict[str, Any] = {"hysteresis": {"half_width_a": 0.04}}
ALL: dict[str, Any] = {
    **HEAT,
    **IRON,
    "dead_time": {"voltage_v": 8.0},
    "device_drop": {"voltage_v": 1.0},
    "bus_sag": {"per_watt": 1e-5},
    "voltage_delay": {"delay_s": 1e-5},
    "current_filter": {"time_constant_s": 5e-6},
    "skin_effect": {"extra_ohm": 1.0},
    "eddy_currents": {"core_loss_ohm": 1000.0},
    "brake_compliance": {"rad_per_nm": 0.005},
    "slot_harmonics": {"relative": 0.02},
}
SWITCHED: dict[str, Any] = {
    "inverter": "switched",
    "switching": {"dead_time_s": 0.7e-6, "output_capacitance_f": 60e-12, "switch_drop_v": 0.8, "diode_drop_v": 1.0},
}
INJECTION = Injection(
    target_d_a=0.5,
    target_q_a=1.0,
    settle_s=0.3,
    duration_s=20.0,
    amplitude_v=20.0,
    frequency_hz=500.0,
    rotation_hz=1.0,
)
HOLD = Hold(current_d_a=0.5, current_q_a=1.0, settle_s=0.3, duration_s=20.0)
MAP = {"kind": "map", "name": "baldor-5k6"}


def ratio(motor: Motor, excitation: Excitation, effects: dict[str, Any], **plant: Any) -> float:
    """Simulated over wall time, best of three, at 10 kHz."""
    options = SimulatedOptions.model_validate({"watchdog_s": None, "plant": {"effects": effects, **plant}})
    drive = SimulatedDrive(DriveSetup(motor=motor, options=options, seed=1))
    own = drive.connect()
    drive.arm(Limits(current_a=own.max_current_a, voltage_v=own.max_voltage_v))
    best = 0.0
    for _ in range(3):
        simulated, wall = drive.telemetry().time_s, time.perf_counter()
        for _ in drive.execute(excitation):
            pass
        best = max(best, (drive.telemetry().time_s - simulated) / (time.perf_counter() - wall))
    drive.close()
    return best


def main() -> None:
    """Print one line a case."""
    cases: tuple[tuple[str, Motor, dict[str, Any], dict[str, Any]], ...] = (
        ("saturation alone", PM400, {}, {}),
        ("heating and hysteresis", PM400, {**HEAT, **IRON}, {}),
        ("heating, hysteresis, dead time", PM400, {**HEAT, **IRON, "dead_time": {"voltage_v": 8.0}}, {}),
        ("every effect", PM400, ALL, {}),
        ("switched, without imperfections", PM400, {}, {"inverter": "switched"}),
        ("switched, dead time and drops", PM400, {}, SWITCHED),
        ("switched, heating and hysteresis", PM400, {**HEAT, **IRON}, SWITCHED),
        ("switched, every effect", PM400, ALL, {"inverter": "switched"}),
        ("flux map, heating and hysteresis", map_motor("baldor-5k6"), {**HEAT, **IRON}, {"magnetics": MAP}),
    )
    for label, motor, effects, plant in cases:
        for excitation in (HOLD, INJECTION):
            speed = ratio(motor, excitation, effects, **plant)
            print(f"{label:34s} {excitation.kind:10s} {speed:7.0f} x real time")


if __name__ == "__main__":
    main()

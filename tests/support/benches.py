"""Motors of three sizes, a drive for each, and plans of procedures made of stages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from orchestrator.config import Plan, make_plan
from protocols import Capabilities, Injection, Point, Procedure, Trapezoid

KINDS = frozenset({"gates_off", "hold", "trapezoid", "injection"})


@dataclass(frozen=True)
class Bench:
    """A motor with limits that fit, and a drive for it."""

    motor: dict[str, Any]
    limits: dict[str, float]
    bus_v: float
    sampling_hz: float = 1e4

    def procedure(self, *stages: dict[str, Any], **fields: Any) -> Procedure:
        return Procedure.model_validate(
            {
                "format": "fluxbench-procedure",
                "version": 1,
                "name": "bench",
                "motor": self.motor,
                "drive": {"name": "simulated"},
                "limits": self.limits,
                "stages": list(stages),
                **fields,
            }
        )

    def capabilities(self, **fields: Any) -> Capabilities:
        return Capabilities.model_validate(
            {
                "name": "bench drive",
                "simulated": True,
                "sampling_frequency_hz": self.sampling_hz,
                "pwm_frequency_hz": self.sampling_hz,
                "pwm_frequencies_hz": (self.sampling_hz, 2 * self.sampling_hz),
                "dc_bus_voltage_v": self.bus_v,
                "max_current_a": 1.2 * self.limits["current_a"],
                "max_voltage_v": max(self.limits["voltage_v"], self.bus_v / 3**0.5),
                "excitations": KINDS,
                "watchdog_s": 0.2,
                "watchdog_covers": KINDS,
                **fields,
            }
        )


PM400 = Bench(
    motor={
        "name": "400 W test PMSM",
        "pole_pairs": 2,
        "rated_current_rms_a": 1.66,
        "stator_resistance_ohm": 4.25,
        "d_inductance_h": 0.04325,
        "q_inductance_h": 0.06905,
        "pm_flux_wb": 0.3,
    },
    limits={"current_a": 5.0, "voltage_v": 150.0},
    bus_v=540.0,
)
SERVO = Bench(
    motor={
        "name": "48 V servo",
        "pole_pairs": 4,
        "rated_current_rms_a": 7.0,
        "stator_resistance_ohm": 0.5,
        "d_inductance_h": 0.3e-3,
        "q_inductance_h": 0.3e-3,
        "pm_flux_wb": 0.01,
    },
    limits={"current_a": 21.0, "voltage_v": 24.0},
    bus_v=48.0,
    sampling_hz=2e4,
)
TRACTION = Bench(
    motor={
        "name": "28 kW traction",
        "pole_pairs": 4,
        "rated_current_rms_a": 145.0,
        "stator_resistance_ohm": 0.03,
        "d_inductance_h": 0.4e-3,
        "q_inductance_h": 1.1e-3,
        "pm_flux_wb": 0.1,
    },
    limits={"current_a": 450.0, "voltage_v": 200.0},
    bus_v=400.0,
)


def targets(plan: Plan) -> list[Point]:
    return [point.target for point in plan.points if point.target is not None]


def plan_of(bench: Bench, *stages: dict[str, Any]) -> Plan:
    return make_plan(bench.procedure(*stages), bench.capabilities())


def injections(plan: Plan, stage: str = "injection") -> list[Injection]:
    return [p.excitation for p in plan.points if isinstance(p.excitation, Injection) and p.stage == stage]


def trapezoids(plan: Plan) -> list[Trapezoid]:
    return [p.excitation for p in plan.points if isinstance(p.excitation, Trapezoid)]

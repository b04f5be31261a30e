"""What each plant makes of a row of the set."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.benchmark.definition import Row, effect_sizes
from tests.blind import campaign, hidden
from tests.blind.benchmark.truths import Hidden, Made
from tests.blind.foreign import cases as foreign_cases
from tests.blind.foreign.judge import BROUGHT, DIRECT, MATERIAL_FLUX_PERCENT, MATERIAL_VOLTAGE_PERCENT
from tests.blind.foreign.plans import PLANS, Bench
from tests.blind.foreign.record import measured_truth
from tests.blind.foreign.record import record as record_foreign
from tests.blind.magnetics import PM400, SERVO_48V, TRACTION_28KW
from tests.blind.removal import Removal, removals
from tests.blind.score import AS_LARGE

MOTORS = {"pm400": PM400, "servo_48v": SERVO_48V, "traction_28kw": TRACTION_28KW}
CAMPAIGNS = {
    "short": campaign.Campaign(period_s=0.4, injection_s=0.2, dwell_s=0.12),
    "shorter": campaign.Campaign(period_s=0.2, injection_s=0.1, dwell_s=0.06),
    "one_pwm": campaign.Campaign(second_pwm=False, period_s=0.4, injection_s=0.2, dwell_s=0.12),
}
"""`tests.blind`'s experiment, so short that a recording has at most 200,000 samples."""
TWINS = ("voltage_delay", "current_filter"), ("dead_time", "device_drop"), ("current_offset", "voltage_bias")
"""One injection frequency, one PWM frequency, and no reading with gates off cannot tell these apart, in this order."""
PARTS = Path(__file__).with_name("removals-1.json")
"""What each of many hidden effects does by the plant: 19 simulations a recording, which `make` does not repeat."""


def made_by(row: Row) -> Made:
    """What the row's plant makes; raises `ModuleNotFoundError` where the plant is not installed."""
    return {"blind": _blind, "foreign": _foreign, "motulator": _motulator}[row.plant](row)


def blind_case(row: Row) -> hidden.Case:
    """The case of a row of `tests.blind`."""
    machine = None if row.case in ("foreign", "foreign_behind") else MOTORS[row.motor]
    case = hidden.draw_case(row.case, row.index, row.seed, machine)
    return replace(case, campaign=CAMPAIGNS[row.plan])


def _blind(row: Row) -> Made:
    case = blind_case(row)
    bench, plan = case.bench, case.campaign
    does = {} if row.kind not in ("clutter", "ordinary") else stored_removals().get(row.id, {})
    most = max((one["of_error"] for one in does.values()), default=0.0)

    def sealed(truth: hidden.Truth) -> Hidden:
        value = truth.parameters.get(effect_sizes()[truth.name].parameter)
        size = None if value is None or row.kind.startswith("switched") else (value, value)
        if truth.name not in does:
            return Hidden(truth.name, truth.size, size)
        part = does[truth.name]
        material = Removal(**part).is_material(0.01 * MATERIAL_FLUX_PERCENT, 0.01 * MATERIAL_VOLTAGE_PERCENT)
        return Hidden(truth.name, truth.size, size, part["of_error"] >= AS_LARGE * most, material)

    def flux(i_d: float, i_q: float) -> tuple[float, float]:
        # What is not even in i_q belongs to the slots, an effect.
        ahead, behind = bench.table.flux(i_d, i_q), bench.table.flux(i_d, -i_q)
        return 0.5 * (ahead[0] + behind[0]), 0.5 * (ahead[1] - behind[1])

    return Made(
        record=lambda folder: campaign.record(bench, plan, folder, "benchmark"),
        plate=bench.machine,
        resistance_ohm=bench.plant.resistance + 0.5 * (bench.bridge.switch_ohm + bench.bridge.diode_ohm),
        flux=flux,
        hidden=[sealed(truth) for truth in case.truths],
        foreign=case.foreign,
        also=case.brought,
        twins=[g for g, apart in zip(TWINS, (False, plan.second_pwm, plan.gates_off), strict=True) if not apart],
    )


@cache
def stored_removals() -> Mapping[str, Mapping[str, Mapping[str, float]]]:
    """What each effect does, by recording and name; see `PARTS`."""
    stored: dict[str, Any] = json.loads(PARTS.read_text(encoding="utf-8"))
    return stored


def worked_out(row: Row) -> dict[str, Any]:
    """The row's part of `PARTS`, by the plant anew."""
    return {name: asdict(one) for name, one in removals(blind_case(row)).items()}


def _foreign(row: Row) -> Made:
    case = foreign_cases.draw_case(row.case, row.index, row.seed)
    rig, motor = replace(case.rig, plan=row.plan), case.rig.motor
    plate = motor.plate
    material = None
    if row.kind in ("single", "double", "log"):
        does = measured_truth(rig)
        material = does["flux_percent"] > MATERIAL_FLUX_PERCENT or does["voltage_percent"] > MATERIAL_VOLTAGE_PERCENT

    def sealed(truth: foreign_cases.Truth) -> Hidden:
        size = None
        for amount, (name, factor) in DIRECT.get(truth.name, {}).items():
            if name == effect_sizes()[truth.name].parameter:
                low, high = truth.amounts[amount]
                size = low / factor, high / factor
        if truth.name == "brake_compliance":
            (low, high), per_rad = next(iter(truth.amounts.values())), float(np.rad2deg(plate.rated_torque_nm))
            size = low / per_rad, high / per_rad
        return Hidden(truth.name, truth.size, size, True, material)

    segments = list(PLANS[rig.plan](Bench(plate, motor.span_d, np.random.default_rng([rig.seed, 2]))))
    apart = (
        False,
        any(segment.pwm_ratio != 1.0 for segment in segments),
        any(segment.stage == "gates_off" for segment in segments),
    )
    return Made(
        record=lambda folder: record_foreign(rig, folder, "benchmark"),
        plate=plate,
        resistance_ohm=rig.plant.resistance,
        flux=motor.iron.flux,
        span_d=motor.span_d,
        # What the library has got since the set was frozen is none of its names.
        hidden=[sealed(truth) for truth in case.truths if truth.name in effect_sizes()],
        foreign=case.foreign,
        also=sorted(BROUGHT) if row.case == "ordinary" else (),
        twins=[group for group, is_separable in zip(TWINS, apart, strict=True) if not is_separable],
    )


def _motulator(row: Row) -> Made:
    from tests.blind.benchmark.motulated_cases import made

    return made(row)

"""Is an answer right? What is printed to a user, held against what the plant knows of itself.

A declared twin counts as the name; so do two effects that the plan lacks the stage to tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.blind.foreign.cases import EFFECTS, TWINS, Case, Truth
from tests.blind.foreign.examine import Answer
from tests.blind.foreign.plans import PLANS, Bench
from tests.blind.foreign.record import LOSS_STEP_S

MATERIAL_FLUX_PERCENT, MATERIAL_VOLTAGE_PERCENT = 0.2, 0.5
"""What a hidden effect does from which a user wants it named: the defaults of `fluxbench diagnose`."""
MAP_PERCENT = 1.0
BROUGHT = {"minimum_pulse", "duty_quantum"}
"""Names that are true of an ordinary bench beside the truths: it leaves short pulses out."""
EXPLAINED = ("explained", "explained_in_another_form", "mostly_explained")
RISE = "rise of R_s in the end, %"
DIRECT: Mapping[str, Mapping[str, tuple[str, float]]] = {
    "dead_time": {"lost at large currents, V": ("voltage_v", 1.0)},
    "device_drop": {"drop at the rated current, V": ("voltage_v", 1.0)},
    "hysteresis": {"half the loop's width, A": ("half_width_a", 1.0)},
    "bus_sag": {"sag, 1/W": ("per_watt", 1.0)},
    "current_filter": {"lag, s": ("time_constant_s", 1.0)},
    "voltage_delay": {"lag, s": ("delay_s", 1.0)},
    "current_gain_mismatch": {"gain of a minus b": ("gain_a_minus_b", 1.0)},
    "shunt_reconstruction": {
        "gain of a minus b": ("gain_a_minus_b", 1.0), "gain of c minus a and b": ("gain_c_minus_ab", 1.0),
    },
    "rotor_misalignment": {"angle, degrees": ("angle_rad", 180.0 / np.pi)},
    "current_offset": {"offset of a, A": ("offset_a_a", 1.0), "offset of b, A": ("offset_b_a", 1.0)},
}  # fmt: skip
"""By effect, which parameter of the answer is which amount of the truth, and its factor."""


@dataclass(frozen=True)
class Size:
    """One amount of a hidden effect, true and as stated."""

    effect: str
    amount: str
    true: tuple[float, float]
    stated: tuple[float, float, float]
    """Lowest, most probable, highest."""

    @property
    def inside(self) -> bool:
        """Whether the stated interval meets the true range."""
        return self.stated[0] <= self.true[1] and self.stated[2] >= self.true[0]

    @property
    def off(self) -> float:
        """Relative error of the most probable value against the nearest true one."""
        nearest = min(max(self.stated[1], self.true[0]), self.true[1])
        return abs(self.stated[1] - nearest) / max(abs(nearest), 1e-30)


@dataclass(frozen=True)
class Judgement:
    """What is right and wrong in one answer; a figure that does not apply is absent."""

    answer: Answer
    right: dict[str, bool] = field(default_factory=dict)
    sizes: tuple[Size, ...] = ()

    @property
    def wrong(self) -> list[str]:
        """Names of the figures that this answer misses."""
        return [name for name, right in self.right.items() if not right]


def judge(answer: Answer) -> Judgement:
    """Hold an answer against what was hidden."""
    case, report = answer.case, answer.report
    if report is None:
        return Judgement(answer, {"answered at all": False})
    right = _right(answer, report)
    delivered, explains = answer.delivered, report["verdict"] in ("clean", *EXPLAINED)
    if delivered is not None and (delivered["usable"] or explains):
        right[f"usable or explained: map within {MAP_PERCENT:g} %"] = delivered["map_percent"] <= MAP_PERCENT
    sizes = tuple(_sizes(answer, report)) if case.judged_as in ("single", "double", "plans") else ()
    return Judgement(answer, right, sizes)


def is_material(answer: Answer) -> bool:
    """Whether all that is hidden does enough to be wanted by name."""
    does = answer.does
    return bool(does["flux_percent"] > MATERIAL_FLUX_PERCENT or does["voltage_percent"] > MATERIAL_VOLTAGE_PERCENT)


def _right(answer: Answer, report: dict[str, Any]) -> dict[str, bool]:
    case = answer.case
    names = [truth.name for truth in case.truths]
    found = [names_of(case, effect) for effect in report["effects"]]
    listed = [*found, *(names_of(case, effect) for effect in report["minor"])]
    unknown, kind = report["verdict"] == "unknown_remains", case.judged_as
    if kind == "no_catalogue":
        return {"in no catalogue: unknown flagged": unknown}
    if kind == "ordinary":
        present = {*EFFECTS, *BROUGHT}
        return {
            "ordinary: no false name": all(one & present for one in found),
            "ordinary: explained, or mostly": report["verdict"] in EXPLAINED,
        }
    if not names:
        return {
            f"{kind}, nothing hidden: no false name": not listed,
            f"{kind}, nothing hidden: stated to be clean": report["verdict"] == "clean",
        }
    if not is_material(answer):
        return {f"{kind}, immaterial: no false name": all(one & set(names) for one in found)}
    right = {
        f"{kind}: main effect named first": bool(found) and bool(found[0] & set(names)),
        f"{kind}: explained, or mostly": report["verdict"] in EXPLAINED,
        f"{kind}: no false name": all(one & set(names) for one in found),
    }
    if kind == "double":
        right["double: both among causes and smaller ones"] = all(any(n in one for one in listed) for n in names)
    return right


def names_of(case: Case, effect: dict[str, Any]) -> set[str]:
    """An effect's name, and what is as good a name in this plan."""
    names = {effect["name"], *effect["twins"]}
    rig = case.rig
    bench = Bench(rig.motor.plate, rig.motor.span_d, np.random.default_rng([rig.seed, 2]))
    segments = list(PLANS[rig.plan](bench))
    told_apart = (
        False,
        any(segment.pwm_ratio != 1.0 for segment in segments),
        any(segment.stage == "gates_off" for segment in segments),
    )
    for pair, apart in zip(TWINS, told_apart, strict=True):
        if names & pair and not apart:
            names |= pair
    return names


def _sizes(answer: Answer, report: dict[str, Any]) -> Iterator[Size]:
    for truth in answer.case.truths:
        for effect in (*report["effects"], *report["minor"]):
            if effect["name"] == truth.name:
                yield from _compared(answer, truth, effect["parameters"])


def _compared(answer: Answer, truth: Truth, parameters: dict[str, Any]) -> Iterator[Size]:
    """The amounts of one effect that both state, in the same physical terms."""
    plate = answer.case.rig.motor.plate

    def scaled(name: str, factor: float) -> tuple[float, float, float] | None:
        stated = parameters[name]
        if stated["low"] is None or stated["high"] is None:
            return None
        ends = sorted((stated["low"] * factor, stated["high"] * factor))
        return ends[0], stated["value"] * factor, ends[1]

    for amount, (name, factor) in DIRECT.get(truth.name, {}).items():
        if name in parameters and (stated := scaled(name, factor)):
            yield Size(truth.name, amount, truth.amounts[amount], stated)
    if truth.name == "brake_compliance" and (stated := scaled("rad_per_nm", np.rad2deg(plate.rated_torque_nm))):
        (amount,) = truth.amounts
        yield Size(truth.name, amount, truth.amounts[amount], stated)
    if truth.name == "eddy_currents":
        low, value, high = (parameters["core_loss_ohm"][key] for key in ("low", "value", "high"))
        if low and high:
            part = _in_phase(parameters, 2 * np.pi * plate.injection_hz)
            (amount,) = truth.amounts
            yield Size(truth.name, amount, truth.amounts[amount], (part / high, part / value, part / low))
    if truth.name == "winding_heating":
        rise = _rise_percent(parameters, np.array(answer.does["watts"]))
        if stated := scaled("rise_per_watt", rise):
            yield Size(truth.name, RISE, (answer.does["rise_percent"],) * 2, stated)


def _value(parameters: dict[str, Any], name: str, absent: float) -> float:
    return float(parameters[name]["value"]) if name in parameters else absent


def _in_phase(parameters: dict[str, Any], omega: float) -> float:
    """Part of the stated conductance that is left in phase at a frequency, by the stated time constants."""
    lag, slower, faster = (_value(parameters, name, 0.0) for name in ("lag_s", "slower", "faster"))
    step = np.arange(-4.0, 4.0)
    shares = np.where(step > 0.0, slower, faster) ** np.abs(step)
    return float(np.sum(shares / (1 + (omega * lag * 4.0**step) ** 2)) / shares.sum())


def _rise_percent(parameters: dict[str, Any], watts: np.ndarray[Any, Any]) -> float:
    """Rise of R_s in the end [%] for one of 1/W, by the stated time constants and the losses that there were."""
    share = _value(parameters, "slow_share", 0.0)
    fast_s = _value(parameters, "time_constant_s", 200.0)
    ages = LOSS_STEP_S * (len(watts) - np.arange(len(watts)) - 0.5)
    rise = 0.0
    for part, tau in ((1 - share, fast_s), (share, fast_s * _value(parameters, "slow_ratio", 6.0))):
        rise += part * float((watts * np.exp(-ages / tau)).sum()) * LOSS_STEP_S / tau
    return 100.0 * rise

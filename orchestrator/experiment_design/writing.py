"""Points as stages of a procedure: those that are alike but for their current become one stage. Measures nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from orchestrator.config import PlannedPoint
from orchestrator.experiment_design.contrasts import Stage
from protocols import CurrentControl, GatesOff, Hold, Trapezoid

_COMMON = {"kind", "rotor_angle_rad", "pwm_frequency_hz", "control"}


def stages_of(points: Sequence[tuple[PlannedPoint, int]], control: CurrentControl) -> list[Stage]:
    """The stages that measure each point so many times, in the points' order.

    Parameters
    ----------
    control : CurrentControl
        The procedure's own.
    """
    stages: dict[str, Stage] = {}
    for point, times in points:
        stage, (field, value) = _stage(point, times, control)
        key = f"{point.stage_index} {stage}"
        stages.setdefault(key, stage).setdefault(field, [])
        if value is not None:
            stages[key][field].append(value)
    return [{name: value for name, value in stage.items() if value != []} for stage in stages.values()]


def _stage(point: PlannedPoint, times: int, control: CurrentControl) -> tuple[Stage, tuple[str, Any]]:
    """A stage without its points, and the point as that stage has it."""
    e, more = point.excitation, Stage()
    asked = e.model_dump(mode="json", exclude=_COMMON)
    if point.settings.get("anchor"):
        more["anchor"] = True
    if e.control != control:
        more["control"] = e.control.model_dump(mode="json")
    if isinstance(e, GatesOff):
        return {"kind": "gates_off", "duration_s": times * e.duration_s}, ("points", None)
    if isinstance(e, Trapezoid):
        axis, held = asked.pop("swept_axis"), asked.pop("held_a")
        return {"kind": "classical", "axes": [axis], **asked, "periods": times * e.periods, **more}, ("held_a", held)
    asked["duration_s"] = times * e.duration_s
    if isinstance(e, Hold):
        target = [asked.pop("current_d_a"), asked.pop("current_q_a")]
        if e.pwm_frequency_hz is not None:
            more["pwm_frequencies_hz"] = [e.pwm_frequency_hz]
        return {"kind": "resistance", **asked, **more}, ("points_a", target)
    target = [asked.pop("target_d_a"), asked.pop("target_q_a")]
    asked["amplitudes_v"] = [asked.pop("amplitude_v")]
    return {"kind": "injection", **asked, **more}, ("points_a", target)

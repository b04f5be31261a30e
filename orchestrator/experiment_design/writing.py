"""Points as stages of a procedure: points that differ in their current alone become one stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from orchestrator.config import PlannedPoint
from orchestrator.experiment_design.contrasts import Stage
from protocols import CurrentControl, GatesOff, Hold, Trapezoid

_COMMON = {"kind", "rotor_angle_rad", "pwm_frequency_hz", "control"}


def stages_of(points: Sequence[tuple[PlannedPoint, int]], control: CurrentControl) -> list[Stage]:
    """The stages that measure each point its number of times, in the points' order.

    Parameters
    ----------
    control : CurrentControl
        Current control of the procedure.
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
    """A stage without its points, and the point as an item of that stage."""
    e, more = point.excitation, Stage()
    settings = e.model_dump(mode="json", exclude=_COMMON)
    if point.settings.get("anchor"):
        more["anchor"] = True
    if e.control != control:
        more["control"] = e.control.model_dump(mode="json")
    if isinstance(e, GatesOff):
        return {"kind": "gates_off", "duration_s": times * e.duration_s}, ("points", None)
    if isinstance(e, Trapezoid):
        axis, held = settings.pop("swept_axis"), settings.pop("held_a")
        return {"kind": "classical", "axes": [axis], **settings, "periods": times * e.periods, **more}, ("held_a", held)
    settings["duration_s"] = times * e.duration_s
    if isinstance(e, Hold):
        target = [settings.pop("current_d_a"), settings.pop("current_q_a")]
        if e.pwm_frequency_hz is not None:
            more["pwm_frequencies_hz"] = [e.pwm_frequency_hz]
        return {"kind": "resistance", **settings, **more}, ("points_a", target)
    target = [settings.pop("target_d_a"), settings.pop("target_q_a")]
    settings["amplitudes_v"] = [settings.pop("amplitude_v")]
    return {"kind": "injection", **settings, **more}, ("points_a", target)

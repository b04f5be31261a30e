"""Building blocks of stages: parsing of entries, scaling from the nameplate, patterns of points.

For authors of stages: `Scaling` computes the settings that a procedure omits, and the patterns give points in the
current plane. The built-in stages in `plugins/stages` use nothing else.
"""

from orchestrator.stages._parsing import (
    installed_stages,
    parse_stage,
    parse_stages,
    proposing_stage,
    spelled_out,
)
from orchestrator.stages._patterns import MAX_POINTS, five_values, grid, largest_q_a, on_axis, paths, steps, within
from orchestrator.stages._ripple import flux_swing_wb, injection_voltage_v, ripple_a
from orchestrator.stages._scaling import NOMINAL_SAMPLING_HZ, Scaling, ScalingRules, given, stiffest_hold_a, tidy
from orchestrator.stages._schema import with_stages

__all__ = [
    "MAX_POINTS",
    "NOMINAL_SAMPLING_HZ",
    "Scaling",
    "ScalingRules",
    "five_values",
    "flux_swing_wb",
    "given",
    "grid",
    "injection_voltage_v",
    "installed_stages",
    "largest_q_a",
    "on_axis",
    "parse_stage",
    "parse_stages",
    "paths",
    "proposing_stage",
    "ripple_a",
    "spelled_out",
    "steps",
    "stiffest_hold_a",
    "tidy",
    "with_stages",
    "within",
]

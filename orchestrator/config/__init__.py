"""Procedures to a checked plan: read, scaled to the motor, laid out in points, checked against limits."""

from orchestrator.config._checking import PlanSummary, StageRow, check_plan, check_point
from orchestrator.config._loading import LoadedProcedure, MotorFile, load_motor, load_procedure, read_procedure
from orchestrator.config._loads import nominal_ripple_a
from orchestrator.config._planning import Plan, PlannedPoint, make_plan
from orchestrator.config._slips import nameplate_doubts

__all__ = [
    "LoadedProcedure",
    "MotorFile",
    "Plan",
    "PlanSummary",
    "PlannedPoint",
    "StageRow",
    "check_plan",
    "check_point",
    "load_motor",
    "load_procedure",
    "make_plan",
    "nameplate_doubts",
    "nominal_ripple_a",
    "read_procedure",
]

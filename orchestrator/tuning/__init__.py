"""From the flux map to the drive: current references, current control, compensation, sensorless limits, and C code.

Knows maps, models and limits; nothing of recordings' samples nor of drives.
"""

from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.drive_tuning import DriveTuning, no_compensation, tune
from orchestrator.tuning.limits import DriveLimits, limits_of
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.requirements import require_known
from orchestrator.tuning.tuning_report import TuningReport, load_tuning, write_tuning

__all__ = [
    "Compensation",
    "DriveLimits",
    "DriveTuning",
    "Machine",
    "TuningReport",
    "limits_of",
    "load_tuning",
    "no_compensation",
    "require_known",
    "tune",
    "write_tuning",
]

"""The calls behind the command line and the Python package, one for each command.

An argument may be a path, an open run or recording, or the object itself.
"""

from orchestrator.interface.api.analysing import (
    add,
    chosen_effects,
    chosen_model,
    compare,
    compare_runs,
    diagnose,
    discover,
    estimate,
    explain,
    map_of,
    remove,
)
from orchestrator.interface.api.exporting import export
from orchestrator.interface.api.measurements import Measurements, open
from orchestrator.interface.api.running import as_overrides, run, run_directory
from orchestrator.interface.api.threads import one_thread
from orchestrator.interface.api.tuning import tune

__all__ = [
    "Measurements",
    "add",
    "as_overrides",
    "chosen_effects",
    "chosen_model",
    "compare",
    "compare_runs",
    "diagnose",
    "discover",
    "estimate",
    "explain",
    "export",
    "map_of",
    "one_thread",
    "open",
    "remove",
    "run",
    "run_directory",
    "tune",
]

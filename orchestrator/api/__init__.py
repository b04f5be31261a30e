"""The calls behind the command line and the Python package, one for each command.

An argument may be a path, an open run or recording, or the object itself.
"""

from orchestrator.api.analysing import (
    add,
    chosen_effects,
    chosen_model,
    compare,
    compare_runs,
    diagnose,
    estimate,
    explain,
    map_of,
    remove,
)
from orchestrator.api.exporting import export
from orchestrator.api.measurements import Measurements, open
from orchestrator.api.running import as_overrides, run, run_directory
from orchestrator.api.threads import one_thread

__all__ = [
    "Measurements",
    "add",
    "as_overrides",
    "chosen_effects",
    "chosen_model",
    "compare",
    "compare_runs",
    "diagnose",
    "estimate",
    "explain",
    "export",
    "map_of",
    "one_thread",
    "open",
    "remove",
    "run",
    "run_directory",
]

"""What a person does with a motor's measurements, one call each: the command line and the Python package stand on it.

Whatever is named may be a path, a run or recording that is open, or the thing itself.
"""

from orchestrator.workbench.analysing import (
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
from orchestrator.workbench.exporting import export
from orchestrator.workbench.measurements import Measurements, open
from orchestrator.workbench.running import as_overrides, run, run_directory
from orchestrator.workbench.threads import one_thread

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

"""Commissioning and diagnosis of permanent-magnet motors from Python: what the command line does, one call each.

::

    import fluxbench

    run = fluxbench.simulate(effects={"dead_time": {"voltage_v": 1.5}})
    print(fluxbench.diagnose(run).words.likely_cause)

docs/python.md has more. Nothing is imported before it is asked for, and everything is defined elsewhere.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.config import load_motor as load_motor
    from orchestrator.config import load_procedure as load_procedure
    from orchestrator.engine import TerminalOperator as TerminalOperator
    from orchestrator.workbench import Measurements as Measurements
    from orchestrator.workbench import add as add
    from orchestrator.workbench import compare as compare
    from orchestrator.workbench import compare_runs as compare_runs
    from orchestrator.workbench import diagnose as diagnose
    from orchestrator.workbench import estimate as estimate
    from orchestrator.workbench import explain as explain
    from orchestrator.workbench import export as export
    from orchestrator.workbench import map_of as map_of
    from orchestrator.workbench import one_thread as one_thread
    from orchestrator.workbench import open as open
    from orchestrator.workbench import remove as remove
    from orchestrator.workbench import run as run
    from plugins.drives.simulated import simulate as simulate
    from protocols import FluxbenchError as FluxbenchError
    from protocols import Motor as Motor
    from protocols import MotorModel as MotorModel
    from protocols import Procedure as Procedure

_HOMES = {
    "FluxbenchError": "protocols",
    "Measurements": "orchestrator.workbench",
    "Motor": "protocols",
    "MotorModel": "protocols",
    "Procedure": "protocols",
    "TerminalOperator": "orchestrator.engine",
    "add": "orchestrator.workbench",
    "compare": "orchestrator.workbench",
    "compare_runs": "orchestrator.workbench",
    "diagnose": "orchestrator.workbench",
    "estimate": "orchestrator.workbench",
    "explain": "orchestrator.workbench",
    "export": "orchestrator.workbench",
    "load_motor": "orchestrator.config",
    "load_procedure": "orchestrator.config",
    "map_of": "orchestrator.workbench",
    "one_thread": "orchestrator.workbench",
    "open": "orchestrator.workbench",
    "remove": "orchestrator.workbench",
    "run": "orchestrator.workbench",
    "simulate": "plugins.drives.simulated",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)

"""Commissioning and diagnosis of permanent-magnet motors from Python: what the command line does, one call each.

::

    import fluxbench

    run = fluxbench.simulate(effects={"dead_time": {"voltage_v": 1.5}})
    print(fluxbench.diagnose(run).words.likely_cause)

docs/python.md has more. Everything is defined elsewhere, and imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.config import load_motor as load_motor
    from orchestrator.config import load_procedure as load_procedure
    from orchestrator.engine import TerminalOperator as TerminalOperator
    from orchestrator.interface.api import Measurements as Measurements
    from orchestrator.interface.api import add as add
    from orchestrator.interface.api import compare as compare
    from orchestrator.interface.api import compare_runs as compare_runs
    from orchestrator.interface.api import diagnose as diagnose
    from orchestrator.interface.api import discover as discover
    from orchestrator.interface.api import estimate as estimate
    from orchestrator.interface.api import explain as explain
    from orchestrator.interface.api import export as export
    from orchestrator.interface.api import map_of as map_of
    from orchestrator.interface.api import one_thread as one_thread
    from orchestrator.interface.api import open as open
    from orchestrator.interface.api import remove as remove
    from orchestrator.interface.api import run as run
    from orchestrator.interface.api import tune as tune
    from plugins.drives.simulated import simulate as simulate
    from protocols import FluxbenchError as FluxbenchError
    from protocols import Motor as Motor
    from protocols import MotorModel as MotorModel
    from protocols import Procedure as Procedure

_HOMES = {
    "FluxbenchError": "protocols",
    "Measurements": "orchestrator.interface.api",
    "Motor": "protocols",
    "MotorModel": "protocols",
    "Procedure": "protocols",
    "TerminalOperator": "orchestrator.engine",
    "add": "orchestrator.interface.api",
    "compare": "orchestrator.interface.api",
    "compare_runs": "orchestrator.interface.api",
    "diagnose": "orchestrator.interface.api",
    "discover": "orchestrator.interface.api",
    "estimate": "orchestrator.interface.api",
    "explain": "orchestrator.interface.api",
    "export": "orchestrator.interface.api",
    "load_motor": "orchestrator.config",
    "load_procedure": "orchestrator.config",
    "map_of": "orchestrator.interface.api",
    "one_thread": "orchestrator.interface.api",
    "open": "orchestrator.interface.api",
    "remove": "orchestrator.interface.api",
    "run": "orchestrator.interface.api",
    "simulate": "plugins.drives.simulated",
    "tune": "orchestrator.interface.api",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)

"""The engine: the state machine, the stages, and every way out of them."""

from orchestrator.engine._commissioning import Commissioning, Outcome
from orchestrator.engine._heartbeat import HeartbeatKeeper
from orchestrator.engine._interrupts import Interrupts, handling_signals
from orchestrator.engine._operator import AbsentOperator, Operator, TerminalOperator
from orchestrator.engine._power import PowerStage
from orchestrator.engine._session import (
    Crew,
    RunResult,
    chosen_estimators,
    connected_drive,
    installed_estimators,
    resume_run,
    start_run,
)
from orchestrator.engine._states import (
    ENERGISED,
    TERMINAL,
    TRANSITIONS,
    State,
    StateMachine,
    Trigger,
    mermaid,
)

__all__ = [
    "ENERGISED",
    "TERMINAL",
    "TRANSITIONS",
    "AbsentOperator",
    "Commissioning",
    "Crew",
    "HeartbeatKeeper",
    "Interrupts",
    "Operator",
    "Outcome",
    "PowerStage",
    "RunResult",
    "State",
    "StateMachine",
    "TerminalOperator",
    "Trigger",
    "chosen_estimators",
    "connected_drive",
    "handling_signals",
    "installed_estimators",
    "mermaid",
    "resume_run",
    "start_run",
]

"""The engine: the state machine, the stages, and every way out of them."""

from orchestrator.engine._commissioning import Commissioning, Outcome
from orchestrator.engine._diagnosing import following_stages
from orchestrator.engine._heartbeat import HeartbeatKeeper
from orchestrator.engine._interrupts import Interrupts, handling_signals
from orchestrator.engine._operator import AbsentOperator, Operator, TerminalOperator
from orchestrator.engine._power import PowerStage
from orchestrator.engine._session import (
    NOTHING_LEFT,
    Crew,
    RunResult,
    chosen_effects,
    chosen_estimators,
    connected_drive,
    extend_run,
    installed_effects,
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
    "NOTHING_LEFT",
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
    "chosen_effects",
    "chosen_estimators",
    "connected_drive",
    "extend_run",
    "following_stages",
    "handling_signals",
    "installed_effects",
    "installed_estimators",
    "mermaid",
    "resume_run",
    "start_run",
]

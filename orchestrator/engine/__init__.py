"""The engine: the state machine, the stages, and every way out of them."""

from orchestrator.engine._commissioning import Commissioning, Outcome
from orchestrator.engine._heartbeat import HeartbeatKeeper, host_latency
from orchestrator.engine._interrupts import Interrupts, handling_signals
from orchestrator.engine._operator import SAFE_BENCH_WORDS, AbsentOperator, Operator, TerminalOperator
from orchestrator.engine._plugins import UsedPlugins
from orchestrator.engine._power import PowerStage
from orchestrator.engine._remote import RemoteOperator
from orchestrator.engine._session import (
    NOTHING_LEFT,
    RunResult,
    RunServices,
    connected_drive,
    extend_run,
    resume_run,
    start_run,
)
from orchestrator.engine._states import TERMINAL, State, StateMachine, StateTable, Trigger, mermaid, table_of

__all__ = [
    "NOTHING_LEFT",
    "SAFE_BENCH_WORDS",
    "TERMINAL",
    "AbsentOperator",
    "Commissioning",
    "HeartbeatKeeper",
    "Interrupts",
    "Operator",
    "Outcome",
    "PowerStage",
    "RemoteOperator",
    "RunResult",
    "RunServices",
    "State",
    "StateMachine",
    "StateTable",
    "TerminalOperator",
    "Trigger",
    "UsedPlugins",
    "connected_drive",
    "extend_run",
    "handling_signals",
    "host_latency",
    "mermaid",
    "resume_run",
    "start_run",
    "table_of",
]

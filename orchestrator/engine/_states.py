"""The states of a run and the ways between them; no work is done here.

A small typed facade over a flat `transitions.Machine`. What is done in a state, and how long it
may take, is the business of whoever fires the triggers: the machine only says what may follow
what, and every way out of an energised state leads through `stopping`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """Where a run stands. A stage kind is one state; repetitions enter it again."""

    IDLE = "idle"
    CONNECTING = "connecting"
    WAITING_FOR_OPERATOR = "waiting_for_operator"
    READING_GATES_OFF = "reading_gates_off"
    ALIGNING = "aligning"
    CHECKING_LOCK = "checking_lock"
    ESTIMATING_RESISTANCE = "estimating_resistance"
    SWEEPING_CLASSICAL = "sweeping_classical"
    SWEEPING_INJECTION = "sweeping_injection"
    PAUSED = "paused"
    ESTIMATING = "estimating"
    COMPARING = "comparing"
    DIAGNOSING = "diagnosing"
    PROPOSING = "proposing"
    STOPPING = "stopping"
    FINISHED = "finished"
    FAULTED = "faulted"
    ABORTED = "aborted"


class Trigger(StrEnum):
    """What moves a run on."""

    CONNECT = "connect"
    ASK_OPERATOR = "ask_operator"
    READ_GATES_OFF = "read_gates_off"
    ALIGN = "align"
    CHECK_LOCK = "check_lock"
    ESTIMATE_RESISTANCE = "estimate_resistance"
    SWEEP_CLASSICAL = "sweep_classical"
    SWEEP_INJECTION = "sweep_injection"
    PAUSE = "pause"
    ESTIMATE = "estimate"
    COMPARE = "compare"
    DIAGNOSE = "diagnose"
    PROPOSE = "propose"
    STOP = "stop"
    FINISH = "finish"
    FAULT = "fault"
    ABORT = "abort"


ENERGISED = (
    State.READING_GATES_OFF,
    State.ALIGNING,
    State.CHECKING_LOCK,
    State.ESTIMATING_RESISTANCE,
    State.SWEEPING_CLASSICAL,
    State.SWEEPING_INJECTION,
)
"""The drive is armed in these, and in no other."""

TERMINAL = (State.FINISHED, State.FAULTED, State.ABORTED)

_AT_REST = (
    State.CONNECTING,
    State.WAITING_FOR_OPERATOR,
    State.ESTIMATING,
    State.COMPARING,
    State.DIAGNOSING,
    State.PROPOSING,
    State.PAUSED,
)
"""Disarmed, and something may follow."""


@dataclass(frozen=True)
class Transition:
    """One row of the table: from any of the sources, by the trigger, to the target."""

    trigger: Trigger
    sources: tuple[State, ...]
    target: State


TRANSITIONS = (
    Transition(Trigger.CONNECT, (State.IDLE,), State.CONNECTING),
    Transition(Trigger.READ_GATES_OFF, _AT_REST + ENERGISED, State.READING_GATES_OFF),
    Transition(Trigger.ALIGN, _AT_REST + ENERGISED, State.ALIGNING),
    Transition(Trigger.CHECK_LOCK, _AT_REST + ENERGISED, State.CHECKING_LOCK),
    Transition(Trigger.ESTIMATE_RESISTANCE, _AT_REST + ENERGISED, State.ESTIMATING_RESISTANCE),
    Transition(Trigger.SWEEP_CLASSICAL, _AT_REST + ENERGISED, State.SWEEPING_CLASSICAL),
    Transition(Trigger.SWEEP_INJECTION, _AT_REST + ENERGISED, State.SWEEPING_INJECTION),
    Transition(Trigger.STOP, (State.IDLE, *_AT_REST, *ENERGISED), State.STOPPING),
    Transition(Trigger.ASK_OPERATOR, (*_AT_REST, State.STOPPING), State.WAITING_FOR_OPERATOR),
    Transition(Trigger.ESTIMATE, (*_AT_REST, State.STOPPING), State.ESTIMATING),
    Transition(Trigger.COMPARE, (*_AT_REST, State.STOPPING), State.COMPARING),
    Transition(Trigger.DIAGNOSE, (State.COMPARING,), State.DIAGNOSING),
    Transition(Trigger.PROPOSE, (State.DIAGNOSING,), State.PROPOSING),
    Transition(Trigger.PAUSE, (State.STOPPING,), State.PAUSED),
    Transition(Trigger.FINISH, (State.STOPPING,), State.FINISHED),
    Transition(Trigger.FAULT, (State.STOPPING,), State.FAULTED),
    Transition(Trigger.ABORT, (State.STOPPING,), State.ABORTED),
)


class StateMachine:
    """The state of one run.

    Parameters
    ----------
    on_change : callable
        Told the old state, the new one and the reason, after the change and outside the
        machine's own callbacks, so that what it raises leaves no half-made transition behind.
    """

    def __init__(self, on_change: Callable[[State, State, str], None]) -> None:
        from transitions import Machine

        self._on_change = on_change
        self._model = _Model()
        Machine(
            model=self._model,
            states=list(State),
            initial=State.IDLE,
            transitions=[
                {"trigger": row.trigger.value, "source": list(row.sources), "dest": row.target} for row in TRANSITIONS
            ],
            auto_transitions=False,
        )

    @property
    def state(self) -> State:
        return self._model.state

    def may(self, trigger: Trigger) -> bool:
        """Whether the trigger leads anywhere from here."""
        return any(row.trigger is trigger and self.state in row.sources for row in TRANSITIONS)

    def fire(self, trigger: Trigger, reason: str = "") -> None:
        """Move on; a trigger that is not in the table for this state is a defect (RuntimeError)."""
        source = self.state
        if not self.may(trigger):
            raise RuntimeError(f"{trigger.value} is not possible in state {source.value}")
        self._model.trigger(trigger.value)
        self._on_change(source, self.state, reason)


class _Model:
    """What `transitions` decorates with its methods; typed here once for all."""

    state: State
    trigger: Callable[[str], bool]


def mermaid() -> str:
    """The table as a Mermaid state diagram, as docs/states.md shows it; alike states stand in one box."""
    groups = {"at_rest": _AT_REST, "energised": ENERGISED}
    lines = ["stateDiagram-v2", f"    [*] --> {State.IDLE.value}"]
    for name, members in groups.items():
        lines += [f"    state {name} {{", *(f"        {state.value}" for state in members), "    }"]
    for row in TRANSITIONS:
        boxes = [name for name, members in groups.items() if set(members) <= set(row.sources)]
        boxed = {state for name in boxes for state in groups[name]}
        sources = [*boxes, *(state.value for state in row.sources if state not in boxed)]
        lines += [f"    {source} --> {row.target.value}: {row.trigger.value}" for source in sources]
    lines += [f"    {state.value} --> [*]" for state in TERMINAL]
    return "\n".join(lines) + "\n"

"""The states of a run and the transitions between them.

A small typed facade over a flat `transitions.Machine`. The run's own states are defined here; stages declare theirs.
The machine only defines which state may follow which; every exit from an energised state leads through `stopping`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from protocols import PluginError, Stage, StageState


class State(StrEnum):
    """States of every run."""

    IDLE = "idle"
    CONNECTING = "connecting"
    WAITING_FOR_OPERATOR = "waiting_for_operator"
    PAUSED = "paused"
    STOPPING = "stopping"
    FINISHED = "finished"
    FAULTED = "faulted"
    ABORTED = "aborted"


class Trigger(StrEnum):
    """Triggers of every run."""

    CONNECT = "connect"
    ASK_OPERATOR = "ask_operator"
    PAUSE = "pause"
    STOP = "stop"
    FINISH = "finish"
    FAULT = "fault"
    ABORT = "abort"


TERMINAL = (State.FINISHED, State.FAULTED, State.ABORTED)


@dataclass(frozen=True)
class Transition:
    """One row of the table: from any of the sources, by the trigger, to the target."""

    trigger: str
    sources: tuple[str, ...]
    target: str


@dataclass(frozen=True)
class StateTable:
    """The states of a run with its stages, and the transitions."""

    energised: tuple[str, ...]
    """States with the drive armed, one per kind of stage."""
    at_rest: tuple[str, ...]
    """Disarmed, not terminal."""
    working: tuple[str, ...]
    """Disarmed states in which a stage evaluates measurements."""
    transitions: tuple[Transition, ...]

    @property
    def states(self) -> tuple[str, ...]:
        """All of them, the run's own first."""
        return (*State, *self.working, *self.energised)


def table_of(stages: Iterable[Stage | type[Stage]]) -> StateTable:
    """The table for a run with these stages.

    Raises
    ------
    PluginError
        Where a stage's state is one of the run's, follows an unknown one, or differs from another stage's of this name.
    """
    energised: dict[str, StageState] = {}
    working: dict[str, StageState] = {}
    for stage in stages:
        if stage.measuring is not None:
            _declare(stage.name, stage.measuring, energised, working)
        for state in stage.working:
            _declare(stage.name, state, working, energised)
    common = (State.CONNECTING, State.WAITING_FOR_OPERATOR)
    at_rest = (*common, *working, State.PAUSED)
    anywhere = (*at_rest, *energised)
    stopped = (*at_rest, State.STOPPING)
    transitions = (
        Transition(Trigger.CONNECT, (State.IDLE,), State.CONNECTING),
        *(Transition(state.trigger, anywhere, state.name) for state in energised.values()),
        Transition(Trigger.STOP, (State.IDLE, *anywhere), State.STOPPING),
        Transition(Trigger.ASK_OPERATOR, stopped, State.WAITING_FOR_OPERATOR),
        *(Transition(s.trigger, stopped if s.after is None else (s.after,), s.name) for s in working.values()),
        Transition(Trigger.PAUSE, (State.STOPPING,), State.PAUSED),
        Transition(Trigger.FINISH, (State.STOPPING,), State.FINISHED),
        Transition(Trigger.FAULT, (State.STOPPING,), State.FAULTED),
        Transition(Trigger.ABORT, (State.STOPPING,), State.ABORTED),
    )
    return _checked(StateTable(tuple(energised), at_rest, tuple(working), transitions))


def _declare(stage: str, state: StageState, same: dict[str, StageState], other: dict[str, StageState]) -> None:
    if state.name in {*State} or state.trigger in {*Trigger}:
        raise PluginError("stages", stage, f"the state {state.name!r} (by {state.trigger!r}) is the run's own")
    if state.name in other or same.setdefault(state.name, state) != state:
        raise PluginError("stages", stage, f"the state {state.name!r} is declared otherwise by another stage")


def _checked(table: StateTable) -> StateTable:
    """The table, after checks: sources exist, and a trigger leads to one state only."""
    targets: dict[str, str] = {}
    for row in table.transitions:
        unknown = set(row.sources) - set(table.states)
        if unknown:
            raise PluginError("stages", row.target, f"follows {', '.join(sorted(unknown))}, and there is no such state")
        if targets.setdefault(row.trigger, row.target) != row.target:
            raise PluginError("stages", row.target, f"the trigger {row.trigger!r} leads to {targets[row.trigger]!r}")
    return table


class StateMachine:
    """The state of one run.

    Parameters
    ----------
    table : StateTable
    on_change : callable
        Called with the old state, the new one and the reason after the change, outside the
        machine's own callbacks, so that its exceptions leave no incomplete transition.
    """

    def __init__(self, table: StateTable, on_change: Callable[[str, str, str], None]) -> None:
        self._on_change = on_change
        self._model = _Model()
        self._model.state = State.IDLE
        self.extend(table)

    def extend(self, table: StateTable) -> None:
        """Replace the table after stages were appended."""
        from transitions import Machine

        self._table = table
        model = _Model()
        Machine(
            model=model,
            states=list(table.states),
            initial=self.state,
            transitions=[
                {"trigger": row.trigger, "source": list(row.sources), "dest": row.target} for row in table.transitions
            ],
            auto_transitions=False,
        )
        self._model = model

    @property
    def state(self) -> str:
        return self._model.state

    def may(self, trigger: str) -> bool:
        """Whether the trigger leads anywhere from here."""
        return any(row.trigger == trigger and self.state in row.sources for row in self._table.transitions)

    def fire(self, trigger: str, reason: str = "") -> None:
        """Change the state; a trigger without a transition from this state is a defect (RuntimeError)."""
        source = self.state
        if not self.may(trigger):
            raise RuntimeError(f"{trigger} is not possible in state {source}")
        self._model.trigger(trigger)
        self._on_change(source, self.state, reason)


class _Model:
    """Model that `transitions` decorates with its methods, typed."""

    state: str
    trigger: Callable[[str], bool]


def mermaid(table: StateTable) -> str:
    """The table as a Mermaid state diagram, as in docs/states.md; states of a kind share a box."""
    groups = {"at_rest": table.at_rest, "energised": table.energised}
    lines = ["stateDiagram-v2", f"    [*] --> {State.IDLE}"]
    for name, members in groups.items():
        lines += [f"    state {name} {{", *(f"        {state}" for state in members), "    }"]
    for row in table.transitions:
        boxes = [name for name, members in groups.items() if set(members) <= set(row.sources)]
        boxed = {state for name in boxes for state in groups[name]}
        sources = [*boxes, *(state for state in row.sources if state not in boxed)]
        lines += [f"    {source} --> {row.target}: {row.trigger}" for source in sources]
    lines += [f"    {state} --> [*]" for state in TERMINAL]
    return "\n".join(lines) + "\n"

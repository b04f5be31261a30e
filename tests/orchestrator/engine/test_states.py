"""The state machine: what may follow what, and that every way out leads through stopping."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.engine import ENERGISED, TERMINAL, TRANSITIONS, State, StateMachine, Trigger, mermaid


def ignore(source: State, target: State, reason: str) -> None:
    """Nobody listens."""


def machine_in(state: State) -> StateMachine:
    """A machine led to `state` by the shortest way."""
    ways: list[tuple[State, list[Trigger]]] = [(State.IDLE, [])]
    for here, way in ways:
        if here is state:
            break
        ways += [
            (row.target, [*way, row.trigger])
            for row in TRANSITIONS
            if here in row.sources and row.target not in [seen for seen, _ in ways]
        ]
    else:
        raise AssertionError(f"{state} cannot be reached")
    machine = StateMachine(ignore)
    for trigger in way:
        machine.fire(trigger)
    assert machine.state is state
    return machine


def test_every_state_can_be_reached() -> None:
    for state in State:
        machine_in(state)


@pytest.mark.parametrize("state", ENERGISED)
def test_the_only_way_from_an_energised_state_to_rest_is_stopping(state: State) -> None:
    targets = {row.target for row in TRANSITIONS if state in row.sources}
    assert targets - set(ENERGISED) == {State.STOPPING}


@pytest.mark.parametrize("state", [state for state in State if state not in (*TERMINAL, State.STOPPING)])
def test_every_state_that_is_not_an_end_can_be_stopped(state: State) -> None:
    machine = machine_in(state)
    machine.fire(Trigger.STOP)
    assert machine.state is State.STOPPING


@pytest.mark.parametrize("state", TERMINAL)
def test_nothing_follows_an_end(state: State) -> None:
    assert not any(machine_in(state).may(trigger) for trigger in Trigger)


@pytest.mark.parametrize("state", ENERGISED)
def test_a_stage_kind_can_be_entered_again(state: State) -> None:
    (trigger,) = {row.trigger for row in TRANSITIONS if row.target is state}
    machine = machine_in(state)
    machine.fire(trigger)
    assert machine.state is state


@given(st.lists(st.sampled_from(Trigger), max_size=30))
def test_a_trigger_out_of_place_is_refused_and_changes_nothing(triggers: list[Trigger]) -> None:
    machine = StateMachine(ignore)
    for trigger in triggers:
        before = machine.state
        if machine.may(trigger):
            machine.fire(trigger)
            continue
        with pytest.raises(RuntimeError, match="not possible"):
            machine.fire(trigger)
        assert machine.state is before


def test_a_listener_that_raises_finds_the_machine_in_the_new_state() -> None:
    def refuse(source: State, target: State, reason: str) -> None:
        raise OSError("disk full")

    machine = StateMachine(refuse)
    with pytest.raises(OSError, match="disk full"):
        machine.fire(Trigger.CONNECT)
    assert machine.state is State.CONNECTING


def test_the_diagram_in_the_docs_is_the_table() -> None:
    page = (Path(__file__).parents[3] / "docs" / "states.md").read_text()
    assert f"```mermaid\n{mermaid()}```" in page

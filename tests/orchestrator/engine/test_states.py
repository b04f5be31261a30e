"""The state machine: what may follow what, and that every way out leads through stopping."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.engine import TERMINAL, State, StateMachine, Trigger, mermaid, table_of
from orchestrator.stages import installed_stages
from protocols import PluginError, Stage, StageState

TABLE = table_of(installed_stages())
TRIGGERS = sorted({row.trigger for row in TABLE.transitions})


def ignore(source: str, target: str, reason: str) -> None:
    """Nobody listens."""


def machine_in(state: str) -> StateMachine:
    """A machine led to `state` by the shortest way."""
    ways: list[tuple[str, list[str]]] = [(State.IDLE, [])]
    for here, way in ways:
        if here == state:
            break
        ways += [
            (row.target, [*way, row.trigger])
            for row in TABLE.transitions
            if here in row.sources and row.target not in [seen for seen, _ in ways]
        ]
    else:
        raise AssertionError(f"{state} cannot be reached")
    machine = StateMachine(TABLE, ignore)
    for trigger in way:
        machine.fire(trigger)
    assert machine.state == state
    return machine


def test_every_state_can_be_reached() -> None:
    for state in TABLE.states:
        machine_in(state)


@pytest.mark.parametrize("state", TABLE.energised)
def test_the_only_way_from_an_energised_state_to_rest_is_stopping(state: str) -> None:
    targets = {row.target for row in TABLE.transitions if state in row.sources}
    assert targets - set(TABLE.energised) == {State.STOPPING}


@pytest.mark.parametrize("state", [state for state in TABLE.states if state not in (*TERMINAL, State.STOPPING)])
def test_every_state_that_is_not_an_end_can_be_stopped(state: str) -> None:
    machine = machine_in(state)
    machine.fire(Trigger.STOP)
    assert machine.state == State.STOPPING


@pytest.mark.parametrize("state", TERMINAL)
def test_nothing_follows_an_end(state: str) -> None:
    assert not any(machine_in(state).may(trigger) for trigger in TRIGGERS)


@pytest.mark.parametrize("state", TABLE.energised)
def test_a_stage_kind_can_be_entered_again(state: str) -> None:
    (trigger,) = {row.trigger for row in TABLE.transitions if row.target == state}
    machine = machine_in(state)
    machine.fire(trigger)
    assert machine.state == state


@given(st.lists(st.sampled_from(TRIGGERS), max_size=30))
def test_a_trigger_out_of_place_is_refused_and_changes_nothing(triggers: list[str]) -> None:
    machine = StateMachine(TABLE, ignore)
    for trigger in triggers:
        before = machine.state
        if machine.may(trigger):
            machine.fire(trigger)
            continue
        with pytest.raises(RuntimeError, match="not possible"):
            machine.fire(trigger)
        assert machine.state == before


def test_a_listener_that_raises_finds_the_machine_in_the_new_state() -> None:
    def refuse(source: str, target: str, reason: str) -> None:
        raise OSError("disk full")

    machine = StateMachine(TABLE, refuse)
    with pytest.raises(OSError, match="disk full"):
        machine.fire(Trigger.CONNECT)
    assert machine.state == State.CONNECTING


def test_the_diagram_in_the_docs_is_the_table() -> None:
    page = (Path(__file__).parents[3] / "docs" / "states.md").read_text()
    assert f"```mermaid\n{mermaid(TABLE)}```" in page


class Soak(Stage):
    """A stage of somebody else's."""

    name = "soak"
    title = "soak"
    measuring = StageState("soaking", "soak")


def test_a_stage_that_is_installed_has_its_state_in_the_table() -> None:
    table = table_of([*installed_stages(), Soak])
    assert set(table.energised) - set(TABLE.energised) == {"soaking"}
    machine = StateMachine(TABLE, ignore)
    machine.fire(Trigger.CONNECT)
    assert not machine.may("soak")
    machine.extend(table)
    machine.fire("soak")
    machine.fire(Trigger.STOP)
    assert machine.state == State.STOPPING


@pytest.mark.parametrize(
    ("measuring", "working", "message"),
    [
        (StageState("stopping", "soak"), (), "the run's own"),
        (StageState("soaking", "stop"), (), "the run's own"),
        (StageState("sweeping_injection", "soak"), (), "declared otherwise"),
        (StageState("soaking", "align"), (), "the trigger 'align' leads to 'aligning'"),
        (None, (StageState("aligning", "align"),), "declared otherwise"),
        (None, (StageState("drying", "dry", after="soaking"),), "follows soaking, and there is no such state"),
    ],
)
def test_states_that_clash_are_refused_when_the_table_is_made(
    measuring: StageState | None, working: tuple[StageState, ...], message: str
) -> None:
    kind = type("Clash", (Soak,), {"__module__": __name__, "measuring": measuring, "working": working})
    with pytest.raises(PluginError, match=message):
        table_of([*installed_stages(), kind])

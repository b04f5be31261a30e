"""Nodes on one bus: identifiers are free where the node goes, and filters let through what is meant for it."""

from __future__ import annotations

import itertools

import can
import pytest

from plugins.wire import MAX_NODES, filters_of_drive, filters_of_host, frame_id, from_bus, on_bus
from plugins.wire._dbc import dbc_text, layouts, message_database

LOWEST_OF_DRIVES = frame_id("Status")
ESTOP = frame_id("EStop")


def test_every_identifier_leaves_room_for_the_node() -> None:
    ids = [layout.frame_id for layout in layouts().values()]
    on_the_bus = [on_bus(identifier, node) for identifier, node in itertools.product(ids, range(MAX_NODES))]
    assert len(set(on_the_bus)) == len(on_the_bus)
    assert max(on_the_bus) < 1 << 11


@pytest.mark.parametrize("node", range(MAX_NODES))
def test_what_is_of_this_node_comes_back_as_it_was_and_nothing_else_but_a_stop(node: int) -> None:
    for layout, other in itertools.product(layouts().values(), range(MAX_NODES)):
        own = from_bus(on_bus(layout.frame_id, other), node)
        assert own == (layout.frame_id if other == node or layout.frame_id == ESTOP else None)


@pytest.mark.parametrize("node", range(MAX_NODES))
def test_the_filters_pass_what_is_taken(node: int) -> None:
    with can.Bus(channel="filters", interface="virtual", ignore_config=True) as bus:
        for identifier in range(0x200):
            message = can.Message(arbitration_id=identifier, is_extended_id=False)
            bus.set_filters(filters_of_host(node))
            assert bus._matches_filters(message) == (identifier % MAX_NODES == node)
            bus.set_filters(filters_of_drive(node))
            wanted = from_bus(identifier, node) is not None and identifier < LOWEST_OF_DRIVES
            assert bus._matches_filters(message) == wanted


def test_a_nodes_dbc_is_the_same_under_its_own_identifiers() -> None:
    import cantools

    shifted = cantools.database.load_string(dbc_text(3), "dbc", strict=True)
    for message in message_database().messages:
        twin = shifted.get_message_by_frame_id(message.frame_id + 3)  # type: ignore[union-attr]
        assert (twin.name, twin.comment, twin.cycle_time) == (message.name, message.comment, message.cycle_time)
        for one, other in zip(message.signals, twin.signals, strict=True):
            assert (one.name, one.comment, one.choices, one.is_float) == (
                other.name,
                other.comment,
                other.choices,
                other.is_float,
            )

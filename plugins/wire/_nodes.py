"""Several drives on one CAN bus: the two lowest bits of an identifier, free in every message, are the node number."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plugins.wire._codec import frame_id

if TYPE_CHECKING:
    from can.typechecking import CanFilter

MAX_NODES = 4
"""Largest number of drives on a bus, numbered from 0."""
_NODE_BITS = MAX_NODES - 1
_IDENTIFIER_BITS = 0x7FF


def on_bus(identifier: int, node: int) -> int:
    """A message's identifier on the bus, to or from this node."""
    return identifier | node


def from_bus(identifier: int, node: int) -> int | None:
    """The message's identifier; None for another node's. An emergency stop belongs to all nodes."""
    own = identifier & ~_NODE_BITS
    return own if identifier & _NODE_BITS == node or own == frame_id("EStop") else None


def filters_of_host(node: int) -> list[CanFilter]:
    """Acceptance filters in python-can's form for all messages of this node."""
    return [_filter(node, _NODE_BITS)]


def filters_of_drive(node: int) -> list[CanFilter]:
    """Acceptance filters of a drive: messages from hosts to this node, and every emergency stop."""
    from_drives = _IDENTIFIER_BITS & ~(frame_id("Status") - 1)  # bits that no identifier of a host has
    return [_filter(node, from_drives | _NODE_BITS), _filter(frame_id("EStop"), _IDENTIFIER_BITS & ~_NODE_BITS)]


def _filter(identifier: int, mask: int) -> CanFilter:
    return {"can_id": identifier, "can_mask": mask, "extended": False}

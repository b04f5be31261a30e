"""Reads the layout of messages from the protocol's DBC.

Not a general DBC parser: it supports the little-endian, unmultiplexed subset of
`protocols/wire/fluxbench.dbc`. Documents and C code are generated from the same file with cantools.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cantools.database.can import Database

_MESSAGE = re.compile(r"^BO_ (\d+) (\w+): (\d+) (\w+)")
_SIGNAL = re.compile(r"^ SG_ (\w+) : (\d+)\|(\d+)@1([+-]) \(([^,]+),0\)")
_IDENTIFIER = re.compile(r'^((?:CM_ |BA_ "\w+" )?(?:BO_|SG_)|VAL_|SIG_VALTYPE_) (\d+) ', re.MULTILINE)
_FLOAT = re.compile(r"^SIG_VALTYPE_ (\d+) (\w+) : 1;")


@dataclass(frozen=True)
class SignalLayout:
    """Position of a signal's bits, and its scale."""

    name: str
    start: int
    bits: int
    signed: bool
    factor: float
    is_float: bool = False


@dataclass(frozen=True)
class MessageLayout:
    """Identifier, length in bytes, sender and signals of a message."""

    frame_id: int
    name: str
    length: int
    sender: str
    signals: tuple[SignalLayout, ...]


def dbc_text(node: int = 0) -> str:
    """The message set as a DBC file, with the identifiers of this node."""
    text = (files("protocols") / "wire" / "fluxbench.dbc").read_text(encoding="utf-8")
    return _IDENTIFIER.sub(lambda match: f"{match[1]} {int(match[2]) | node} ", text) if node else text


def message_database() -> Database:
    """The message set as a cantools database, with comments and value tables, for documents and C code."""
    import cantools

    database = cantools.database.load_string(dbc_text(), "dbc", strict=True)
    assert isinstance(database, cantools.database.can.Database)
    return database


@cache
def layouts() -> dict[str, MessageLayout]:
    """Layout of every message, by name."""
    text = dbc_text()
    floats = {(int(frame), name) for frame, name in (m.groups() for m in map(_FLOAT.match, text.splitlines()) if m)}
    layouts_by_name: dict[str, MessageLayout] = {}
    for block in text.split("\n\n"):
        head = _MESSAGE.match(block)
        if head is None:
            continue
        frame_id, name, length, sender = int(head[1]), head[2], int(head[3]), head[4]
        signals = tuple(
            SignalLayout(m[1], int(m[2]), int(m[3]), m[4] == "-", float(m[5]), (frame_id, m[1]) in floats)
            for m in map(_SIGNAL.match, block.splitlines())
            if m
        )
        layouts_by_name[name] = MessageLayout(frame_id, name, length, sender, signals)
    return layouts_by_name

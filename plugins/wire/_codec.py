"""Encodes and decodes messages by the DBC's layout; `_blocks` does so for bulk data."""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from typing import NamedTuple, get_type_hints

from plugins.wire._dbc import MessageLayout, SignalLayout, layouts
from plugins.wire._messages import MESSAGES, MIN_BYTES, EStop, Message
from protocols import InputError


class Frame(NamedTuple):
    """A frame on a link: an 11-bit identifier and a payload."""

    frame_id: int
    payload: bytes


class _Codec(NamedTuple):
    message_type: Callable[..., Message]
    layout: MessageLayout
    kinds: tuple[type, ...]
    """Type of each field, in the order of the layout's signals."""


def frame_id(name: str) -> int:
    """Identifier of a message by its name in the DBC; raises `KeyError`."""
    return layouts()[name].frame_id


def encode(message: Message) -> Frame:
    """The frame of a message.

    Raises `InputError` where a field does not fit its signal.
    """
    codec = _by_name()[type(message).__name__]
    bits = 0
    for signal, value in zip(codec.layout.signals, message, strict=True):
        bits |= _raw(codec.layout.name, signal, value) << signal.start
    return Frame(codec.layout.frame_id, bits.to_bytes(codec.layout.length, "little"))


def decode(frame_id: int, payload: bytes) -> Message | None:
    """The message of a frame; None for an unknown identifier, length or enumeration value.

    An emergency stop is accepted with any payload. Extra bytes of a later minor version are
    ignored; bytes that an earlier minor version lacks are zero.
    """
    codec = _by_id().get(frame_id)
    if codec is None:
        return None
    unknown = EStop() if codec.message_type is EStop else None
    if len(payload) < MIN_BYTES.get(codec.layout.name, codec.layout.length):
        return unknown
    bits = int.from_bytes(payload[: codec.layout.length], "little")
    try:
        values = [_value(signal, kind, bits) for signal, kind in zip(codec.layout.signals, codec.kinds, strict=True)]
    except ValueError:  # not a member of the enumeration
        return unknown
    return codec.message_type(*values)


def single(value: float) -> float:
    """The value rounded to an IEEE 754 single; raises `OverflowError` beyond its range."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _raw(message: str, signal: SignalLayout, value: float) -> int:
    if signal.is_float:
        try:
            return int.from_bytes(struct.pack("<f", value), "little")
        except OverflowError:
            raise InputError("wire", f"{message}.{signal.name}", f"{value:g} does not fit a single") from None
    count = round(value / signal.factor) if signal.factor != 1.0 else int(value)
    low = -(1 << (signal.bits - 1)) if signal.signed else 0
    if not low <= count < low + (1 << signal.bits):
        raise InputError("wire", f"{message}.{signal.name}", f"{value:g} does not fit {signal.bits} bits")
    return count & ((1 << signal.bits) - 1)


def _value(signal: SignalLayout, kind: type, bits: int) -> float:
    count = (bits >> signal.start) & ((1 << signal.bits) - 1)
    if signal.is_float:
        return float(struct.unpack("<f", count.to_bytes(4, "little"))[0])
    if signal.signed and count >> (signal.bits - 1):
        count -= 1 << signal.bits
    if issubclass(kind, IntEnum):
        return kind(count)
    return count * signal.factor if signal.factor != 1.0 else count


@cache
def _by_name() -> dict[str, _Codec]:
    table = {}
    for message_type in MESSAGES:
        layout, hints = layouts()[message_type.__name__], get_type_hints(message_type)
        table[layout.name] = _Codec(message_type, layout, tuple(hints[signal.name] for signal in layout.signals))
    return table


@cache
def _by_id() -> dict[int, _Codec]:
    return {codec.layout.frame_id: codec for codec in _by_name().values()}

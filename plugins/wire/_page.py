"""The page that documents the drive protocol: a template with tables from the DBC and the register table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from importlib.resources import files
from typing import TYPE_CHECKING

from plugins.wire import _meanings as words
from plugins.wire._blocks import CAN_FD_LAYOUT, CLASSIC_LAYOUT, serial_blocks
from plugins.wire._dbc import message_database
from plugins.wire._facts import DriveFacts
from plugins.wire._messages import AckStatus, Capability, Fault, Op, Phase, PowerState
from plugins.wire._program import AXES, KINDS, WAVEFORMS
from plugins.wire._registers import Register, registers
from plugins.wire._rows import CaptureFormat, Channel

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

_OWN_TABLES = {"op", "status", "state", "cause", "phase", "parameter"}
"""Signals whose values have a separate table on the page."""
_RIPPLE_ROW_BYTES = 16
_EXAMPLE_ROWS = 50_000
"""Rows of a point in the paper: 5 s at 10 kS/s."""


def page() -> str:
    """The text of docs/wire.md: protocols/wire/page.md with the tables inserted."""
    database = message_database()
    inserts: dict[str, Callable[[], str]] = {
        "states": lambda: _meanings("state", PowerState, words.STATES),
        "faults": lambda: _meanings("bit", Fault, words.FAULTS),
        "channels": lambda: _table(("bit", "channel"), ((_bit(c), str(c.name).lower()) for c in Channel)),
        "messages": lambda: "\n\n".join((_overview(database.messages), *map(_message, database.messages))),
        "ops": lambda: _meanings("op", Op, words.OPS),
        "ack_statuses": lambda: _meanings("status", AckStatus, words.ACK_STATUSES),
        "phases": lambda: _meanings("phase", Phase, words.PHASES),
        "registers": lambda: "\n\n".join(_register_sections()),
        "bandwidth": lambda: _table(("link", "bits for a block", "kB/s", "a point of 400 kB"), _bandwidth()),
        "load": lambda: _live_load(database),
    }
    template = (files("protocols") / "wire" / "page.md").read_text(encoding="utf-8")
    return re.sub(r"<!-- insert: (\w+) -->", lambda match: inserts[match[1]](), template)


# Tables


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def _meanings(title: str, kind: type[Enum], meanings: dict[str, str]) -> str:
    names = {member.name.lower(): member.value for member in kind}
    assert names.keys() == meanings.keys(), f"{kind.__name__}: {names.keys() ^ meanings.keys()}"
    return _table((title, "name", "meaning"), ((value, name, meanings[name]) for name, value in names.items()))


def _bit(flag: Channel | Capability) -> int:
    return flag.value.bit_length() - 1


def _overview(messages: Sequence[Message]) -> str:
    rows = (
        (f"0x{m.frame_id:03X}", f"[{m.name}](#{m.name.lower()})", _direction(m), m.length, _period(m)) for m in messages
    )
    return _table(("identifier", "message", "from", "bytes", "period"), rows)


def _direction(message: Message) -> str:
    return message.senders[0].lower()


def _period(message: Message) -> str:
    return f"{message.cycle_time} ms" if message.cycle_time else ""


def _message(message: Message) -> str:
    head = f"### {message.name}\n\n`0x{message.frame_id:03X}`, {_direction(message)}. {message.comment}"
    return head + "\n\n" + _table(("signal", "bits", "type", "unit", "meaning"), _signals(message.signals))


def _signals(signals: Sequence[Signal]) -> Iterator[tuple[str, str, str, str, str]]:
    for signal in signals:
        if signal.name.startswith("data_") and signal.name != "data_0":
            continue
        bits, name = f"{signal.start} to {signal.start + signal.length - 1}", signal.name
        meaning = str(signal.comment)
        if signal.name == "data_0":
            bits, name, meaning = (
                f"{signal.start} to 511",
                "data_0 to data_14",
                "The block's bytes in order; zeros past the end of the capture.",
            )
        elif signal.choices and signal.name not in _OWN_TABLES:
            meaning += " " + ", ".join(f"{number} {choice}" for number, choice in signal.choices.items()) + "."
        kind = "f32" if signal.is_float else f"{'i' if signal.is_signed else 'u'}{signal.length}"
        scale = "" if signal.scale == 1 else f"{signal.scale:.6g} "
        yield name, bits, kind, scale + (signal.unit or ""), meaning


# Registers


def _register_sections() -> Iterator[str]:
    sections: dict[str, list[Register]] = {}
    for register in registers().values():
        sections.setdefault(register.section, []).append(register)
    for title, members in sections.items():
        head = ("index", "name", "access", "unit", "range", "default", "meaning")
        yield f"### {title}\n\n" + _table(head, map(_register, members))


def _register(register: Register) -> tuple[object, ...]:
    low, high = (f"{bound:.6g}" for bound in register.range)
    default = "" if register.access == "read" else f"{register.default:.6g}"
    text = register.text
    if register.values in _VALUES:
        text += " " + ", ".join(f"{k} {name}" for k, name in enumerate(_VALUES[register.values])) + "."
    if register.bits in _BITS:
        text += " Bits: " + ", ".join(f"{k} {name}" for k, name in _BITS[register.bits]) + "."
    unit = register.unit or ("whole" if register.whole else "")
    return register.index, register.name, register.access, unit, f"{low} to {high}", default, text


_VALUES: dict[str | None, tuple[str, ...]] = {
    "ExcitationKind": KINDS,
    "SweptAxis": AXES,
    "Waveform": WAVEFORMS,
    "CaptureFormat": tuple(form.name.lower() for form in CaptureFormat),
    "Switch": ("off", "on"),
}
_BITS: dict[str | None, list[tuple[int, str]]] = {
    "Capability": [(_bit(flag), str(flag.name).lower()) for flag in Capability],
    "ExcitationKind": list(enumerate(KINDS)),
}


# Bandwidth


def classic_bits(data_bytes: int, *, stuffed: bool = False) -> int:
    """Bits of a classic CAN frame with an 11-bit identifier, its three bits of interframe space included.

    ISO 11898-1: 47 bits beside the data; at worst one stuff bit after the first five of the 34 + 8 n
    stuffed bits and one after every four more.
    """
    return 47 + 8 * data_bytes + ((34 + 8 * data_bytes - 1) // 4 if stuffed else 0)


def fd_seconds(nominal_hz: float, data_hz: float) -> float:
    """Time of a CAN FD frame of 64 bytes, without dynamic stuff bits (ISO 11898-1, CRC-21).

    29 bits at the nominal rate (SOF to BRS, acknowledge, end of frame, interframe space); in the
    data phase ESI, DLC, 512 bits of data, 4 of stuff count, 21 of CRC, 7 fixed stuff bits, and the delimiter.
    """
    return 29 / nominal_hz + (1 + 4 + 512 + 4 + 21 + 7 + 1) / data_hz


def serial_bytes(data_bytes: int) -> int:
    """Bytes on the line for a bulk block: header, identifier, CRC, COBS and the closing zero."""
    body = 2 + 4 + data_bytes + 4
    return body + math.ceil(body / 254) + 1


def _bandwidth() -> Iterator[tuple[str, str, str, str]]:
    point = _EXAMPLE_ROWS * 4 * 2
    for name, worst in (("classic CAN 1 Mbit/s", False), ("the same, worst stuffing", True)):
        bits = classic_bits(8, stuffed=worst)
        yield _link(name, f"{bits}", CLASSIC_LAYOUT.block * 1e6 / bits, point)
    yield _link("CAN FD 1/5 Mbit/s", "29 + 550", CAN_FD_LAYOUT.block / fd_seconds(1e6, 5e6), point)
    block = serial_blocks(DriveFacts.block_bytes).block
    for baud in (921_600, 3_000_000):
        line = serial_bytes(block)
        yield _link(f"UART {baud / 1e6:g} Mbit/s, blocks of {block} B", f"10 x {line}", baud / 10 * block / line, point)


def _link(name: str, bits: str, rate: float, point: int) -> tuple[str, str, str, str]:
    return name, bits, f"{rate / 1e3:.0f}", f"{point / rate:.1f} s"


def bus_load(rates_hz: Mapping[int, float], rows_hz: float, requests_hz: float, *, stuffed: bool) -> float:
    """Load of a 1 Mbit/s bus by telemetry (frames a second, by length) and ripple rows at this request rate."""
    telemetry = sum(rate * classic_bits(size, stuffed=stuffed) for size, rate in rates_hz.items())
    frames_hz = rows_hz * _RIPPLE_ROW_BYTES / CLASSIC_LAYOUT.block + 2.0 * requests_hz
    return (telemetry + frames_hz * classic_bits(8, stuffed=stuffed)) / 1e6


def _live_load(database: Database) -> str:
    rates: dict[int, float] = {}
    for message in database.messages:
        if message.cycle_time and not message.name.startswith("Ripple"):
            rates[message.length] = rates.get(message.length, 0.0) + 1e3 / message.cycle_time
    plain, worst = (100.0 * bus_load(rates, 500.0, 50.0, stuffed=stuffed) for stuffed in (False, True))
    return f"{plain:.1f} % ({worst:.1f} %)"

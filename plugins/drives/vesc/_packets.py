"""Encoding of a VESC's frames (comm/packet.c), commands (datatypes.h) and their values."""

from __future__ import annotations

import re
import struct
from binascii import crc_hqx
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from protocols import DriveFault, FaultCause

MAX_PAYLOAD_BYTES = 512
"""Octets of a payload (PACKET_MAX_PL_LEN)."""
SHORT, LONG, END = 2, 3, 3


class Command(IntEnum):
    """The used members of COMM_PACKET_ID."""

    FW_VERSION = 0
    SAMPLE_PRINT = 19
    TERMINAL_CMD = 20
    PRINT = 21
    ALIVE = 30
    GET_VALUES_SELECTIVE = 50
    LISP_PRINT = 135
    LISP_REPL_CMD = 138


class Sampling(IntEnum):
    """When rows are taken (debug_sampling_mode)."""

    NOW = 1
    START = 2
    """From the first period in which the motor runs."""


ROW = np.dtype(
    [
        ("command", "u1"),
        ("index", ">i2"),
        ("i", ">f4", 3),
        ("v", ">f4", 3),
        ("zero", ">f4"),
        ("filtered", ">f4"),
        ("rate", ">f4"),
        ("status", "u1"),
        ("phase", "u1"),
        ("again", ">i4"),
    ]
)
"""A sampled row, as `send_sample_block` in motor/mc_interface.c writes it."""


def encode_frame(payload: bytes) -> bytes:
    """A payload of 1 to 512 octets as a frame."""
    n = len(payload)
    head = struct.pack(">BB", SHORT, n) if n < 256 else struct.pack(">BH", LONG, n)
    return head + payload + struct.pack(">HB", crc_hqx(payload, 0), END)


class Decoder:
    """Decodes payloads from a stream of octets; damaged ones are skipped, octet by octet."""

    def __init__(self) -> None:
        self._waiting = b""

    def feed(self, octets: bytes) -> list[bytes]:
        """The payloads that these octets complete."""
        return self._decoded(self._waiting + octets, is_over=False)

    def pause(self) -> list[bytes]:
        """The payloads behind the start of a frame that did not go on: after a pause of the line it was noise."""
        return self._decoded(self._waiting, is_over=True)

    def _decoded(self, data: bytes, is_over: bool) -> list[bytes]:
        at, payloads = 0, list[bytes]()
        while at < len(data):
            payload, used = _first(data, at)
            if payload is not None:
                payloads.append(payload)
            elif used == 0 and not is_over:
                break
            at += used or 1
        self._waiting = data[at:]
        return payloads


def _first(data: bytes, at: int) -> tuple[bytes | None, int]:
    """Payload and length of the frame at `at`; (None, 1) without a frame there, (None, 0) for an incomplete one."""
    start = data[at]
    if start not in (SHORT, LONG):
        return None, 1
    if len(data) - at < start:
        return None, 0
    n = int.from_bytes(data[at + 1 : at + start])
    if not (1 if start == SHORT else 255) <= n <= MAX_PAYLOAD_BYTES:
        return None, 1
    begin, end = at + start, at + start + n
    if len(data) < end + 3:
        return None, 0
    payload = data[begin:end]
    if data[end + 2] != END or int.from_bytes(data[end : end + 2]) != crc_hqx(payload, 0):
        return None, 1
    return payload, start + n + 3


@dataclass(frozen=True)
class Values:
    """A reading; currents and voltages are means since the previous reading, in the control's frame."""

    i: complex
    bus_v: float
    fault: int
    v: complex
    timed_out: bool

    MASK = 1 << 4 | 1 << 5 | 1 << 8 | 1 << 15 | 1 << 19 | 1 << 20 | 1 << 21

    @classmethod
    def request(cls) -> bytes:
        """Payload that requests a reading."""
        return struct.pack(">BI", Command.GET_VALUES_SELECTIVE, cls.MASK)

    @classmethod
    def of(cls, payload: bytes) -> Values:
        """Decode a reading; raises `DriveFault` for another payload."""
        layout = struct.Struct(">BIiihBiiB")
        if len(payload) != layout.size:
            raise DriveFault(FaultCause.WRONG_DATA, f"a reading of {len(payload)} octets, expected {layout.size}")
        _, mask, d, q, bus, fault, vd, vq, status = layout.unpack(payload)
        if mask != cls.MASK:
            raise DriveFault(FaultCause.WRONG_DATA, f"a reading of {mask:#x}, {cls.MASK:#x} was requested")
        return cls(complex(d, q) / 100.0, bus / 10.0, fault, complex(vd, vq) / 1000.0, bool(status & 1))


def rows_of(payloads: list[bytes]) -> np.ndarray:
    """Sampled rows in their order; raises `DriveFault` where one is missing or of another length."""
    if any(len(payload) != ROW.itemsize for payload in payloads):
        raise DriveFault(FaultCause.WRONG_DATA, f"a sampled row is not of {ROW.itemsize} octets")
    rows = np.frombuffer(b"".join(payloads), ROW)
    if not np.array_equal(rows["index"], np.arange(len(rows))):
        raise DriveFault(FaultCause.WRONG_DATA, "sampled rows are missing, or belong to two captures")
    return rows


def numbers_in(text: str) -> list[float]:
    """The numbers of an answer of the board's Lisp: `> (60.000000f32 1000)`."""
    return [float(one) for one in re.findall(r"-?\d+(?:\.\d+)?", re.sub(r"f32|u32|i32", "", text))]

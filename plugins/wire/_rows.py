"""Rows of a capture as bytes: channels, format and scales. Exact in f32; within half a count in int16."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols import DriveFault, FaultCause, InputError

Real = NDArray[np.floating[Any]]


class Channel(IntFlag):
    """Channels of a row, in the order of their bits."""

    I_ALPHA = 1
    I_BETA = 2
    V_ALPHA = 4
    V_BETA = 8
    V_DC = 16
    I_A = 32
    I_B = 64
    I_C = 128
    TEMPERATURE = 256


VECTORS = Channel.I_ALPHA | Channel.I_BETA | Channel.V_ALPHA | Channel.V_BETA
"""Channels that every capture needs."""


class CaptureFormat(IntEnum):
    """Number format of the rows, little-endian."""

    INT16 = 0
    F32 = 1


_SCALE_REGISTERS = ("current_scale_a", "voltage_scale_v", "bus_scale_v", "temperature_scale_c", "ripple_scale_a")
"""Registers in the order of the fields of `Scales`."""


@dataclass(frozen=True)
class Scales:
    """Value of a count of each quantity."""

    current_a: float
    voltage_v: float
    bus_v: float
    temperature_c: float
    ripple_a: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Scales:
        """Scales from a drive's registers."""
        return cls(*(values[name] for name in _SCALE_REGISTERS))

    @classmethod
    def spanning(cls, current_a: float, voltage_v: float, bus_v: float, ripple_a: float) -> Scales:
        """Scales with which int16 spans these values, rounded to singles."""
        spans = (current_a, voltage_v, bus_v, 32767 * 0.01, ripple_a)
        return cls(*(float(np.float32(span / 32767.0)) for span in spans))

    def as_registers(self) -> dict[str, float]:
        return dict(zip(_SCALE_REGISTERS, astuple(self), strict=True))

    def of_channel(self, channel: Channel) -> float:
        """The scale of one channel."""
        if channel in (Channel.V_ALPHA, Channel.V_BETA):
            return self.voltage_v
        if channel is Channel.V_DC:
            return self.bus_v
        return self.temperature_c if channel is Channel.TEMPERATURE else self.current_a


@dataclass(frozen=True)
class RowFormat:
    """Layout of a row."""

    channels: Channel
    form: CaptureFormat
    scales: Scales

    def __post_init__(self) -> None:
        if not self.channels:
            raise InputError("wire", "capture_mask", "a row without channels")

    @property
    def row_bytes(self) -> int:
        return len(list(self.channels)) * (2 if self.form is CaptureFormat.INT16 else 4)

    def pack(self, columns: Mapping[Channel, Real]) -> bytes:
        """Bytes of rows from one array per channel, shape (n,) each, SI units.

        int16 saturates, as a converter does. Raises `InputError` for a NaN.
        """
        missing = [str(channel.name) for channel in self.channels if channel not in columns]
        if missing:
            raise InputError("wire", ", ".join(missing), "requested, but not measured")
        table = np.stack([columns[channel] for channel in self.channels], axis=1).astype(np.float64)
        if not np.isfinite(table).all():
            raise InputError("wire", "rows", "a sample is not finite")
        if self.form is CaptureFormat.F32:
            return table.astype("<f4").tobytes()
        counts = np.rint(table / [self.scales.of_channel(channel) for channel in self.channels])
        return np.clip(counts, -32768, 32767).astype("<i2").tobytes()

    def unpack(self, data: bytes | memoryview) -> dict[Channel, NDArray[np.float64]]:
        """One array per channel, shape (n,), SI units.

        Raises `DriveFault` (wrong_data) for an incomplete row or a sample that is not finite.
        """
        if len(data) % self.row_bytes:
            raise DriveFault(
                FaultCause.WRONG_DATA, f"{len(data)} bytes are no whole number of {self.row_bytes}-byte rows"
            )
        count = len(list(self.channels))
        int16 = self.form is CaptureFormat.INT16
        table = np.frombuffer(data, dtype="<i2" if int16 else "<f4").reshape(-1, count).astype(np.float64)
        if not int16 and not np.isfinite(table).all():
            raise DriveFault(FaultCause.WRONG_DATA, "a captured sample is not finite")
        scales = [self.scales.of_channel(channel) if int16 else 1.0 for channel in self.channels]
        return {channel: table[:, k] * scales[k] for k, channel in enumerate(self.channels)}

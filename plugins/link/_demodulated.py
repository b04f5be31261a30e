"""Injections as ripple rows, demodulated on the drive: read during the injection and converted to waveforms.

Waveforms are yielded before their verification by the CRC over all rows. They are a model of the samples, without the
noise that a row averages out.
"""

from __future__ import annotations

import math
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from plugins.link._host import Host
from plugins.link._machine import Machine
from plugins.link._raw import bus_voltage, temperature
from plugins.link._reading import Reader
from plugins.wire import (
    RIPPLE_FLAG,
    Capability,
    DriveFacts,
    RippleGrid,
    RippleRows,
    reconstruct,
)
from protocols import Capture, DriveFault, DriveRefused, FaultCause, Injection

MIN_ROWS_PER_REVOLUTION = 16
"""Smallest number of rows in a revolution of the injected vector; the waveform is linear between rows."""


def ripple_periods(injection: Injection, facts: DriveFacts) -> int:
    """Injection periods in a row: the smallest number within the drive's rate and memory, a divisor if possible.

    Raises `DriveRefused` where the rows would be too coarse for the rotation.
    """
    periods = injection.duration_s * injection.frequency_hz
    min_periods = max(
        1,
        math.ceil(injection.frequency_hz / facts.ripple_rate_max_hz - 1e-6),
        math.ceil(periods / facts.ripple_memory_rows - 1e-6),
    )
    chosen = next((n for n in range(min_periods, 2 * min_periods) if round(periods) % n == 0), min_periods)
    if chosen * injection.rotation_hz * MIN_ROWS_PER_REVOLUTION > injection.frequency_hz:
        raise DriveRefused(
            f"ripple rows of {chosen} periods at {injection.frequency_hz:g} Hz are too coarse for a rotation at "
            f"{injection.rotation_hz:g} Hz; capture it raw"
        )
    return chosen


class RippleRead:
    """The ripple rows of one injection; implements `Rows`.

    Parameters
    ----------
    host : Host
    machine : Machine
    number : int
        Capture number.
    injection : Injection
    periods : int
        Injection periods in a row.

    Raises `DriveFault` (wrong_data) where the drive announces another number of rows.
    """

    def __init__(self, host: Host, machine: Machine, number: int, injection: Injection, periods: int) -> None:
        self._host, self._scales, self._number = host, machine.facts.scales, number
        self._fs = fs = machine.capabilities.sampling_frequency_hz
        self._samples = injection.rows(fs)
        self._grid = RippleGrid(
            fs,
            injection.frequency_hz,
            injection.waveform,
            periods,
            round(injection.discard_s * fs),
            machine.capabilities.voltage_delay_samples,
            bool(machine.facts.bits & Capability.RIPPLE_CURVATURE),
        )
        self._rotation = np.exp(1j * injection.rotor_angle_rad)
        rows = self._grid.rows(self._samples)
        announced = int(host.read("ripple_rows"))
        if announced != rows:
            raise DriveFault(FaultCause.WRONG_DATA, f"the drive announces {announced} ripple rows instead of {rows}")
        self._reader = Reader(host, number + RIPPLE_FLAG, rows * self._grid.row_bytes, machine.layout)
        self._crc, self._parsed_bytes = 0, 0
        self._base: tuple[float, float] | None = None
        self._finished = False
        self._counts = np.zeros((0, self._grid.columns), dtype="<i2")
        self._waves: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def poll(self, done_rows: int, complete: bool, wait_s: float) -> bool:
        """Continue reading; raises `DriveFault` (wrong_data) where the CRC contradicts yielded rows."""
        assembly, size = self._reader.assembly, self._grid.row_bytes
        data = self._reader.poll(assembly.length if complete else self._grid.rows(done_rows) * size, wait_s)
        if data is None:
            return False
        if crc32(data[: self._parsed_bytes]) != self._crc:
            raise DriveFault(FaultCause.WRONG_DATA, f"ripple rows of capture {self._number} were damaged on the way")
        self._finished, self._waves = True, None
        return True

    @property
    def _rows_ready(self) -> int:
        return max(self._reader.assembly.prefix, self._parsed_bytes) // self._grid.row_bytes

    @property
    def ready(self) -> int:
        """Samples that no later row changes, since waveforms are interpolated between centres of rows."""
        if self._finished:
            return self._samples
        rows = self._rows_ready
        return int(self._grid.starts(rows)[rows - 1]) if rows else 0

    def block(self, first: int, stop: int, start_s: float) -> Capture:
        """Samples of the reconstructed waveforms."""
        i, v = self._waveforms()
        return Capture(
            start_s=start_s,
            sampling_frequency_hz=self._fs,
            i_ab=self._stator(i[first:stop]),
            v_ab=self._stator(v[first:stop]),
            v_dc=bus_voltage(self._host, stop - first),
            clipped_rows=self._clipped(first, stop),
            temperature_c=temperature(self._host, stop - first),
        )

    def _clipped(self, first: int, stop: int) -> int:
        """Samples in rows with a saturated count."""
        starts = self._grid.starts(len(self._counts))
        rows = slice(int(np.searchsorted(starts, first, "right")) - 1, int(np.searchsorted(starts, stop)))
        counts = self._counts[max(rows.start, 0) : rows.stop]
        share = np.count_nonzero(np.abs(counts.astype(np.int32)).max(axis=1, initial=0) >= 32767) / max(len(counts), 1)
        return round(share * (stop - first))

    def _waveforms(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Waveforms of the received rows; the CRC has to confirm these bytes later."""
        rows, size = self._rows_ready, self._grid.row_bytes
        if self._waves is None or len(self._counts) != rows:
            if self._base is None:
                self._base = self._host.read("base_voltage_d_v"), self._host.read("base_voltage_q_v")
            data = self._reader.assembly.peek(self._parsed_bytes, rows * size)
            self._crc, self._parsed_bytes = crc32(data, self._crc), rows * size
            new_counts = np.frombuffer(data, dtype="<i2").reshape(-1, self._grid.columns)
            self._counts = np.concatenate((self._counts, new_counts))
            values = RippleRows.of_counts(self._counts, self._scales)
            self._waves = reconstruct(values, self._base, self._grid, self._samples if self._finished else None)
        return self._waves

    def _stator(self, dq: NDArray[np.float64]) -> NDArray[np.float32]:
        turned = (dq[:, 0] + 1j * dq[:, 1]) * self._rotation
        return np.column_stack((turned.real, turned.imag)).astype(np.float32)

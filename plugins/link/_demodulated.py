"""Injections as ripple rows, demodulated on the drive: seen live, read again with their CRC, turned into waveforms.

The waveforms are a model of the samples: what a row averages over is gone from their noise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from plugins.link._host import Host
from plugins.link._machine import Machine
from plugins.link._raw import bus_voltage, temperature
from plugins.link._reading import Reader
from plugins.wire import (
    RIPPLE,
    RIPPLE_ROW_BYTES,
    DriveFacts,
    RippleD,
    RippleGrid,
    RippleRows,
    Unwrapped,
    reconstruct,
)
from protocols import Capture, DriveFault, DriveRefused, FaultCause, Injection

ROWS_A_TURN = 16
"""Fewest rows in one turn of the injected vector; the waveform is linear between rows."""


def ripple_periods(injection: Injection, facts: DriveFacts) -> int:
    """Injection periods in a row: as few as the drive's rate and memory allow, without a rest where possible.

    Raises `DriveRefused` where the rows would be too coarse for the rotation.
    """
    periods = injection.duration_s * injection.frequency_hz
    fewest = max(
        1,
        math.ceil(injection.frequency_hz / facts.ripple_rate_max_hz - 1e-6),
        math.ceil(periods / facts.ripple_memory_rows - 1e-6),
    )
    chosen = next((n for n in range(fewest, 2 * fewest) if round(periods) % n == 0), fewest)
    if chosen * injection.rotation_hz * ROWS_A_TURN > injection.frequency_hz:
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

    Raises `DriveFault` (wrong_data) where the drive is about to make another number of rows.
    """

    def __init__(self, host: Host, machine: Machine, number: int, injection: Injection, periods: int) -> None:
        self._host, self._scales = host, machine.facts.scales
        self._fs = fs = machine.capabilities.sampling_frequency_hz
        self._samples = injection.rows(fs)
        self._grid = RippleGrid(
            fs,
            injection.frequency_hz,
            injection.waveform,
            periods,
            round(injection.discard_s * fs),
            machine.capabilities.voltage_delay_samples,
        )
        self._turned = np.exp(1j * injection.rotor_angle_rad)
        rows = self._grid.rows(self._samples)
        announced = int(host.read("ripple_rows"))
        if announced != rows:
            raise DriveFault(FaultCause.WRONG_DATA, f"the drive makes {announced} ripple rows instead of {rows}")
        self._layout, self._number = machine.layout, number + RIPPLE
        self._reader: Reader | None = None
        self._counts = np.zeros((rows, 6), dtype="<i2")
        self._seen = np.zeros((rows, 2), dtype=np.bool_)
        self._unwrapped = Unwrapped(16)
        self._base: tuple[float, float] | None = None
        self._used = 0
        self._finished = False
        self._waves: tuple[int, NDArray[np.float64], NDArray[np.float64]] | None = None

    def turn(self, done_rows: int, complete: bool, wait_s: float) -> bool:
        """Take live rows; at the end read all, and require that they are what was seen live."""
        self._take_live()
        if not complete:
            self._host.link.wait(lambda: False, wait_s)
            return False
        if self._reader is None:  # made no sooner, for it counts the time in which nothing comes
            self._reader = Reader(self._host, self._number, len(self._counts) * RIPPLE_ROW_BYTES, self._layout)
        data = self._reader.turn(self._reader.assembly.length, wait_s)
        if data is None:
            return False
        read = np.frombuffer(data, dtype="<i2").reshape(-1, 6)
        if not np.array_equal(read[: self._used], self._counts[: self._used]):
            raise DriveFault(FaultCause.WRONG_DATA, "ripple rows read at the end are not those that were seen live")
        self._counts, self._finished, self._waves = read, True, None
        return True

    def _take_live(self) -> None:
        for row in self._host.link.ripple():
            n, axis = self._unwrapped(row.n), 0 if isinstance(row, RippleD) else 1
            if 0 <= n < len(self._counts):
                self._counts[n, 3 * axis : 3 * axis + 3] = row.mean, row.ripple, row.v
                self._seen[n, axis] = True

    @property
    def _rows_ready(self) -> int:
        if self._finished:
            return len(self._counts)
        gaps = np.flatnonzero(~self._seen.all(axis=1))[:1]
        return int(gaps[0]) if len(gaps) else len(self._counts)

    @property
    def ready(self) -> int:
        """Samples that no later row changes: a waveform runs from the middle of a row to that of the next."""
        if self._finished:
            return self._samples
        rows = self._rows_ready
        return int(self._grid.starts(rows)[rows - 1]) if rows else 0

    def block(self, first: int, stop: int, start_s: float) -> Capture:
        """Samples of the waveforms that the rows stand for."""
        i, v = self._waveforms()
        self._used = max(self._used, self._rows_ready)
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
        """Samples of rows that have a count at the end of its scale."""
        starts = self._grid.starts(len(self._counts))
        rows = slice(int(np.searchsorted(starts, first, "right")) - 1, int(np.searchsorted(starts, stop)))
        counts = self._counts[max(rows.start, 0) : rows.stop]
        share = np.count_nonzero(np.abs(counts.astype(np.int32)).max(axis=1, initial=0) >= 32767) / max(len(counts), 1)
        return round(share * (stop - first))

    def _waveforms(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        rows = self._rows_ready
        if self._waves is None or self._waves[0] != rows:
            if self._base is None:
                self._base = self._host.read("base_voltage_d_v"), self._host.read("base_voltage_q_v")
            values = RippleRows.of_counts(self._counts[:rows], self._scales)
            count = self._samples if self._finished else None
            self._waves = (rows, *reconstruct(values, self._base, self._grid, count))
        return self._waves[1:]

    def _stator(self, dq: NDArray[np.float64]) -> NDArray[np.float32]:
        turned = (dq[:, 0] + 1j * dq[:, 1]) * self._turned
        return np.column_stack((turned.real, turned.imag)).astype(np.float32)

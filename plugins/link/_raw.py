"""Raw rows of a capture, read during the capture and yielded before their verification by the CRC."""

from __future__ import annotations

from zlib import crc32

import numpy as np

from plugins.link._host import Host
from plugins.link._machine import Machine, row_format
from plugins.link._reading import Reader
from plugins.wire import NO_TEMPERATURE_C, Channel
from protocols import Capture, DriveFault, FaultCause

_MAX_INT16 = 32767
"""Largest int16 count."""


class RawRead:
    """The rows of one program; implements `Rows`.

    Parameters
    ----------
    host : Host
    machine : Machine
    number, rows : int
        Capture number, and rows of the complete capture.

    Raises `DriveFault` (wrong_data) where the drive announces another capture.
    """

    def __init__(self, host: Host, machine: Machine, number: int, rows: int) -> None:
        self._format = row_format(machine)
        self._host, self._fs = host, machine.capabilities.sampling_frequency_hz
        announced = int(host.read("capture_rows")), int(host.read("capture_row_bytes"))
        if announced != (rows, self._format.row_bytes):
            raise DriveFault(
                FaultCause.WRONG_DATA,
                f"the drive captures {announced[0]} rows of {announced[1]} bytes; "
                f"{rows} of {self._format.row_bytes} were requested",
            )
        self._reader = Reader(host, number, rows * self._format.row_bytes, machine.layout)
        self._crc, self._yielded_bytes = 0, 0

    def poll(self, done_rows: int, complete: bool, wait_s: float) -> bool:
        """Continue reading; raises `DriveFault` (wrong_data) where the CRC contradicts yielded rows."""
        assembly = self._reader.assembly
        data = self._reader.poll(assembly.length if complete else done_rows * self._format.row_bytes, wait_s)
        if data is None:
            return False
        if crc32(data[: self._yielded_bytes]) != self._crc:
            raise DriveFault(FaultCause.WRONG_DATA, f"rows of capture {assembly.capture} were damaged on the way")
        return True

    @property
    def ready(self) -> int:
        """Number of rows from the start without a gap."""
        return max(self._reader.assembly.prefix, self._yielded_bytes) // self._format.row_bytes

    def block(self, first: int, stop: int, start_s: float) -> Capture:
        """Rows `first` to `stop` as a capture."""
        size = self._format.row_bytes
        data = self._reader.assembly.peek(first * size, stop * size)
        self._crc, self._yielded_bytes = crc32(data, self._crc), stop * size
        columns = self._format.unpack(data)

        def vectors(alpha: Channel, beta: Channel) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
            return np.column_stack((columns[alpha], columns[beta])).astype(np.float32)

        v_dc = columns.get(Channel.V_DC)
        return Capture(
            start_s=start_s,
            sampling_frequency_hz=self._fs,
            i_ab=vectors(Channel.I_ALPHA, Channel.I_BETA),
            v_ab=vectors(Channel.V_ALPHA, Channel.V_BETA),
            v_dc=bus_voltage(self._host, stop - first) if v_dc is None else v_dc.astype(np.float32),
            temperature_c=temperature(self._host, stop - first),
            clipped_rows=clipped_rows(data, len(self._format.channels)),
        )


def clipped_rows(data: bytes | memoryview, channels: int) -> int:
    """Number of rows with a saturated int16 count, of a converter or a scale."""
    counts = np.frombuffer(data, dtype="<i2").reshape(-1, channels)
    is_saturated = (counts >= _MAX_INT16) | (counts <= -_MAX_INT16)
    return int(np.count_nonzero(is_saturated.any(axis=1)))


def bus_voltage(host: Host, rows: int) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """The bus voltage by telemetry, for drives that do not capture it, shape (rows,)."""
    status = host.link.news.status
    return np.full(rows, status.v_dc if status else 0.0, dtype=np.float32)


def temperature(host: Host, rows: int) -> np.ndarray[tuple[int], np.dtype[np.float32]] | None:
    """Present temperature by telemetry for a block of rows, shape (rows,); None without a thermometer."""
    status = host.link.news.status
    if status is None or status.temperature == NO_TEMPERATURE_C:
        return None
    return np.full(rows, host.read("temperature_c"), dtype=np.float32)

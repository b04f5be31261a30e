"""A thermometer beside the drive: a logger's file that grows, or a serial line that sends text.

A reading is one number of the last whole line. The run never waits for one; an old or implausible value counts as none.
"""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from protocols import Capture, InputError, ThermometerChoice

_NUMBER = re.compile(rb"(?<![\w.:-])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.:-])")
"""Not within a date, a time or a name."""
_TAIL_BYTES = 4096
_MIN_TEMPERATURE_C = -100.0
_MAX_TEMPERATURE_C = 400.0
"""Range of a winding's temperature; loggers write 9999 for a missing sensor."""


class _Lines(Protocol):
    def latest(self) -> tuple[bytes, float]:
        """The last whole line, and how old it is [s]."""
        ...


class _FileLines:
    def __init__(self, path: Path) -> None:
        self._path = path

    def latest(self) -> tuple[bytes, float]:
        with self._path.open("rb") as file:
            state = os.fstat(file.fileno())
            file.seek(max(0, state.st_size - _TAIL_BYTES))
            lines = file.read().split(b"\n")[:-1]
        return next((line for line in reversed(lines) if line.strip()), b""), time.time() - state.st_mtime


class _SerialLines:
    def __init__(self, port: Any) -> None:
        self._port, self._rest, self._line, self._at_s = port, b"", b"", -math.inf

    def latest(self) -> tuple[bytes, float]:
        *lines, self._rest = (self._rest + self._port.read(self._port.in_waiting or 1)[-_TAIL_BYTES:]).split(b"\n")
        complete = [line for line in lines if line.strip()]
        if complete:
            self._line, self._at_s = complete[-1], time.monotonic()
        return self._line, time.monotonic() - self._at_s


class Thermometer:
    """Temperatures for captures, from a source of lines.

    Parameters
    ----------
    choice : ThermometerChoice
    lines : object
        With `latest`.
    """

    def __init__(self, choice: ThermometerChoice, lines: _Lines) -> None:
        self._choice, self._lines = choice, lines

    def reading_c(self) -> float | None:
        """Present reading [degrees Celsius]; None where it is old or implausible."""
        try:
            line, age_s = self._lines.latest()
        except OSError:  # a logger that rotates its file, a plug that was pulled: no reason to end a run
            return None
        numbers = _NUMBER.findall(line)
        if age_s > self._choice.stale_s or not -len(numbers) <= self._choice.column < len(numbers):
            return None
        value = float(numbers[self._choice.column])
        return value if _MIN_TEMPERATURE_C <= value <= _MAX_TEMPERATURE_C else None


class LoggedTemperature:
    """The temperature of one segment's blocks: read with each, the last one kept where there is none."""

    def __init__(self, thermometer: Thermometer | None) -> None:
        self._thermometer = thermometer
        self._latest_c = None if thermometer is None else thermometer.reading_c()

    @property
    def missing(self) -> bool:
        """Whether the thermometer gave no reading as the segment began: then none of its blocks has a temperature."""
        return self._thermometer is not None and self._latest_c is None

    def put_into(self, capture: Capture) -> Capture:
        """The capture with the thermometer's temperature, in the place of the drive's own."""
        if self._thermometer is None or self._latest_c is None:
            return capture
        now_c = self._thermometer.reading_c()
        self._latest_c = self._latest_c if now_c is None else now_c
        return capture.model_copy(update={"temperature_c": np.full(len(capture), self._latest_c, dtype=np.float32)})


@contextmanager
def open_thermometer(choice: ThermometerChoice | None) -> Iterator[Thermometer | None]:
    """The procedure's thermometer, where it has one; raises `InputError` where it is not there."""
    if choice is None:
        yield None
    elif choice.file is not None:
        if not choice.file.is_file():
            raise InputError("thermometer", "file", f"{choice.file}: no such file; the logger has to write already")
        yield Thermometer(choice, _FileLines(choice.file))
    else:
        import serial

        try:
            port = serial.Serial(choice.port, choice.baud_rate, timeout=0)
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError("thermometer", "port", f"{choice.port} cannot be opened: {reason}") from None
        with port:
            yield Thermometer(choice, _SerialLines(port))

"""Communication with a VESC: version, settings, readings, a held current, a tone, sampled rows.

Commands are those of a stock firmware from 6.06 on: the terminal's `rotor_lock_openloop`, LispBM's console, and
COMM_SAMPLE_PRINT. docs/vesc.md gives the sources.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import Any

from plugins.drives.vesc._link import Link
from plugins.drives.vesc._packets import Command, Sampling, Values, numbers_in, rows_of
from plugins.link import ProcessClock
from protocols import DriveFault, DriveRefused, FaultCause

ANSWER_TIMEOUT_S = 1.0
CONSOLE_PERIOD_S = 0.55
"""Time between two lines to the Lisp console, which silently drops a line within half a second of another."""
TONE_RELEASE_S = 1.1
"""Time after a tone's start during which no command switches the bridge off."""
FOC_MOTOR_TYPE = 2
INJECTING_SENSOR_MODES = range(3, 9)
"""Sensor modes FOC_SENSOR_MODE_HFI to HFI_V5."""


@dataclass(frozen=True)
class Settings:
    """The relevant part of the board's configuration; the first five are changed for a run and restored."""

    max_scale: float
    min_scale: float
    abs_current_a: float
    timeout_ms: float
    current_max_a: float
    current_min_a: float
    max_duty: float
    zero_vectors_hz: float
    proportional: float
    integral: float
    motor_type: int
    sensor_mode: int
    inverted: int

    @property
    def own_limit_a(self) -> float:
        return self.current_max_a * self.max_scale


class Board:
    """A board, by a link.

    Parameters
    ----------
    link : Link
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self.check, self.close = link.check, link.close
        self._sent_s, self.released_s = time.monotonic(), 0.0  # an earlier host may have sent a line just now

    def version(self) -> tuple[int, int, str]:
        """Major and minor version of the firmware, and the board's name."""
        answer = self._link.ask(bytes([Command.FW_VERSION]), Command.FW_VERSION, ANSWER_TIMEOUT_S)
        if len(answer) < 4:
            raise DriveFault(FaultCause.WRONG_DATA, f"{self._link.where}: a version of {len(answer)} octets")
        return answer[1], answer[2], answer[3:].split(b"\0")[0].decode("latin1")

    def settings(self) -> Settings:
        """Read the active configuration."""
        limits = self._numbers(
            _conf_get(
                "l-current-max-scale",
                "l-current-min-scale",
                "l-abs-current-max",
                "timeout-msec",
                "l-current-max",
                "l-current-min",
                "l-max-duty",
            ),
            7,
        )
        # The console prints six decimals, too few for the proportional gain of a small winding.
        kinds = _conf_get("foc-current-ki", "motor-type", "foc-sensor-mode", "m-invert-direction")
        rest = self._numbers(f"(conf-get 'foc-f-zv) (* 1000.0 (conf-get 'foc-current-kp)) {kinds}", 6)
        values: list[Any] = [*limits, rest[0], rest[1] / 1000.0, rest[2], *map(int, rest[3:])]
        return Settings(*values)

    def apply(self, max_scale: float, min_scale: float, abs_current_a: float, timeout_ms: float) -> None:
        """Set these in the board's volatile memory; raises `DriveFault` where they differ when read back."""
        settings = {
            "l-current-max-scale": f"{max_scale:.6f}",
            "l-current-min-scale": f"{min_scale:.6f}",
            "l-abs-current-max": f"{abs_current_a:.6f}",
            "timeout-msec": f"{timeout_ms:.0f}",
        }
        commands = " ".join(f"(conf-set '{name} {value})" for name, value in settings.items())
        readback = self._numbers(_conf_get(*settings), len(settings), before=commands)
        for (name, value), now in zip(settings.items(), readback, strict=True):
            if abs(now - float(value)) > 1e-4 * abs(float(value)) + 1e-6:
                raise DriveFault(FaultCause.WRONG_DATA, f"{name} is {now:g} after {value} was written")

    def values(self) -> Values:
        """A reading, averaged since the previous one."""
        return Values.of(self._link.ask(Values.request(), Command.GET_VALUES_SELECTIVE, ANSWER_TIMEOUT_S))

    def alive(self) -> None:
        """Feed the board's timeout."""
        self._link.send(bytes([Command.ALIVE]))

    def hold(self, current_a: float, degrees: float) -> None:
        """Hold a current along an angle; zero current releases the motor."""
        text = f"rotor_lock_openloop {current_a:.6g} 0 {degrees % 360.0:.6f}"
        self._link.forget(Command.PRINT)
        self._link.send(bytes([Command.TERMINAL_CMD]) + text.encode() + b"\0")
        output = ""
        while not output.endswith("OK\n"):
            answer = self._link.take(Command.PRINT, ANSWER_TIMEOUT_S)
            if answer is None:
                raise DriveFault(
                    FaultCause.NO_ANSWER, f"{self._link.where}: {text!r} has no answer; {output.strip()!r}"
                )
            output += answer[1:].rstrip(b"\0").decode("latin1")
            if "must be" in output or "requires" in output:
                raise DriveRefused(f"{self._link.where}: {output.splitlines()[-1]}")
            if "Fault occured" in output:
                raise DriveFault(FaultCause.INTERNAL, f"{self._link.where}: {output.splitlines()[-1]}")

    def sample(self, mode: Sampling, rows: int) -> None:
        """Start sampling of `rows` successive rows; `row` returns them."""
        self._link.forget(Command.SAMPLE_PRINT)
        self._link.send(struct.pack(">BBHBB", Command.SAMPLE_PRINT, mode, rows, 1, 0))

    def row(self, timeout_s: float) -> bytes | None:
        """The next received row; None after `timeout_s` without one."""
        return self._link.take(Command.SAMPLE_PRINT, timeout_s)

    def row_rate_hz(self) -> float:
        """Rate of the rows as they state it, rounded down to 10 Hz."""
        self.sample(Sampling.NOW, 1)
        row = self.row(ANSWER_TIMEOUT_S)
        if row is None:
            raise DriveFault(FaultCause.NO_ANSWER, f"{self._link.where}: samples no rows")
        return float(rows_of([row])["rate"][0])

    def tone(self, frequency_hz: float, amplitude_v: float, turns_hz: float, lasts_s: float) -> None:
        """Start a sine along q of a rotating frame without current; it ends by itself.

        The tone switches the bridge on and begins with its first period. The frame turns some time later.
        """
        self._evaluate(
            f"(progn (foc-play-stop) (foc-play-tone 0 {frequency_hz:.6f} {amplitude_v:.6f}) "
            f"(foc-openloop 0.0 {60.0 * turns_hz:.6f}) (sleep {lasts_s:.3f}) (foc-play-stop))"
        )
        self.released_s = time.monotonic() + TONE_RELEASE_S

    # The console

    def _numbers(self, query: str, count: int, before: str = "") -> list[float]:
        """Values of expressions; the console prints up to 128 characters."""
        expression = f"(progn {before} (list {query}))"
        self._link.forget(Command.LISP_PRINT)
        self._evaluate(expression)
        waited_s, output = ProcessClock(), ""
        while (remaining_s := ANSWER_TIMEOUT_S - waited_s()) > 0.0:
            answer = self._link.take(Command.LISP_PRINT, remaining_s)
            if answer is None:
                break
            output = answer[1:].rstrip(b"\0").decode("latin1")
            if output.startswith("> ("):
                numbers = numbers_in(output)
                if len(numbers) == count:
                    return numbers
        raise DriveFault(FaultCause.NO_ANSWER, f"{self._link.where}: no answer to {expression!r}; {output!r}")

    def _evaluate(self, expression: str) -> None:
        time.sleep(max(0.0, self._sent_s + CONSOLE_PERIOD_S - time.monotonic()))
        self._link.send(bytes([Command.LISP_REPL_CMD]) + expression.encode() + b"\0")
        self._sent_s = time.monotonic()


def _conf_get(*names: str) -> str:
    return " ".join(f"(conf-get '{name})" for name in names)

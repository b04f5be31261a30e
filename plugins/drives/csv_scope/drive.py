"""The drive `csv_scope`: a person or a script plays the excitations on any equipment and returns files.

It serves equipment without a protocol for a host: real-time simulators (dSPACE, Speedgoat, PLECS RT box), an inverter
with an oscilloscope. Each request is a numbered file in a folder; docs/csv-scope.md describes requests and answers.
A folder has no watchdog: the person or script that plays protects motor and drive.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BaseModel, Field

from orchestrator.driving import DriveShell, in_blocks, keepalive
from plugins.drives.csv_scope._results import read_columns, read_result
from plugins.drives.csv_scope._tables import table_of, write_table
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveSetup,
    Excitation,
    FaultCause,
    InputError,
    Limits,
    NonNegative,
    Positive,
    Strict,
    Telemetry,
)

Playable = Literal["gates_off", "hold", "trapezoid", "injection"]
"""Excitations that a table fixed in advance can describe."""


class CsvScopeOptions(Strict):
    """Options of the drive `csv_scope`: folder, mapping and capabilities of the equipment."""

    folder: Path = Field(description="Existing folder for requests and answers.")
    mapping: Path = Field(description="An import's mapping, which describes the columns of an answer.")
    sampling_frequency_hz: Positive
    dc_bus_voltage_v: Positive
    max_current_a: Positive
    max_voltage_v: Positive | None = None
    """None: the bus voltage over sqrt(3), available in every direction."""
    pwm_frequency_hz: Positive | None = None
    """None: the sampling frequency."""
    voltage_delay_samples: NonNegative = 0.0
    longest_capture_s: Positive | None = None
    longest_excitation_s: Positive | None = None
    frequency_step_hz: Positive | None = None
    rotation_step_hz: Positive | None = None
    excitations: frozenset[Playable] = frozenset(get_args(Playable))
    wait_s: Positive | None = None
    """Longest wait for a measurement; None: unlimited."""
    deed_s: Positive = 120.0
    """Longest wait for the power stage to be switched on or off."""
    steady_s: NonNegative = 0.3
    """A file that has not changed for this time is complete; 0 if files are renamed into place."""


class CsvScopeDrive(DriveShell):
    """A folder as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `CsvScopeOptions`.
    """

    name: ClassVar[str] = "csv_scope"
    Options: ClassVar[type[BaseModel]] = CsvScopeOptions
    poll_s: ClassVar[float] = 0.02
    alive_s: ClassVar[float] = 0.25
    """Period of keepalives while waiting for an answer."""
    block_s: ClassVar[float] = 0.25

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: CsvScopeOptions = setup.options
        self._columns: dict[str, Any] = {}
        self._number = 0
        self._clock_s, self._origin_s = 0.0, time.monotonic()
        self._current, self._bus_v = 0j, self._options.dc_bus_voltage_v

    def open(self) -> Capabilities:
        """Read folder and mapping and continue their numbers; raises `InputError` where one is missing."""
        o = self._options
        if not o.folder.is_dir():
            raise InputError("drive", "folder", f"{o.folder} is no directory")
        self._columns = read_columns(o.mapping)
        numbers = [int(path.name[:4]) for path in o.folder.glob("[0-9][0-9][0-9][0-9].*")]
        self._number = max(numbers, default=0)
        pwm = o.pwm_frequency_hz or o.sampling_frequency_hz
        return Capabilities(
            name="csv_scope",
            sampling_frequency_hz=o.sampling_frequency_hz,
            pwm_frequency_hz=pwm,
            pwm_frequencies_hz=(pwm,),
            dc_bus_voltage_v=o.dc_bus_voltage_v,
            voltage_delay_samples=o.voltage_delay_samples,
            max_current_a=o.max_current_a,
            max_voltage_v=o.max_voltage_v or o.dc_bus_voltage_v / math.sqrt(3.0),
            longest_capture_s=o.longest_capture_s,
            longest_excitation_s=o.longest_excitation_s,
            frequency_step_hz=o.frequency_step_hz,
            rotation_step_hz=o.rotation_step_hz,
            heeds_bandwidth=False,
            excitations=o.excitations,
            watchdog_s=None,
            clock_is_simulated=True,  # playing takes any time
            notes=(f"each point waits for an answer in {o.folder} (docs/csv-scope.md)",),
        )

    def energise(self, limits: Limits) -> None:
        """Request the power stage to be switched on, within these limits."""
        self._execute("arm", limits=limits.model_dump(mode="json"))

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Write the table and the request; blocks follow when the answer arrives."""
        fs = self._options.sampling_frequency_hz
        stem = self._next_stem()
        write_table(self._options.folder / f"{stem}.table.csv", table_of(excitation, fs))
        self._request(
            stem,
            "play",
            table=f"{stem}.table.csv",
            answer=f"{stem}.result.csv",
            rows=excitation.rows(fs),
            sampling_frequency_hz=fs,
            excitation=excitation.model_dump(mode="json"),
        )
        return self._await_capture(stem, excitation)

    def _await_capture(self, stem: str, excitation: Excitation) -> Iterator[Capture]:
        o, fs = self._options, self._options.sampling_frequency_hz
        for _ in self._waiting(stem, "result.csv", o.wait_s):
            yield keepalive(self._now_s(), fs)
        path = o.folder / f"{stem}.result.csv"
        drive = {"name": self.name, "dc_bus_voltage_v": o.dc_bus_voltage_v}
        try:
            capture = read_result(path, self._columns, excitation, self.setup.motor, drive, fs)
        except DriveFault as fault:
            raise self._latched(fault) from None
        start_s = max(self._now_s() - excitation.captured_s, self._clock_s + excitation.settling_s)
        self._clock_s = start_s + excitation.captured_s
        turn = np.exp(-1j * excitation.rotor_angle_rad)
        self._current = complex(*capture.i_ab[-max(1, len(capture) // 10) :].mean(axis=0)) * turn
        self._bus_v = float(np.median(capture.v_dc))
        yield from in_blocks(capture.model_copy(update={"start_s": start_s}), self.block_s)

    def ramp(self) -> None:
        """Request zero current, and wait for the confirmation."""
        self._execute("ramp_down")
        self._current = 0j

    def switch_off(self) -> None:
        """Request the power stage to be switched off."""
        self._execute("disarm")
        self._current = 0j

    def telemetry(self) -> Telemetry:
        """The last row of the last answer."""
        i = self._current
        return Telemetry(
            state=self.state,
            time_s=self._now_s(),
            i_d_a=i.real,
            i_q_a=i.imag,
            v_dc_v=self._bus_v,
            faults=self.faults,
        )

    def checkpoint(self, point_id: str) -> None:
        """Nothing to save: the folder holds all."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Continue the experiment's clock from `start_s`."""
        self._clock_s, self._origin_s = start_s, time.monotonic() - start_s

    # The folder

    def _now_s(self) -> float:
        return max(self._clock_s, time.monotonic() - self._origin_s)

    def _next_stem(self) -> str:
        self._number += 1
        return f"{self._number:04d}"

    def _request(self, stem: str, order: str, **fields: Any) -> None:
        """Write a request atomically."""
        path = self._options.folder / f"{stem}.request.json"
        partial = path.with_suffix(".partial")
        try:
            partial.write_text(json.dumps({"request": order, **fields}, indent=1), encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            raise DriveFault(FaultCause.LINK_LOST, f"{path}: cannot be written: {error.strerror or error}") from None

    def _execute(self, order: str, **fields: Any) -> None:
        stem = self._next_stem()
        self._request(stem, order, answer=f"{stem}.done", **fields)
        for _ in self._waiting(stem, "done", self._options.deed_s):
            pass

    def _waiting(self, stem: str, answer: str, longest_s: float | None) -> Iterator[None]:
        """Wait for an answer, yielding periodically; raises `DriveFault` for a reported fault or after `longest_s`."""
        folder, begun_s, yielded_s = self._options.folder, time.monotonic(), time.monotonic()
        path, fault = folder / f"{stem}.{answer}", folder / f"{stem}.fault"
        while not self._is_whole(path):
            if self._is_whole(fault):
                self.limits = None  # a player that reports a fault has switched off
                raise self._latched(_fault_in(fault))
            now_s = time.monotonic()
            if longest_s is not None and now_s - begun_s > longest_s:
                raise self._latched(DriveFault(FaultCause.NO_ANSWER, f"{path}: has not come for {longest_s:g} s"))
            if now_s - yielded_s > self.alive_s:
                yielded_s = now_s
                yield
            time.sleep(self.poll_s)

    def _latched(self, fault: DriveFault) -> DriveFault:
        """Latch a fault without `trip`, whose switching off by a file would delay the report."""
        self.latch(fault)
        return fault

    def _is_whole(self, path: Path) -> bool:
        try:
            return time.time() - path.stat().st_mtime >= self._options.steady_s
        except OSError:
            return False


def _fault_in(path: Path) -> DriveFault:
    """The player's fault: `cause: detail` with a cause of `FaultCause`, or a detail alone."""
    text = path.read_text(encoding="utf-8", errors="replace").strip() or "the player reports an unspecified fault"
    cause, _, detail = text.splitlines()[0].partition(":")
    known = {one.value: one for one in FaultCause}
    match = known.get(cause.strip())
    return DriveFault(match or FaultCause.INTERNAL, (detail.strip() or cause) if match else text.splitlines()[0])

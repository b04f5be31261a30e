"""The drive `csv_scope`: a person or a script plays the excitations, on whatever there is, and brings back files.

For what has no protocol that a host could speak: real-time simulators (dSPACE, Speedgoat, PLECS RT box), an inverter
with an oscilloscope. Each request is a numbered file in a folder; docs/csv-scope.md says what is in it and how it is
answered. There is no dead man in a folder: who plays protects motor and drive.
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
"""What a table can say: it knows beforehand when a voltage is turned."""


class CsvScopeOptions(Strict):
    """Options of the drive `csv_scope`: what it is that plays, in numbers."""

    folder: Path = Field(description="Where requests go and answers come from; has to be there.")
    mapping: Path = Field(description="An import's mapping: which columns of an answer are what.")
    sampling_frequency_hz: Positive
    dc_bus_voltage_v: Positive
    max_current_a: Positive
    max_voltage_v: Positive | None = None
    """None: what the bus gives in every direction."""
    pwm_frequency_hz: Positive | None = None
    """None: the sampling frequency."""
    voltage_delay_samples: NonNegative = 0.0
    longest_capture_s: Positive | None = None
    longest_excitation_s: Positive | None = None
    frequency_step_hz: Positive | None = None
    rotation_step_hz: Positive | None = None
    excitations: frozenset[Playable] = frozenset(get_args(Playable))
    wait_s: Positive | None = None
    """For a measurement; None: as long as it takes."""
    deed_s: Positive = 120.0
    """For the power stage to be switched on or off."""
    steady_s: NonNegative = 0.3
    """A file that has not changed for so long is whole; one that is renamed into place needs none of it."""


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
    """Between signs of life while nothing has come."""
    block_s: ClassVar[float] = 0.25

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: CsvScopeOptions = setup.options
        self._columns: dict[str, Any] = {}
        self._number = 0
        self._clock_s, self._origin_s = 0.0, time.monotonic()
        self._current, self._bus_v = 0j, self._options.dc_bus_voltage_v

    def open(self) -> Capabilities:
        """Look at folder and mapping, and number on after what is there; raises `InputError` where they are not."""
        o = self._options
        if not o.folder.is_dir():
            raise InputError("drive", "folder", f"{o.folder} is no directory")
        self._columns = read_columns(o.mapping)
        taken = [int(path.name[:4]) for path in o.folder.glob("[0-9][0-9][0-9][0-9].*")]
        self._number = max(taken, default=0)
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
            clock_is_simulated=True,  # who plays takes the time that it takes
            notes=(f"each point waits for an answer in {o.folder} (docs/csv-scope.md)",),
        )

    def energise(self, limits: Limits) -> None:
        """Ask for the power stage, within these limits."""
        self._do("arm", limits=limits.model_dump(mode="json"))

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Write the table and the request; blocks come when the answer is there."""
        fs = self._options.sampling_frequency_hz
        stem = self._next()
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
        return self._answered(stem, excitation)

    def _answered(self, stem: str, excitation: Excitation) -> Iterator[Capture]:
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
        self._do("ramp_down")
        self._current = 0j

    def switch_off(self) -> None:
        """Ask for the power stage to be switched off."""
        self._do("disarm")
        self._current = 0j

    def telemetry(self) -> Telemetry:
        """What the last answer ended with: nothing is known of what has happened since."""
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
        """Nothing to keep: the folder has it."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Let the experiment's clock go on from `start_s`."""
        self._clock_s, self._origin_s = start_s, time.monotonic() - start_s

    # The folder

    def _now_s(self) -> float:
        return max(self._clock_s, time.monotonic() - self._origin_s)

    def _next(self) -> str:
        self._number += 1
        return f"{self._number:04d}"

    def _request(self, stem: str, deed: str, **fields: Any) -> None:
        """Write a request, whole when it has its name."""
        path = self._options.folder / f"{stem}.request.json"
        partial = path.with_suffix(".partial")
        try:
            partial.write_text(json.dumps({"request": deed, **fields}, indent=1), encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            raise DriveFault(FaultCause.LINK_LOST, f"{path}: cannot be written: {error.strerror or error}") from None

    def _do(self, deed: str, **fields: Any) -> None:
        stem = self._next()
        self._request(stem, deed, answer=f"{stem}.done", **fields)
        for _ in self._waiting(stem, "done", self._options.deed_s):
            pass

    def _waiting(self, stem: str, answer: str, longest_s: float | None) -> Iterator[None]:
        """Until the answer is there, with a look around now and then; raises `DriveFault` for a fault, or in vain."""
        folder, begun_s, yielded_s = self._options.folder, time.monotonic(), time.monotonic()
        path, fault = folder / f"{stem}.{answer}", folder / f"{stem}.fault"
        while not self._is_whole(path):
            if self._is_whole(fault):
                self.limits = None  # who says so has switched off
                raise self._latched(_fault_in(fault))
            now_s = time.monotonic()
            if longest_s is not None and now_s - begun_s > longest_s:
                raise self._latched(DriveFault(FaultCause.NO_ANSWER, f"{path}: has not come for {longest_s:g} s"))
            if now_s - yielded_s > self.alive_s:
                yielded_s = now_s
                yield
            time.sleep(self.poll_s)

    def _latched(self, fault: DriveFault) -> DriveFault:
        """Not `trip`: switching off by a file takes a wait, which would delay the fault's report."""
        self.latch(fault)
        return fault

    def _is_whole(self, path: Path) -> bool:
        try:
            return time.time() - path.stat().st_mtime >= self._options.steady_s
        except OSError:
            return False


def _fault_in(path: Path) -> DriveFault:
    """What the player says has happened: a cause of `FaultCause`, a colon, and words; else words alone."""
    text = path.read_text(encoding="utf-8", errors="replace").strip() or "the player says that something is wrong"
    cause, _, detail = text.splitlines()[0].partition(":")
    known = {one.value: one for one in FaultCause}
    match = known.get(cause.strip())
    return DriveFault(match or FaultCause.INTERNAL, (detail.strip() or cause) if match else text.splitlines()[0])

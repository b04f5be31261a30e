"""Fits what a stage asks for to what a drive can do: long captures in parts or shorter, frequencies on its grid.

What no drive could do, and what limits do not allow, is refused elsewhere. A drive that says nothing of itself but what
it always did gets what it always got.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from protocols import Capabilities, Excitation, GatesOff, Hold, Injection, SegmentStage, Stage, Trapezoid

_NEXT_TO = 0.2
"""How far a frequency may be moved, as a part of it: beyond that it is another experiment."""
_IN_PARTS = (SegmentStage.RESISTANCE, SegmentStage.GATES_OFF)
"""What is as good in several captures as in one; elsewhere a point is one segment."""


@dataclass
class Fitting:
    """Fits excitations to one drive, and keeps what there is to say about it, once for each stage.

    Parameters
    ----------
    drive : Capabilities or None
        None: everything stays as it is.
    """

    drive: Capabilities | None
    notes: dict[str, None] = field(default_factory=dict)

    def of(self, excitation: Excitation, stage: Stage, index: int) -> list[Excitation]:
        """What is run in its place, in order; mostly itself."""
        drive = self.drive
        if drive is None:
            return [excitation]
        where = f"stages.{index} ({stage.name})"
        if not drive.heeds_bandwidth and not isinstance(excitation, GatesOff):
            self._note(f"{drive.name} has a current control of its own: no control.bandwidth_hz is heeded")
        if isinstance(excitation, Injection):
            excitation = self._on_the_grid(self._of_a_wave(excitation, drive, where), drive, where)
        longest_s = longest_capture_s(excitation, drive)
        if longest_s is None or longest_s <= 0.0 or excitation.captured_s <= longest_s:
            return [excitation]
        if isinstance(excitation, Trapezoid):
            return self._fewer_periods(excitation, longest_s, where)
        if isinstance(excitation, Injection):
            return [self._fewer_turns(excitation, longest_s, drive, where)]
        if isinstance(excitation, Hold | GatesOff) and stage.records_as in _IN_PARTS:
            return self._in_parts(excitation, longest_s, drive, where)
        self._note(f"{where}: {excitation.captured_s:g} s become {longest_s:g} s, the drive's longest capture")
        return [excitation.model_copy(update={"duration_s": longest_s})]

    def _of_a_wave(self, e: Injection, drive: Capabilities, where: str) -> Injection:
        if e.waveform in drive.injection_waveforms or len(drive.injection_waveforms) != 1:
            return e
        (only,) = drive.injection_waveforms
        self._note(f"{where}: waveform {e.waveform} becomes {only}, all that the drive plays")
        return e.model_copy(update={"waveform": only})

    def _on_the_grid(self, e: Injection, drive: Capabilities, where: str) -> Injection:
        update: dict[str, float] = {}
        if drive.frequency_step_hz is not None:
            near = _frequency_near(e, drive.frequency_step_hz, drive.sampling_frequency_hz)
            if near is not None:
                update["frequency_hz"] = near
        if drive.rotation_step_hz is not None and e.rotation_hz > 0.0:
            update["rotation_hz"] = max(1, round(e.rotation_hz / drive.rotation_step_hz)) * drive.rotation_step_hz
        moved = {name: value for name, value in update.items() if not math.isclose(value, getattr(e, name))}
        if not moved:
            return e
        turned = e.model_copy(update=moved)
        if "rotation_hz" in moved:  # as many turns as before
            turned = turned.model_copy(update={"duration_s": e.duration_s * e.rotation_hz / turned.rotation_hz})
        self._note(f"{where}: {_changes(e, turned, moved)}, on the drive's grid")
        return turned

    def _fewer_turns(self, e: Injection, longest_s: float, drive: Capabilities, where: str) -> Injection:
        """Whole turns of the injected direction; one faster turn where not even one fits."""
        turns = math.floor(longest_s * e.rotation_hz + 1e-9)
        update = {"duration_s": turns / e.rotation_hz if turns else longest_s}
        if e.rotation_hz > 0.0 and not turns:
            step = drive.rotation_step_hz or 0.0
            rotation = math.ceil(1.0 / longest_s / step - 1e-9) * step if step else 1.0 / longest_s
            update = {"rotation_hz": rotation, "duration_s": 1.0 / rotation}
        shorter = e.model_copy(update=update)
        self._note(f"{where}: {_changes(e, shorter, update)}: the drive's longest capture is {longest_s:g} s")
        return shorter

    def _fewer_periods(self, e: Trapezoid, longest_s: float, where: str) -> list[Excitation]:
        at_once = math.floor(longest_s / e.period_s + 1e-9)
        if not at_once:
            faster = e.model_copy(update={"period_s": longest_s})
            self._note(f"{where}: {_changes(e, faster, {'period_s': 0})}: the drive's longest capture")
            return self._fewer_periods(faster, longest_s, where) if e.periods > 1 else [faster]
        counts = [at_once] * (e.periods // at_once) + [e.periods % at_once] * bool(e.periods % at_once)
        self._note(f"{where}: {e.periods} periods become {len(counts)} captures of {at_once}")
        return [e.model_copy(update={"periods": count}) for count in counts]

    def _in_parts(self, e: Hold | GatesOff, longest_s: float, drive: Capabilities, where: str) -> list[Excitation]:
        captures = math.ceil(e.captured_s / longest_s - 1e-9)
        rows = math.floor(e.captured_s * drive.sampling_frequency_hz / captures + 1e-9)
        part_s = rows / drive.sampling_frequency_hz
        self._note(f"{where}: {e.captured_s:g} s become {captures} captures of {part_s:g} s each")
        first: Excitation = e.model_copy(update={"duration_s": part_s})
        again = first.model_copy(update={"settle_s": 0.0}) if isinstance(e, Hold) else first
        return [first, *[again] * (captures - 1)]

    def _note(self, text: str) -> None:
        self.notes[text] = None


def longest_capture_s(excitation: Excitation, drive: Capabilities) -> float | None:
    """What the drive captures of such an excitation at most; None where nothing limits it."""
    limits = [drive.longest_capture_s]
    if drive.longest_excitation_s is not None:
        limits.append(drive.longest_excitation_s - excitation.settling_s)
    if drive.longest_injection_s is not None and isinstance(excitation, Injection):
        limits.append(drive.longest_injection_s - excitation.discard_s)
    return min((limit for limit in limits if limit is not None), default=None)


def on_grid(value: float, step: float | None) -> bool:
    """Whether a frequency is a whole multiple of the drive's step."""
    return step is None or math.isclose(value, round(value / step) * step, rel_tol=1e-6, abs_tol=1e-9)


def _frequency_near(e: Injection, step_hz: float, sampling_hz: float) -> float | None:
    """The next frequency on the grid with a whole number of samples a period (even, of a square wave)."""
    unit = 2 if e.waveform == "square" else 1
    reach = math.ceil(_NEXT_TO * e.frequency_hz / step_hz)
    middle = round(e.frequency_hz / step_hz)
    found = [
        k * step_hz
        for k in range(max(1, middle - reach), middle + reach + 1)
        if on_grid(sampling_hz / (k * step_hz), unit) and abs(k * step_hz / e.frequency_hz - 1.0) <= _NEXT_TO
    ]
    return min(found, key=lambda f: abs(f - e.frequency_hz), default=None)


def _changes(before: Excitation, after: Excitation, names: Mapping[str, Any]) -> str:
    def described(name: str) -> str:
        quantity, _, unit = name.rpartition("_")
        unit = {"hz": "Hz"}.get(unit, unit)
        return f"{quantity} {getattr(before, name):.6g} {unit} becomes {getattr(after, name):.6g} {unit}"

    return ", ".join(map(described, names))

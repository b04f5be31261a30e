"""Adapts a stage's excitations to a drive: long captures are split or shortened, frequencies moved to its grid.

`_requirements` refuses what no drive can do or limits forbid. Capabilities that a drive does not state count as
unlimited, so plans for older drives stay unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from protocols import Capabilities, Excitation, GatesOff, Hold, Injection, SegmentStage, Stage, Trapezoid

MAX_FREQUENCY_SHIFT = 0.2
"""Largest relative shift of a frequency; beyond it the experiment would be another one."""
SPLITTABLE_STAGES = (SegmentStage.RESISTANCE, SegmentStage.GATES_OFF)
"""Stages whose points may be split into several captures; elsewhere a point is one segment."""
MAX_CAPTURES = 1000
"""Captures into which a point is split at most; a drive that captures so little is refused by its limit."""


@dataclass
class PlanAdapter:
    """Adapts excitations to one drive, and collects notes on the changes, once for each stage.

    Parameters
    ----------
    drive : Capabilities or None
        None: no excitation is changed.
    """

    drive: Capabilities | None
    notes: dict[str, None] = field(default_factory=dict)

    def adapt(self, excitation: Excitation, stage: Stage, index: int) -> list[Excitation]:
        """The excitations to run instead, in order; usually the given one alone."""
        drive = self.drive
        if drive is None:
            return [excitation]
        where = f"stages.{index} ({stage.name})"
        if not drive.heeds_bandwidth and not isinstance(excitation, GatesOff):
            self._note(f"{drive.name} ignores control.bandwidth_hz: it tunes its current control itself")
        if isinstance(excitation, Injection):
            excitation = self._on_the_grid(self._with_supported_waveform(excitation, drive, where), drive, where)
        longest_s = longest_capture_s(excitation, drive)
        if longest_s is None or longest_s <= 0.0 or excitation.captured_s <= longest_s:
            return [excitation]
        if isinstance(excitation, Trapezoid):
            return self._within_capture_sweeping(excitation, longest_s, where)
        if isinstance(excitation, Injection):
            return [self._within_capture_rotating(excitation, longest_s, drive, where)]
        if isinstance(excitation, Hold | GatesOff) and stage.records_as in SPLITTABLE_STAGES:
            return self._split(excitation, longest_s, drive, where)
        self._note(f"{where}: {excitation.captured_s:g} s become {longest_s:g} s, the drive's longest capture")
        return [excitation.model_copy(update={"duration_s": longest_s})]

    def _with_supported_waveform(self, e: Injection, drive: Capabilities, where: str) -> Injection:
        if e.waveform in drive.injection_waveforms or len(drive.injection_waveforms) != 1:
            return e
        (only,) = drive.injection_waveforms
        self._note(f"{where}: waveform {e.waveform} becomes {only}, the drive's only waveform")
        return e.model_copy(update={"waveform": only})

    def _on_the_grid(self, e: Injection, drive: Capabilities, where: str) -> Injection:
        update: dict[str, float] = {}
        if drive.frequency_step_hz is not None:
            nearest_hz = _frequency_near(e, drive.frequency_step_hz, drive.sampling_frequency_hz)
            if nearest_hz is not None:
                update["frequency_hz"] = nearest_hz
        if drive.rotation_step_hz is not None and e.rotation_hz > 0.0:
            update["rotation_hz"] = max(1, round(e.rotation_hz / drive.rotation_step_hz)) * drive.rotation_step_hz
        changes = {name: value for name, value in update.items() if not math.isclose(value, getattr(e, name))}
        if not changes:
            return e
        changed = e.model_copy(update=changes)
        if "rotation_hz" in changes:  # the number of rotations stays
            changed = changed.model_copy(update={"duration_s": e.duration_s * e.rotation_hz / changed.rotation_hz})
        self._note(f"{where}: {_changes(e, changed, changes)}, on the drive's grid")
        return changed

    def _within_capture_rotating(self, e: Injection, longest_s: float, drive: Capabilities, where: str) -> Injection:
        """A shorter injection of whole rotations; one faster rotation where none fits."""
        rotations = math.floor(longest_s * e.rotation_hz + 1e-9)
        update = {"duration_s": rotations / e.rotation_hz if rotations else longest_s}
        if e.rotation_hz > 0.0 and not rotations:
            step = drive.rotation_step_hz or 0.0
            rotation = math.ceil(1.0 / longest_s / step - 1e-9) * step if step else 1.0 / longest_s
            update = {"rotation_hz": rotation, "duration_s": 1.0 / rotation}
        shorter = e.model_copy(update=update)
        self._note(f"{where}: {_changes(e, shorter, update)}: the drive's longest capture is {longest_s:g} s")
        return shorter

    def _within_capture_sweeping(self, e: Trapezoid, longest_s: float, where: str) -> list[Excitation]:
        per_capture = math.floor(longest_s / e.period_s + 1e-9)
        if not per_capture:
            faster = e.model_copy(update={"period_s": longest_s})
            self._note(f"{where}: {_changes(e, faster, ['period_s'])}: the drive's longest capture")
            return self._within_capture_sweeping(faster, longest_s, where) if e.periods > 1 else [faster]
        counts = [per_capture] * (e.periods // per_capture) + [e.periods % per_capture] * bool(e.periods % per_capture)
        self._note(f"{where}: {e.periods} periods become {len(counts)} captures of {per_capture}")
        return [e.model_copy(update={"periods": count}) for count in counts]

    def _split(self, e: Hold | GatesOff, longest_s: float, drive: Capabilities, where: str) -> list[Excitation]:
        captures = math.ceil(min(e.captured_s / longest_s, MAX_CAPTURES + 1.0) - 1e-9)
        if captures > MAX_CAPTURES:  # refused with the drive's limit
            return [e]
        rows = math.floor(e.captured_s * drive.sampling_frequency_hz / captures + 1e-9)
        part_s = rows / drive.sampling_frequency_hz
        self._note(f"{where}: {e.captured_s:g} s become {captures} captures of {part_s:g} s each")
        first: Excitation = e.model_copy(update={"duration_s": part_s})
        next_part = first.model_copy(update={"settle_s": 0.0}) if isinstance(e, Hold) else first
        return [first, *[next_part] * (captures - 1)]

    def _note(self, text: str) -> None:
        self.notes[text] = None


def longest_capture_s(excitation: Excitation, drive: Capabilities) -> float | None:
    """Longest capture of such an excitation by the drive [s]; None without a limit."""
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
    """Nearest frequency on the grid with a whole number of samples per period (even for a square wave)."""
    unit = 2 if e.waveform == "square" else 1
    reach = math.ceil(MAX_FREQUENCY_SHIFT * e.frequency_hz / step_hz)
    middle = round(e.frequency_hz / step_hz)
    candidates = [
        k * step_hz
        for k in range(max(1, middle - reach), middle + reach + 1)
        if on_grid(sampling_hz / (k * step_hz), unit) and abs(k * step_hz / e.frequency_hz - 1.0) <= MAX_FREQUENCY_SHIFT
    ]
    return min(candidates, key=lambda f: abs(f - e.frequency_hz), default=None)


def _changes(old: Excitation, new: Excitation, names: Iterable[str]) -> str:
    def describe(name: str) -> str:
        quantity, _, unit = name.rpartition("_")
        unit = {"hz": "Hz"}.get(unit, unit)
        return f"{quantity} {getattr(old, name):.6g} {unit} becomes {getattr(new, name):.6g} {unit}"

    return ", ".join(map(describe, names))

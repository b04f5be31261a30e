"""Checks of a recording while it is read: it is refused where no motor and no sensor error can explain it.

A gain or a nameplate that is wrong by ten still passes, because such a recording can be diagnosed. Units that are
wrong by a thousand, columns of zeros and reversed polarity do not pass.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.validation.plausibility import (
    DRIVE_RANGES,
    MIN_OHMIC_RATIO,
    MIN_SLOW_VOLTAGE_RATIO,
    MOTOR_RANGES,
    POSSIBLE_BOUNDS,
    Numbers,
    is_reversed,
    outside,
    slow_part,
    suspicious_phase_rad,
    within,
)
from protocols import Capture, Manifest, NotMeasuredError, RecordingError, RecordingReader, Segment, SegmentStage

_RATES = ("frequency_hz", "rotation_hz", "period_s", "pwm_frequency_hz")
_TARGETS = ("target_d_a", "target_q_a", "held_a")
_MEASURING = (SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION)


@dataclass(frozen=True)
class _SegmentStatistics:
    """Statistics of one segment: means over its slow parts, and sums over the steps of its ripple."""

    current_a: float
    voltage_v: float
    i_squared: float = 0.0
    v_squared: float = 0.0
    v_on_i: complex = 0.0
    """Mean of conj(i) v."""
    steps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sum di^2, sum dv^2 Ts^2, sum di dv Ts."""


class SoundRecording:
    """A `protocols.RecordingReader` that refuses recordings that cannot be a motor's.

    It checks nameplate and settings on creation, each capture on loading, and the whole in `conclude`.

    Raises
    ------
    RecordingError
        Where the manifest has impossible numbers.
    """

    def __init__(self, recording: RecordingReader) -> None:
        self._recording = recording
        self._seen: dict[str, _SegmentStatistics] = {}
        _check_manifest(recording.manifest)

    @property
    def manifest(self) -> Manifest:
        return self._recording.manifest

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return self._recording.segments(*stages)

    def load(self, segment: Segment) -> Capture:
        """The segment's waveforms; raises `NotMeasuredError` too, where no motor can have them."""
        capture = self._recording.load(segment)
        if segment.id not in self._seen:
            self._check_sizes(segment, capture)
            self._seen[segment.id] = _statistics(segment, capture, self.manifest.drive.voltage_delay_samples or 0.0)
        return capture

    def read_through(self, max_samples: int = 2_000_000) -> None:
        """Load evenly spread segments with a bounded number of samples in all, and conclude."""
        segments = self.segments(*_MEASURING)
        total = sum(s.samples for s in segments)
        stride = max(1, math.ceil(total / max_samples))
        for segment in segments[::stride]:
            self.load(segment)
        self.conclude()

    def conclude(self) -> None:
        """Check the loaded segments as a whole.

        Raises
        ------
        NotMeasuredError
            Where currents and voltages are not those of one motor.
        """
        stage_of = {s.id: s.stage for s in self.segments()}
        seen = [x for name, x in self._seen.items() if stage_of.get(name) in _MEASURING]
        if not seen:
            return
        current, voltage = max(x.current_a for x in seen), max(x.voltage_v for x in seen)
        bus = self.manifest.drive.dc_bus_voltage_v
        if current == 0.0:
            self._refuse("i_alpha, i_beta", "zero throughout: no current was measured")
        # Noise alone, up to a fiftieth of the rated current, needs no voltage.
        if voltage < POSSIBLE_BOUNDS.bus_voltages[0] * bus and current > 0.02 * (
            self.manifest.motor.rated_current_a or 0.0
        ):
            problem = f"at most {voltage:.3g} V, though up to {current:.3g} A flow and the bus has {bus:g} V"
            self._refuse("v_alpha, v_beta", f"{problem}: not the voltage at a motor")
        self._check_polarity_and_resistance(seen)
        self._check_inductance(seen)

    def _check_sizes(self, segment: Segment, capture: Capture) -> None:
        motor, bus = self.manifest.motor, self.manifest.drive.dc_bus_voltage_v
        rated = motor.rated_current_a
        max_a = POSSIBLE_BOUNDS.rated_currents[1] * (MOTOR_RANGES["rated_current_rms_a"][1] if rated is None else rated)
        peak = _largest(capture.i_ab)
        if peak > max_a:
            excess = (
                "beyond any motor's current"
                if rated is None
                else f"{peak / rated:.3g} times the rated current, {rated:.3g} A peak"
            )
            self._refuse(
                f"{segment.id}: i_alpha, i_beta",
                f"{_place(capture.i_ab, peak)}: {peak:.4g} A, {excess}; a unit is wrong",
            )
        peak = _largest(capture.v_ab)
        if peak > POSSIBLE_BOUNDS.bus_voltages[1] * bus:
            excess = f"{peak / bus:.3g} times the bus voltage, {bus:g} V"
            self._refuse(
                f"{segment.id}: v_alpha, v_beta",
                f"{_place(capture.v_ab, peak)}: {peak:.4g} V, {excess}; a unit is wrong",
            )
        low, high = (limit * bus for limit in POSSIBLE_BOUNDS.bus)
        # With the bridge off the bus may be off too.
        low = 0.0 if segment.stage is SegmentStage.GATES_OFF else low
        measured = float(np.median(capture.v_dc[::16]))  # a sixteenth of the samples suffices
        if not low <= measured <= high:
            problem = f"{measured:.4g} V (median) on a nominal bus of {bus:g} V; a unit is wrong"
            self._refuse(f"{segment.id}: v_dc", problem)
        peak = float(np.max(capture.v_dc, initial=0.0))
        if peak > high:
            row = int(np.argmax(capture.v_dc))
            problem = f"sample {row}: {peak:.4g} V on a nominal bus of {bus:g} V, which is impossible"
            self._refuse(f"{segment.id}: v_dc", problem)

    def _check_polarity_and_resistance(self, seen: Sequence[_SegmentStatistics]) -> None:
        i2 = sum(x.i_squared for x in seen)
        motor = self.manifest.motor
        least = 0.05 * max(motor.rated_current_a or 0.0, *(x.current_a for x in seen))
        # Offsets of the sensors and of the inverter may have any angle to each other.
        usable = [x for x in seen if x.v_squared > (MIN_SLOW_VOLTAGE_RATIO * x.voltage_v) ** 2 and x.i_squared > 0.0]
        if not usable or math.sqrt(i2 / len(seen)) < least:
            return
        least_ohm = MIN_OHMIC_RATIO * (motor.stator_resistance_ohm or 0.0)
        driven = [x for x in usable if x.v_squared > least_ohm**2 * x.i_squared]
        # Each voltage is scaled to its current: a segment in which the drive lost control counts once.
        product = sum((x.v_on_i * math.sqrt(x.i_squared / x.v_squared) for x in driven), 0j)
        driven_a2, usable_a2 = (sum(x.i_squared for x in those) for those in (driven, usable))
        angle = suspicious_phase_rad(product, driven_a2, driven_a2)
        if angle is not None:
            problem = f"voltage and current are {abs(math.degrees(angle)):.0f} degrees apart, but a winding takes power"
            hint = "one of both is reversed" if is_reversed(angle) else "phases are exchanged, or frames differ"
            self._refuse("v_alpha, v_beta against i_alpha, i_beta", f"{problem}: {hint}")
        large = [x for x in usable if x.i_squared >= usable_a2 / len(usable)]
        nameplate, ohm = motor.stator_resistance_ohm, float(np.median([x.v_on_i.real / x.i_squared for x in large]))
        if nameplate is None or within(ohm, POSSIBLE_BOUNDS.resistance, nameplate):
            return
        problem = f"{ohm:.3g} ohm, where the nameplate has {nameplate:g} ohm: a unit is wrong"
        self._refuse("v_alpha, v_beta over i_alpha, i_beta", problem)

    def _check_inductance(self, seen: Sequence[_SegmentStatistics]) -> None:
        i2, v2, product = (sum(x.steps[k] for x in seen) for k in range(3))
        if i2 == 0.0 or v2 == 0.0 or abs(product) < 0.2 * math.sqrt(i2 * v2):
            return
        where = "ripple of v_alpha, v_beta and i_alpha, i_beta"
        if product < -0.5 * math.sqrt(i2 * v2):
            self._refuse(where, "the current falls where the voltage drives it up: one is reversed, or far too late")
        motor = self.manifest.motor
        if product < 0.0 or motor.d_inductance_h is None or motor.q_inductance_h is None:
            return
        henry, nameplate = v2 / product, math.sqrt(motor.d_inductance_h * motor.q_inductance_h)
        if not within(henry, POSSIBLE_BOUNDS.inductance, nameplate):
            problem = f"an inductance of {henry:.3g} H, where the nameplate has {nameplate:.3g} H"
            self._refuse(where, f"{problem}; a unit, or the sampling frequency, is wrong")

    def _refuse(self, field: str, problem: str) -> None:
        raise NotMeasuredError(self.manifest.name, field, problem)


def _check_manifest(manifest: Manifest) -> None:
    for name, problem in outside(manifest.motor.model_dump(), MOTOR_RANGES, "no motor has that"):
        raise RecordingError(manifest.name, f"motor.{name}", problem)
    for name, problem in outside(manifest.drive.model_dump(), DRIVE_RANGES, "no drive does that"):
        raise RecordingError(manifest.name, f"drive.{name}", problem)
    for segment in manifest.segments:
        if abs(segment.start_s) > 1e8:  # three years
            problem = f"{segment.start_s:g} s; expected seconds since the start of the experiment"
            raise RecordingError(manifest.name, f"segments.{segment.id}.start_s", problem)
        _check_settings(manifest.name, segment)


def _check_settings(name: str, segment: Segment) -> None:
    settings: Mapping[str, object] = segment.settings
    for key in (*_RATES, *_TARGETS):
        value = settings.get(key)
        if value is None:
            continue
        field = f"segments.{segment.id}.settings.{key}"
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise RecordingError(name, field, f"expected a number, got {value!r}"[:120])
        if abs(value) > 1e9 or (key in _RATES and value < 0):
            raise RecordingError(name, field, f"{value!r} is impossible"[:120])


def _largest(x: Numbers) -> float:
    """Size of the largest component of vectors (n, 2)."""
    return max(float(x.max()), -float(x.min()))


def _place(x: Numbers, size: float) -> str:
    return f"sample {int(np.argmax(np.abs(x).max(axis=1) >= size))}"


def _statistics(segment: Segment, capture: Capture, late: float) -> _SegmentStatistics:
    current, voltage = _largest(capture.i_ab), _largest(capture.v_ab)
    if segment.stage not in _MEASURING:
        return _SegmentStatistics(current, voltage)
    fs = capture.sampling_frequency_hz
    i, v = (np.asarray(slow_part(x, fs), dtype=np.float64) @ [1.0, 1j] for x in (capture.i_ab, capture.v_ab))
    steps = _steps(capture, round(late)) if segment.stage is SegmentStage.INJECTION else (0.0, 0.0, 0.0)
    powers = (np.vdot(x, y) / len(i) for x, y in ((i, i), (v, v), (i, v)))
    i_squared, v_squared, v_on_i = powers
    return _SegmentStatistics(current, voltage, float(i_squared.real), float(v_squared.real), complex(v_on_i), steps)


def _steps(capture: Capture, late: int, samples: int = 4000) -> tuple[float, float, float]:
    """Sums over the steps of the ripple in the first samples, some hundred periods."""
    i = np.asarray(capture.i_ab[:samples], dtype=np.float64)
    v = np.asarray(capture.v_ab[: len(i)], dtype=np.float64)
    if len(i) < late + 3:
        return 0.0, 0.0, 0.0
    di = np.diff(i, axis=0)[late:]
    dv = (v - v.mean(axis=0))[: len(di)] / capture.sampling_frequency_hz
    return float(np.sum(di * di)), float(np.sum(dv * dv)), float(np.sum(di * dv))

"""Whether a recording has enough information to name a cause, and which effects it cannot separate."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

import numpy as np

from orchestrator.diagnosis.selection.contrasts import MIN_AMPLITUDE_RATIO, SAME_CURRENT
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import MIN_SAMPLES_PER_TEST_FUNCTION, PreparedRecording, SegmentData
from orchestrator.formatting.quantities import plural
from orchestrator.numerics.types import Array
from protocols import NotMeasuredError, RecordingReader, Remark, SegmentStage

MIN_CURRENT: float = 0.02
"""Largest current required, relative to the rated one."""
MIN_CURRENT_SIGMAS: float = 5.0
"""Largest current required, in standard deviations of a reading."""
MIN_HOLD_S: float = 0.01
"""Minimum length of an informative hold [s]."""
MIN_EQUATIONS: int = 10
"""Minimum number of equations of an informative sweep or injection."""
MIN_OPERATING_POINTS: int = 6
"""Number of operating points below which no cause can be named: fewer than the simplest map's unknowns."""
OPERATING_POINTS_PER_SWEEP: int = 2
"""Operating points of a sweep, one on each side; a hold or an injection has one."""

_Reader = TypeVar("_Reader", bound=RecordingReader)
_More = ParamSpec("_More")
_Result = TypeVar("_Result")


_SWEEPS = (SegmentStage.CLASSICAL, SegmentStage.STEPS)
"""Stages that sweep the current."""


def require_enough(prepared: PreparedRecording, noise: SensorNoise) -> None:
    """Refuse a recording that is sampled too slowly, has no excitation, or has too few operating points.

    Raises
    ------
    NotMeasuredError
        With the value of the recording, and the value required.
    """
    cutting = prepared.criteria.weak_form
    fs = prepared.manifest.drive.sampling_frequency_hz
    min_hz = MIN_SAMPLES_PER_TEST_FUNCTION / cutting.hat_s
    if fs < min_hz:
        problem = f"{fs:g} Hz is too slow for a diagnosis; expected {min_hz:g} Hz at least"
        raise NotMeasuredError(prepared.manifest.name, "drive.sampling_frequency_hz", problem)
    low, high, q = prepared.current_range
    reach = max(-low, high, q)
    spread = math.sqrt(float(np.trace(noise.covariance)))
    rated = prepared.manifest.motor.rated_current_a or 0.0
    if reach < max(MIN_CURRENT * rated, MIN_CURRENT_SIGMAS * spread):
        problem = f"no excitation: currents stay below {reach:.3g} A"
        raise NotMeasuredError(prepared.manifest.name, "i_alpha, i_beta", problem)
    if (points := _operating_points(prepared)) < MIN_OPERATING_POINTS:
        used = [p for p in prepared.pieces if p.stage is not SegmentStage.GATES_OFF]
        sweeps = MIN_OPERATING_POINTS // 2
        expected = f"{MIN_OPERATING_POINTS} holds or injections at different currents, or {sweeps} sweeps"
        problem = (
            f"{len(used)} segments, {sum(map(_seconds, used)):.3g} s in all, show {plural(points, 'operating point')}: "
            f"too few to name a cause; expected {expected}"
        )
        raise NotMeasuredError(prepared.manifest.name, "segments", problem)


def solvable(work: Callable[Concatenate[_Reader, _More], _Result]) -> Callable[Concatenate[_Reader, _More], _Result]:
    """Decorator of functions of a recording: equations without a solution raise a `NotMeasuredError`.

    Raises
    ------
    NotMeasuredError
        From the linear algebra's exception.
    """

    @wraps(work)
    def guarded(recording: _Reader, /, *more: _More.args, **named: _More.kwargs) -> _Result:
        try:
            return work(recording, *more, **named)
        except (np.linalg.LinAlgError, ZeroDivisionError) as error:
            hint = "check nameplate, units, sampling frequency and any effect of your own"
            problem = f"its equations have no solution ({error}): {hint}"
            raise NotMeasuredError(recording.manifest.name, "", problem) from error

    return guarded


def _operating_points(prepared: PreparedRecording) -> int:
    """Number of distinct operating points with enough data."""
    low, high, q = prepared.current_range
    same_a = SAME_CURRENT * max(-low, high, q)
    covered = [p for p in prepared.pieces if p.stage is not SegmentStage.GATES_OFF and _is_informative(p, same_a)]
    return sum(OPERATING_POINTS_PER_SWEEP * _sweeps(p, same_a) or 1 for p in _distinct_segments(covered, same_a))


def _sweeps(piece: SegmentData, same_a: float) -> int:
    """Number of parallel sweeps of a segment, at distinct currents across; 0 for other stages."""
    if piece.stage not in _SWEEPS:
        return 0
    # Across its direction, a single sweep has only the width of its noise.
    across = math.sqrt(max(float(np.linalg.eigvalsh(np.cov(piece.signals.i_ab.T))[0]), 0.0))
    return 1 + int(across / same_a)


def _seconds(piece: SegmentData) -> float:
    return len(piece.signals.v_dc) / piece.signals.sampling_frequency_hz


def _is_informative(piece: SegmentData, same_a: float) -> bool:
    """Whether a segment is long enough and, if it is a hold, has settled."""
    if piece.stage is not SegmentStage.RESISTANCE:
        return piece.windows.rows >= MIN_EQUATIONS
    i = piece.signals.i_ab
    half, last = len(i) // 2, len(i) // 4
    moved = i[half:-last].mean(axis=0) - i[-last:].mean(axis=0)
    return _seconds(piece) >= MIN_HOLD_S and float(np.abs(moved).max()) < same_a


def _distinct_segments(pieces: Sequence[SegmentData], same_a: float) -> list[SegmentData]:
    """Segments whose mean or swing of the current differs from all earlier ones."""
    different: list[SegmentData] = []
    marks: list[Array] = []
    for piece in pieces:
        i = piece.signals.i_ab
        mark = np.concatenate([i.mean(axis=0), i.std(axis=0)])
        if all(float(np.abs(mark - other).max()) > same_a for other in marks):
            different.append(piece)
            marks.append(mark)
    return different


def missing_contrasts(prepared: PreparedRecording) -> list[Remark]:
    """Remarks on effects that this recording cannot separate, independent of any fit."""
    missing: list[Remark] = []

    def add(code: str, text: str, **values: float) -> None:
        missing.append(Remark.of(code, text, **values))

    stages = {p.stage for p in prepared.pieces}
    if (points := _operating_points(prepared)) < prepared.criteria.selection.few_views:
        add(
            "few_places",
            "with so few operating points ({places}), one unknown effect may look like several known ones",
            places=points,
        )
    if not stages & {*_SWEEPS, SegmentStage.INJECTION}:
        add("nothing_moves", "no sweep and no injection: flux and inductance cannot be seen, only the resistance")
    elif not stages & {*_SWEEPS}:
        add("no_sweep", "no sweep: hysteresis is hard to tell from eddy currents, and a yielding brake from a lag")
    if SegmentStage.RESISTANCE not in stages:
        add(
            "no_holds",
            "no holds: resistance, its drift and the inverter's errors rest on what moves, and are less sure",
        )
    if SegmentStage.GATES_OFF not in stages:
        add("no_gates_off", "no gates-off reading: a current offset and a voltage bias cannot be separated")
    if len({p.signals.pwm_frequency_hz for p in prepared.pieces if p.stage is SegmentStage.RESISTANCE}) < 2:
        add("one_pwm_frequency", "one PWM frequency only: dead time and device drop cannot be separated")
    amplitudes = {round(_swing(p), 1) for p in prepared.pieces if p.stage is SegmentStage.INJECTION}
    if not amplitudes and SegmentStage.STEPS in stages:
        pass  # the edges of steps show what a ripple would
    elif not amplitudes:
        add("no_injection", "no injection: effects of the ripple (delay, skin effect, eddy currents) cannot be seen")
    elif max(amplitudes) < MIN_AMPLITUDE_RATIO * min(amplitudes):
        add("one_amplitude", "one injection amplitude only: eddy currents and hysteresis would be hard to tell apart")
    if prepared.manifest.motor.pm_flux_wb is None:
        add(
            "no_magnet_flux",
            "no magnet flux on the nameplate: a yielding brake cannot be separated from q-axis inductance",
        )
    return missing


def _swing(piece: SegmentData) -> float:
    return float(np.linalg.norm(np.std(piece.signals.v_ab, axis=0)))

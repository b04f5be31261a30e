"""Stator resistance from constant currents: DC holds, and the rests of the classical sweeps for its drift.

Heating is told as a drift of readings, not modelled; a common gain of both kinds of sensor cannot be seen.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from orchestrator.analysis import COPPER_PER_K, Dwell, dwell, each_capture, find_dwells, temperature_rise
from plugins.estimators._inverter import VoltageFit, fit_voltage
from protocols import (
    EstimationContext,
    NotMeasuredError,
    RecordingReader,
    ResistanceEstimate,
    ResistanceReading,
    Segment,
    SegmentStage,
)

_SETTLING = 1 / 3  # share of a hold that is left out: foreign loggers begin before the current has settled


class ResistanceEstimator:
    """R_s as the slope of mean voltage over mean current, the inverter's step taken out.

    The value is that of the DC holds, with a 95 % interval from their scatter; readings over the whole recording
    show how it drifts.
    """

    name: ClassVar[str] = "resistance"
    summary: ClassVar[str] = "R_s from held direct currents, and its drift over the recording"
    produces: ClassVar[Literal["resistance", "flux_map"]] = "resistance"

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> ResistanceEstimate:
        """Estimate R_s; raises `NotMeasuredError` without a segment that rests at a current."""
        holds = _holds(recording)
        dwells = sorted([*holds, *_rests(recording)], key=lambda one: one[1].start_s)
        used = holds or dwells
        largest = max((float(np.linalg.norm(d.i_ab)) for _, d in used), default=0.0)
        if largest <= 0.0:
            problem = "no segment of stage resistance or classical in which a current rests"
            raise NotMeasuredError(recording.manifest.name, "segments", problem)
        pwm = {s.id: _pwm_hz(recording, s) for s, _ in dwells}
        fit = fit_voltage(
            np.array([d.i_ab for _, d in used]),
            np.array([d.v_ab for _, d in used]),
            np.array([d.start_s + 0.5 * d.seconds for _, d in used]),
            np.array([pwm[s.id] for s, _ in used]),
        )
        strong = [(s, d) for s, d in dwells if np.linalg.norm(d.i_ab) > 0.2 * largest]
        readings = tuple(_reading(fit, d, pwm[s.id]) for s, d in strong)
        half = _student_95(fit.freedom) * fit.std_ohm
        return ResistanceEstimate(
            value_ohm=fit.resistance_ohm,
            low=fit.resistance_ohm - half,
            high=fit.resistance_ohm + half,
            first_ohm=readings[0].value_ohm,
            last_ohm=readings[-1].value_ohm,
            readings=readings,
            notes=_notes(fit, [d for _, d in used], bool(holds), readings),
        )


def _holds(recording: RecordingReader) -> list[tuple[Segment, Dwell]]:
    delay = recording.manifest.drive.voltage_delay_samples or 0.0
    return each_capture(
        recording,
        recording.segments(SegmentStage.RESISTANCE),
        lambda s, c: (s, dwell(c, round(_SETTLING * len(c)), None, delay)),
    )


def _rests(recording: RecordingReader) -> list[tuple[Segment, Dwell]]:
    delay = recording.manifest.drive.voltage_delay_samples or 0.0
    sweeps = recording.segments(SegmentStage.CLASSICAL)
    found = each_capture(recording, sweeps, lambda s, c: find_dwells(c, s.rotor_angle_rad, delay))
    return [(s, d) for s, dwells in zip(sweeps, found, strict=True) for d in dwells]


def _pwm_hz(recording: RecordingReader, segment: Segment) -> float:
    own = segment.settings.get("pwm_frequency_hz")
    return float(own if own is not None else recording.manifest.drive.pwm_frequency_hz or 0.0)


def _reading(fit: VoltageFit, rest: Dwell, pwm_hz: float) -> ResistanceReading:
    length = float(np.linalg.norm(rest.i_ab))
    along = rest.i_ab / length
    voltage = fit.resistive(rest.i_ab[None], rest.v_ab[None], pwm_hz)[0]
    noise = float(np.sqrt(along @ rest.v_covariance @ along)) / length
    return ResistanceReading(
        start_s=rest.start_s, value_ohm=float(along @ voltage) / length, std_ohm=float(np.hypot(noise, fit.std_ohm))
    )


def _student_95(freedom: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))


def _notes(fit: VoltageFit, used: list[Dwell], held: bool, readings: tuple[ResistanceReading, ...]) -> tuple[str, ...]:
    notes = []
    if not held:
        notes.append("no DC holds: R_s is from the rests of the classical sweeps")
    if not fit.error_v:
        notes.append("too few different currents to tell R_s from the inverter's own voltage drop")
    largest = max(float(np.linalg.norm(d.i_ab)) for d in used)
    for pwm_hz, error in fit.error_v.items():
        if error > 0.01 * fit.resistance_ohm * largest:
            at = f" at {pwm_hz / 1e3:.3g} kHz" if pwm_hz else ""
            notes.append(f"the inverter keeps {error:.2f} V from each phase{at} (dead time or device drops); taken out")
    if fit.error_v and max(fit.error_v.values()) > 0.01 * fit.resistance_ohm * largest:
        notes.append(
            "what the inverter's devices lose in proportion to the current counts as R_s: nothing here tells them"
        )
    change = readings[-1].value_ohm / readings[0].value_ohm - 1.0
    rise = temperature_rise(readings)
    if rise is not None and abs(change) > max(0.02, 1.5 * (rise.high - rise.value) * COPPER_PER_K):
        notes.append(
            f"R_s changes by {100 * change:+.1f} % over the recording: the winding's temperature by {rise.value:+.0f} "
            f"(+-{max(rise.high - rise.value, 1.0):.0f}) K, if it is copper and started at 20 C"
        )
    return tuple(notes)

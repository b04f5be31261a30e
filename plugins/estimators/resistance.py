"""Stator resistance from constant currents: DC holds, the rests of the classical sweeps, and the means of injection.

Heating shows as a drift of readings and is not modelled; a common gain of both kinds of sensor is invisible.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orchestrator.analysis import (
    COPPER_PER_K,
    Dwell,
    KnownResistance,
    each_capture,
    find_dwells,
    known_resistance,
    mean_over_dwell,
    temperature_rise,
)
from orchestrator.numerics.types import Array
from plugins.estimators._inverter import VoltageFit, fit_voltage
from protocols import (
    Capture,
    Estimate,
    EstimationContext,
    NotMeasuredError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    ResistanceReading,
    Segment,
    SegmentStage,
)

_NEEDING = (SegmentStage.CLASSICAL, SegmentStage.STEPS, SegmentStage.SPIN)
"""Stages whose flux takes an R_s: where nothing rests in them, the nameplate's has to do."""


@dataclass(frozen=True)
class ResistanceEstimator:
    """R_s as the slope of mean voltage over mean current, the inverter's step taken out.

    R_s drifts as the winding heats up. `value_ohm` is its mean over the instants of the DC holds, or of the sweeps'
    rests where nothing was held, and the 95 % interval is that of this mean; where R_s was at other times the readings
    say, of which `first_ohm` and `last_ohm` are the first and the last. Currents of less than a fifth of the largest
    show the inverter, and are neither readings nor in the mean.

    Attributes
    ----------
    settling_ratio : float
        Part of a hold that is left out: foreign loggers begin before the current has settled.
    strong_current_ratio : float
        Current over the largest one, below which a hold shows the inverter instead of R_s.
    preheat_holds : float
        Longest time that a current flowed before its hold, in holds.
    max_injection_readings : int
        Most points of the injection that make readings: more add nothing about a drift.
    max_injection_s : float
        Longest part of each that is used [s].
    min_samples : int
        Fewest samples of a reading.
    shape_error_ratio : float
        Error of the inverter's shape in a ripple, over the noise of the holds.
    max_std_ratio : float
        Standard deviation of a reading over R_s, above which it is left out.
    pwm_tolerance_ratio : float
        Relative difference within which PWM frequencies count as one.
    max_loss_ratio, max_loss_v : float
        Of the bus, and beside it [V]: what each phase may lose where nothing here tells (two microseconds of dead time
        at 10 kHz, and a device's drop).
    """

    settling_ratio: float = 1.0 / 3.0
    strong_current_ratio: float = 0.2
    preheat_holds: float = 2.0
    max_injection_readings: int = 60
    max_injection_s: float = 1.0
    min_samples: int = 100
    shape_error_ratio: float = 2.0
    max_std_ratio: float = 0.02
    pwm_tolerance_ratio: float = 0.01
    max_loss_ratio: float = 0.02
    max_loss_v: float = 1.0

    name: ClassVar[str] = "resistance"
    summary: ClassVar[str] = "R_s from held direct currents, and its drift over the recording"
    requires: ClassVar[tuple[type[Estimate], ...]] = ()
    produces: ClassVar[type[Estimate]] = ResistanceEstimate
    rank: ClassVar[int] = 0

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> ResistanceEstimate:
        """Estimate R_s; raises `NotMeasuredError` without a segment that rests at a current."""
        holds, rests = self._holds(recording), _rests(recording)
        used = holds or rests
        largest = max((float(np.linalg.norm(d.i_ab)) for _, d in used), default=0.0)
        known = known_resistance(recording.manifest.motor)
        if largest <= 0.0:
            if known is not None and recording.segments(*_NEEDING):
                return _as_known(known)
            problem = "no segment of stage resistance or classical in which a current rests"
            raise NotMeasuredError(recording.manifest.name, "segments", problem)
        fit = self._fit(recording, used)
        if not fit.error_v and not fit.unlike_step_v:
            used = sorted([*used, *self._means(recording)], key=lambda one: one[1].start_s)
            fit = self._fit(recording, used)
        strong = [(s, d) for s, d in (*holds, *rests) if np.linalg.norm(d.i_ab) > self.strong_current_ratio * largest]
        every = [_reading(fit, d, _pwm_hz(recording, s)) for s, d in strong]
        every += self._injected(recording, fit, self.strong_current_ratio * largest)
        readings = tuple(sorted(every, key=lambda reading: reading.start_s))
        if not readings or not np.isfinite(fit.resistance_ohm):
            raise NotMeasuredError(recording.manifest.name, "segments", "what was held determines no resistance")
        doubt_ohm = 0.0
        if not fit.error_v and not fit.unlike_step_v:
            lost_v = self.max_loss_ratio * recording.manifest.drive.dc_bus_voltage_v + self.max_loss_v
            # A loss of one volt in each phase is a vector of at most 4/3 V along the current.
            doubt_ohm = 4.0 / 3.0 * lost_v / largest
        value, low, high, beside = _with_known(known, fit, doubt_ohm)
        if fit.unlike_step_v:
            aside = 2.0 * fit.unlike_step_v / largest
            low, high = min(low, fit.with_step_ohm - aside), max(high, fit.with_step_ohm + aside)
        return ResistanceEstimate(
            value_ohm=value,
            low=low,
            high=high,
            first_ohm=readings[0].value_ohm,
            last_ohm=readings[-1].value_ohm,
            readings=readings,
            temperature_rise_k=temperature_rise(readings),
            inverter=tuple(fit.losses()),
            remarks=(*beside, *_remarks(fit, [d for _, d in used], bool(holds), readings, low)),
        )

    def constant_currents(self, recording: RecordingReader) -> list[Dwell]:
        """The stretches over whose instants `value_ohm` is the mean."""
        used = [d for _, d in self._holds(recording) or _rests(recording)]
        largest = max((float(np.linalg.norm(d.i_ab)) for d in used), default=0.0)
        return [d for d in used if np.linalg.norm(d.i_ab) > self.strong_current_ratio * largest]

    def _fit(self, recording: RecordingReader, used: list[tuple[Segment, Dwell]]) -> VoltageFit:
        return fit_voltage(
            np.array([d.i_ab for _, d in used]),
            np.array([d.v_ab for _, d in used]),
            np.array([d.start_s + 0.5 * d.seconds for _, d in used]),
            np.array([_pwm_hz(recording, s) for s, _ in used]),
            self._heat([d for _, d in used]),
            own_std_v=float(np.sqrt(np.median([np.trace(d.v_covariance) / 2.0 for _, d in used]))),
            strong_current_ratio=self.strong_current_ratio,
        )

    def _means(self, recording: RecordingReader) -> list[tuple[Segment, Dwell]]:
        """The means under injection, as if they had been held: where a current stands, the inverter keeps as much."""
        injected = recording.segments(SegmentStage.INJECTION)
        means = each_capture(recording, injected, lambda s, c: (s, self._mean(c)))
        return [(s, mean) for s, mean in means if mean is not None]

    def _holds(self, recording: RecordingReader) -> list[tuple[Segment, Dwell]]:
        delay = recording.manifest.drive.voltage_delay_samples or 0.0
        return each_capture(
            recording,
            recording.segments(SegmentStage.RESISTANCE),
            lambda s, c: (s, mean_over_dwell(c, round(self.settling_ratio * len(c)), None, delay)),
        )

    def _heat(self, dwells: list[Dwell]) -> Array:
        """Integral of the squared current up to the middle of each dwell, as far as it was seen.

        What flowed before a dwell, since the one before it, was its own current settling.
        """
        start, seconds = np.array([d.start_s for d in dwells]), np.array([d.seconds for d in dwells])
        squares = np.array([d.i_ab @ d.i_ab for d in dwells])
        before = np.diff(start, prepend=-np.inf) - np.concatenate([[0.0], seconds[:-1]])
        gained = squares * (np.clip(before, 0.0, self.preheat_holds * seconds) + seconds)
        return np.asarray(np.cumsum(gained) - 0.5 * squares * seconds)

    def _injected(self, recording: RecordingReader, fit: VoltageFit, least_a: float) -> list[ResistanceReading]:
        """Readings at some of the injection's points, as far as the inverter is known at their PWM frequency."""
        known = [
            s
            for s in recording.segments(SegmentStage.INJECTION)
            if any(abs(_pwm_hz(recording, s) - f) <= self.pwm_tolerance_ratio * f for f in fit.error_v)
        ]
        some = known[:: max(1, -(-len(known) // self.max_injection_readings))]
        means = each_capture(recording, some, lambda s, c: self._mean_reading(fit, c, _pwm_hz(recording, s), least_a))
        return [reading for reading in means if reading is not None]

    def _mean_reading(
        self, fit: VoltageFit, capture: Capture, pwm_hz: float, least_a: float
    ) -> ResistanceReading | None:
        """R_s of the means, in which the ripple cancels; what the inverter keeps follows it and is averaged too."""
        mean = self._mean(capture)
        if mean is None:
            return None
        i = capture.i_ab[len(capture) - round(mean.seconds * capture.sampling_frequency_hz) :].astype(np.float64)
        weight, mean_i = _fading(len(i)), mean.i_ab
        length = float(np.linalg.norm(mean_i))
        if length <= least_a:
            return None
        # Between two samples the current runs straight: Simpson's rule.
        middle = 0.5 * (i + np.concatenate([i[1:], i[-1:]]))
        lost = weight @ (fit.lost(i, pwm_hz) + 2.0 * fit.lost(middle, pwm_hz)) / 3.0
        along = mean_i / length
        std = float(np.hypot(self.shape_error_ratio * fit.noise_v, fit.lost_std(i, pwm_hz, along))) / length
        if std > self.max_std_ratio * fit.resistance_ohm:
            return None
        value = float(along @ (mean.v_ab - lost)) / length
        return ResistanceReading(start_s=mean.start_s, value_ohm=value, std_ohm=std)

    def _mean(self, capture: Capture) -> Dwell | None:
        """Means of an injection's last part, in which the ripple cancels; None where it is too short.

        They are taken behind a window that begins and ends at zero, so that whole periods are not needed.
        """
        rate = capture.sampling_frequency_hz
        first = max(round(self.settling_ratio * len(capture)), len(capture) - round(self.max_injection_s * rate))
        if len(capture) - first < self.min_samples:
            return None
        weight = _fading(len(capture) - first)
        i, v = (weight @ x[first:].astype(np.float64) for x in (capture.i_ab, capture.v_ab))
        return Dwell(capture.start_s + first / rate, len(weight) / rate, i, v, np.zeros((2, 2)))


def _fading(count: int) -> Array:
    """Weights of a mean that begin and end at nothing."""
    window = np.hanning(count + 2)[1:-1]
    return np.asarray(window / window.sum())


def _as_known(known: KnownResistance) -> ResistanceEstimate:
    """What was known beforehand, where nothing rests."""
    half = 1.96 * known.std_ohm
    text = "no current rests: R_s = {value_ohm:.4g} ohm is the nameplate's, believed to +-{half_percent:.2g} % (95 %)"
    if not known.is_measured:
        text += ", for it has no stator_resistance_std_ohm"
    values = {"value_ohm": known.value_ohm, "half_percent": 100.0 * half / known.value_ohm}
    return ResistanceEstimate(
        value_ohm=known.value_ohm,
        low=known.value_ohm - half,
        high=known.value_ohm + half,
        first_ohm=known.value_ohm,
        last_ohm=known.value_ohm,
        remarks=(Remark.of("as_known", text, **values),),
    )


def _with_known(
    known: KnownResistance | None, fit: VoltageFit, doubt_ohm: float, doubtful: float = 3.0
) -> tuple[float, float, float, list[Remark]]:
    """R_s of the holds, its 95 % interval, and remarks; what was measured before counts where both agree.

    `doubt_ohm` is what the inverter may have in it: R_s is then not less than a nameplate lets it be.
    """
    from scipy.special import stdtrit

    half = float(stdtrit(fit.freedom, 0.975)) * fit.std_ohm
    if known is None or not known.is_measured:
        least = 0.0 if known is None else min(fit.resistance_ohm, known.value_ohm - 1.96 * known.std_ohm)
        low = max(fit.resistance_ohm - doubt_ohm, least)
        return fit.resistance_ohm, min(low, fit.resistance_ohm) - half, fit.resistance_ohm + half, []
    std = float(np.hypot(half / 1.96, 0.5 * doubt_ohm))
    apart = known.apart(fit.resistance_ohm, std)
    if apart > doubtful:
        text = (
            "R_s is {apart:.0f} standard deviations off the {known_ohm:.4g} ohm that were known: is the winding warm?"
        )
        remark = Remark.of("off_the_known", text, apart=apart, known_ohm=known.value_ohm)
        return fit.resistance_ohm, fit.resistance_ohm - half, fit.resistance_ohm + half, [remark]
    value, std = known.with_measured(fit.resistance_ohm, std)
    return value, value - 1.96 * std, value + 1.96 * std, []


def _rests(recording: RecordingReader) -> list[tuple[Segment, Dwell]]:
    delay = recording.manifest.drive.voltage_delay_samples or 0.0
    sweeps = recording.segments(SegmentStage.CLASSICAL)
    dwells_of = each_capture(recording, sweeps, lambda s, c: find_dwells(c, s.rotor_angle_rad, delay))
    return [(s, d) for s, dwells in zip(sweeps, dwells_of, strict=True) for d in dwells]


def _pwm_hz(recording: RecordingReader, segment: Segment) -> float:
    own = segment.settings.get("pwm_frequency_hz")
    return float(own if own is not None else recording.manifest.drive.pwm_frequency_hz or 0.0)


def _reading(fit: VoltageFit, rest: Dwell, pwm_hz: float) -> ResistanceReading:
    length = float(np.linalg.norm(rest.i_ab))
    along = rest.i_ab / length
    voltage = fit.resistive(rest.i_ab[None], rest.v_ab[None], pwm_hz)[0]
    own = max(float(np.sqrt(along @ rest.v_covariance @ along)), fit.noise_v)
    std = np.hypot(own, fit.lost_std(rest.i_ab[None], pwm_hz, along)) / length
    return ResistanceReading(start_s=rest.start_s, value_ohm=float(along @ voltage) / length, std_ohm=float(std))


def _remarks(
    fit: VoltageFit, used: list[Dwell], held: bool, readings: tuple[ResistanceReading, ...], low: float
) -> tuple[Remark, ...]:
    remarks = []
    if not held:
        remarks.append(Remark.of("no_holds", "no DC holds: R_s is from the rests of the classical sweeps"))
    if fit.unlike_step_v:
        text = (
            "no dead time and no device drop explains the held voltages: {beside_v:.2g} V (rms) remain beside the best "
            "step, as of a bridge that leaves out short pulses; nothing is taken off, and R_s may be as little as "
            "{low_ohm:.3g} ohm; hold larger currents, or set a shorter minimum pulse"
        )
        remarks.append(Remark.of("unlike_inverter", text, beside_v=fit.unlike_step_v, low_ohm=low))
    elif not fit.error_v:
        text = (
            "too few different currents to tell R_s from what the inverter keeps: without that it may be as little as "
            "{low_ohm:.3g} ohm; hold three currents of different size, or inject"
        )
        remarks.append(Remark.of("few_currents", text, low_ohm=low))
    largest = max(float(np.linalg.norm(d.i_ab)) for d in used)
    # Of a loss that is not there something is left as well: within its own error it is not spoken of.
    least = 0.01 * fit.resistance_ohm * largest
    kept = [loss for loss in fit.losses() if loss.phase_v > max(least, 3.0 * loss.std_v)]
    for loss in kept:
        at = " at {pwm_khz:.3g} kHz" if loss.pwm_frequency_hz else ""
        text = f"the inverter keeps {{kept_v:.2f}} V from each phase{at} (dead time or device drops); taken out"
        remarks.append(Remark.of("inverter_loss", text, kept_v=loss.phase_v, pwm_khz=loss.pwm_frequency_hz / 1e3))
    if kept:
        text = "what the inverter's devices lose in proportion to the current counts as R_s: nothing here tells them"
        remarks.append(Remark.of("device_resistance", text))
    rise = temperature_rise(readings)
    change = 0.0 if rise is None else readings[-1].value_ohm / readings[0].value_ohm - 1.0
    if rise is not None and abs(change) > max(0.02, 1.5 * (rise.high - rise.value) * COPPER_PER_K):
        text = (
            "R_s changes by {change_percent:+.1f} % over the recording: the winding's temperature by {rise_k:+.0f} "
            "(+-{half_k:.0f}) K, if it is copper and started at 20 C"
        )
        figures = {"change_percent": 100 * change, "rise_k": rise.value, "half_k": max(rise.high - rise.value, 1.0)}
        remarks.append(Remark.of("drift", text, **figures))
    return tuple(remarks)

"""Stator resistance from constant currents: DC holds, dwells of the classical sweeps, and means of injection.

Heating appears as a drift of the readings and is not modelled. A common gain of both kinds of sensor is unobservable.
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

_STAGES_WITH_R_S = (SegmentStage.CLASSICAL, SegmentStage.STEPS, SegmentStage.SPIN)
"""Stages whose flux depends on R_s: without a dwell the nameplate's value is used."""


@dataclass(frozen=True)
class ResistanceEstimator:
    """R_s as the slope of mean voltage over mean current, corrected for the inverter's voltage step.

    R_s drifts as the winding heats up. `value_ohm` is its mean over the instants of the DC holds (without holds: of the
    sweeps' dwells), with the 95 % interval of this mean. The readings give R_s over time; `first_ohm` and `last_ohm`
    are the first and the last of them. Currents below a fifth of the largest are dominated by the inverter's loss and
    enter neither the readings nor the mean.

    Attributes
    ----------
    settling_ratio : float
        Initial share of a hold that is discarded, since external loggers may start before the current has settled.
    strong_current_ratio : float
        Current over the largest one, below which the inverter's loss dominates a hold.
    preheat_holds : float
        Longest time for which a current flowed before its hold, over the hold's duration.
    max_injection_readings : int
        Largest number of injection points that give readings; more do not improve the drift.
    max_injection_s : float
        Longest part of an injection point that is used [s].
    min_samples : int
        Smallest number of samples of a reading.
    shape_error_ratio : float
        Error of the inverter's step shape under ripple, over the noise of the holds.
    max_std_ratio : float
        Standard deviation of a reading over R_s, above which it is left out.
    pwm_tolerance_ratio : float
        Relative difference within which PWM frequencies count as one.
    max_loss_ratio, max_loss_v : float
        Assumed largest loss per phase where it cannot be identified: this share of the bus voltage (2 us of dead time
        at 10 kHz) plus this device drop [V].
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
        """Estimate R_s; raises `NotMeasuredError` without a segment that dwells at a constant current."""
        holds, sweep_dwells = self._holds(recording), _sweep_dwells(recording)
        used = holds or sweep_dwells
        largest = max((float(np.linalg.norm(d.i_ab)) for _, d in used), default=0.0)
        known = known_resistance(recording.manifest.motor)
        if largest <= 0.0:
            if known is not None and recording.segments(*_STAGES_WITH_R_S):
                return _nameplate_estimate(known)
            problem = "no segment of stage resistance or classical with a constant current"
            raise NotMeasuredError(recording.manifest.name, "segments", problem)
        fit = self._fit(recording, used)
        if not fit.error_v and not fit.unlike_step_v:
            used = sorted([*used, *self._means(recording)], key=lambda one: one[1].start_s)
            fit = self._fit(recording, used)
        strong_a = self.strong_current_ratio * largest
        strong = [(s, d) for s, d in (*holds, *sweep_dwells) if np.linalg.norm(d.i_ab) > strong_a]
        unsorted = [_reading(fit, d, _pwm_hz(recording, s)) for s, d in strong]
        unsorted += self._injected(recording, fit, strong_a)
        readings = tuple(sorted(unsorted, key=lambda reading: reading.start_s))
        if not readings or not np.isfinite(fit.resistance_ohm):
            raise NotMeasuredError(recording.manifest.name, "segments", "the constant currents do not determine R_s")
        unknown_loss_ohm = 0.0
        if not fit.error_v and not fit.unlike_step_v:
            lost_v = self.max_loss_ratio * recording.manifest.drive.dc_bus_voltage_v + self.max_loss_v
            # A loss of one volt in each phase is a vector of at most 4/3 V along the current.
            unknown_loss_ohm = 4.0 / 3.0 * lost_v / largest
        value, low, high, nameplate_remarks = _with_known(known, fit, unknown_loss_ohm)
        if fit.unlike_step_v:
            margin_ohm = 2.0 * fit.unlike_step_v / largest
            low, high = min(low, fit.with_step_ohm - margin_ohm), max(high, fit.with_step_ohm + margin_ohm)
        return ResistanceEstimate(
            value_ohm=value,
            low=low,
            high=high,
            first_ohm=readings[0].value_ohm,
            last_ohm=readings[-1].value_ohm,
            readings=readings,
            temperature_rise_k=temperature_rise(readings),
            inverter=tuple(fit.losses()),
            remarks=(*nameplate_remarks, *_remarks(fit, [d for _, d in used], bool(holds), readings, low)),
        )

    def constant_currents(self, recording: RecordingReader) -> list[Dwell]:
        """The dwells over whose instants `value_ohm` is the mean."""
        used = [d for _, d in self._holds(recording) or _sweep_dwells(recording)]
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
        """Means under injection, treated as holds: at a constant mean current the inverter's loss is the same."""
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
        """Integral of i^2 up to the middle of each dwell, where recorded; between dwells, of the next one's current."""
        start, seconds = np.array([d.start_s for d in dwells]), np.array([d.seconds for d in dwells])
        squares = np.array([d.i_ab @ d.i_ab for d in dwells])
        before = np.diff(start, prepend=-np.inf) - np.concatenate([[0.0], seconds[:-1]])
        gained = squares * (np.clip(before, 0.0, self.preheat_holds * seconds) + seconds)
        return np.asarray(np.cumsum(gained) - 0.5 * squares * seconds)

    def _injected(self, recording: RecordingReader, fit: VoltageFit, min_a: float) -> list[ResistanceReading]:
        """Readings at some injection points whose PWM frequency has an identified inverter loss."""
        known = [
            s
            for s in recording.segments(SegmentStage.INJECTION)
            if any(abs(_pwm_hz(recording, s) - f) <= self.pwm_tolerance_ratio * f for f in fit.error_v)
        ]
        selected = known[:: max(1, -(-len(known) // self.max_injection_readings))]
        means = each_capture(recording, selected, lambda s, c: self._mean_reading(fit, c, _pwm_hz(recording, s), min_a))
        return [reading for reading in means if reading is not None]

    def _mean_reading(self, fit: VoltageFit, capture: Capture, pwm_hz: float, min_a: float) -> ResistanceReading | None:
        """R_s of a point's mean voltage and current, corrected for the inverter's mean loss under the ripple."""
        mean = self._mean(capture)
        if mean is None:
            return None
        i = capture.i_ab[len(capture) - round(mean.seconds * capture.sampling_frequency_hz) :].astype(np.float64)
        weight, mean_i = _hann_weights(len(i)), mean.i_ab
        length = float(np.linalg.norm(mean_i))
        if length <= min_a:
            return None
        # The current is linear between two samples: Simpson's rule.
        middle = 0.5 * (i + np.concatenate([i[1:], i[-1:]]))
        lost = weight @ (fit.lost(i, pwm_hz) + 2.0 * fit.lost(middle, pwm_hz)) / 3.0
        along = mean_i / length
        std = float(np.hypot(self.shape_error_ratio * fit.noise_v, fit.lost_std(i, pwm_hz, along))) / length
        if std > self.max_std_ratio * fit.resistance_ohm:
            return None
        value = float(along @ (mean.v_ab - lost)) / length
        return ResistanceReading(start_s=mean.start_s, value_ohm=value, std_ohm=std)

    def _mean(self, capture: Capture) -> Dwell | None:
        """Means over an injection's last part, without the ripple; None where it is too short."""
        # A window that begins and ends at zero needs no whole periods.
        rate = capture.sampling_frequency_hz
        first = max(round(self.settling_ratio * len(capture)), len(capture) - round(self.max_injection_s * rate))
        if len(capture) - first < self.min_samples:
            return None
        weight = _hann_weights(len(capture) - first)
        i, v = (weight @ x[first:].astype(np.float64) for x in (capture.i_ab, capture.v_ab))
        return Dwell(capture.start_s + first / rate, len(weight) / rate, i, v, np.zeros((2, 2)))


def _hann_weights(count: int) -> Array:
    """Weights of a mean by a Hann window, shape (count,)."""
    window = np.hanning(count + 2)[1:-1]
    return np.asarray(window / window.sum())


def _nameplate_estimate(known: KnownResistance) -> ResistanceEstimate:
    """The nameplate's R_s as an estimate, for recordings without a constant current."""
    half = 1.96 * known.std_ohm
    text = "no constant current: R_s = {value_ohm:.4g} ohm is the nameplate's, with +-{half_percent:.2g} % (95 %)"
    if not known.is_measured:
        text += " assumed, since it states no stator_resistance_std_ohm"
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
    known: KnownResistance | None, fit: VoltageFit, unknown_loss_ohm: float, max_sigmas: float = 3.0
) -> tuple[float, float, float, list[Remark]]:
    """R_s of the holds, combined with a measured nameplate value that agrees; 95 % interval and remarks."""
    # `unknown_loss_ohm` is the largest share of an unidentified inverter loss; the nameplate bounds R_s from below.
    from scipy.special import stdtrit

    half = float(stdtrit(fit.freedom, 0.975)) * fit.std_ohm
    if known is None or not known.is_measured:
        min_loss_v = 0.0 if known is None else min(fit.resistance_ohm, known.value_ohm - 1.96 * known.std_ohm)
        low = max(fit.resistance_ohm - unknown_loss_ohm, min_loss_v)
        return fit.resistance_ohm, min(low, fit.resistance_ohm) - half, fit.resistance_ohm + half, []
    std = float(np.hypot(half / 1.96, 0.5 * unknown_loss_ohm))
    sigmas = known.apart(fit.resistance_ohm, std)
    if sigmas > max_sigmas:
        text = "R_s is {apart:.0f} standard deviations off the nameplate's {known_ohm:.4g} ohm: is the winding warm?"
        remark = Remark.of("off_the_known", text, apart=sigmas, known_ohm=known.value_ohm)
        return fit.resistance_ohm, fit.resistance_ohm - half, fit.resistance_ohm + half, [remark]
    value, std = known.with_measured(fit.resistance_ohm, std)
    return value, value - 1.96 * std, value + 1.96 * std, []


def _sweep_dwells(recording: RecordingReader) -> list[tuple[Segment, Dwell]]:
    delay = recording.manifest.drive.voltage_delay_samples or 0.0
    sweeps = recording.segments(SegmentStage.CLASSICAL)
    dwells_of = each_capture(recording, sweeps, lambda s, c: find_dwells(c, s.rotor_angle_rad, delay))
    return [(s, d) for s, dwells in zip(sweeps, dwells_of, strict=True) for d in dwells]


def _pwm_hz(recording: RecordingReader, segment: Segment) -> float:
    explicit = segment.settings.get("pwm_frequency_hz")
    return float(explicit if explicit is not None else recording.manifest.drive.pwm_frequency_hz or 0.0)


def _reading(fit: VoltageFit, hold: Dwell, pwm_hz: float) -> ResistanceReading:
    length = float(np.linalg.norm(hold.i_ab))
    along = hold.i_ab / length
    voltage = fit.resistive(hold.i_ab[None], hold.v_ab[None], pwm_hz)[0]
    noise_v = max(float(np.sqrt(max(float(along @ hold.v_covariance @ along), 0.0))), fit.noise_v)
    std = np.hypot(noise_v, fit.lost_std(hold.i_ab[None], pwm_hz, along)) / length
    return ResistanceReading(start_s=hold.start_s, value_ohm=float(along @ voltage) / length, std_ohm=float(std))


def _remarks(
    fit: VoltageFit, used: list[Dwell], held: bool, readings: tuple[ResistanceReading, ...], low: float
) -> tuple[Remark, ...]:
    remarks = []
    if not held:
        remarks.append(Remark.of("no_holds", "no DC holds: R_s is from the constant currents of the classical sweeps"))
    if fit.unlike_step_v:
        text = (
            "neither dead time nor device drops explain the held voltages: {beside_v:.2g} V (rms) remain with the best "
            "step, as with a bridge that drops short pulses; no loss is subtracted, and R_s may be as low as "
            "{low_ohm:.3g} ohm; hold larger currents, or set a shorter minimum pulse"
        )
        remarks.append(Remark.of("unlike_inverter", text, beside_v=fit.unlike_step_v, low_ohm=low))
    elif not fit.error_v:
        text = (
            "too few different currents to separate R_s from the inverter's loss: R_s may be as low as "
            "{low_ohm:.3g} ohm; hold three currents of different size, or inject"
        )
        remarks.append(Remark.of("few_currents", text, low_ohm=low))
    largest = max(float(np.linalg.norm(d.i_ab)) for d in used)
    # The estimate of a zero loss is not exactly zero: a loss within its error gets no remark.
    min_loss_v = 0.01 * fit.resistance_ohm * largest
    significant = [loss for loss in fit.losses() if loss.phase_v > max(min_loss_v, 3.0 * loss.std_v)]
    for loss in significant:
        at = " at {pwm_khz:.3g} kHz" if loss.pwm_frequency_hz else ""
        text = f"each phase loses {{kept_v:.2f}} V in the inverter{at}; corrected"
        remarks.append(Remark.of("inverter_loss", text, kept_v=loss.phase_v, pwm_khz=loss.pwm_frequency_hz / 1e3))
    if significant:
        text = "R_s includes the on-state resistance of the inverter's devices, which cannot be separated here"
        remarks.append(Remark.of("device_resistance", text))
    rise = temperature_rise(readings)
    change = 0.0 if rise is None else readings[-1].value_ohm / readings[0].value_ohm - 1.0
    if rise is not None and abs(change) > max(0.02, 1.5 * (rise.high - rise.value) * COPPER_PER_K):
        text = (
            "R_s changes by {change_percent:+.1f} % over the recording, hence the winding temperature by {rise_k:+.0f} "
            "(+-{half_k:.0f}) K for copper, assuming 20 °C at the start"
        )
        figures = {"change_percent": 100 * change, "rise_k": rise.value, "half_k": max(rise.high - rise.value, 1.0)}
        remarks.append(Remark.of("drift", text, **figures))
    return tuple(remarks)

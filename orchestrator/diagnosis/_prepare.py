"""Preparation of a diagnosis: the recording is read and checked, and its noise estimated."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.progress import Budget, SearchRecorder
from orchestrator.diagnosis.judgement.sufficiency import missing_contrasts, require_enough
from orchestrator.diagnosis.reporting.motor_model import flux_of, with_noise_of
from orchestrator.diagnosis.weak_form.noise import SensorNoise, sensor_noise
from orchestrator.diagnosis.weak_form.preparation import coarse, prepare
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData
from orchestrator.numerics.frames import to_dq, to_phases
from orchestrator.numerics.lattice import step_of
from orchestrator.numerics.types import Array
from orchestrator.numerics.zero_sequence import gains_of
from orchestrator.recording._recording_checks import SoundRecording
from orchestrator.recording_checks import check_recording
from protocols import RecordingReader, Remark, Saturated, SegmentStage, Signals
from protocols.fleet_priors import FleetPriors

MAX_RATED_CURRENT_FACTOR: float = 2.0
"""Factor of the largest current used that limits the rated current as the scale of the map's smoothness."""
MIN_RIPPLE_NOISE_RATIO: float = 1.1
"""Ratio of the readings' scatter under injection to that at rest from which a remark is made."""


def open_for_diagnosis(
    recording: RecordingReader,
    poll: Callable[[], None] = lambda: None,
    criteria: Criteria | None = None,
    *,
    pm_flux_wb: float | None = None,
    fleet: FleetPriors | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> DiagnosisSetup:
    """Read a recording and estimate its noise; an exception from `poll` ends any fit of it.

    Parameters
    ----------
    pm_flux_wb : float, optional
        Magnet flux of the model compared with the recording; the nameplate's by default.
    fleet : FleetPriors, optional
        Priors from other motors of this type on R_s and on the inductances at zero current.

    Raises
    ------
    RecordingError
        If the manifest or a capture is invalid.
    NotMeasuredError
        If currents and voltages cannot be a motor's, or are too few to be diagnosed.
    """
    criteria = criteria or Criteria()
    watched = SoundRecording(recording)
    prepared = prepare(watched, criteria)
    watched.conclude()
    noise = sensor_noise(prepared.pieces)
    prepared = replace(
        prepared, pieces=tuple(noise.with_quiet_current(piece) for piece in prepared.pieces), fleet=fleet
    )
    require_enough(prepared, noise)
    remarks = [
        *prepared.remarks,
        *missing_contrasts(prepared),
        *_noise_remarks(noise),
        *rounding_remarks(prepared.pieces, noise),
        *_gain_remarks([p.signals for p in prepared.pieces]),
    ]
    return with_carrier_ripple(setup_of(prepared, noise, pm_flux_wb=pm_flux_wb, remarks=remarks, poll=poll, tell=tell))


def open_for_refit(
    recording: RecordingReader, model: object, tell: Callable[[str], None] = lambda _: None
) -> DiagnosisSetup:
    """The setup for fitting a model to a recording, with the model-error noise of a whole model.

    Its first remarks are inconsistent metadata, which make any fit doubtful, then R and L unlike the nameplate's.
    """
    tell("checking signs, units and axes of the recording")
    checked = check_recording(recording)
    tell("estimating the noise")
    setup = with_noise_of(open_for_diagnosis(recording, pm_flux_wb=flux_of(model), tell=tell), model)
    return replace(setup, remarks=(*checked.all_remarks, *setup.remarks))


def setup_of(
    prepared: PreparedRecording,
    noise: SensorNoise,
    *,
    pm_flux_wb: float | None = None,
    remarks: Sequence[Remark] = (),
    poll: Callable[[], None] = lambda: None,
    tell: Callable[[str], None] = lambda _: None,
) -> DiagnosisSetup:
    """The setup of a diagnosis of prepared signals with a known noise."""
    motor, criteria = prepared.manifest.motor, prepared.criteria
    low, high, q = prepared.current_range
    reach = max(-low, high, q)
    # Current scale of the map's smoothness: the rated one is too large where little of the plane was measured.
    current = min(motor.rated_current_a or reach, MAX_RATED_CURRENT_FACTOR * reach)
    l_d = motor.d_inductance_h or _rough_inductance(prepared)
    l_q = motor.q_inductance_h or l_d
    samples = sum(len(p.signals.v_dc) for p in prepared.pieces)
    budget = Budget(max(criteria.fitting.most_effort, criteria.fitting.most_effort_per_sample * samples))
    flux = (motor.pm_flux_wb or 0.0) if pm_flux_wb is None else pm_flux_wb
    trace = SearchRecorder(budget, samples)
    fitter = Fitter(prepared, noise, flux, budget=budget, poll=poll, tell=tell, trace=trace)
    part = coarse(prepared)
    search = Fitter(part, noise, fitter.pm_flux_wb, budget=budget, poll=poll, tell=tell, trace=trace.of_part())
    return DiagnosisSetup(prepared, fitter, search, l_d, l_q, current, tuple(remarks))


def _noise_remarks(noise: SensorNoise) -> list[Remark]:
    """Remarks on unusual noise of the current readings, all of which the noise model includes."""
    remarks = []
    if noise.correlation != 0.0:
        text = "the current readings' noise is correlated, {correlation:.2f} from one to the next"
        remarks.append(Remark.of("noise_correlated", text, correlation=noise.correlation))
    ratio = math.sqrt(float(np.trace(noise.ripple)) / float(np.trace(noise.covariance)))
    if ratio > MIN_RIPPLE_NOISE_RATIO:
        text = "the current readings scatter {ratio:.1f} times as much under injection (jitter or PWM ripple)"
        remarks.append(Remark.of("noise_under_injection", text, ratio=ratio))
    for line in noise.lines:
        kind = "switching ripple in the samples" if line.switching else "periodic disturbance"
        size = {"amplitude_ma": 1e3 * math.sqrt(2.0 * line.power), "frequency_hz": line.frequency_hz}
        text = "{kind}: {amplitude_ma:.2g} mA at {frequency_hz:.4g} Hz in the holds"
        remarks.append(Remark.of("periodic", text, kind=kind, **size))
    return remarks


def _gain_remarks(signals: Sequence[Signals]) -> list[Remark]:
    """Remarks on unequal sensor gains, where the sum of three phase currents shows them significantly."""
    gains = gains_of(signals)
    if gains is None or all(gains.differ(pair) is None for pair in ((1, -1, 0), (0, 1, -1), (1, 0, -1))):
        return []
    text = (
        "the three currents do not add up to zero: by their sum, sensors a, b, c read {a_percent:+.2f}, "
        "{b_percent:+.2f}, {c_percent:+.2f} % off their mean"
    )
    a, b, c = (100.0 * float(value) for value in gains.off_mean)
    return [Remark.of("gains_by_sum", text, a_percent=a, b_percent=b, c_percent=c)]


def _rough_inductance(prepared: PreparedRecording) -> float:
    """Flux swing over current swing of the most strongly excited segment, by plain integration [H]."""
    best, ratio = 0.0, 0.01
    for piece in prepared.pieces:
        s = piece.signals
        di = np.diff(s.i_ab, axis=0)
        dv = (s.v_ab - s.v_ab.mean(axis=0))[:-1] / s.sampling_frequency_hz
        power = float(np.sum(di * di))
        together = float(np.sum(di * dv))
        if together > best and power > 0.0:
            best, ratio = together, float(np.sum(dv * dv)) / together
    return ratio


MIN_RESISTIVE_RIPPLE: float = 0.02
"""R_s over the inductance, times the carrier's period, from which R_s is included in the ripple within a period: the
ripple's effect is its square over 24, and 2e-5 of the voltage is the smallest that recordings resolve."""


def with_carrier_ripple(setup: DiagnosisSetup) -> DiagnosisSetup:
    """The setup with switching ripple, where it matters and does not worsen the fit of the map alone."""
    drive, ohm = setup.prepared.manifest.drive, setup.prepared.manifest.motor.stator_resistance_ohm or 0.0
    period_s = 1.0 / (drive.pwm_frequency_hz or drive.sampling_frequency_hz)
    if ohm * period_s <= MIN_RESISTIVE_RIPPLE * min(setup.l_d_h, setup.l_q_h):
        return setup
    rippling = setup.with_ripple(ripples=True)
    plain, other = (one.part_fitter.fit(baseline_model(one, Saturated())) for one in (setup, rippling))
    threshold = 2.0 * plain.criteria.selection.log_evidence * max(plain.chi2_per_dof, 1.0)
    return setup if other.objective - plain.objective > threshold else rippling


FIRST_NUMBERS_CHECKED = 2000
"""Number of values of a log that are checked first."""
MIN_ROUNDING_VARIANCE_RATIO = 0.1
"""Rounding variance over the noise's in an equation from which a remark is made."""


def rounding_remarks(pieces: Sequence[SegmentData], noise: SensorNoise) -> list[Remark]:
    """Remarks on voltages and currents that were logged in steps too large for a diagnosis."""
    remarks, used = [], [p for p in pieces if p.stage is not SegmentStage.GATES_OFF]
    volts = logged_step(used, lambda piece: piece.command_ab)
    if (
        volts is not None
        and max(_rounding_variance_ratio(piece, noise, volts) for piece in used) > MIN_ROUNDING_VARIANCE_RATIO
    ):
        text = (
            "voltages are logged in steps of {step_v:.3g} V: where the drive's own are finer, that rounding shows "
            "beside the noise, and may be reported as unknown; log more decimals"
        )
        remarks.append(Remark.of("rounded_voltages", text, step_v=volts))
    amperes = logged_step(used, lambda piece: piece.current_ab)
    if amperes is not None and amperes > 2.0 * math.sqrt(0.5 * float(np.trace(noise.covariance))):
        text = (
            "currents are logged in steps of {step_a:.3g} A, more than they scatter by: rounding that no noise dithers "
            "is no noise, and may be reported as unknown; log more decimals"
        )
        remarks.append(Remark.of("rounded_currents", text, step_a=amperes))
    return remarks


def logged_step(pieces: Sequence[SegmentData], read: Callable[[SegmentData], Array]) -> float | None:
    """The step of a log as (alpha, beta), in the rotor's frame or as phases; None where it has none.

    Differences of two phases keep the phases' step, for vectors from two or three readings. Phases computed from a
    vector have lost the zero sequence and are multiples of a third of the step.
    """
    frames: tuple[Callable[[SegmentData], Array], ...] = (
        read,
        lambda piece: to_dq(read(piece), piece.segment.rotor_angle_rad),
        lambda piece: _between_phases(read(piece)),
    )
    busiest = max(
        pieces,
        key=lambda piece: float(np.abs(np.diff(read(piece)[:FIRST_NUMBERS_CHECKED], axis=0)).sum()),
        default=None,
    )
    for frame in frames:
        if busiest is None or step_of(frame(busiest)[:FIRST_NUMBERS_CHECKED].ravel()) is None:
            continue
        step = step_of(np.concatenate([frame(piece).ravel() for piece in pieces]))
        if step is not None:
            return step
    return None


def _between_phases(x_ab: Array) -> Array:
    """a - c, b - a and c - b of vectors (n, 2), shape (n, 3)."""
    phases = to_phases(x_ab)
    return np.asarray(phases - np.roll(phases, 1, axis=1))


def _rounding_variance_ratio(piece: SegmentData, noise: SensorNoise, step_v: float) -> float:
    """Variance of a step's rounding in an equation of one test function, over that of the readings' noise."""
    signals, width = piece.signals, piece.windows.step
    ts, variance = 1.0 / signals.sampling_frequency_hz, 0.5 * float(np.trace(noise.of(piece)))
    motor = signals.motor
    henry = (motor.d_inductance_h if motor else None) or 0.0
    ohm = (motor.stator_resistance_ohm if motor else None) or 0.0
    rounded = ts**2 * step_v**2 / 12.0 / piece.averaged * 2.0 * width / 3.0
    reading_noise = variance * (2.0 * henry**2 / width + (ohm * ts) ** 2 * 2.0 * width / 3.0)
    return rounded / reading_noise if reading_noise > 0.0 else math.inf

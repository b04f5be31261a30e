"""Likely cause of an overcurrent trip: set-point, noise, ripple, a wrong inductance, or the current control.

The plan gives the set-point and the nameplate's ripple; readings with the gates off give noise and offset; measured
injections give the ripple over the nameplate's. A trip acts at limits.current_a or above, so a sum below that limit
does not explain it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.config import PlannedPoint, nominal_ripple_a
from orchestrator.stages import flux_swing_wb, ripple_a
from protocols import GatesOff, Injection, Limits, Motor, RecordingReader, Segment, SegmentStage

MAX_RIPPLE_RATIO = 2.0
"""Measured ripple over the nameplate's above which the inductance is the cause: iron saturates by 20 to 60 %."""
MAX_INJECTIONS_READ = 5
"""Those of a lock check: at rest and under torque."""
MIN_CURRENT_RATIO = 0.3
"""Smallest useful current over the set-point; below it better sensors are needed."""
_PEAK_OVER_RMS = {"square": math.sqrt(3.0), "sine": math.sqrt(2.0)}
"""Peak over rms of the current ripple, by injected waveform."""


@dataclass(frozen=True)
class SensorNoise:
    """Readings with the gates off: their mean's length, and the standard deviations of the vector [A]."""

    offset_a: float
    max_std_a: float
    """Standard deviation along the axis on which it is largest."""
    mean_square_a2: float
    """Variance, both axes together."""

    def peak_a(self, rows: int) -> float:
        """Length that the noise reaches once in `rows` rows: P(|n| > x) = exp(-x^2 / 2 sigma^2) per row [A]."""
        return self.max_std_a * math.sqrt(2.0 * math.log(max(rows, 2)))


@dataclass(frozen=True)
class RippleRatio:
    """Measured over the nameplate's ripple of one injection."""

    segment: str
    ratio: float


def sensor_noise(recording: RecordingReader) -> SensorNoise | None:
    """Noise of the latest segment with the gates off; None without one."""
    segments = recording.segments(SegmentStage.GATES_OFF)
    if not segments:
        return None
    readings = recording.load(segments[-1]).i_ab.astype(np.float64)
    if len(readings) < 2:
        return None
    covariance = np.cov(readings.T)
    return SensorNoise(
        offset_a=float(np.linalg.norm(readings.mean(axis=0))),
        max_std_a=math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])),
        mean_square_a2=float(np.trace(covariance)),
    )


def ripple_ratio(recording: RecordingReader, motor: Motor, noise: SensorNoise | None) -> RippleRatio | None:
    """Smallest ratio of the first injections: where iron saturates least, the nameplate has to hold.

    None without an injection or without a nameplate inductance.
    """
    stages = (SegmentStage.LOCK_CHECK, SegmentStage.INJECTION)
    segments = [segment for segment in recording.segments() if segment.stage in stages]
    ratios = (_ripple_ratio(recording, segment, motor, noise) for segment in segments[:MAX_INJECTIONS_READ])
    return min((ratio for ratio in ratios if ratio is not None), key=lambda ratio: ratio.ratio, default=None)


def _ripple_ratio(
    recording: RecordingReader, segment: Segment, motor: Motor, noise: SensorNoise | None
) -> RippleRatio | None:
    settings = segment.settings
    amplitude_v, frequency_hz, waveform = (settings.get(key) for key in ("amplitude_v", "frequency_hz", "waveform"))
    if waveform not in _PEAK_OVER_RMS or not isinstance(amplitude_v, float) or not isinstance(frequency_hz, float):
        return None
    nominal_a = ripple_a(flux_swing_wb(amplitude_v, frequency_hz, waveform), motor)
    if nominal_a <= 0.0:
        return None
    readings = recording.load(segment).i_ab.astype(np.float64)
    mean_square = float(readings.var(axis=0).sum()) - (noise.mean_square_a2 if noise is not None else 0.0)
    peak_a = _PEAK_OVER_RMS[waveform] * math.sqrt(max(mean_square, 0.0))
    return RippleRatio(segment.id, peak_a / nominal_a)


def explain_overcurrent(
    point: PlannedPoint,
    motor: Motor,
    limits: Limits,
    sampling_frequency_hz: float,
    noise: SensorNoise | None = None,
    ripple: RippleRatio | None = None,
) -> str:
    """One line on the cause of the trip, with its numbers and the remedy.

    Parameters
    ----------
    point : PlannedPoint
        Point at which the drive tripped.
    motor : Motor
        The nameplate.
    limits : Limits
    sampling_frequency_hz : float
        Rate at which the drive checks its readings.
    noise : SensorNoise, optional
        Measured before.
    ripple : RippleRatio, optional
        From an injection measured before.
    """
    excitation, limit_a = point.excitation, limits.current_a
    set_point_a, nominal_a = excitation.longest_current_a, nominal_ripple_a(excitation, motor)
    if isinstance(excitation, GatesOff):
        return "no current is driven with the gates off: offset, noise or scale of the sensors reach the trip alone"
    rows = round((excitation.settling_s + excitation.captured_s) * sampling_frequency_hz)
    noise_a = noise.peak_a(rows) + noise.offset_a if noise is not None else 0.0
    swing_a = nominal_a * (max(ripple.ratio, 1.0) if ripple is not None else 1.0)
    budget = f"{set_point_a:.3g} A were commanded{_noise_text(noise, noise_a, rows)}"
    if nominal_a > 0.0:
        budget += f", the nameplate's ripple is {nominal_a:.2g} A"
    wrong = ripple is not None and ripple.ratio > MAX_RIPPLE_RATIO
    if ripple is not None and wrong and (nominal_a > 0.0 or set_point_a + noise_a < limit_a):
        return f"{budget}; {_wrong_inductance(ripple, motor)}"
    if set_point_a + noise_a + swing_a < limit_a:
        return (
            f"{budget}: together less than limits.current_a of {limit_a:g} A; {_causes(point, motor, limit_a, noise_a)}"
        )
    if noise_a >= swing_a:
        return f"{budget}: {_too_noisy(point, limit_a, noise_a, swing_a)}"
    return f"{budget}: the ripple reaches the trip; {_weaker(point, limit_a - set_point_a - noise_a, swing_a)}"


def _noise_text(noise: SensorNoise | None, noise_a: float, rows: int) -> str:
    if noise is None:
        return ""
    return f", noise and offset reach {noise_a:.2g} A ({noise.max_std_a:.2g} A rms with the gates off, {rows} rows)"


def _wrong_inductance(ripple: RippleRatio, motor: Motor) -> str:
    known = {"d": motor.d_inductance_h, "q": motor.q_inductance_h}
    true = " and ".join(f"{axis}_inductance_h {h / ripple.ratio:.2g}" for axis, h in known.items() if h is not None)
    return (
        f"in {ripple.segment} the ripple was {ripple.ratio:.2g} times the nameplate's: its inductance is too large, or "
        f"the iron saturates by as much; with {true} H (half of what is measured line to line) the plan fits the motor"
    )


def _too_noisy(point: PlannedPoint, limit_a: float, noise_a: float, swing_a: float) -> str:
    set_point_a = point.excitation.longest_current_a
    needed_a = set_point_a + noise_a + swing_a
    room_a = limit_a - noise_a - swing_a
    raised = f"limits.current_a of {_up(needed_a):g} A, where motor and drive bear it"
    if room_a < MIN_CURRENT_RATIO * set_point_a:
        return f"the noise reaches the trip; that needs quieter sensors, or {raised}"
    return (
        f"the noise reaches the trip; currents of {_down(room_a):g} A at most in stages.{point.stage_index} end "
        f"that, or {raised}, with these {set_point_a:.3g} A written into the stage: left out, they grow with the limit"
    )


def _weaker(point: PlannedPoint, room_a: float, swing_a: float) -> str:
    excitation = point.excitation
    if not isinstance(excitation, Injection) or room_a <= 0.0:
        return f"currents in stages.{point.stage_index} lower by {_up(swing_a - room_a):g} A end that"
    return f"an injection of {_down(excitation.amplitude_v * room_a / swing_a):g} V ends that"


def _causes(point: PlannedPoint, motor: Motor, limit_a: float, noise_a: float) -> str:
    """Possible causes where the known contributions do not reach the trip."""
    excitation = point.excitation
    nominal_a = nominal_ripple_a(excitation, motor)
    ohm = motor.stator_resistance_ohm
    short = "a short between phases" + (f" (expect {2.0 * ohm:.3g} ohm from terminal to terminal)" if ohm else "")
    if nominal_a > 0.0:
        # the first half wave of a square begins at the mean: it reaches twice the ripple
        ratio = (limit_a - excitation.longest_current_a - noise_a) / (2.0 * nominal_a)
        return (
            f"an inductance below the nameplate's by {max(ratio, 1.0):.2g} times or more does that (a wrong unit or "
            f"decimal, line to line for phase, saturation), or {short}: measure both at the terminals"
        )
    bandwidth = excitation.control.bandwidth_hz
    return (
        f"an overshoot of the current control does that, which the nameplate's R and L tune: control.bandwidth_hz of "
        f"{0.5 * bandwidth:.3g} in place of {bandwidth:.3g}; or {short}: measure R and L at the terminals"
    )


def _up(value: float) -> float:
    """Value rounded up to two digits."""
    return -_down(-value)


def _down(value: float) -> float:
    """Value rounded down to two digits."""
    if value == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return float(f"{math.floor(value / unit + 1e-9) * unit:.6g}")

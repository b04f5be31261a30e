"""What a comparison reports: the error of one model, as the JSON of `fluxbench compare`."""

from __future__ import annotations

from protocols._base import Lenient
from protocols._estimates import AxisPercent
from protocols._remarks import Number, Remarked


class NoiseFloor(Lenient):
    """Expected residual of sensor noise alone."""

    rms_v: Number
    heldout_rms_v: Number = None
    """Expected residual of the held-out stages; noise makes more of some stages than of others."""


class StageError(Lenient):
    """The residual in one kind of stage, at one PWM frequency."""

    stage: str
    pwm_frequency_hz: Number = None
    rms_v: Number
    noise_rms_v: Number = None
    """What the noise of its readings alone would leave."""
    chi2: Number
    chi2_of_noise: Number = None
    """What noise alone exceeds once in a thousand: far above 1 where few values were measured."""
    current_rms_a: Number


class WorstSegment(Lenient):
    """A segment that the model fits badly, with its mean current."""

    segment: str
    pwm_frequency_hz: Number = None
    i_d_a: Number
    i_q_a: Number
    rms_v: Number
    noise_rms_v: Number = None
    """What the noise of its readings alone would leave."""


class CompareReport(Remarked):
    """`fluxbench compare --json`."""

    recording: str
    model: str
    noise_floor: NoiseFloor
    rms_v: Number = None
    """Over all stages, as `noise_floor` and `chi2` are."""
    heldout_rms_v: Number = None
    """Over the stages alone that are not fitted; None where there are none."""
    chi2: Number
    stages: tuple[StageError, ...]
    worst: tuple[WorstSegment, ...]
    parity: AxisPercent
    reciprocity_percent: Number
    crossings: AxisPercent

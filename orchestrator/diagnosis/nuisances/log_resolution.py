"""Detection of logs with so few decimals that their rounding is noticeable beside the readings' noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import to_dq, to_phases
from orchestrator.numerics.lattice import step_of
from orchestrator.numerics.types import Array
from protocols import Remark, SegmentStage

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

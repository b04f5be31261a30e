"""Likelihood gradient of the readings with respect to each voltage command, given a local ARX model.

In a block of readings the next one is fitted as a combination of the last LAGS readings and commands. One volt added to
a command moves the current as the nameplate's inductance and resistance predict, or the fit where it is precise; the
residual is informative about it as far as the combination does not adapt.
Source: L. Ljung, System Identification, 2nd edition, section 4.2 (ARX models), Prentice Hall 1999.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from orchestrator.diagnosis.nuisances.pwm_quantiser import leg_step_of
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData, mean_between
from orchestrator.numerics.frames import rotation
from orchestrator.numerics.types import Array
from protocols import SegmentStage

MIN_TIMER_STEP_S: float = 2e-9
"""Finest timer step that is searched [s]: half a gigahertz is finer than the control's jitter."""

EXCITED_STAGES = (SegmentStage.CLASSICAL, SegmentStage.INJECTION, SegmentStage.STEPS)
"""Stages whose commands vary by design; in a hold they only respond to the readings' noise."""
LAGS = 30
"""Number of past readings and commands in the combination: a few milliseconds."""
BLOCK_READINGS = 20_000
"""Readings fitted with one combination of 120 coefficients; saturation within a block acts as noise."""
MIN_BLOCK_READINGS = 20 * LAGS
MAX_BLOCKS = 45
"""Maximum number of blocks, evenly spread; a million readings suffice."""
LINEAR_STRETCH_READINGS = 300
"""Readings in which a machine is nearly linear; divides a block evenly."""
RELATIVE_RIDGE = 1e-7
"""Ridge relative to a regressor's variance, for regressors that are constant in a block."""
NAMEPLATE_RELATIVE_STD = 0.3
"""Relative standard deviation of the nameplate's current response to a volt in one sample."""


@dataclass(frozen=True)
class CommandTrace:
    """Likelihood of one block of readings.

    Attributes
    ----------
    command_ab : array, shape (n, 2)
    pull_ab : array, shape (n, 2)
        Gradient of the log likelihood by each command's volts [1/V].
    information : float
        Information on a command's voltage per axis, summed over the block [1/V^2].
    pwm_hz : float
    """

    command_ab: Array
    pull_ab: Array
    information: float
    pwm_hz: float


def command_traces(
    prepared: PreparedRecording, inductance_h: tuple[float, float], resistance_ohm: float
) -> list[CommandTrace]:
    """Traces of the blocks whose commands vary by more than a modulator's timer may round.

    Parameters
    ----------
    prepared : PreparedRecording
    inductance_h : tuple of float
        Approximate L_d and L_q.
    resistance_ohm : float
        Approximate R_s.
    """
    bus_v = prepared.manifest.drive.dc_bus_voltage_v
    fs = prepared.manifest.drive.sampling_frequency_hz
    blocks = [
        (piece, slice(start, start + BLOCK_READINGS))
        for piece in prepared.pieces
        if piece.stage in EXCITED_STAGES and not piece.held_out
        for start in range(0, len(piece.command_ab) - MIN_BLOCK_READINGS, BLOCK_READINGS)
        if _command_rms(piece.command_ab[start : start + BLOCK_READINGS])
        > leg_step_of(MIN_TIMER_STEP_S, piece.signals.pwm_frequency_hz, bus_v)
    ]
    decay = np.exp(-resistance_ohm / (np.array(inductance_h) * fs))
    stride = max(1.0, len(blocks) / MAX_BLOCKS)
    chosen = [blocks[int(k * stride)] for k in range(int(len(blocks) / stride))]
    return [_trace(piece, rows, (1.0 - decay) / resistance_ohm, decay) for piece, rows in chosen]


def _command_rms(command_ab: Array) -> float:
    """rms of a command around its mean, along the axis with the larger one [V]."""
    return float(command_ab.std(axis=0).max())


def _trace(piece: SegmentData, rows: slice, per_volt_dq: Array, decay_dq: Array) -> CommandTrace:
    i_ab, command_ab = piece.current_ab[rows], piece.command_ab[rows]
    turn = rotation(piece.segment.rotor_angle_rad)
    per_volt, decay = (turn @ np.diag(x) @ turn.T for x in (per_volt_dq, decay_dq))
    residual, readings, commands, variance_by = _arx_residual(
        i_ab, mean_between(command_ab, 1, math.floor(piece.delay_samples))
    )
    floor = np.spacing(np.abs(i_ab).max()) ** 2 + np.finfo(np.float64).tiny
    weight = np.linalg.inv(residual.T @ residual / len(residual) + floor * np.eye(2))
    weighed, pull, information = residual @ weight, np.zeros_like(command_ab), 0.0
    # The nameplate's response and its decay, minus what the combination predicts from it.
    moved, certain = np.eye(2), (NAMEPLATE_RELATIVE_STD * float(np.abs(per_volt).max())) ** 2
    for lag in range(LAGS):
        if lag:
            moved = moved @ decay - readings[lag - 1] - (np.eye(2) if lag == 1 else 0.0)
        share = certain / (certain + variance_by[lag])
        answer = share * commands[lag] + (1.0 - share) * (moved @ per_volt)
        pull[LAGS - 1 - lag : len(pull) - 1 - lag] += weighed @ answer
        information += 0.5 * float(np.trace(answer.T @ weight @ answer)) * len(residual)
    pull = _without_slope(_of_commands(pull, piece.delay_samples), command_ab)
    return CommandTrace(command_ab, pull, information, piece.signals.pwm_frequency_hz)


def _arx_residual(i_ab: Array, acting_ab: Array) -> tuple[Array, Array, Array, Array]:
    """Residual and coefficients of the next reading's prediction by the last readings and commands.

    Returns
    -------
    residual : array, shape (n - LAGS, 2)
        Residual from reading LAGS on.
    readings, commands : array, shape (LAGS, 2, 2)
        Coefficients of the step to the next reading, the newest first.
    variance_by : array, shape (LAGS, 2, 2)
        Variance of `commands`.
    """
    both = np.hstack([i_ab, acting_ab])
    # Row k has readings and commands k + LAGS - 1, k + LAGS - 2, ..., k.
    rows = sliding_window_view(both, LAGS, axis=0)[:-1, :, ::-1].transpose(0, 2, 1)
    past = rows.reshape(len(rows), -1)
    past -= past.mean(axis=0)
    size = past.std(axis=0)
    size[size == 0.0] = 1.0
    past /= size
    step = np.diff(i_ab, axis=0)[LAGS - 1 :]
    step = step - step.mean(axis=0)
    inverse = np.linalg.inv(past.T @ past / len(past) + RELATIVE_RIDGE * np.eye(past.shape[1]))
    followed = inverse @ (past.T @ step / len(past))
    residual = step - past @ followed
    variance = np.outer(np.diag(inverse) / size**2, residual.var(axis=0)) / len(past)
    by, variance_by = ((x.reshape(LAGS, 4, 2).transpose(0, 2, 1)) for x in (followed / size[:, None], variance))
    return residual, by[:, :, :2], by[:, :, 2:], variance_by[:, :, 2:]


def _of_commands(pull_ab: Array, delay_samples: float) -> Array:
    """The gradient by the commands from that by the acting voltages, which are delayed by so many samples."""
    whole = math.floor(delay_samples)
    part = delay_samples - whole
    later = np.concatenate([pull_ab[whole:], np.zeros((whole + 1, 2))])
    return np.asarray((1.0 - part) * later[:-1] + part * later[1:], dtype=np.float64)


def _without_slope(pull_ab: Array, command_ab: Array) -> Array:
    """The gradient by the commands' voltage without its part linear in the command, removed per stretch of a block.

    The combination belongs to a whole block. Where the machine saturates within it, the predicted response is wrong by
    a slope, which resembles a part of a sawtooth. As sweeps dwell at regularly spaced commands, one sawtooth could
    imitate the slopes at all of them.
    """
    residual = np.empty_like(pull_ab)
    for start in range(0, len(pull_ab), LINEAR_STRETCH_READINGS):
        rows = slice(start, start + LINEAR_STRETCH_READINGS)
        moved = command_ab[rows] - command_ab[rows].mean(axis=0)
        size = float(np.einsum("ij,ij->", moved, moved))
        slope = np.linalg.solve(moved.T @ moved + (RELATIVE_RIDGE * size + 1e-300) * np.eye(2), moved.T @ pull_ab[rows])
        residual[rows] = pull_ab[rows] - pull_ab[rows].mean(axis=0) - moved @ slope
    return residual

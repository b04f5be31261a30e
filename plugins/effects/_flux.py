"""Flux linkage of a batch's segments, and its path before each of them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import dq_of
from orchestrator.numerics.types import Array
from plugins.effects._vectors import Starts, doubles
from protocols import RealArray, SignalBatch

STEPS_PER_WAY = 8
"""Steps between two corners of a path."""


def initial_paths(batch: SignalBatch, psi: Array, overshoot: float) -> tuple[Array, Starts]:
    """Path of the flux (M, 2) to the start of each segment, from the current's history, and its bounds.

    It is straight between points, and at the end overshoots by a part of the last section and returns. Where the
    history is unknown, the end of a periodic record precedes its start.
    """
    came_from = [np.zeros((0, 2)) if s.came_from_ab is None else s.came_from_ab for s in batch.segments]
    points = np.array([len(one) for one in came_from])
    lengths = np.where(points > 0, STEPS_PER_WAY * (points + 1) + 1, np.diff(batch.starts) // 4)
    way_starts = np.append(0, np.cumsum(lengths)).astype(np.int64)
    motor, theta_rad = batch.motor, batch.theta_rad[batch.starts[:-1]]
    inductance = np.repeat(typical_inductance(batch)[:, None], 2, axis=1)
    if motor is not None and motor.d_inductance_h is not None and motor.q_inductance_h is not None:
        inductance[:] = motor.d_inductance_h, motor.q_inductance_h
    axis = doubles(np.stack([np.cos(theta_rad), np.sin(theta_rad)], axis=1))
    began = doubles(batch.i_ab[batch.starts[:-1]])
    corners = (doubles(np.concatenate(came_from)), points.astype(np.int64), began, inductance, axis)
    return _ways(psi, batch.starts, way_starts, *corners, overshoot), way_starts


@njit(cache=True, nogil=True)
def _ways(
    psi: Array,
    starts: Starts,
    way_starts: Starts,
    came_from_ab: Array,
    points: Starts,
    i_ab: Array,
    inductance: Array,
    axis: Array,
    overshoot: float,
) -> Array:
    """The flux (M, 2) of `initial_paths` from the current's history `came_from_ab`, `points` entries per segment."""
    # `i_ab`, `inductance`, `axis`, (segments, 2): start current, L_d and L_q there, cosine and sine of the d axis'
    # angle.
    out = np.empty((way_starts[-1], 2))
    point = 0
    for s in range(starts.shape[0] - 1):
        first, end, way = starts[s], starts[s + 1], way_starts[s]
        if points[s] == 0:
            length = way_starts[s + 1] - way
            for k in range(length):
                for x in range(2):
                    out[way + k, x] = psi[end - length + k, x] + (psi[first, x] - psi[end - 1, x])
            continue
        corners = np.zeros((points[s] + 2, 2))
        cos, sin = axis[s, 0], axis[s, 1]
        for k in range(points[s]):
            d, q = dq_of(came_from_ab[point, 0] - i_ab[s, 0], came_from_ab[point, 1] - i_ab[s, 1], cos, sin)
            d, q = inductance[s, 0] * d, inductance[s, 1] * q
            corners[k, 0], corners[k, 1] = cos * d - sin * q, sin * d + cos * q
            point += 1
        for x in range(2):
            corners[-2, x] = -overshoot * corners[-3, x]
            for k in range(points[s] + 1):
                for part in range(STEPS_PER_WAY):
                    on = (corners[k + 1, x] - corners[k, x]) * (part / STEPS_PER_WAY) + corners[k, x]
                    out[way + k * STEPS_PER_WAY + part, x] = psi[first, x] + on
            out[way_starts[s + 1] - 1, x] = psi[first, x]
    return out


def flux_of(batch: SignalBatch) -> Array:
    """Flux linkage (N, 2), up to a constant per segment [Wb]."""
    if batch.psi_smooth_ab is not None:
        return doubles(batch.psi_smooth_ab)
    drops = (doubles(batch.v_ab), doubles(batch.i_ab), doubles(batch.resistance_ohm))
    return np.asarray(_summed(*drops, batch.starts, doubles(batch.sampling_frequency_hz)))


@njit(cache=True, nogil=True)
def _summed(v_ab: Array, i_ab: Array, ohm: Array, starts: Starts, rates_hz: Array) -> Array:
    """Integral of v - R i from each segment's start, shape (N, 2) [Wb]."""
    out = np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        sum_a, sum_b = 0.0, 0.0
        for k in range(starts[s], starts[s + 1]):
            sum_a += v_ab[k, 0] - ohm[k] * i_ab[k, 0]
            sum_b += v_ab[k, 1] - ohm[k] * i_ab[k, 1]
            out[k, 0], out[k, 1] = sum_a / rates_hz[s], sum_b / rates_hz[s]
    return out


def magnet_wb(batch: SignalBatch) -> float:
    """The nameplate's magnet flux [Wb]; 0 where it has none."""
    return (batch.motor.pm_flux_wb if batch.motor is not None else None) or 0.0


def typical_inductance(batch: SignalBatch) -> Array:
    """Typical inductance of each segment [H]: the nameplate's, else the swing of flux over that of current."""
    motor = batch.motor
    if motor is not None and motor.d_inductance_h is not None and motor.q_inductance_h is not None:
        return np.full(len(batch.segments), math.sqrt(motor.d_inductance_h * motor.q_inductance_h))
    current, flux = _swing(batch.i_m_ab, batch.starts), _swing(flux_of(batch), batch.starts)
    return np.divide(flux, current, out=np.ones_like(flux), where=current > 0.0)


def _swing(x: RealArray, starts: Starts) -> Array:
    """Largest minus smallest value of each segment, on the axis with the larger difference, shape (segments,)."""
    span = np.maximum.reduceat(x, starts[:-1]) - np.minimum.reduceat(x, starts[:-1])
    return np.asarray(span.max(axis=1), dtype=np.float64)

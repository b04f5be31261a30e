"""Proposals that no curve finds: where over a quantity a leftover steps, and with which frequency it repeats.

The equations are linear in what acts on each interval, so the gradient of the residual's square by a law's value at
each sample is a weighted sum of the residual. Summed from a sample on, it is the gradient by a step there; its Fourier
transform is that by a line of each frequency. All of them are known at once; the ranking evaluates the highest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis.fitting.model import BatchLinearisation, Fit
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.discovery.places import Place
from orchestrator.discovery.quantities import Quantity
from orchestrator.numerics.frames import to_ab
from orchestrator.numerics.types import Array
from protocols import RealArray

MIN_HEIGHT: float = 300.0
"""Power of a line over its background, below which it is not proposed; chance and a law over time stay below."""
MIN_PERIODS: float = 20.0
"""Periods in the experiment below which a curve over time finds them."""
BLOCKS: int = 128
"""Parts of the spectrum whose medians are its background."""
PADDING: int = 4
"""Zero padding of the transform."""
LINE_SPACING_HZ: float = 20.0
"""Distance from a line within which others are its own, by the lengths of the segments."""


def gradient_over(
    fit: Fit, place: Place, phases: tuple[float, float, float], quantity: Quantity
) -> tuple[Array, Array]:
    """Values of a quantity of all phases alike at the fitted samples, ascending, and the gradient by a law's there."""
    parts = [
        part
        for linearisation in fit.linearisation.batches
        if linearisation.base.segments[0].bridge_on
        for part in _gradients(fit, linearisation, place, phases, quantity)
    ]
    x, gradient = (np.concatenate(one) for one in zip(*parts, strict=True))
    order = np.argsort(x, kind="stable")
    return x[order], gradient[order]


def step_places(x: Array, gradient: Array, count: int) -> list[float]:
    """Where a step from there on has the largest gradients, a local maximum each."""
    beyond = np.abs(np.cumsum(gradient[::-1])[::-1])
    peak = np.flatnonzero((beyond[1:-1] >= beyond[:-2]) & (beyond[1:-1] > beyond[2:])) + 1
    return [float(x[k]) for k in peak[np.argsort(-beyond[peak])[:count]]]


def line_frequencies(time_s: Array, gradient: NDArray[np.inexact], interval_s: float, count: int) -> list[float]:
    """Frequencies of the highest lines of a gradient, of two gradients where it is complex [Hz]."""
    place = np.round((time_s - time_s[0]) / interval_s).astype(np.int64)
    length = 2 ** math.ceil(math.log2(PADDING * (int(place[-1]) + 1)))
    parts = (np.bincount(place, weights=part, minlength=length) for part in (np.real(gradient), np.imag(gradient)))
    spectrum = np.abs(np.fft.fft(next(parts) + 1j * next(parts))) ** 2
    # The backward half is the same frequencies turning the other way.
    power = spectrum[: length // 2]
    power[1:] += spectrum[: length // 2 : -1]
    width = len(power) // BLOCKS
    background = np.repeat(np.median(power[: width * BLOCKS].reshape(BLOCKS, width), axis=1), width)
    height = power[: len(background)] / np.maximum(background, 1e-12 * float(power.max()))
    height[: math.ceil(MIN_PERIODS * PADDING)] = height[-1] = 0.0
    step_hz, found = 1.0 / (length * interval_s), list[float]()
    apart = math.ceil(LINE_SPACING_HZ / step_hz)
    while len(found) < count and height.max() > MIN_HEIGHT:
        top = int(np.argmax(height))
        before, here, after = power[top - 1 : top + 2]
        # The vertex of a parabola through the three, at most half a step away.
        bend = max(2.0 * here - before - after, abs(after - before), 1e-300)
        found.append(step_hz * float(top + 0.5 * (after - before) / bend))
        height[max(top - apart, 0) : top + apart] = 0.0
    return found


def _gradients(
    fit: Fit, linearisation: BatchLinearisation, place: Place, phases: tuple[float, float, float], quantity: Quantity
) -> Iterator[tuple[Array, Array]]:
    """The quantity's values and the gradient of each fitted segment; what its effects add is neglected."""
    batch, base, unit = linearisation.batch, linearisation.base, place.typical
    y = unit * np.array(phases) * np.ones((base.samples, 1)) if place.of_phases else np.full(base.samples, unit)
    changed = base.changed_along(place.apply(base, y).arrays)
    x = quantity.of(base)
    for j, (index, piece) in enumerate(zip(batch.places, batch.pieces, strict=True)):
        if piece.held_out:
            continue
        at, segment = base.slice_of(j), base.segment(j)
        of_rows = fit.residual[index] / np.sqrt(linearisation.pieces[j].whitener.variance)
        pull = np.concatenate([to_ab(_of_intervals(piece, of_rows), piece.segment.rotor_angle_rad), np.zeros((1, 2))])
        step = pull - np.concatenate([np.zeros((1, 2)), pull[:-1]])
        volts = pull / float(piece.signals.sampling_frequency_hz)
        assert segment.inductance_ab is not None
        assert segment.psi_ab is not None
        own = {name: (array[at] - getattr(segment, name)) / unit for name, array in changed.items()}
        gradient = np.zeros(len(pull))
        if "v_ab" in own:
            gradient += np.sum(volts * own["v_ab"], axis=1)
        if "i_ab" in own:
            gradient -= segment.resistance_ohm * np.sum(volts * own["i_ab"], axis=1)
        if "resistance_ohm" in own:
            gradient -= own["resistance_ohm"] * np.sum(volts * segment.i_ab, axis=1)
        if "i_m_ab" in own:
            gradient += np.sum(step * _times(segment.inductance_ab, own["i_m_ab"]), axis=1)
        if "theta_rad" in own:
            turned = _quarter(segment.psi_ab) - _times(segment.inductance_ab, _quarter(segment.i_m_ab))
            gradient += own["theta_rad"] * np.sum(step * turned, axis=1)
        yield x[at], gradient


def _times(inductance_ab: RealArray, i_ab: RealArray) -> Array:
    """L i of (n, 3) and (n, 2)."""
    aa, ab, bb = inductance_ab.T
    return np.stack([aa * i_ab[:, 0] + ab * i_ab[:, 1], ab * i_ab[:, 0] + bb * i_ab[:, 1]], axis=1)


def _quarter(x_ab: RealArray) -> Array:
    """J x, a quarter turn ahead."""
    return np.stack([-x_ab[:, 1], x_ab[:, 0]], axis=1)


def _of_intervals(piece: SegmentData, of_rows: Array) -> Array:
    """Gradient by each interval's volt seconds (n - 1, 2) of one by the equations (rows,): the windows transposed."""
    w = piece.windows
    rows = of_rows.reshape(w.test_functions, len(w.modes), 2)
    padded = np.zeros((w.test_functions + 2, w.n_bins, 2))
    padded[1:-1] = np.einsum("jma,mb->jba", rows, w.modes)
    x = (np.arange(len(w.bins)) + 0.5) / w.step
    before = np.minimum(x.astype(np.int64), w.test_functions)
    after = (x - before)[:, None]
    first, second = np.maximum(1.0 - after, 0.0), np.minimum(after, 1.0)
    return np.asarray(first * padded[before, w.bins] + second * padded[before + 1, w.bins], dtype=np.float64)

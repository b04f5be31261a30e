"""The copper loss over the whole experiment: measured where it was captured, taken from what follows where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from orchestrator.numerics.types import Array
from protocols import LossHistory, RecordingReader, Segment, SegmentStage

LOSS_STEP_S: float = 0.05
"""Step of the history of losses [s]: short beside a winding's thermal time constant."""
MAX_LOSS_STEPS: int = 2000
"""Steps of the history of losses in a long experiment, without those at gaps."""

_UNFITTED_STAGES = (SegmentStage.ALIGNMENT, SegmentStage.LOCK_CHECK)


@dataclass(frozen=True)
class SegmentHeat:
    """What is known of the current of one segment, for the heat it leaves.

    Attributes
    ----------
    start_s, end_s : float
    times_s, squares : array, shape (m,)
        Mean square of the current from each time to the next [A^2].
    before : float
        The same of what had flowed until the first reading.
    """

    start_s: float
    end_s: float
    times_s: Array
    squares: Array
    before: float


def step_of(duration_s: float) -> float:
    """Time step of the history of an experiment that took so long [s]."""
    return max(LOSS_STEP_S, duration_s / MAX_LOSS_STEPS)


def segment_heat(square: Array, start_s: float, end_s: float, fs: float, step_s: float, before: float) -> SegmentHeat:
    """From the square of the current at each sample, shape (n,)."""
    starts = np.arange(0, len(square), max(1, round(step_s * fs)))
    means = np.add.reduceat(square, starts) / np.diff(np.append(starts, len(square)))
    return SegmentHeat(start_s, end_s, start_s + starts / fs, np.asarray(means, dtype=np.float64), before)


def heat_of_unread(recording: RecordingReader, segments: Sequence[Segment], step_s: float) -> list[SegmentHeat]:
    """Of segments that are not fitted: as captured, injection points that were left out by what they aimed at."""
    fs = recording.manifest.drive.sampling_frequency_hz
    heats = []
    for segment in segments:
        end = segment.start_s + segment.samples / fs
        target = [segment.settings.get(f"target_{axis}_a") for axis in "dq"]
        if segment.stage in _UNFITTED_STAGES and segment.samples:
            i_ab = np.asarray(recording.load(segment).i_ab, dtype=np.float64)
            square = np.einsum("ij,ij->i", i_ab, i_ab)
            heats.append(segment_heat(square, segment.start_s, end, fs, step_s, float(square[0])))
        elif segment.stage is SegmentStage.INJECTION and None not in target:
            aimed = sum(float(x) ** 2 for x in target if x is not None)
            heats.append(SegmentHeat(segment.start_s, end, np.array([segment.start_s]), np.array([aimed]), aimed))
    return heats


def loss_history(items: Sequence[SegmentHeat], resistance_ohm: float, settling_s: float) -> LossHistory:
    """All of them in order of time.

    In a gap the drive settles to what flows next; the rest of one longer than `settling_s` is spent without current.
    """
    items = sorted(items, key=lambda h: h.start_s)
    usual_s = _usual_settling_s(items, settling_s)
    times: list[Array] = []
    squares: list[Array] = []
    captured: list[Array] = []
    end = 0.0
    for item in items:
        gap = max(item.start_s - end, 0.0)
        if gap > 0.0:
            settled = gap if gap <= settling_s else usual_s
            times.append(np.array([end, item.start_s - settled]))
            squares.append(np.array([0.0, item.before]))
            captured.append(np.zeros(2))
        times.append(item.times_s)
        squares.append(item.squares)
        captured.append(np.ones(len(item.squares)))
        end = item.end_s
    times.append(np.array([end]))
    squares.append(np.zeros(1))
    captured.append(np.zeros(1))
    return LossHistory(
        time_s=np.concatenate(times),
        power_w=1.5 * resistance_ohm * np.concatenate(squares),
        captured=np.concatenate(captured),
    )


def _usual_settling_s(items: Sequence[SegmentHeat], longest_s: float) -> float:
    """How long a drive settles before a capture: as in most gaps that are no longer than the longest, if there are."""
    ends = accumulate((item.end_s for item in items), max, initial=0.0)
    gaps = [gap for item, end in zip(items, ends, strict=False) if 0.0 < (gap := item.start_s - end) <= longest_s]
    return float(np.median(gaps)) if gaps else longest_s

"""Classify a log window by window into holds, sweeps, injections and steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._source import Numbers
from orchestrator.importing.guessing._square_waves import SquareWave, square_waves
from protocols import SegmentStage

Complex = NDArray[np.complex128]

_WINDOW_S = 0.02
"""Window length: some periods of an injection, a small part of a sweep or a hold."""
_MIN_STRETCH_S = 0.1
"""A shorter stretch is a transition between stages and joins the stretch before it."""
_MAX_DWELL_S = 1.0
"""Longest dwell of a sweep at its turning points."""
_CURRENT_SHARE = 0.03
"""Share of the largest current above which a current flows; sensor offsets are smaller."""
_SWING_SHARE = 0.4
"""Share of the largest current that voltage steps swing the current by; an injection's ripple is smaller."""
_CURRENT_STEP_SHARE = 0.03
"""Change of the mean current, as a share of the largest, that begins another hold or injection point."""


@dataclass(frozen=True)
class Stretch:
    """A time range of one stage."""

    stage: SegmentStage
    start_s: float
    end_s: float
    injected_hz: float | None = None


def stretches_of(time_s: Numbers, i_ab: Numbers, v_ab: Numbers, largest: tuple[float, float]) -> list[Stretch]:
    """The stretches of a log in order of time; `largest` is the current [A] and voltage [V] of the whole log."""
    i, v = (np.asarray(x[:, 0] + 1j * x[:, 1]) for x in (i_ab, v_ab))
    period_s = float(np.median(np.diff(time_s)))
    samples = max(20, int(_WINDOW_S / period_s))
    gaps = np.flatnonzero(np.diff(time_s) > 1.5 * period_s) + 1
    waves: list[Stretch] = []
    groups: list[list[Stretch]] = [[]]  # of what lies between two square waves
    for begin, end in zip([0, *gaps.tolist()], [*gaps.tolist(), time_s.size], strict=True):
        at = begin
        for wave in square_waves(v[begin:end], largest[1], max(samples // 8, 1)):
            rows = slice(begin + wave.start, begin + wave.end)
            if _is_of_steps(i[rows], v[rows], wave, largest[0]):
                continue
            groups[-1] += _classified(time_s, i, v, slice(at, rows.start), largest)
            groups.append([])
            end_s = float(time_s[rows.stop - 1]) + period_s
            hz = 0.5 / (wave.half_period * period_s)
            waves.append(Stretch(SegmentStage.INJECTION, float(time_s[rows.start]), end_s, hz))
            at = rows.stop
        groups[-1] += _classified(time_s, i, v, slice(at, end), largest)
    others = [
        part
        for group in groups
        for run in _joined(group)
        for part in _by_current(run, time_s, i, largest[0], time_s[gaps])
    ]
    # Beside a wave a short rest belongs to it.
    kept = [part for part in others if not waves or part.end_s - part.start_s >= _MIN_STRETCH_S]
    return sorted((*kept, *waves), key=lambda part: part.start_s)


def _classified(time_s: Numbers, i: Complex, v: Complex, rows: slice, largest: tuple[float, float]) -> list[Stretch]:
    """The stretches of uninterrupted rows, classified window by window."""
    period_s = float(np.median(np.diff(time_s)))
    samples = max(20, int(_WINDOW_S / period_s))
    windows = []
    for start in range(rows.start, max(rows.stop - samples, rows.start) + 1, samples):
        stop = rows.stop if start + 2 * samples > rows.stop else start + samples
        if stop > start:
            stage, hz = _stage(i[start:stop], v[start:stop], period_s, *largest)
            windows.append(Stretch(stage, float(time_s[start]), float(time_s[stop - 1]) + period_s, hz))
    return _without_short_dwells(_merged(windows))


def _is_of_steps(i: Complex, v: Complex, wave: SquareWave, largest_a: float) -> bool:
    """Whether a square wave is about zero and swings the current as voltage steps do."""
    settled = i[i.size // 2 :]  # free of the current before
    about_zero = abs(v.mean()) < 0.1 * wave.step_v
    return bool(about_zero and np.max(np.abs(settled - settled.mean())) > _SWING_SHARE * largest_a)


def _by_current(run: Stretch, time_s: Numbers, i: Complex, largest_a: float, resumed_s: Numbers) -> list[Stretch]:
    """A stretch of holds or injections, split by current; the transition to a current belongs to its part."""
    # A change within the window of a time after a gap, `resumed_s`, is placed at that time.
    if run.stage not in (SegmentStage.RESISTANCE, SegmentStage.INJECTION):
        return [run]
    first, last = np.searchsorted(time_s, [run.start_s, run.end_s])
    period_s = float(np.median(np.diff(time_s)))
    samples = max(20, int(_WINDOW_S / period_s))
    starts = np.arange(first, max(last - samples + 1, first + 1), samples)
    means = np.add.reduceat(i[first:last], starts - first) / np.diff(np.append(starts, last))
    jumps = np.abs(np.diff(means)) > _CURRENT_STEP_SHARE * largest_a
    # A transition over several windows counts from its begin.
    begins = np.flatnonzero(jumps & ~np.concatenate([[False], jumps[:-1]])) + 1
    edges = [run.start_s]
    for begin in begins.tolist():
        ends = time_s[starts[max(begin - 1, 0)]], time_s[min(starts[begin] + samples, time_s.size - 1)]
        near = resumed_s[(resumed_s > ends[0]) & (resumed_s <= ends[1])]
        at = float(near[0] if near.size else time_s[starts[begin]])
        if at - edges[-1] >= _MIN_STRETCH_S and run.end_s - at >= _MIN_STRETCH_S:
            edges.append(at)
    return [replace(run, start_s=a, end_s=b) for a, b in zip(edges, [*edges[1:], run.end_s], strict=True)]


def _without_short_dwells(runs: list[Stretch]) -> list[Stretch]:
    """Merge short dwells into the sweep beside them, which reverses there."""
    kinds = [run.stage for run in runs]
    for k, run in enumerate(runs):
        neighbours = kinds[max(k - 1, 0) : k + 2]
        is_short_dwell = run.stage is SegmentStage.RESISTANCE and run.end_s - run.start_s < _MAX_DWELL_S
        if is_short_dwell and SegmentStage.CLASSICAL in neighbours:
            runs[k] = Stretch(SegmentStage.CLASSICAL, run.start_s, run.end_s)
    return _joined(runs)


def _stage(
    i: Complex, v: Complex, period_s: float, largest_a: float, largest_v: float
) -> tuple[SegmentStage, float | None]:
    if np.max(np.abs(v)) <= 1e-4 * largest_v:
        # A current that decays without voltage ends a step: the bridge is on.
        return (SegmentStage.STEPS if np.max(np.abs(i)) > _CURRENT_SHARE * largest_a else SegmentStage.GATES_OFF), None
    if _two_levels(v) and np.max(np.abs(i - i.mean())) > _SWING_SHARE * largest_a:
        return SegmentStage.STEPS, None
    ripple = v - v.mean()
    if np.sqrt(np.mean(np.abs(ripple) ** 2)) > 0.03 * largest_v:
        power = np.abs(np.fft.fft(ripple)) ** 2
        power = power + np.roll(power[::-1], 1)  # both directions of rotation
        half = power[: v.size // 2 + 1]
        line = int(np.argmax(half))
        if line >= 4 and half[max(line - 1, 0) : line + 2].sum() > 0.3 * half.sum():
            return SegmentStage.INJECTION, line / (v.size * period_s)
        if _two_levels(v) and np.ptp(np.abs(i - i.mean())) > 0.1 * largest_a:
            return SegmentStage.STEPS, None
    quarter = max(1, i.size // 4)
    change = abs(i[-quarter:].mean() - i[:quarter].mean())
    return (SegmentStage.RESISTANCE if change < 0.01 * largest_a else SegmentStage.CLASSICAL), None


def _two_levels(v: Complex) -> bool:
    """Whether nearly all voltages have one amplitude: plus or minus, on one axis or both."""
    length = np.abs(v)
    return bool(np.mean(np.abs(length - np.median(length)) < 0.05 * np.median(length)) > 0.8)


def _merged(found: list[Stretch]) -> list[Stretch]:
    """Merge neighbours of one stage; a short stretch joins the one before, or the one after without excitation."""
    runs = _joined(found)
    while len(runs) > 1:
        shortest = min(range(len(runs)), key=lambda k: runs[k].end_s - runs[k].start_s)
        run = runs[shortest]
        if run.end_s - run.start_s >= _MIN_STRETCH_S:
            break
        before, after = runs[max(shortest - 1, 0)], runs[min(shortest + 1, len(runs) - 1)]
        # A stretch without voltage contains no part of the transition to the first stage.
        into = shortest == 0 or (before.stage is SegmentStage.GATES_OFF and shortest + 1 < len(runs))
        other = after if into else before
        runs[shortest] = Stretch(other.stage, run.start_s, run.end_s, other.injected_hz)
        runs = _joined(runs)
    return runs


def _joined(found: list[Stretch]) -> list[Stretch]:
    runs: list[Stretch] = []
    for one in found:
        if runs and runs[-1].stage is one.stage:
            runs[-1] = Stretch(one.stage, runs[-1].start_s, one.end_s, runs[-1].injected_hz or one.injected_hz)
        else:
            runs.append(one)
    return runs

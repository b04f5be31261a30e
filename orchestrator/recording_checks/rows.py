"""Rows lost, doubled, held or interpolated on their way into the file, by shifted edges and by readings without noise.

A reading repeats the one before by chance where the current hardly moves: at a wave's crest, or within one step of the
converter. Repeats count only where the voltage must have moved the current by several times its scatter and the
converter's step.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.survey import MIN_EDGE_FRACTION, MIN_SAMPLES, SegmentReadings, Survey, parts
from protocols import Convention, ManifestCorrection

MAX_PLATEAU_STEP_FRACTION = 0.02
"""Step of an injected square's voltage between its edges, relative to an edge, where its direction turns."""
MAX_SHIFTED_EDGE_SHARE = 0.01
"""Part of an injection's edges that may come a row early or late; more do where rows are lost or doubled."""
MIN_EARLY_EDGES = 3
"""Early edges that show lost rows where no edge is late; a complete recording has none."""
MAX_REPEATED_SHARE = 0.005
"""Part of rows under a ripple that may repeat the row before, or be the mean of their neighbours."""
MAX_REPEATED_ROWS_BY_CHANCE = 3
"""Rows that repeat the row before where the current must have moved, up to which they may be chance."""
MIN_STEP_TO_SCATTER_RATIO = 4.0
"""Step of the current that the voltage makes, over the median scatter and the converter's step, from which on a
reading repeats by chance once in 65,000 rows: exp(-(4 x 1.18)^2 / 2)."""
MAX_CHANCE_RATIO = 3.0
"""Multiple of the repeats expected by chance, by the same count two rows apart."""
MAX_EXTRA_REPEATED_SHARE_AT_REST = 0.3
"""Part by which held currents may repeat more often than moving ones: more is a converter's dead band, not rows."""


def broken_rows(survey: Survey) -> Convention | None:
    """The first kind of broken rows that is too frequent to be chance."""
    seen = survey.injections
    if not seen:
        return None
    early, late, edges = np.sum([_edges(s) for s in seen], axis=0)
    repeated, by_chance, moving = np.sum([_repeated(s, _moving(s)) for s in seen], axis=0)
    middle, middle_chance, rows = np.sum([_interpolated(s) for s in seen], axis=0)
    at_rest = np.sum([_repeated(s) for s in survey.holds], axis=0) if survey.holds else np.zeros(3)
    too_many = repeated > max(MAX_REPEATED_SHARE * moving + MAX_CHANCE_RATIO * by_chance, MAX_REPEATED_ROWS_BY_CHANCE)
    # A converter that ignores small steps repeats far more at rest; held rows repeat everywhere alike.
    too_many &= at_rest[0] < (repeated / max(moving, 1.0) + MAX_EXTRA_REPEATED_SHARE_AT_REST) * max(at_rest[2], 1.0)
    share = (
        f"{100 * repeated / max(moving, 1.0):.2g} % of the {moving:.0f} rows in which the voltage must have moved the "
        "current repeat the one before"
    )
    if too_many and late - early > MAX_SHIFTED_EDGE_SHARE * edges:
        return _broken("doubled", "rows look doubled", f"{share}, and edges of the voltage come late")
    if too_many:
        return _broken("held", "rows look held: their readings are the row before's", share)
    if middle > MAX_REPEATED_SHARE * rows + MAX_CHANCE_RATIO * middle_chance:
        share = (
            f"{100 * middle / max(rows, 1.0):.2g} % of the rows under injection are the exact mean of their neighbours"
        )
        return _broken("interpolated", "rows look interpolated", share)
    if early - late > MAX_SHIFTED_EDGE_SHARE * edges or (early >= MIN_EARLY_EDGES and late == 0):
        share = f"{100 * early / max(edges, 1.0):.2g} % of the injected edges come a row early, and none late"
        return _broken("lost", "rows look lost", share)
    return None


def _broken(kind: str, what: str, evidence: str) -> Convention:
    text = "record again: a row's number is its time, and the original rows cannot be restored"
    return Convention(kind=f"rows_{kind}", what=what, evidence=evidence, correction=ManifestCorrection(text=text))


def _edges(readings: SegmentReadings) -> tuple[int, int, int]:
    """Numbers of early edges, late edges and all edges of an injected square wave; zeros for any other wave."""
    steps = np.abs(np.diff(readings.v))
    jump = float(np.quantile(steps, 0.999)) if len(steps) else 0.0
    at = np.flatnonzero(steps > MIN_EDGE_FRACTION * jump)
    if len(at) < 10 or np.median(steps) > MAX_PLATEAU_STEP_FRACTION * jump or len(at) > len(steps) / 3:
        return 0, 0, 0
    # An edge with a row in its middle counts once.
    at = at[np.concatenate([[True], np.diff(at) > 1])]
    # An injection may begin and end within a period.
    between = np.diff(at)[1:-1]
    regular = between[np.abs(between - np.median(between)) <= 1.0] if len(between) else between
    if not len(regular):
        return 0, 0, 0
    usual, mean = float(np.median(between)), float(np.mean(regular))
    # A period of a fractional number of rows has two lengths.
    low, high = (usual, usual) if abs(mean - usual) < 0.2 else (math.floor(mean), math.ceil(mean))
    return int(np.count_nonzero(between < low)), int(np.count_nonzero(between > high)), len(between)


def _repeated(readings: SegmentReadings, moving: NDArray[np.bool_] | None = None) -> tuple[int, int, int]:
    """Rows that repeat the current of the row before, of the one before that, and the number of (moving) rows."""
    i = readings.i
    counted = np.ones(len(i), dtype=bool) if moving is None else moving
    before, two_before = (counted[k:] & (i[k:] == i[:-k]) for k in (1, 2))
    return int(np.count_nonzero(before)), int(np.count_nonzero(two_before)), int(np.count_nonzero(counted))


def _moving(readings: SegmentReadings) -> NDArray[np.bool_]:
    """Rows (n,) in which the voltage moves the current by several times its scatter and its converter's step."""
    # By least squares, i_k+1 - i_k is a linear map of the voltages of the rows k - 1 to k + 1 and of i_k.
    moving = np.zeros(len(readings.i), dtype=bool)
    if len(readings.i) < MIN_SAMPLES:
        return moving
    u, i = parts(readings.ripple_v), parts(readings.i - readings.i.mean())
    columns = np.concatenate([u[:-2], u[1:-1], u[2:], i[1:-1]], axis=1)
    steps = i[2:] - i[1:-1]
    expected = columns @ np.linalg.lstsq(columns.T @ columns, columns.T @ steps, rcond=1e-9)[0]
    scatter = float(np.median(np.hypot(*(steps - expected).T)))
    moving[2:] = np.hypot(*expected.T) > MIN_STEP_TO_SCATTER_RATIO * max(scatter, *(_converter_step(x) for x in i.T))
    return moving


def _converter_step(numbers: Array) -> float:
    """The smallest difference between two numbers (n,), a converter's step where its readings are quantised [A]."""
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(numbers).max(initial=0.0))
    gaps = np.diff(np.unique(numbers))
    return float(min(gaps[gaps > rounding], default=0.0))


def _interpolated(readings: SegmentReadings) -> tuple[int, int, int]:
    """Rows whose current is the mean of both neighbours, the number expected by chance, and the number of rows."""
    # By chance as many rows are the mean of their second neighbours. A converter's counts on a straight line meet their
    # neighbours' mean as often as they miss it by one.
    differences, rounding = _second_differences(readings, 1)
    nonzero = differences[differences > rounding]
    one_count = int(np.count_nonzero(nonzero < 1.5 * nonzero.min())) if len(nonzero) else 0
    second_neighbours = int(np.count_nonzero(_second_differences(readings, 2)[0] <= rounding))
    return len(differences) - len(nonzero), max(one_count, second_neighbours), len(readings.i)


def _second_differences(readings: SegmentReadings, spacing: int) -> tuple[Array, float]:
    """Second differences of moving currents over so many rows (m,), and their rounding error [A]."""
    i = readings.i
    earlier, middle, later = i[: -2 * spacing], i[spacing:-spacing], i[2 * spacing :]
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(i).max(initial=0.0))
    change: Array = np.abs(later - earlier)
    differences: Array = np.abs(earlier - 2.0 * middle + later)
    return differences[change > 10.0 * rounding], rounding

"""Rows that were lost, doubled, held or interpolated on their way into the file: by edges that are a row off, and by
readings that no sensor with noise gives.

A reading repeats the one before by chance where the current hardly moves: at a wave's crest, or between two steps of a
converter. Repeats are counted where the voltage must have moved the current by several times what a row's step scatters
and a converter's step is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.recording_checks.survey import Sighting, Survey, parts
from protocols import Convention, ManifestCorrection


def broken_rows(survey: Survey) -> Convention | None:
    """The first kind that there are too many of to be chance."""
    seen, limits = survey.injections, survey.criteria
    if not seen:
        return None
    early, late, edges = np.sum([_edges(s, limits) for s in seen], axis=0)
    repeated, by_chance, moving = np.sum([_repeated(s, _moving(s, limits)) for s in seen], axis=0)
    middle, middle_chance, rows = np.sum([_in_the_middle(s) for s in seen], axis=0)
    at_rest = np.sum([_repeated(s) for s in survey.holds], axis=0) if survey.holds else np.zeros(3)
    too_many = repeated > max(limits.repeated * moving + limits.by_chance * by_chance, limits.few_repeated)
    # A converter that does not follow small steps repeats far more at rest; rows are repeated wherever they are.
    too_many &= at_rest[0] < (repeated / max(moving, 1.0) + limits.many_repeated) * max(at_rest[2], 1.0)
    share = (
        f"{100 * repeated / max(moving, 1.0):.2g} % of the {moving:.0f} rows in which the voltage must have moved the "
        "current repeat the one before"
    )
    if too_many and late - early > limits.irregular * edges:
        return _broken("doubled", "rows look doubled", f"{share}, and edges of the voltage come late")
    if too_many:
        return _broken("held", "rows look held: their readings are the row before's", share)
    if middle > limits.repeated * rows + limits.by_chance * middle_chance:
        share = (
            f"{100 * middle / max(rows, 1.0):.2g} % of the rows under injection are the very mean of their neighbours"
        )
        return _broken("interpolated", "rows look interpolated", share)
    if early - late > limits.irregular * edges or (early >= limits.few_early and late == 0):
        share = f"{100 * early / max(edges, 1.0):.2g} % of the injected edges come a row early, and none late"
        return _broken("lost", "rows look lost", share)
    return None


def _broken(kind: str, what: str, evidence: str) -> Convention:
    text = "record again: time is told by the number of a row, and what was there cannot be restored"
    return Convention(kind=f"rows_{kind}", what=what, evidence=evidence, correction=ManifestCorrection(text=text))


def _edges(seen: Sighting, limits: ConventionCriteria) -> tuple[int, int, int]:
    """Edges of an injected square wave that come early and late, of how many; none of any other wave."""
    steps = np.abs(np.diff(seen.v))
    jump = float(np.quantile(steps, 0.999)) if len(steps) else 0.0
    at = np.flatnonzero(steps > limits.edge * jump)
    if len(at) < 10 or np.median(steps) > limits.still * jump or len(at) > len(steps) / 3:
        return 0, 0, 0
    # Both halves of an edge with a row in its middle are one.
    at = at[np.concatenate([[True], np.diff(at) > 1])]
    # An injection may begin and end within a period.
    between = np.diff(at)[1:-1]
    alike = between[np.abs(between - np.median(between)) <= 1.0] if len(between) else between
    if not len(alike):
        return 0, 0, 0
    usual, mean = float(np.median(between)), float(np.mean(alike))
    # A period that is no whole number of rows has two lengths.
    low, high = (usual, usual) if abs(mean - usual) < 0.2 else (math.floor(mean), math.ceil(mean))
    return int(np.count_nonzero(between < low)), int(np.count_nonzero(between > high)), len(between)


def _repeated(seen: Sighting, moving: NDArray[np.bool_] | None = None) -> tuple[int, int, int]:
    """Rows that repeat the current of the row before, of the one before that, and how many rows there are.

    Parameters
    ----------
    moving : array of bool, shape (n,), optional
        The rows that are counted; None: all.
    """
    i = seen.i
    counted = np.ones(len(i), dtype=bool) if moving is None else moving
    before, two_before = (counted[k:] & (i[k:] == i[:-k]) for k in (1, 2))
    return int(np.count_nonzero(before)), int(np.count_nonzero(two_before)), int(np.count_nonzero(counted))


def _moving(seen: Sighting, limits: ConventionCriteria) -> NDArray[np.bool_]:
    """Rows (n,) in which the voltage moves the current by several times its scatter and its converter's step.

    By least squares, i_k+1 - i_k is a sum of the voltages of the rows k - 1 to k + 1 and of i_k, each both ways.
    """
    moving = np.zeros(len(seen.i), dtype=bool)
    if len(seen.i) < limits.least_looked_at:
        return moving
    u, i = parts(seen.ripple_v), parts(seen.i - seen.i.mean())
    columns = np.concatenate([u[:-2], u[1:-1], u[2:], i[1:-1]], axis=1)
    steps = i[2:] - i[1:-1]
    expected = columns @ np.linalg.lstsq(columns.T @ columns, columns.T @ steps, rcond=1e-9)[0]
    scatter = float(np.median(np.hypot(*(steps - expected).T)))
    moving[2:] = np.hypot(*expected.T) > limits.several_steps * max(scatter, *(_least_gap(x) for x in i.T))
    return moving


def _least_gap(numbers: Array) -> float:
    """The smallest difference between two numbers (n,), which is a converter's step where it shows one [A]."""
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(numbers).max(initial=0.0))
    gaps = np.diff(np.unique(numbers))
    return float(min(gaps[gaps > rounding], default=0.0))


def _in_the_middle(seen: Sighting) -> tuple[int, int, int]:
    """Rows whose current is the mean of both neighbours, how many are so by chance, and how many rows there are.

    As many as are the mean of their second neighbours; or, of a converter's counts, as are next to their neighbours'
    mean: a straight line in counts meets it as often as it misses it by one.
    """
    bends, rounding = _bends(seen, 1)
    off = bends[bends > rounding]
    next_to_it = int(np.count_nonzero(off < 1.5 * off.min())) if len(off) else 0
    two_apart = int(np.count_nonzero(_bends(seen, 2)[0] <= rounding))
    return len(bends) - len(off), max(next_to_it, two_apart), len(seen.i)


def _bends(seen: Sighting, apart: int) -> tuple[Array, float]:
    """How far currents that move are off the mean of those so many rows before and after (m,), and what rounds [A]."""
    i = seen.i
    before, now, after = i[: -2 * apart], i[apart:-apart], i[2 * apart :]
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(i).max(initial=0.0))
    moved: Array = np.abs(after - before)
    bends: Array = np.abs(before - 2.0 * now + after)
    return bends[moved > 10.0 * rounding], rounding

"""All effects fitted at once, linearly around the model that the search found, and ranked by size.

The order in which a search adds effects may decide its result. A joint fit under the priors has no order, so that a
difference between the two deserves a remark.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import Library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.scoring import LinearView, linear_view, score
from orchestrator.diagnosis.selection.search_state import SearchResult
from protocols import FoundEffect, JointEntry, Remark

MAX_CORRELATION: float = 0.995
"""Correlation above which two effects share a column in the joint fit; the priors separate similar ones below it."""
MIN_SIZE_EXCESS: float = 1.5
"""Ratio of the joint fit's first effect to the largest named one, in typical sizes, from which it is reported."""
CERTAIN_SIGMAS: float = 4.0
"""Standard deviations beyond which an effect is not due to chance."""
MAX_CHI2_CHANGE: float = 0.01
"""Relative change of chi2 beyond which effects have to be scored anew."""


def joint_fit(fitter: Fitter, search: SearchResult, library: Library) -> tuple[JointEntry, ...]:
    """All effects at once, linearly around the model, under the priors; ranked by relative size."""
    view = search.view if search.view is not None and _still_holds(search.view, search.fit) else None
    view = view or linear_view(fitter, search.fit, library)
    which = _distinct(view)
    if not which:
        return ()
    fit, columns = view.fit, [view.columns[k] for k in which]
    normal, right = view.normal[np.ix_(which, which)], view.right[which]
    inflation = max(fit.chi2_per_dof, 1.0)
    x0 = np.array([a.standardised_value(n) for a, n in columns])
    precision = normal / inflation + np.eye(len(columns))
    off = np.array([a.prior_residual(n) for a, n in columns])
    x = x0 - np.linalg.solve(precision, right / inflation + off)
    spread = np.sqrt(np.diag(np.linalg.inv(precision)))
    entries: dict[str, JointEntry] = {}
    for (active, name), value, sigma in zip(columns, x, spread, strict=True):
        p = active.candidate.named(name)
        if name not in active.candidate.amplitudes:
            continue
        size = abs(float(value)) * p.prior_width / abs(p.typical)
        entry = JointEntry(name=active.name, relative_size=size, z=float(value / sigma))
        known = entries.get(active.name)
        if known is None or abs(entry.z or 0.0) > abs(known.z or 0.0):
            entries[active.name] = entry
    # Insignificant effects are ranked below all significant ones, whatever their size.
    certain = CERTAIN_SIGMAS
    return tuple(sorted(entries.values(), key=lambda e: (abs(e.z or 0.0) < certain, -(e.relative_size or 0.0))))


def other_opinion(joint: Sequence[JointEntry], found: Sequence[FoundEffect]) -> list[Remark]:
    """A remark where the joint fit ranks an effect first that the search has not named."""
    if not joint or not found or joint[0].name in {name for e in found for name in (e.name, *e.twins)}:
        return []
    first, size, z = joint[0].name, joint[0].relative_size or 0.0, abs(joint[0].z or 0.0)
    largest = max(found, key=lambda e: e.relative_size or 0.0)
    named = largest.relative_size or 0.0
    if z < CERTAIN_SIGMAS or size < MIN_SIZE_EXCESS * named:
        return []
    text = (
        "with all effects fitted together {first} is the largest, {first_size:.2g} of its typical size; "
        "of those that were named, {named} is, {named_size:.2g} of its own"
    )
    return [Remark.of("joint_disagrees", text, first=first, first_size=size, named=largest.name, named_size=named)]


def _still_holds(view: LinearView, fit: Fit) -> bool:
    """Whether a view belongs to this fit, or to one with nearly the same chi2."""
    seen = view.fit
    same = seen.model.names == fit.model.names and seen.model.space is fit.model.space
    parameters = [n for _, n in seen.model.free] == [n for _, n in fit.model.free]
    return same and parameters and abs(seen.chi2 - fit.chi2) < MAX_CHI2_CHANGE * fit.chi2


def _distinct(view: LinearView) -> list[int]:
    """The columns of a view without effects whose column is parallel to that of one with a larger gain."""
    # Two such columns would be fitted to large, meaningless values of opposite sign.
    scale = np.sqrt(np.maximum(np.diag(view.normal), 1e-300))
    like = np.abs(view.normal / np.outer(scale, scale))
    taken = list(range(len(view.fit.model.free)))
    for scored in score(view):
        columns = [k for k, (a, _) in enumerate(view.columns) if a.name == scored.candidate.name]
        if not taken or like[np.ix_(columns, taken)].max() < MAX_CORRELATION:
            taken += columns
    return taken

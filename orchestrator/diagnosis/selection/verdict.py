"""The verdict on what is left after a search. Words nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from orchestrator.diagnosis.fitting.baseline import is_sharp
from orchestrator.diagnosis.fitting.candidates import Active
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.shares import left_of_excitation, unexplained_at_rest_v
from protocols import Verdict


def left_fraction(before_chi2: float, after: Fit) -> float:
    """u = sqrt((chi2_after - 1) / (chi2_before - 1)); 0 where the first model already fits."""
    if before_chi2 <= after.criteria.selection.detected_chi2:
        return 0.0
    return math.sqrt(max(after.chi2_per_dof - 1.0, 0.0) / (before_chi2 - 1.0))


def verdict_of(before: Fit, after: Fit, effects: int) -> Verdict:
    """The verdict on what is left: it has to be small beside what was found, and small in itself.

    The fraction alone would forgive a large second error beside a huge first one; so would the fitted part alone what
    only the held-out part shows. What no engineer would miss is forgiven near the noise, and not far beyond it: what
    nobody has named may be small where it was measured, and not elsewhere. Where nothing was named, noise that is a
    little more than the readings say is noise, and so is what chance makes of few readings. What a reading without
    current denies is no explanation.
    """
    if unexplained_at_rest_v(after) > 0.0:
        return "unknown_remains"
    return _judged(before, after, effects, remainder(after), after.criteria.selection.explained_left)


def fitted_verdict(before: Fit, after: Fit) -> Verdict:
    """The same of what was fitted alone, for decisions on names: what was held out judges them, and makes none.

    A search may take for explained what is not yet good enough to be told so.
    """
    limits = after.criteria.selection
    return _judged(before, after, len(after.model.active), after.chi2_per_dof - 1.0, limits.formless_left)


def _judged(before: Fit, after: Fit, effects: int, left: float, bearable: float) -> Verdict:
    limits = after.criteria.selection
    by_chance = limits.chance_sigmas * math.sqrt(2.0 / after.dof)
    if after.chi2_per_dof - 1.0 <= max(limits.detected_chi2 - 1.0, by_chance) and left <= max(bearable, by_chance):
        return "explained" if effects else "clean"
    by_chance = limits.chance_sigmas * math.sqrt(2.0 / after.dof)
    bearable_by = (
        (max(limits.noise_known, by_chance), limits.material_voltage),
        (limits.formless_left, limits.nothing_left),
    )
    if not effects and any(left <= most and left_of_excitation(after) <= part for most, part in bearable_by):
        return "clean"
    fraction = left_fraction(before.chi2_per_dof, after)
    # What even a sharp map leaves may be more of its detail, and what was found a part of that.
    if is_sharp(after) and after.chi2_per_dof - 1.0 > limits.noise_known:
        return "unknown_remains"
    if not effects or fraction > limits.mostly_explained or left > limits.immaterial_left:
        return "unknown_remains"
    if fraction <= limits.explained and left <= bearable:
        return "explained"
    immaterial = fraction <= limits.explained and left_of_excitation(after) <= limits.material_voltage
    forgiven = left <= limits.mostly_left or immaterial
    return "mostly_explained" if forgiven and not _is_strained(after) else "unknown_remains"


def _is_strained(fit: Fit) -> bool:
    """Whether a form is bent further than such effects are: where something is left, it stands in for another one."""
    return any(_strain(a, a.bent_by) > fit.criteria.selection.strained for a in fit.model.active)


def most_strained(fit: Fit) -> str | None:
    """The effect whose form is furthest from where such effects have theirs; None where none is too far."""
    strains = {a.name: _strain(a, [n for n in a.free if n not in a.candidate.amplitudes]) for a in fit.model.active}
    most = max(strains, key=lambda name: strains[name], default=None)
    return most if most is not None and strains[most] > fit.criteria.selection.strained else None


def rare_together(fit: Fit) -> list[str]:
    """Effects larger than most drives have them, the largest first, where they are so many that it is suspicious."""
    limits = fit.criteria.selection
    sizes = {a.name: _strain(a, a.candidate.amplitudes) for a in fit.model.active}
    large = sorted((n for n in sizes if sizes[n] > limits.rare_size), key=lambda n: sizes[n], reverse=True)
    return large if len(large) >= limits.rare_count else []


def _strain(active: Active, names: Iterable[str]) -> float:
    """How far some numbers of an effect are from where such effects have them, in standard deviations of the prior."""
    return max((abs(active.off_prior(n)) for n in names), default=0.0)


def remainder(fit: Fit) -> float:
    """What is left of chi2 - 1, ripple included: of what was fitted or of what was held out, whichever is more."""
    return max(fit.chi2_per_dof, held_out_chi2(fit) or 0.0) - 1.0


def held_out_chi2(fit: Fit) -> float | None:
    """Mean square of what was held out, over noise and how far R_s and the map are uncertain; None where nothing was.

    A point at the map's edge that no fit has seen is told by the smoothness alone: it may well be off.
    """
    covariance = np.linalg.inv(fit.normal)
    squares, rows = 0.0, 0
    for piece, frame, r, e in zip(fit.prepared.pieces, fit.frame.pieces, fit.resistance, fit.residual, strict=True):
        if piece.held_out:
            told = np.column_stack([r, frame.white_basis])
            squares += float(e @ np.linalg.solve(np.eye(len(e)) + told @ covariance @ told.T, e))
            rows += len(e)
    return squares / rows if rows else None

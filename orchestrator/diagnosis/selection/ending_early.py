"""A search ended early by the user: its best fit so far, fitted briefly to the whole recording."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.forward_search import SearchResult, refit_steps
from orchestrator.diagnosis.selection.interim import Checkpoint
from orchestrator.diagnosis.selection.joint_search import redundant_terms, refit_briefly
from orchestrator.diagnosis.selection.joint_workflow import build_ladder, drop_confounded, with_fixed_effects
from orchestrator.diagnosis.selection.workflow import fit_to_whole


def unfinished_search(checkpoint: Checkpoint) -> tuple[SearchResult, list[str]]:
    """The result of an unfinished search, from its last checkpoint.

    Returns
    -------
    search : Search
        Fits to the whole recording, with the noise of the checkpoint's setup.
    doubtful : list of str
        Effects that are not separable from the remaining error.
    """
    checkpoint = _with_own_noise(checkpoint)
    if checkpoint.is_joint:
        return _of_joint_fit(checkpoint)
    setup, search = checkpoint.setup, checkpoint.search
    if checkpoint.is_part:
        steps = fit_to_whole(setup, checkpoint.first, search.steps[1:])
        search = SearchResult(steps, search.detected_not_named, search.indistinguishable)
    return search, []


def _with_own_noise(checkpoint: Checkpoint) -> Checkpoint:
    """The checkpoint, its first models refitted with the current noise if they have another."""
    if checkpoint.first[-1].fit.linearisation.noise is checkpoint.setup.fitter.noise:
        return checkpoint
    return replace(checkpoint, first=tuple(refit_steps(checkpoint.setup, checkpoint.first)))


def _of_joint_fit(checkpoint: Checkpoint) -> tuple[SearchResult, list[str]]:
    setup, search = checkpoint.setup, checkpoint.search
    whole = _on_whole(setup, search.fit) if checkpoint.is_part else search.fit
    if not whole.model.active:
        return SearchResult(list(checkpoint.first), search.detected_not_named), []
    ladder = build_ladder(setup, checkpoint.first, whole, search.indistinguishable, search.detected_not_named)
    return drop_confounded(setup.fitter, ladder)


def _on_whole(setup: DiagnosisSetup, part: Fit) -> Fit:
    """A part's joint fit refitted to the whole recording, without the effects that are redundant to first order."""
    out = redundant_terms(part)
    model = part.model.with_active([active for active in part.model.active if active.name not in out])
    # The map is fitted first: the whole recording covers more of the current plane.
    rested = setup.fitter.fit(with_fixed_effects(model), relinearisations=0)
    return refit_briefly(setup.fitter, rested.model.with_active(model.active))

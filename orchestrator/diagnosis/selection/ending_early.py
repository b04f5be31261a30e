"""A search ended early by the user: its best fit so far, fitted to the whole recording."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.diagnosis.selection.bayes_factors import redundant_terms
from orchestrator.diagnosis.selection.interim import Checkpoint
from orchestrator.diagnosis.selection.search import on_whole, result_of
from orchestrator.diagnosis.selection.search_result import SearchResult


def unfinished_search(checkpoint: Checkpoint) -> tuple[SearchResult, list[str]]:
    """The result of an unfinished search, from its last checkpoint.

    Returns
    -------
    search : SearchResult
        Fits to the whole recording, with the noise of the checkpoint's setup.
    doubtful : list of str
        Effects that are not separable from the remaining error.
    """
    state, fit = checkpoint.state, checkpoint.state.fit
    if state.is_part:
        out = redundant_terms(fit) if state.is_joint else []
        model = fit.model.with_active([active for active in fit.model.active if active.name not in out])
        state = on_whole(replace(state, fit=replace(fit, model=model)), checkpoint.first)
    return result_of(state, checkpoint.first)

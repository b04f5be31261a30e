"""`fluxbench explain`: the reasons of a diagnosis, and the steps of its search."""

from __future__ import annotations

import shlex
from pathlib import Path

from orchestrator.formatting.explaining import (
    BASIS_HEAD,
    LOG_EVIDENCE_SCALE,
    NEXT_STEPS,
    SEARCH_HEAD,
    basis_rows,
    search_legend,
    search_rows,
)
from orchestrator.formatting.names import VERDICTS, plain
from orchestrator.formatting.results import part_notes
from orchestrator.interface import api
from orchestrator.interface.cli._output import say, say_document, say_notes, say_wide_table
from protocols import Explanation


def explain(path: Path, as_json: bool) -> int:
    """Print the reasons of the verdict, the search, and the evidence for each named effect."""
    explanation = api.explain(path)
    if as_json:
        say_document(explanation.model_dump_json(indent=2))
    else:
        _print(path, explanation)
    return 0


def _print(path: Path, explanation: Explanation) -> None:
    say(f"{path}: {plain(explanation.verdict)}, {VERDICTS[explanation.verdict].meaning}")
    say(*(f"  {reason.sentence}" for reason in explanation.reasons))
    if not explanation.reasons:
        say("  An older version made this diagnosis and kept no reasons; `fluxbench diagnose` makes it again.")
    if explanation.model_changes:
        say(f"  model.json was changed since: {', '.join(explanation.model_changes)}")
    if explanation.search:
        say("", "steps of the search (chi2 per degree of freedom, before → after):")
        say_wide_table(SEARCH_HEAD, search_rows(explanation.search))
        say_notes(search_legend(explanation.search))
    if explanation.effects:
        say("", "evidence for each named effect:")
        say_wide_table(BASIS_HEAD, basis_rows(explanation.effects))
        say_notes((*part_notes(explanation.effects), LOG_EVIDENCE_SCALE))
    if explanation.to_decide:
        say("", f"to decide: {explanation.to_decide}")
    say(f"next: {NEXT_STEPS[explanation.verdict].format(run=shlex.quote(str(path)))}")

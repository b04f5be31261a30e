"""`fluxbench explain`: the reasons of a diagnosis, and the steps of its search."""

from __future__ import annotations

import shlex
from pathlib import Path

from orchestrator.formatting.explaining import (
    SEARCH_HEAD,
    basis_head,
    basis_rows,
    limit_notes,
    log_evidence_notes,
    reason_sentences,
    search_legend,
    search_rows,
)
from orchestrator.formatting.names import VERDICTS, plain
from orchestrator.formatting.quantities import plural
from orchestrator.formatting.results import STAND_IN, part_notes
from orchestrator.formatting.search_summary import noise_note, search_notes, search_summary
from orchestrator.interface import api
from orchestrator.interface.cli._output import say, say_document, say_notes, say_wide_table
from orchestrator.recording import has_recording
from protocols import Explanation


def explain(path: Path, steps: bool, as_json: bool) -> int:
    """Print the reasons of the verdict, the course of the search, and the evidence for each named effect."""
    explanation = api.explain(path)
    if as_json:
        say_document(explanation.model_dump_json(indent=2))
    else:
        _print(path, explanation, steps)
    return 0


def _print(path: Path, explanation: Explanation, steps: bool) -> None:
    run = shlex.quote(str(path))
    say(f"{path}: {plain(explanation.verdict)}, {VERDICTS[explanation.verdict].meaning}")
    say(*(f"  {sentence}" for sentence in reason_sentences(explanation.reasons)))
    if explanation.reasons and (note := noise_note(explanation.search)):
        say(f"  {note}")
    if not explanation.reasons:
        say("  An older version made this diagnosis and kept no reasons; `fluxbench diagnose` makes it again.")
    if explanation.model_changes:
        say(f"  model.json was changed since: {', '.join(explanation.model_changes)}")
    search = explanation.search
    if search:
        say("", "how the search got there (chi2 per degree of freedom of the fitted stages; 1 is noise alone):")
        say(*(f"  {line}" for line in search_summary(search)))
        say(*(f"  {note}" for note in search_notes(search)))
        if not steps:
            say(f"  `fluxbench explain {run} --steps` lists all {plural(len(search), 'step')}")
    if search and steps:
        say("", "all steps of the search (chi2 per degree of freedom, before → after):")
        say_wide_table(SEARCH_HEAD, search_rows(search))
        say_notes(search_legend(search))
    if explanation.effects:
        say("", "evidence for each named effect:")
        say_wide_table(basis_head(explanation), basis_rows(explanation.effects, search))
        doubt = [STAND_IN] if explanation.verdict == "unknown_remains" else []
        say_notes(
            (
                *doubt,
                *explanation.notes,
                *part_notes(explanation.effects),
                *limit_notes(explanation),
                *log_evidence_notes(explanation.effects, search),
            )
        )
    if explanation.next_steps:
        say("", "what to do now:", *(f"  {line}" for line in explanation.next_steps))
    if not has_recording(path):
        say(f"RECORDING is that of {explanation.recording!r}; {path} has its results alone")

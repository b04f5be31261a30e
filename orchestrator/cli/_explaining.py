"""`fluxbench explain`: why a diagnosis says what it says, and what its search tried."""

from __future__ import annotations

from pathlib import Path

from orchestrator import api
from orchestrator.cli._output import say, say_document, say_wide_table
from orchestrator.formatting.explaining import BASIS_HEAD, SEARCH_HEAD, basis_rows, search_rows
from orchestrator.formatting.names import VERDICTS, plain
from protocols import Explanation


def explain(path: Path, as_json: bool) -> int:
    """Print the reasons of the verdict, the search, and what each named effect rests on."""
    found = api.explain(path)
    if as_json:
        say_document(found.model_dump_json(indent=2))
    else:
        _print(found)
    return 0


def _print(found: Explanation) -> None:
    say(f"{found.recording}: {plain(found.verdict)}, {VERDICTS[found.verdict].meaning}")
    say(*(f"  {reason.sentence}" for reason in found.reasons))
    if not found.reasons:
        say("  An older version made this diagnosis and kept no reasons; `fluxbench diagnose` makes it again.")
    if found.search:
        say("", "what the search tried (chi2 per degree of freedom, before → after):")
        say_wide_table(SEARCH_HEAD, search_rows(found.search))
    if found.effects:
        say("what each named effect rests on:")
        say_wide_table(BASIS_HEAD, basis_rows(found.effects))

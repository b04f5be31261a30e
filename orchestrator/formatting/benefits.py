"""What is said of an effect that was added or taken out, and the command that undoes a change which did not help."""

from __future__ import annotations

from orchestrator.formatting.sentences import typographic
from protocols import Remark

UNDONE_BY = {"helps": None, "does_not_help": "remove", "needed": "add", "not_needed": None}
"""Codes of the remarks that say whether an effect helps, each with the command that undoes the change, if advised."""
BENEFITS = frozenset(UNDONE_BY)


def benefit_line(remark: Remark, run: str) -> str:
    """A remark of `add` or `remove` on one effect, with the command that undoes the change where that is advised."""
    command = UNDONE_BY[remark.code]
    if command is None:
        return typographic(f"{remark.text}.")
    undoes = {"remove": "takes it out again", "add": "puts it back"}[command]
    return typographic(f"{remark.text}; `fluxbench {command} {run} {remark.values['effect']}` {undoes}.")

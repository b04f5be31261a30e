"""`fluxbench discover`: the law that no effect of the library explains."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.formatting.names import plain
from orchestrator.formatting.progress import Progress
from orchestrator.formatting.quantities import number, quantity
from orchestrator.interface import api
from orchestrator.interface.cli._interrupting import prompt_interrupt
from orchestrator.interface.cli._output import say, say_document, say_notes, say_table

if TYPE_CHECKING:
    from orchestrator.discovery import Discovery, FoundLaw

RANKED_ROWS = 6
"""Rows of the table of places."""


def discover(
    path: Path,
    write: Path | None,
    name: str | None,
    effects: Path | None,
    without: Sequence[str],
    out: Path | None,
    as_json: bool,
) -> int:
    """Print the law, its forms and the fall of the error; exit code 0 with or without one."""
    progress = Progress(results=sys.stderr if as_json else sys.stdout)
    with prompt_interrupt():
        found = api.discover(
            path, write=write, name=name, effects=effects or (), without=without, out=out, tell=progress
        )
    if as_json:
        say_document(found.model_dump_json(indent=2))
    else:
        _print(path, found, write, (out or path) / "results")
    return 0


def _print(path: Path, found: Discovery, write: Path | None, results: Path) -> None:
    say(f"{path}: {OUTCOMES[found.outcome]}", f"  {found.reason[0].upper()}{found.reason[1:]}.", "")
    if found.ranking:
        ranked = [
            (
                plain(r.place),
                plain(r.quantity),
                r.phase or "all",
                r.kind,
                number(r.log_evidence),
                f"{100 * r.share:.1f} %",
            )
            for r in found.ranking[:RANKED_ROWS]
        ]
        say_table(("place", "over", "phase", "law", "log evidence", "of the error"), ranked)
    if found.outcome != "law":
        if write is not None:
            say(f"{write} was not written: there is no law to write")
        return
    for law in found.laws:
        _print_law(law)
    volts = [("before", found.before_rms_v, found.chi2_before, found.before)]
    volts += [("with the law", found.after_rms_v, found.chi2_after, found.after)]
    rows = [(label, quantity(v, "V") if v else "-", number(heldout), number(chi2)) for label, v, chi2, heldout in volts]
    say_table(("model", "held out", "in units of noise", "chi2"), rows)
    if found.floor_rms_v:
        say(f"noise alone leaves {quantity(found.floor_rms_v, 'V')}")
    say_notes([f"picture: {results / 'discovery.svg'}"])
    names = " ".join(law.name for law in found.laws)
    if write is None:
        say(f"`fluxbench discover {path} --write FILE.py` writes it as an effect.")
    else:
        say(f"written: {write}; `fluxbench add {path} {names} --effects {write}` adds it to the model")


def _print_law(law: FoundLaw) -> None:
    say(law.sentence)
    rows = []
    for form in law.forms:
        constants = ", ".join(
            f"{c.name} {quantity(c.value, c.unit) if c.unit != '1' else number(c.value)}" for c in form.constants
        )
        rows.append((f"y = {form.formula}", constants, number(form.heldout), number(form.chi2)))
    say_table(("form", "constants", "held out, in noise", "chi2"), rows)
    say_notes(
        [
            *(f"as well: {one}" for one in law.as_well),
            *([law.gauge] if law.gauge else []),
            *([f"to decide: {law.to_decide}"] if law.to_decide else []),
        ]
    )


OUTCOMES = {
    "law": "a law that no effect of the library has",
    "nothing_to_learn": "nothing to learn",
    "no_law": "no law found",
}

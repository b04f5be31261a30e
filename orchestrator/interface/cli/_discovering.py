"""`fluxbench discover`: the law that no effect of the library explains."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.formatting.names import plain
from orchestrator.formatting.progress import Progress
from orchestrator.formatting.quantities import number, quantity
from orchestrator.formatting.sentences import listed
from orchestrator.interface import api
from orchestrator.interface.cli._interrupting import prompt_interrupt
from orchestrator.interface.cli._output import say, say_document, say_notes, say_table

if TYPE_CHECKING:
    from orchestrator.discovery import Discovery, FoundLaw
    from orchestrator.discovery.report import RankedHypothesis

RANKED_ROWS = 6
"""Rows of the table of places."""
MIN_SHARE_OF_RIVAL = 0.5
"""Part of the error that a row removes, over the first one's, from which a measurement has to tell the two apart."""
DURATION = (
    "half a minute to 6 minutes, and a diagnosis before it where there is none; Ctrl-C ends it and writes nothing"
)
"""How long a search takes on two cores, and what an interruption leaves."""
RANKING_NOTES = (
    "place is where a law acts in the motor's equations, over the quantity that it depends on; odd, even or none is "
    "the symmetry of its curve",
    "log evidence is the gain in nat over the model without it (5 nat: odds of 150 to 1); of the error: what a free "
    "curve there removes",
)


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
    progress.result(DURATION)
    with prompt_interrupt():
        found = api.discover(
            path, write=write, name=name, effects=effects or (), without=without, out=out, tell=progress
        )
    if as_json:
        say_document(found.model_dump_json(indent=2))
    else:
        given = [("--effects", effects), *(("--without", one) for one in without), ("--out", out)]
        _print(path, found, write, [(option, value) for option, value in given if value is not None])
    return 0


Given = Sequence[tuple[str, Path | str]]
"""Options as they were given, with their values."""


def _print(path: Path, found: Discovery, write: Path | None, given: Given) -> None:
    out = dict(given).get("--out")
    results = Path(out or path) / "results"
    reason = found.reason.removeprefix("nothing to learn here: ")
    say(f"{path}: {OUTCOMES[found.outcome]}", f"  {reason[0].upper()}{reason[1:]}.", "")
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
        say_notes((*RANKING_NOTES, *passed_over(found)))
    if found.outcome != "law":
        say(*next_steps(path, found))
        if write is not None:
            say(f"{write} was not written: there is no law to write")
        return
    for law in found.laws:
        _print_law(law)
        say(*library_advice(path, law, given))
    volts = [("before", found.before_rms_v, found.chi2_before, found.before)]
    volts += [("with the law", found.after_rms_v, found.chi2_after, found.after)]
    rows = [(label, quantity(v, "V") if v else "-", number(heldout), number(chi2)) for label, v, chi2, heldout in volts]
    say_table(("model", "held out", "in units of noise", "chi2"), rows)
    if found.floor_rms_v:
        say(f"noise alone leaves {quantity(found.floor_rms_v, 'V')}")
    say_notes([f"picture: {results / 'discovery.svg'}"])
    say(next_command(path, found, write, given))


def passed_over(found: Discovery) -> list[str]:
    """Why the first row of the table is not the law that was found; nothing where it is."""
    if found.outcome != "law" or not found.laws:
        return []
    law, first = found.laws[0], found.ranking[0]
    if (first.place, first.quantity, first.phase) == (law.place, law.quantity, law.phase):
        return []
    kept, instead = (_in_words(one) + ("" if one.phase else " in all phases") for one in (law, first))
    return [
        f"the rows rank curves on a part of the recording. As formulas on the whole of it, {kept} was kept instead of "
        f"{instead}: it leaves less, or as much with fewer constants"
    ]


def next_command(path: Path, found: Discovery, write: Path | None, given: Given) -> str:
    """The command that writes the laws, or adds them to the model, with the options that were given."""
    run, names = shlex.quote(str(path)), " ".join(law.name for law in found.laws)
    if write is None:
        return f"`fluxbench discover {run} --write FILE.py{_options(given)}` writes it as an effect."
    of_add = [("--effects", write), *(pair for pair in given if pair[0] == "--out")]
    text = f"written: {write}; `fluxbench add {run} {names}{_options(of_add)}` adds it to the model"
    if not found.stood_in:
        return text
    removals = " and ".join(f"`fluxbench remove {run} {name}{_options(of_add)}`" for name in found.stood_in)
    return f"{text}; then {removals}: the law stands without {listed([plain(name) for name in found.stood_in])}"


def library_advice(path: Path, law: FoundLaw, given: Given) -> list[str]:
    """Where an effect of the library is what a law looks like: the command that adds it instead."""
    if not law.library:
        return []
    run = shlex.quote(str(path))
    options = _options([pair for pair in given if pair[0] != "--without"])
    like = listed([plain(one) for one in law.library])
    return [f"it looks like {like}, which the library has: `fluxbench add {run} {law.library[0]}{options}` first"]


def next_steps(path: Path, found: Discovery) -> list[str]:
    """What to measure or try where there is no law."""
    from orchestrator.diagnosis import CROSS_SATURATION, SATURATION
    from orchestrator.discovery.separation import least_alike

    run = shlex.quote(str(path))
    if found.outcome != "no_law":
        steps = [f"next: `fluxbench explain {run}` has the reasons of the verdict"]
        if causes := [name for name in found.kept_effects if name not in (SATURATION, CROSS_SATURATION)]:
            steps.append(
                f"if you doubt a named cause ({listed([plain(name) for name in causes])}): "
                f"`fluxbench discover {run} --without {causes[0]}` looks for a law in its place"
            )
        return steps
    steps = []
    if found.ranking:
        first = found.ranking[0]
        steps.append(
            f"no place fits: the first row, {_in_words(first)}, removes {100.0 * first.share:.0f} % of the error to "
            "first order, but no law there halves the held-out error; neither its place nor its phase is certain"
        )
        if apart := least_alike(found.ranking, MIN_SHARE_OF_RIVAL):
            rival, measurement = apart
            steps.append(f"to measure next: {measurement}; that tells the first row from {_in_words(rival)}")
    steps.append(
        f"to try next: `fluxbench compare {run}` shows where the error is; `fluxbench new effect NAME` begins a law of "
        "your own"
    )
    return steps


def _in_words(one: RankedHypothesis | FoundLaw) -> str:
    phase = f" in phase {one.phase}" if one.phase else ""
    return f"{plain(one.place)} over {plain(one.quantity)}{phase}"


def _options(given: Given) -> str:
    return "".join(f" {option} {shlex.quote(str(value))}" for option, value in given)


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

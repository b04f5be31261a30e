"""The blind suite's table as a page: figures with their intervals, and every answer that was wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.blind.effects import CATALOGUE, FOREIGN
from tests.blind.hidden import MANY, NUISANCES
from tests.blind.score import (
    ABOUT_FOREIGN,
    ACCEPTED,
    FAINT_FIGURES,
    FAINT_LISTED,
    FOUND_FIRST,
    SWITCHED_MAP,
    Judgement,
    exact,
    named_by,
    stated,
    wilson,
)

AIMS = {
    "clean: no false name": "0 false of 300",
    "single: first name right": "98 %",
    "clutter: first name right": "97 %",
    "double: exact set": "85 %",
    "left out: unknown flagged": "97 %",
    "foreign: unknown flagged": "90 %",
    "explained, and not flagged unknown": "99 %",
    FAINT_LISTED[1]: "95 % from 0.03 on",
    FAINT_FIGURES[2]: "95 %",
}
ORDER = (
    "clean: no false name", "clean: stated to be clean", "single: first name right", "single: exact set",
    FOUND_FIRST, "clutter: named, or listed as smaller",
    "clutter: no false name", "double: exact set", "double: first name right",
    "left out: unknown flagged", *ABOUT_FOREIGN.values(), "explained, and not flagged unknown",
    ACCEPTED, "ordinary: no false name", "switched, clean: no false name", "switched, clean: stated to be clean",
    f"switched, clean: {SWITCHED_MAP}", "switched: no false name", "switched: dead time within 20 %",
    f"switched: {SWITCHED_MAP}", "nuisance: no false name", "nuisance: first name right",
    "faint: no wrong name", *FAINT_FIGURES, *FAINT_LISTED[:-1], "too little to say: stated so", "answered at all",
)  # fmt: skip


def page(judgements: Sequence[Judgement], seed: int, date: str, usual: int) -> str:
    """The whole page, as Markdown; `usual` is how many recordings the command makes unless it is reported otherwise."""
    ordered = sorted(judgements, key=lambda j: _order(j.answer.case.label))
    kinds = [j.answer.case.kind for j in ordered]
    counts = ", ".join(f"{kinds.count(kind)} {kind.replace('_', ' ')}" for kind in dict.fromkeys(kinds))
    lines = [
        "# The blind suite",
        "",
        "This page tells you how often `fluxbench diagnose` is right. To examine it anew (some hours):",
        "",
        f"    python -m tests.blind --seed {seed} --write docs/blind-suite.md",
        "",
        "With `--answers tests/blind/answers.jsonl.gz` the command goes on from the answers that are stored there.",
        "The command writes this page. It makes recordings with hidden effects and diagnoses them. The plant",
        "shares no code with the diagnosis nor with the simulated drive (`tests/blind`). Sizes are drawn",
        f"log-uniformly from the catalogue's ranges. The catalogue has {len(CATALOGUE)} effects.",
        f"Another {len(FOREIGN)} are foreign, which no catalogue has, and {len(NUISANCES)} are nuisances. An effect",
        "that the report declares indistinguishable from the hidden one counts. A second plant has",
        "[other forms and other plans](blind-suite-foreign.md).",
        "",
        "- **Left out**: the hidden effect is not in the library, and has to be flagged as unknown. One injection",
        "  frequency cannot separate voltage_delay from current_filter, so of these two the name of the other",
        "  counts.",
        "- **Clutter**: every effect at 0.05 of its typical size, and one larger. No name of the catalogue is",
        "  false there.",
        "- **Ordinary**: every effect log-uniformly from 0.01 to 1 of its typical size. No name is false there",
        "  either.",
        "- **Switched**: an ordinary bench behind a bridge, computed edge by edge. It has most effects and those",
        "  that such a bridge causes. Any other name is false.",
        "",
        "The plant itself decides which effect of clutter is the first and which are material: it runs without",
        "noise, with and without each (`tests/blind/removal.py`). A map is delivered where something was fitted.",
        "",
        f"Date {date}, seed {seed}, {len(ordered)} recordings of the {usual} that it makes: {counts}.",
        "",
        "| figure | right | of | % | 95 % interval | aim |",
        "| --- | --- | --- | --- | --- | --- |",
        *_proportions(ordered),
        "",
        *_amounts(ordered),
        *_probabilities(ordered),
        "",
        "## By effect",
        "",
        *_by_effect(ordered),
        "",
        "## Wrong answers",
        "",
        *_misses(ordered, seed),
    ]
    return "\n".join(lines) + "\n"


def _order(label: str) -> tuple[str, int]:
    kind, index = label.split(":")[:2]
    return kind, int(index)


def _proportions(judgements: Sequence[Judgement]) -> list[str]:
    rows = []
    for figure in ORDER:
        outcomes = [j.right[figure] for j in judgements if figure in j.right]
        if outcomes:
            rows.append(_row(figure, sum(outcomes), len(outcomes), AIMS.get(figure, "")))
    for kind, aim in (("single", "90 %"), ("double", ""), ("clutter", "")):
        own = [j for j in judgements if j.answer.case.kind == kind]
        over = [j.over_floor for j in own if j.over_floor is not None]
        if over:
            rows.append(_row(f"{kind}: held-out error within 1.2 floors", sum(o <= 1.2 for o in over), len(over), aim))
        closed = [j.closed for j in own if j.closed is not None]
        if closed:
            rows.append(_row(f"{kind}: held-out error closed by 98 %", sum(c >= 0.98 for c in closed), len(closed), ""))
    for kind in MANY:
        met = [named for j in judgements if j.answer.case.kind == kind for _, named in j.material]
        if met:
            rows.append(_row(f"{kind}: material ones named", sum(met), len(met), "95 %"))
    for kind in ("ordinary", "switched"):
        met = [found for j in judgements if j.answer.case.kind == kind for _, found in j.sizeable]
        if met:
            rows.append(_row(f"{kind}: hidden effects from 0.1 of typical found", sum(met), len(met), "95 %"))
    held = [inside for j in judgements for _, inside in j.intervals]
    if held:
        rows.append(_row("95 % intervals that hold the truth", sum(held), len(held), "93..97 %"))
    return rows


def _row(figure: str, hits: int, count: int, aim: str) -> str:
    low, high = wilson(hits, count)
    return f"| {figure} | {hits} | {count} | {100 * hits / count:.0f} | {100 * low:.0f}..{100 * high:.0f} | {aim} |"


def _amounts(judgements: Sequence[Judgement]) -> list[str]:
    closed = [j.closed for j in judgements if j.closed is not None]
    seconds = np.array([j.answer.seconds for j in judgements])
    cpu = np.array([j.answer.cpu_s for j in judgements])
    samples = np.array([j.answer.samples for j in judgements])
    peak = max(j.answer.peak_mb for j in judgements)
    lines = []
    if closed:
        lines.append(f"Held-out error closed: {100 * float(np.median(closed)):.1f} % at the median (aim 98 %).")
    lines.append(
        f"A diagnosis of {np.median(samples) / 1e6:.2f} M samples takes {np.median(seconds):.1f} s at the median, "
        f"{seconds.max():.1f} s at most, on a machine that does other work too. It takes {np.median(cpu):.1f} s of one "
        f"core at the median, {cpu.max():.1f} s at most, and {peak:.0f} MB at most."
    )
    return [*lines, *_maps(judgements), *_beside(judgements)]


def _probabilities(judgements: Sequence[Judgement]) -> list[str]:
    """How far the stated probabilities can be relied on, by tenths."""
    stated = [one for j in judgements for one in j.stated]
    if not stated:
        return []
    chance, there = np.array([p for p, _ in stated]), np.array([right for _, right in stated])
    tenth = np.minimum((10 * chance).astype(int), 9)
    rows = []
    for k in np.unique(tenth):
        own = tenth == k
        rows.append(
            f"| {k / 10:.1f} to {(k + 1) / 10:.1f} | {own.sum()} | {chance[own].mean():.3f} | {there[own].mean():.3f} |"
        )
    largest = [j.of_largest for j in judgements if j.of_largest is not None]
    about = (
        "Stated probabilities, of causes and of smaller effects, and how many of these are present (aim: within 0.05 "
        "in each tenth). Recordings with a hidden effect outside the library are left out:"
    )
    mean = f"The largest hidden effect of one, two, or clutter has {np.mean(largest):.3f} at the mean (aim 0.95)."
    head = ["| stated | effects | mean | there |", "| --- | --- | --- | --- |"]
    return ["", about, "", *head, *rows, *(["", mean] if largest else [])]


def _beside(judgements: Sequence[Judgement]) -> list[str]:
    """The same recordings by simpler searches."""
    kinds = ("clean", "single", "double")
    answers = [j.answer for j in judgements if j.answer.baselines and j.answer.case.kind in kinds]
    rows = []
    for method in named_by(answers[0]) if answers else ():
        cells, false = [], 0
        for kind in kinds:
            reported = [exact(a.case, named_by(a)[method]) for a in answers if a.case.kind == kind]
            cells.append(f"{sum(right for right, _ in reported)} of {len(reported)}")
            false += sum(wrong for _, wrong in reported)
        rows.append(f"| {method} | {' | '.join(cells)} | {false / len(answers):.2f} |")
    about = (
        "Recordings with exactly the hidden effects named, beside linear searches over the library's columns "
        "(`tests/blind/baselines.py`):"
    )
    head = "| method | clean | single | double | false names a recording |"
    return ["", about, "", head, "| --- | --- | --- | --- | --- |", *rows] if rows else []


def _maps(judgements: Sequence[Judgement]) -> list[str]:
    """How good the delivered maps are, class by class."""
    rows = []
    for kind in dict.fromkeys(j.answer.case.kind for j in judgements):
        known = [j.answer.delivered for j in judgements if j.answer.case.kind == kind and j.answer.delivered]
        if known:
            off, inside, ohm = (
                np.array([d[n] for d in known]) for n in ("map_percent", "inside", "resistance_percent")
            )
            usable = sum(d["usable"] for d in known)
            rows.append(
                f"| {kind.replace('_', ' ')} | {len(known)} | {usable} | {np.median(off):.3f} | {off.max():.3f} "
                f"| {100 * np.median(inside):.0f} | {np.median(ohm):.3f} |"
            )
    head = "| class | maps | usable | rms error, % of rated flux: median | at most | in their 95 %, % | R_s error, % |"
    about = "The delivered maps, with the effects removed, against the plant's own:"
    return ["", about, "", head, "| --- | --- | --- | --- | --- | --- | --- |", *rows] if rows else []


def _by_effect(judgements: Sequence[Judgement]) -> list[str]:
    rows = ["| hidden | first name right | exact set | unknown flagged without it |", "| --- | --- | --- | --- |"]
    for name in CATALOGUE:
        cells = []
        for figure in ("single: first name right", "single: exact set", "left out: unknown flagged"):
            outcomes = [
                j.right[figure] for j in judgements if figure in j.right and j.answer.case.truths[0].name == name
            ]
            cells.append(f"{sum(outcomes)} of {len(outcomes)}" if outcomes else "-")
        if any(cell != "-" for cell in cells):
            rows.append(f"| {name} | {' | '.join(cells)} |")
    for name in FOREIGN:
        outcomes = [r for j in judgements if j.answer.case.foreign == name for r in j.right.values()]
        if outcomes:
            rows.append(f"| (foreign) {name} | | | {sum(outcomes)} of {len(outcomes)} |")
    return rows


def _misses(judgements: Sequence[Judgement], seed: int) -> list[str]:
    lines = [f"`python -m tests.blind --make CASE --seed {seed} --out DIR` makes a recording again.", ""]
    lines += ["| case | hidden | stated | missed |", "| --- | --- | --- | --- |"]
    for j in judgements:
        if j.wrong:
            case = j.answer.case
            lines.append(
                f"| {case.label} | {case.hidden} ({case.family}) | {stated(j.answer)} | {'; '.join(j.wrong)} |"
            )
    return lines

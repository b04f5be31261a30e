"""The viewer's pages of text, in Markdown: what R_s is, whether to trust the map, a diagnosis in its five slots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun as rr

from plugins.streams.rerun._tape import Entry, When, entry
from protocols import AxisPercent, DiagnosisWords, FluxMapEstimate, LockChecked, ResistanceEstimate

PAPER = AxisPercent(d_percent=1.3, q_percent=2.9)
"""Crossings that Combes, Malrait, Martin and Rouchon print of their own measurement."""
SLOTS = {
    "where_it_fails": "Where it fails",
    "what_it_looks_like": "What it looks like",
    "likely_cause": "Likely cause",
    "if_added": "If added",
    "to_decide": "To decide",
}


def page(path: str, when: When, text: str) -> Entry:
    """A page of Markdown."""
    return entry(path, when, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), size=len(text) + 600)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(c) for c in line) + " |" for line in lines)


def _cell(text: str) -> str:
    return one_line(text.replace("|", "/"))


def one_line(text: str) -> str:
    """Text from outside without its line breaks."""
    return " ".join(text.split())


def plain(name: str) -> str:
    """A state, stage or effect as words."""
    return name.replace("_", " ")


def duration(seconds: float) -> str:
    """Seconds as a person reads them."""
    whole = max(0, round(seconds))
    return f"{whole} s" if whole < 100 else f"{whole // 60} min {whole % 60} s"


def volts(value: float) -> str:
    """A small voltage with a fitting unit."""
    return f"{1e3 * value:.3g} mV" if abs(value) < 1.0 else f"{value:.3g} V"


def amperes(value: float) -> str:
    """A current with a fitting unit."""
    return f"{1e3 * value:.3g} mA" if abs(value) < 1.0 else f"{value:.3g} A"


def vector(i_d_a: float, i_q_a: float) -> str:
    """(i_d, i_q) in amperes; a zero has no minus."""
    d, q = round(float(i_d_a), 2) + 0.0, round(float(i_q_a), 2) + 0.0
    return f"({d:+.2f}, {q:+.2f}) A".replace("-", "−")


def resistance_page(found: ResistanceEstimate) -> str:
    """R_s, its course and its notes."""
    rows = [
        ("R_s", f"{found.value_ohm:.4g} Ω"),
        ("95 %", f"{found.low:.4g} to {found.high:.4g} Ω"),
        ("first reading", f"{found.first_ohm:.4g} Ω"),
        ("last reading", f"{found.last_ohm:.4g} Ω"),
        ("readings", str(len(found.readings))),
    ]
    told = [f"- {one_line(remark.text)}" for remark in found.remarks]
    return "\n\n".join(["# Stator resistance", table(("", ""), rows), *told])


def trust_page(maps: Mapping[str, FluxMapEstimate], lock: LockChecked | None) -> str:
    """The checks that need no truth, each method's, beside the paper's."""
    head = ("method", "crossings d", "crossings q", "parity d", "parity q", "reciprocity")
    rows = [
        (name, *_axes(found.checks.crossings), *_axes(found.checks.parity), percent(found.checks.reciprocity_percent))
        for name, found in maps.items()
    ]
    rows.append(("the paper's", *_axes(PAPER), "", "", ""))
    parts = [
        "# Can the map be trusted?",
        "In per cent of the rated flux. Crossings: what two current paths say where they meet. Parity: how far the "
        "map is from the symmetry in i_q that every such motor has. Small is good.",
        table(head, rows),
    ]
    if lock is not None:
        parts.append(f"**Rotor:** {one_line(lock.summary)}")
    for found in maps.values():
        parts += [f"- {one_line(remark.text)}" for remark in found.remarks]
    return "\n\n".join(parts)


def words_page(words: DiagnosisWords) -> str:
    """A diagnosis in its five slots."""
    told = ((title, getattr(words, slot)) for slot, title in SLOTS.items())
    return "\n\n".join(["# The diagnosis", *(f"## {title}\n\n{one_line(text)}" for title, text in told if text)])


def percent(value: float | None) -> str:
    """Two figures; what is below a hundred-thousandth is nothing."""
    if value is None:
        return "–"
    return f"{value:.2g} %" if value >= 1e-5 else "0 %"


def _axes(value: AxisPercent | None) -> tuple[str, str]:
    return ("–", "–") if value is None else (percent(value.d_percent), percent(value.q_percent))

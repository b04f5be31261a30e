"""The viewer's pages of text, in Markdown: what R_s is, whether to trust the map, a diagnosis in its five slots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun as rr

from orchestrator.formatting.explaining import search_lines
from orchestrator.formatting.names import PAPER_CROSSINGS, slots
from orchestrator.formatting.quantities import UNKNOWN, percent
from orchestrator.formatting.results import resistance, resistance_course
from orchestrator.formatting.sentences import markdown_table, one_line, typographic, visible
from plugins.streams.rerun._tape import Entry, When, entry
from protocols import AxisPercent, DiagnosisWords, FluxMapEstimate, LockChecked, ResistanceEstimate, SearchEvent


def page(path: str, when: When, text: str) -> Entry:
    """A page of Markdown, its sentences in printed characters."""
    text = visible(typographic(text))
    return entry(path, when, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), array_bytes=len(text))


def resistance_page(estimate: ResistanceEstimate) -> str:
    """R_s, its course and its notes."""
    rows = [
        ("R_s", resistance(estimate)),
        ("course", resistance_course(estimate)),
        ("readings", str(len(estimate.readings))),
    ]
    remarks = (f"- {one_line(remark.text)}" for remark in estimate.remarks)
    return "\n\n".join(["# Stator resistance", markdown_table(("", ""), rows), *remarks])


def trust_page(maps: Mapping[str, FluxMapEstimate], lock: LockChecked | None) -> str:
    """The self-consistency checks, each method's, beside the paper's."""
    head = ("method", "crossings d", "crossings q", "parity d", "parity q", "reciprocity")
    rows = [
        (name, *_axes(entry.checks.crossings), *_axes(entry.checks.parity), percent(entry.checks.reciprocity_percent))
        for name, entry in maps.items()
    ]
    rows.append(("the paper's", *_axes(PAPER_CROSSINGS), "", "", ""))
    parts = [
        "# Can the map be trusted?",
        "In per cent of the rated flux. Crossings: flux difference where two current paths cross. Parity: how far the "
        "map is from the symmetry in i_q that every such motor has. Small is good.",
        markdown_table(head, rows),
    ]
    if lock is not None:
        parts.append(f"**Rotor:** {one_line(lock.summary)}")
    parts += dict.fromkeys(f"- {one_line(remark.text)}" for one in maps.values() for remark in one.remarks)
    return "\n\n".join(parts)


def words_page(words: DiagnosisWords, reasons: Sequence[str] = ()) -> str:
    """A diagnosis in its five slots, the reasons of its verdict first."""
    why = ["\n".join(f"- {one_line(reason)}" for reason in reasons)] if reasons else []
    sections = (f"## {title.capitalize()}\n\n{one_line(text)}" for title, text in slots(words))
    return "\n\n".join(["# The diagnosis", *why, *sections])


def search_page(events: Sequence[SearchEvent]) -> str:
    """The moves of a search, a line each."""
    return "\n\n".join(["## Steps of the search", *(one_line(line) for line in search_lines(events))])


def _axes(value: AxisPercent | None) -> tuple[str, str]:
    return (UNKNOWN, UNKNOWN) if value is None else (percent(value.d_percent), percent(value.q_percent))

"""The diagnosis in words and tables: verdict, five slots, ladder, effects, look-alikes, the next experiment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from plugins.streams.report._text import NOT_MEASURED, number, plain, scaled, typographic
from protocols import JointEntry, ParameterValue

if TYPE_CHECKING:
    from orchestrator.diagnosis import SavedDiagnosis

VERDICTS = {
    "clean": ("Clean", "the model fits within the noise", "good"),
    "explained": ("Explained", "with the effects below, the model fits", "good"),
    "mostly_explained": ("Mostly explained", "the effects below account for most of the error", "fair"),
    "unknown_remains": ("Unknown remains", "no effect of the library accounts for what is left", "bad"),
}
SLOTS = {
    "where_it_fails": "Where it fails",
    "what_it_looks_like": "What it looks like",
    "likely_cause": "Likely cause",
    "if_added": "If added",
    "to_decide": "To decide",
}
MOST_JOINT = 7
SURE_Z = 4.0


@dataclass(frozen=True)
class Verdict:
    """The page's first line."""

    name: str
    text: str
    mood: str


@dataclass(frozen=True)
class Experiment:
    """What to measure next."""

    yaml: str
    reason: str


Rows = list[list[str]]


def verdict(found: SavedDiagnosis) -> Verdict:
    """The verdict, and what it means."""
    return Verdict(*VERDICTS[found.report.verdict])


def slots(found: SavedDiagnosis) -> Iterator[tuple[str, str]]:
    """The five slots, title and text."""
    for slot, title in SLOTS.items():
        yield title, typographic(getattr(found.words, slot) or NOT_MEASURED)


def ladder_rows(found: SavedDiagnosis) -> Rows:
    """The error after each added effect; the last line is the noise floor."""
    rows = [
        [
            "the model alone" if rung.added is None and not k else f"+ {plain(rung.added or 'refitted')}",
            number(rung.chi2),
            scaled(rung.rms_v, "V"),
            scaled(rung.heldout_rms_v, "V"),
            scaled(rung.current_rms_a, "A"),
        ]
        for k, rung in enumerate(found.report.ladder)
    ]
    floor = scaled(found.report.noise_floor.rms_v, "V")
    return [*rows, ["noise alone", "1", floor, floor, ""]]


def effect_rows(found: SavedDiagnosis) -> Rows:
    """Every parameter of every effect, with its interval and what the effect cannot be told from."""
    rows: Rows = []
    for effect in found.report.effects:
        for k, (name, value) in enumerate(effect.parameters.items()):
            unit = "" if value.unit == "1" else f" {typographic('1 ' + value.unit)[2:]}"
            first = k == 0
            rows.append(
                [
                    plain(effect.name) if first else "",
                    name,
                    f"{number(value.value)}{unit}",
                    _interval(value),
                    number(effect.relative_size, 3) if first else "",
                    (", ".join(map(plain, effect.twins)) or "nothing") if first else "",
                ]
            )
    return rows


def joint(found: SavedDiagnosis) -> Sequence[JointEntry]:
    """The first entries of the joint fit's ranking."""
    return found.report.joint[:MOST_JOINT]


def alike_rows(found: SavedDiagnosis) -> Rows:
    """What looks alike in this data set: ties in the search, and where search and joint fit disagree."""
    rows = [
        [plain(effect.name), ", ".join(map(plain, effect.twins)), "does as well in its place"]
        for effect in found.report.effects
        if effect.twins
    ]
    named = {effect.name for effect in found.report.effects}
    ranking = {entry.name: entry for entry in found.report.joint}
    for name, entry in ranking.items():
        if name not in named and abs(entry.z or 0.0) >= SURE_Z:
            told = f"in the joint fit z = {number(entry.z, 3)}, yet not worth a name"
            rows.append([plain(name), "–", told])
    for name in found.report.traces:
        if name not in ranking or abs(ranking[name].z or 0.0) < SURE_Z:
            rows.append([plain(name), "–", "a trace, below what deserves a name"])
    return rows


def leftover_rows(found: SavedDiagnosis) -> Rows:
    """Shapes of what is left, with their shares."""
    return [[plain(s.group), f"{100.0 * (s.share or 0.0):.0f} %"] for s in found.report.unexplained.shape]


def leftover_told(found: SavedDiagnosis) -> str:
    """How much of the error is left."""
    fraction = found.report.unexplained.fraction
    return "" if fraction is None else f"{number(100.0 * fraction, 2)} % of the first error, beyond the noise, is left."


def experiment(found: SavedDiagnosis) -> Experiment | None:
    """The next experiment as a stage of a procedure."""
    import yaml

    proposal = found.report.next_experiment
    if proposal is None:
        return None
    text = yaml.safe_dump({"stages": [proposal.stage]}, sort_keys=False, default_flow_style=None, width=60)
    first, second = map(plain, proposal.separates)
    return Experiment(text, f"Tells {first} from {second}, {number(proposal.minutes, 2)} min.")


def remarks(found: SavedDiagnosis) -> list[str]:
    """The diagnosis' own remarks."""
    return [typographic(remark.text) for remark in found.report.remarks]


def _interval(value: ParameterValue) -> str:
    return "" if value.low is None or value.high is None else f"{number(value.low)} to {number(value.high)}"

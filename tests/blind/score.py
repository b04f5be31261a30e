"""Is an answer right? The figures of the blind suite, each from a recording's truth and the JSON of its diagnosis.

A declared twin counts as the name; so do two effects that the campaign lacks the stage to tell apart.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.blind.examine import Answer
from tests.blind.hidden import SILENT, SLOW_LEG, Case
from tests.blind.removal import Removal

FLOORS = 3.0
"""A held-out error is stated to close only where it was this many noise floors before."""

FOUND_FIRST = "clutter: first name right"
"""Right is the name of what makes the largest part of the error by the plant itself, ..."""
AS_LARGE = 0.8
"""... or of what makes this part of that: which is larger depends on how kinds of readings are weighed."""
SIZEABLE = 0.1
"""Size, in units of the typical one, from which an effect of an ordinary bench counts as one to be found."""
ACCEPTED_PERCENT = 1.0
ACCEPTED = "usable or explained: map within 1 % of the rated flux"
ACCEPTED_VERDICTS = ("clean", "explained", "explained_in_another_form")
SWITCHED_PERCENT = 0.3
SWITCHED_MAP = "map within 0.3 % of the rated flux"
WITHIN = 0.2
"""Relative error up to which the dead time's parameters count as found on a bench that switches."""
FAINT_EDGES = (0.02, 0.05, 0.1, 0.2)
"""Sizes, in units of the typical one, between which faint effects are counted apart."""
FAINT_FIGURES = tuple(f"faint, {a:g} to {b:g} of typical: named" for a, b in itertools.pairwise(FAINT_EDGES))
FAINT_LISTED = tuple(f"{figure}, or listed as smaller" for figure in FAINT_FIGURES)

ABOUT_FOREIGN = {
    "foreign": "foreign: unknown flagged",
    "foreign_behind": "foreign behind 8 V of dead time: unknown flagged",
    "switched_foreign": "switched, one slow leg: reported within 20 %, or unknown flagged",
}
"""Figures of the classes that hide what no catalogue has."""
TWINS_HERE = {"voltage_delay", "current_filter"}
"""One injection frequency and one sampling phase cannot part these: with one left out, the other's name is right."""


@dataclass(frozen=True)
class Judgement:
    """What is right and wrong in one answer; a figure that does not apply is absent."""

    answer: Answer
    right: dict[str, bool] = field(default_factory=dict)
    closed: float | None = None
    """(before - after) / (before - floor) of the held-out error."""
    over_floor: float | None = None
    """Held-out error after, in noise floors."""
    intervals: tuple[tuple[str, bool], ...] = ()
    material: tuple[tuple[str, bool], ...] = ()
    """Effects that are material by the plant itself, where many are hidden: is each among the causes?"""
    sizeable: tuple[tuple[str, bool], ...] = ()
    """Hidden effects of an ordinary bench, switched or not, from `SIZEABLE` on: is each among causes and minor ones?"""
    stated: tuple[tuple[float, bool], ...] = ()
    """Probability of every effect that is listed, as a cause or as smaller, and whether it is there."""
    of_largest: float | None = None
    """Probability of the largest hidden effect of one, two, or clutter; nil where it is not listed."""

    @property
    def wrong(self) -> list[str]:
        """Names of the figures that this answer misses, aside from how much of what is faint is found."""
        return [name for name, right in self.right.items() if not right and name not in (*FAINT_FIGURES, *FAINT_LISTED)]


def judge(answer: Answer) -> Judgement:
    """Hold an answer against what was hidden."""
    case, report = answer.case, answer.report
    if case.nuisance in SILENT:
        numberless = report is None or (not report["effects"] and bool(report["notes"]))
        return Judgement(answer, {"too little to say: stated so": numberless})
    if report is None:
        return Judgement(answer, {"answered at all": False})
    right = _right(case, report)
    if case.kind == "clutter" and answer.removal is not None:
        right |= _of_clutter(answer.removal, report)
    if answer.delivered is not None and (answer.delivered["usable"] or report["verdict"] in ACCEPTED_VERDICTS):
        right[ACCEPTED] = answer.delivered["map_percent"] <= ACCEPTED_PERCENT
    closed, over_floor = _closed(report)
    in_catalogue = case.kind in ("single", "double", "clutter")
    intervals = tuple(_intervals(case, report)) if case.kind in ("single", "double") else ()
    listed = [(_or_twins(case, e), e.get("probability") or 0.0) for e in (*report["effects"], *report.get("minor", ()))]
    known = set().union(*(names for names, _ in listed))
    in_library = case.kind not in ("left_out", *ABOUT_FOREIGN) and case.nuisance is None
    there = {*(truth.name for truth in case.truths), *case.brought}
    hidden = case.truths if case.kind in ("ordinary", "switched") else ()
    if case.kind in ("switched", "switched_clean"):
        off = math.inf if answer.delivered is None else answer.delivered["map_percent"]
        right[f"{case.kind.replace('_', ', ')}: {SWITCHED_MAP}"] = off <= SWITCHED_PERCENT
    return Judgement(
        answer,
        right,
        closed if in_catalogue else None,
        over_floor if in_catalogue else None,
        intervals,
        tuple(_material(answer)),
        tuple((truth.name, truth.name in known) for truth in hidden if truth.size >= SIZEABLE),
        tuple((p, bool(names & there)) for names, p in listed) if in_library else (),
        max((p for names, p in listed if case.truths[0].name in names), default=0.0) if in_catalogue else None,
    )


def named_by(answer: Answer) -> dict[str, list[set[str]]]:
    """Names by method, those of the diagnosis first, each with what is as good a name here."""
    assert answer.report is not None
    ours = [_or_twins(answer.case, effect) for effect in answer.report["effects"]]
    others = {
        method: [_or_twins(answer.case, {"name": n, "twins": TWINS_HERE if n in TWINS_HERE else ()}) for n in names]
        for method, names in (answer.baselines or {}).items()
    }
    return {"fluxbench": ours, **others}


def exact(case: Case, found: Sequence[set[str]]) -> tuple[bool, int]:
    """Whether just the hidden effects are named, and how many names are of none of them."""
    names = [truth.name for truth in case.truths]
    return _matches(found, names), sum(not one & set(names) for one in found)


def stated(answer: Answer) -> str:
    """An answer in a line."""
    if answer.report is None:
        return f"refused: {answer.error}"
    report = answer.report
    names = [
        effect["name"] + (f" (or {', '.join(effect['twins'])})" if effect["twins"] else "")
        for effect in report["effects"]
    ]
    before, after = report["ladder"][0]["chi2"], report["ladder"][-1]["chi2"]
    chi2 = f"chi2 {_short(before)} to {_short(after)}" if len(report["ladder"]) > 1 else f"chi2 {_short(before)}"
    return f"{report['verdict'].replace('_', ' ')}: {', '.join(names) or 'no name'}; {chi2}"


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _right(case: Case, report: dict[str, Any]) -> dict[str, bool]:
    found = [_or_twins(case, effect) for effect in report["effects"]]
    listed = [*found, *(_or_twins(case, effect) for effect in report.get("minor", ()))]
    names = [truth.name for truth in case.truths]
    unknown = report["verdict"] == "unknown_remains"
    right: dict[str, bool] = {}
    if case.kind == "clean":
        right["clean: no false name"] = not listed
        right["clean: stated to be clean"] = report["verdict"] == "clean"
    elif case.kind == "single":
        right["single: first name right"] = bool(found) and names[0] in found[0]
    elif case.kind == "clutter":
        right["clutter: named, or listed as smaller"] = any(_alike(names[0], name) for name in set().union(*listed))
        right["clutter: no false name"] = all(one & set(names) for one in found)
    elif case.kind == "ordinary":
        right["ordinary: no false name"] = all(one & set(names) for one in found)
    elif case.kind == "switched_clean":
        right["switched, clean: no false name"] = not listed
        right["switched, clean: stated to be clean"] = report["verdict"] == "clean"
    elif case.kind == "switched":
        right["switched: no false name"] = all(one & {*names, *case.brought} for one in found)
        right |= _dead_time(case, report)
    elif case.kind == "double":
        right["double: exact set"] = _matches(found, names)
        right["double: first name right"] = bool(found) and bool(found[0] & set(names))
    elif case.kind == "left_out":
        right["left out: unknown flagged"] = unknown or (bool(found) and {names[0], *set.union(*found)} == TWINS_HERE)
    elif case.kind in ABOUT_FOREIGN:
        right[ABOUT_FOREIGN[case.kind]] = unknown or _in_the_rows(case, report) or _slow_leg_told(case, report)
    elif case.kind == "faint":
        at = sum(case.truths[0].size > edge for edge in FAINT_EDGES[1:-1])
        right[FAINT_FIGURES[at]] = bool(found) and names[0] in found[0]
        right[FAINT_LISTED[at]] = any(names[0] in one for one in listed)
        right["faint: no wrong name"] = all(names[0] in one for one in listed)
    elif case.kind == "nuisance":
        about = "nuisance: " + ("first name right" if names else "no false name")
        right[about] = (bool(found) and names[0] in found[0]) if names else not listed
    if case.kind == "single":
        right["single: exact set"] = _matches(found, names)
    if case.kind not in ("left_out", *ABOUT_FOREIGN):
        right["explained, and not flagged unknown"] = not unknown
    return right


def _of_clutter(removal: dict[str, dict[str, float]], report: dict[str, Any]) -> dict[str, bool]:
    """Whether the first name is of what does most to the error."""
    most = max(done["of_error"] for done in removal.values())
    largest = [name for name, done in removal.items() if done["of_error"] >= AS_LARGE * most]
    stated = [effect["name"] for effect in report["effects"][:1]]
    return {FOUND_FIRST: any(_alike(true, name) for true in largest for name in stated)}


def _material(answer: Answer) -> Iterable[tuple[str, bool]]:
    """Effects that count in an engineer's units by the plant, and whether each is named as a cause."""
    report = answer.report
    if report is None or answer.removal is None:
        return
    flux, voltage = (report["materiality"][f"{name}_percent"] / 100.0 for name in ("flux", "voltage"))
    causes = set().union(*(_or_twins(answer.case, effect) for effect in report["effects"]))
    for name, done in answer.removal.items():
        if Removal(**done).is_material(flux, voltage):
            yield name, any(_alike(name, stated) for stated in causes)


def _slow_leg_told(case: Case, report: dict[str, Any]) -> bool:
    """Whether the dead time's form says by how much longer leg a's is than the mean."""
    bridge, stated = case.bench.bridge, next((e for e in report["effects"] if e["name"] == "dead_time"), None)
    if case.foreign != SLOW_LEG or stated is None:
        return False
    longer = 3.0 * bridge.dead_a_s / (bridge.dead_a_s + 2.0 * bridge.dead_s) - 1.0
    leg = stated["parameters"].get("leg_a_longer")
    return leg is not None and abs(leg["value"] - longer) <= WITHIN * longer


def _dead_time(case: Case, report: dict[str, Any]) -> dict[str, bool]:
    """Whether what dead time is stated to cost at large currents is right, where it is sizeable."""
    (truth,) = (t for t in case.truths if t.name == "dead_time")
    if truth.size < SIZEABLE:
        return {}
    stated = [e["parameters"]["voltage_v"]["value"] for e in report["effects"] if e["name"] == truth.name]
    true = truth.parameters["voltage_v"]
    return {"switched: dead time within 20 %": bool(stated) and abs(stated[0] - true) <= WITHIN * true}


def _in_the_rows(case: Case, report: dict[str, Any]) -> bool:
    """Readings that repeat the one before are that, and nothing unknown."""
    return case.foreign == "lost_samples" and (report.get("convention") or {}).get("kind") == "rows_held"


def _or_twins(case: Case, effect: dict[str, Any]) -> set[str]:
    names = {effect["name"], *effect["twins"]}
    for pair, told_apart in (
        ({"current_offset", "voltage_bias"}, case.campaign.gates_off),
        ({"dead_time", "device_drop"}, case.campaign.second_pwm),
    ):
        if names & pair and not told_apart:
            names |= pair
    return names


def _alike(true: str, stated: str) -> bool:
    """Whether a name of the joint fit is the hidden one; of two identical columns it keeps either."""
    return stated == true or {stated, true} == TWINS_HERE


def _matches(found: Sequence[set[str]], names: Sequence[str]) -> bool:
    """Whether each found effect can be given one hidden name, with none left over."""
    if len(found) != len(names):
        return False
    if not found:
        return True
    return any(name in found[0] and _matches(found[1:], [n for n in names if n != name]) for name in names)


def _closed(report: dict[str, Any]) -> tuple[float | None, float | None]:
    floor = report["noise_floor"].get("heldout_rms_v") or report["noise_floor"]["rms_v"]
    before, after = report["ladder"][0]["heldout_rms_v"], report["ladder"][-1]["heldout_rms_v"]
    if None in (floor, before, after) or before <= FLOORS * floor:
        return None, None
    return (before - after) / (before - floor), after / floor


def _intervals(case: Case, report: dict[str, Any]) -> Iterable[tuple[str, bool]]:
    for truth in case.truths:
        for effect in report["effects"]:
            for name, true in truth.parameters.items() if effect["name"] == truth.name else ():
                value = effect["parameters"].get(name)
                if value is not None and value["low"] is not None and value["high"] is not None:
                    yield f"{truth.name}.{name}", value["low"] <= true <= value["high"]


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a proportion (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if count == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / count
    centre, spread = p + z * z / (2 * count), z * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2))
    scale = 1 + z * z / count
    return max(0.0, float((centre - spread) / scale)), min(1.0, float((centre + spread) / scale))

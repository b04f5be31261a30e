"""Score answers against the sealed truths of a set: `python scorer.py answers.jsonl truth/`.

This file needs numpy and nothing else, fluxbench neither. Each truth is checked against its seal in `benchmark.json`,
which lies beside the folder of truths, before a word of it is used. The rules: docs/benchmark.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

VERDICTS = ("clean", "explained", "unknown")
MAP_PERCENT = 1.0
"""Largest rms error of a usable map, of the rated flux."""
POINTS_SHARE = 0.6
"""Part of the asked points that a map has to have, to count as one."""
WORST = 10

Score = dict[str, Any]


class ScoreError(Exception):
    """What is wrong with a file, in one line."""


def read_answers(file: Path, units: dict[str, str] | None = None) -> dict[str, dict[str, Any]]:
    """Answers by recording, from a file of JSON lines.

    Parameters
    ----------
    units : dict, optional
        The names that may be used, each with the unit of its size; any by default.

    Raises
    ------
    ScoreError
        For a line that is not an answer.
    """
    answers: dict[str, dict[str, Any]] = {}
    for number, line in enumerate(_text(file).splitlines(), 1):
        if not line.strip():
            continue
        try:
            answer = json.loads(line)
            _check(answer, units)
        except ValueError as wrong:
            raise ScoreError(f"{file}: line {number}: {wrong}") from None
        if answer["id"] in answers:
            raise ScoreError(f"{file}: line {number}: a second answer about {answer['id']}")
        answers[answer["id"]] = answer
    return answers


def read_truths(folder: Path) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The set's manifest, and the truths by recording, each checked against its seal.

    Raises
    ------
    ScoreError
        For a truth that is missing or is not the one that was sealed.
    """
    manifest = _json(folder.parent / "benchmark.json")
    truths = {}
    for entry in manifest["recordings"]:
        file = folder / f"{entry['id']}.json"
        truth = _json(file)
        text = json.dumps(truth, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
        if hashlib.sha256(f"{entry['salt']}{text}".encode()).hexdigest() != entry["truth_sha256"]:
            raise ScoreError(f"{file}: not the truth that was sealed: its hash is not that of benchmark.json")
        truths[entry["id"]] = truth
    return manifest, truths


def score_one(answer: dict[str, Any] | None, truth: dict[str, Any], entry: dict[str, Any]) -> Score:
    """What is right and wrong in one answer; a figure that does not apply is None.

    Parameters
    ----------
    answer : dict or None
        None where there is none, which is wrong.
    entry : dict
        The recording's entry of the manifest.
    """
    effects, judged = truth["effects"], truth["verdict"] != "unknown"
    answer = answer or {"verdict": None}
    names = [named["name"] for named in answer.get("names", [])]
    immaterial = bool(effects) and all(effect["material"] is False for effect in effects)
    main = {name for effect in effects if effect["main"] for name in effect["accepted"]}
    there = {*truth["also"], *(name for effect in effects for name in effect["accepted"])}
    material = [effect for effect in effects if effect["material"]]
    sizes = [size for size in (_size(effect, answer) for effect in effects) if size is not None]
    map_percent, inside = _map(answer, truth, entry)
    usable = bool(answer.get("usable", False))
    score: Score = {
        "id": truth["id"],
        "class": truth["class"],
        "origin": truth["origin"],
        "motor": truth["motor"],
        "hidden": _described(truth),
        "stated": f"{answer['verdict'] or 'no answer'}: {', '.join(names) or 'no name'}",
        "answered": answer["verdict"] is not None,
        "verdict": answer["verdict"] == truth["verdict"] or (immaterial and answer["verdict"] == "clean"),
        "main": names[0] in main if names and judged and effects else None,
        "false": sum(name not in there for name in names) if judged else 0,
        "exact": _matches(names, [effect["accepted"] for effect in effects]) if judged and len(effects) < 3 else None,
        "found": (sum(bool(set(names) & set(e["accepted"])) for e in material), len(material)) if judged else (0, 0),
        "sizes": [off for off, _ in sizes if off is not None],
        "size_inside": [within for _, within in sizes if within is not None],
        "resistance_percent": _resistance(answer, truth),
        "resistance_inside": _inside(answer.get("resistance_ohm"), (truth["resistance_ohm"],) * 2),
        "map_percent": map_percent,
        "map_inside": inside,
        "usable": usable,
        "usable_though_off": usable and (map_percent is None or map_percent > MAP_PERCENT),
        "seconds": answer.get("seconds"),
    }
    if judged and effects and not immaterial and not names:
        score["main"] = False
    score["right"] = (
        score["verdict"] and score["main"] is not False and not score["false"] and not score["usable_though_off"]
    )
    return score


def score_all(
    answers: dict[str, dict[str, Any]], manifest: dict[str, Any], truths: dict[str, dict[str, Any]]
) -> list[Score]:
    """A score for each recording of the set."""
    return [score_one(answers.get(entry["id"]), truths[entry["id"]], entry) for entry in manifest["recordings"]]


def summary(scores: Sequence[Score]) -> dict[str, Any]:
    """The figures of some recordings."""
    mains = [score["main"] for score in scores if score["main"] is not None]
    found = [score["found"] for score in scores]
    return {
        "recordings": len(scores),
        "answered": sum(score["answered"] for score in scores),
        "right": sum(score["right"] for score in scores),
        "verdict_right": sum(score["verdict"] for score in scores),
        "main_right": sum(mains),
        "main_of": len(mains),
        "exact": sum(bool(score["exact"]) for score in scores),
        "exact_of": sum(score["exact"] is not None for score in scores),
        "false_names": sum(score["false"] for score in scores),
        "material_found": sum(hits for hits, _ in found),
        "material_of": sum(count for _, count in found),
        "size_error_percent": _median(100.0 * off for score in scores for off in score["sizes"]),
        "sizes_inside": sum(sum(score["size_inside"]) for score in scores),
        "sizes_of": sum(len(score["size_inside"]) for score in scores),
        "resistance_percent": _median(score["resistance_percent"] for score in scores),
        "resistance_inside": sum(bool(score["resistance_inside"]) for score in scores),
        "resistance_of": sum(score["resistance_inside"] is not None for score in scores),
        "map_percent": _median(score["map_percent"] for score in scores),
        "maps": sum(score["map_percent"] is not None for score in scores),
        "map_inside_percent": _median(score["map_inside"] for score in scores),
        "usable": sum(score["usable"] for score in scores),
        "usable_though_off": sum(score["usable_though_off"] for score in scores),
        "seconds": _median(score["seconds"] for score in scores),
    }


def grouped(scores: Sequence[Score]) -> list[tuple[str, str, dict[str, Any]]]:
    """Class, origin and figures: each class on own and outer plants, and all at the end."""
    groups = []
    for kind in (*sorted({score["class"] for score in scores}), "all"):
        for origin in ("own", "outer", *(("both",) if kind == "all" else ())):
            chosen = [s for s in scores if kind in ("all", s["class"]) and origin in ("both", s["origin"])]
            if chosen:
                groups.append((kind, origin, summary(chosen)))
    return groups


def worst(scores: Sequence[Score], count: int = WORST) -> list[Score]:
    """The answers that are furthest from right, of those that are wrong."""
    wrong = [score for score in scores if not score["right"] and score["answered"]]

    def badness(score: Score) -> tuple[float, float]:
        faults = 2 * score["usable_though_off"] + score["false"] + (score["main"] is False) + (not score["verdict"])
        return faults, score["map_percent"] or 0.0

    return sorted(wrong, key=badness, reverse=True)[:count]


def missed(score: Score) -> str:
    """What is wrong in one answer, in words."""
    words = [
        "verdict" if not score["verdict"] else "",
        "main name" if score["main"] is False else "",
        f"{score['false']} false" if score["false"] else "",
        "usable though off" if score["usable_though_off"] else "",
    ]
    return ", ".join(word for word in words if word)


HEAD = (
    "class", "plants", "right", "verdict", "main name", "exact set", "false names", "material found", "sizes inside",
    "size error, %", "R_s error, %", "R_s inside", "map error, %", "map inside, %", "usable", "though off", "s",
)  # fmt: skip
"""Of the table; errors and seconds are medians."""


def rows_of(scores: Sequence[Score]) -> list[tuple[str, ...]]:
    """The table's rows under `HEAD`."""

    def of(hits: int, count: int) -> str:
        return f"{hits} of {count}" if count else "-"

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"

    return [
        (
            kind, origin, of(f["right"], f["recordings"]), of(f["verdict_right"], f["recordings"]),
            of(f["main_right"], f["main_of"]), of(f["exact"], f["exact_of"]), str(f["false_names"]),
            of(f["material_found"], f["material_of"]), of(f["sizes_inside"], f["sizes_of"]),
            number(f["size_error_percent"]), number(f["resistance_percent"]),
            of(f["resistance_inside"], f["resistance_of"]), number(f["map_percent"]), number(f["map_inside_percent"]),
            of(f["usable"], f["maps"]), str(f["usable_though_off"]), number(f["seconds"]),
        )
        for kind, origin, f in grouped(scores)
    ]  # fmt: skip


def report(scores: Sequence[Score]) -> str:
    """The table by class, and the worst answers."""
    rows = [HEAD, *rows_of(scores)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    answered = sum(score["answered"] for score in scores)
    lines += ["", f"{answered} of {len(scores)} recordings answered; median errors; missing answers count as wrong."]
    lines += ["A dash: nothing to score, as no effect of the list is hidden, or the answer gives no size or no map."]
    furthest = worst(scores)
    if furthest:
        lines += ["", "The worst answers:"]
        for score in furthest:
            where = f"{score['id']} {score['class']}, {score['origin']}, {score['motor']}"
            lines.append(f"  {where}: hidden {score['hidden']}; stated {score['stated']}; missed: {missed(score)}")
    return "\n".join(lines)


def _described(truth: dict[str, Any]) -> str:
    largest = sorted(truth["effects"], key=lambda effect: -float(effect["relative"]))
    words = [f"{effect['name']} x{effect['relative']:.2g}" for effect in largest[:3]]
    words += [f"and {len(largest) - 3} smaller"] if len(largest) > 3 else []
    words += [truth["foreign"]] if truth["foreign"] else []
    return ", ".join(words) or "nothing"


def _size(effect: dict[str, Any], answer: dict[str, Any]) -> tuple[float | None, bool | None] | None:
    """Relative error of a stated size and whether its interval holds the truth; None where either states none."""
    stated: dict[str, Any] = next((n for n in answer.get("names", []) if n["name"] == effect["name"]), {})
    if effect["size"] is None or stated.get("size") is None:
        return None
    low, high = effect["size"]
    nearest = min(max(stated["size"], low), high)
    off = abs(stated["size"] - nearest) / abs(nearest) if nearest else None
    return off, _inside(stated, (low, high))


def _inside(stated: dict[str, Any] | None, true: tuple[float, float]) -> bool | None:
    if not stated or stated.get("low") is None or stated.get("high") is None:
        return None
    return bool(stated["low"] <= true[1] and stated["high"] >= true[0])


def _resistance(answer: dict[str, Any], truth: dict[str, Any]) -> float | None:
    stated = answer.get("resistance_ohm")
    return 100.0 * abs(stated["value"] / truth["resistance_ohm"] - 1.0) if stated else None


def _map(answer: dict[str, Any], truth: dict[str, Any], entry: dict[str, Any]) -> tuple[float | None, float | None]:
    """rms error of the flux over the asked points, of the rated flux [%], and the part inside the 95 % band [%]."""
    stated, true = answer.get("flux_wb") or [], np.array(truth["flux_wb"], dtype=float)
    if len(stated) != len(true):
        return None, None
    found = np.array([point or (np.nan, np.nan) for point in stated], dtype=float)
    given = np.isfinite(found).all(axis=1)
    if given.mean() < POINTS_SHARE:
        return None, None
    off = (found - true)[given]
    percent = 100.0 * float(np.sqrt(np.mean(off**2))) / entry["rated_flux_wb"]
    stds = answer.get("flux_std_wb") or []
    if len(stds) != len(true):
        return percent, None
    std = np.array([point or (np.nan, np.nan) for point in stds], dtype=float)[given]
    return percent, 100.0 * float(np.mean(np.abs(off) <= 1.96 * std))


def _matches(names: Sequence[str], accepted: Sequence[Iterable[str]]) -> bool:
    """Whether the names can be given one effect each, with none left over."""
    if len(names) != len(accepted):
        return False
    if not names:
        return True
    rest = range(len(accepted))
    return any(names[0] in accepted[k] and _matches(names[1:], [accepted[m] for m in rest if m != k]) for k in rest)


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _check(answer: Any, units: dict[str, str] | None) -> None:
    """Raise `ValueError` with what was expected, for what the score could not be computed from."""
    if not isinstance(answer, dict) or not isinstance(answer.get("id"), str):
        raise ValueError("expected an object with the recording's id")
    if answer.get("verdict") not in VERDICTS:
        raise ValueError(f"verdict: expected one of {', '.join(VERDICTS)}")
    names = answer.get("names", [])
    if not isinstance(names, list) or not all(isinstance(n, dict) and isinstance(n.get("name"), str) for n in names):
        raise ValueError('names: expected a list of objects like {"name": "..."}')
    for named in names:
        if units is not None and named["name"] not in units:
            raise ValueError(f"names: {named['name']} is none of the effects in benchmark.json")
        if units is not None and named.get("size") is not None and named.get("unit") != units[named["name"]]:
            raise ValueError(f"names: {named['name']}: expected the unit {units[named['name']]}")
        _check_numbers(named, ("size", "low", "high"), named["name"])
    if answer.get("resistance_ohm") is not None:
        if not isinstance(answer["resistance_ohm"], dict):
            raise ValueError('resistance_ohm: expected an object like {"value": 4.2, "low": 4.1, "high": 4.3}')
        _check_numbers(answer["resistance_ohm"], ("low", "high"), "resistance_ohm")
        if not _is_number(answer["resistance_ohm"].get("value")):
            raise ValueError("resistance_ohm: expected a number as its value")
    for name in ("flux_wb", "flux_std_wb"):
        points = answer.get(name) or []
        if not isinstance(points, list) or not all(_is_point(point) for point in points):
            raise ValueError(f"{name}: expected a list of [psi_d, psi_q] or null, one for each of points_a")
    _check_numbers(answer, ("seconds",), "the answer")


def _check_numbers(values: dict[str, Any], names: Iterable[str], where: str) -> None:
    for name in names:
        if values.get(name) is not None and not _is_number(values[name]):
            raise ValueError(f"{where}: {name}: expected a finite number")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_point(point: Any) -> bool:
    return point is None or (isinstance(point, list) and len(point) == 2 and all(_is_number(x) for x in point))


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as wrong:
        raise ScoreError(f"{file}: cannot be read: {getattr(wrong, 'strerror', None) or 'not a text'}") from None


def _json(file: Path) -> Any:
    try:
        return json.loads(_text(file))
    except ValueError:
        raise ScoreError(f"{file}: not a JSON file") from None


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(prog="scorer.py", description=__doc__)
    parser.add_argument("answers", type=Path, help="JSON lines, an answer each")
    parser.add_argument("truth", type=Path, help="the set's folder of truths")
    parser.add_argument("--answered", action="store_true", help="leave out the recordings without an answer")
    parser.add_argument("--json", action="store_true", help="print the score of each recording as one JSON object")
    wanted = parser.parse_args(words)
    try:
        scores = scores_of(wanted.answers, wanted.truth, answered=wanted.answered)
    except ScoreError as wrong:
        print(wrong, file=sys.stderr)
        return 2
    print(json.dumps({"all": summary(scores), "recordings": scores}, indent=1) if wanted.json else report(scores))
    return 0


def scores_of(answers: Path, truth: Path, *, answered: bool = False) -> list[Score]:
    """The scores of a file of answers; `answered` leaves out recordings without one. Raises `ScoreError`."""
    manifest, truths = read_truths(truth)
    units = {name: effect["unit"] for name, effect in manifest["effects"].items()}
    found = read_answers(answers, units)
    unknown = sorted(set(found) - set(truths))
    if unknown:
        raise ScoreError(f"{answers}: no recording of this set has the id {unknown[0]}")
    return [score for score in score_all(found, manifest, truths) if score["answered"] or not answered]


if __name__ == "__main__":
    raise SystemExit(main())

"""What of an answer is right, and the table of all."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from tests.laws.examine import Answer
from tests.laws.subjects import Subject, subject

NOISE = 1.2
"""Held-out error, in units of its noise, up to which a law leaves no more than noise."""
WRONG_MAP_PERCENT = 1.0
GOOD_MAP_PERCENT = 0.3
EXPLAINED = ("clean", "explained", "explained_in_another_form", "convention")


@dataclass(frozen=True)
class Judgement:
    """An answer beside its truth.

    Attributes
    ----------
    is_written : bool
        Whether a law was written.
    is_right : bool
        Whether all that was written has the hidden law's place, quantity and phase.
    is_left_to_noise : bool
    is_good_map : bool
        Whether the map is within `GOOD_MAP_PERCENT`, or stated not to be usable where it is not.
    is_usable_but_wrong : bool
        Whether a map that a user would trust is wrong: one that is stated to be usable, or that of an explained
        recording, or that with a law that leaves no more than noise.
    """

    answer: Answer
    is_written: bool
    is_right: bool
    is_left_to_noise: bool
    is_good_map: bool
    is_usable_but_wrong: bool

    @property
    def is_explained(self) -> bool:
        """Whether the library has explained it without a law."""
        return self.answer.verdict in EXPLAINED

    @property
    def is_open(self) -> bool:
        """Whether more than noise is left of what the library explains."""
        return not self.is_explained and self.answer.before > NOISE

    @property
    def hidden(self) -> Subject:
        return subject(self.answer.kind, self.answer.seed)

    def has_right_term(self, method: str) -> bool:
        """Whether the first term of another method has the law's place, quantity and phase."""
        return tuple(self.answer.baseline.get(method, {}).get("first", ())) in self.hidden.names

    def has_right_quantity(self) -> bool:
        """Whether gplearn's expression is one of the law's quantity alone."""
        used = set(self.answer.baseline.get("gplearn", {}).get("first", ()))
        return len(used) == 1 and used <= {_as_given(quantity) for _, quantity, _ in self.hidden.names}


def _as_given(quantity: str) -> str:
    """The quantity under which gplearn is given one: it knows no memory."""
    return "phase_currents" if quantity == "smooth_currents" else quantity


def judge(answer: Answer) -> Judgement:
    """Hold an answer against what was hidden."""
    names = subject(answer.kind, answer.seed).names
    written = answer.outcome == "law"
    right = written and {tuple(place) for place in answer.places} <= set(names)
    noise = written and answer.after <= NOISE
    error, usable = (answer.map_after, answer.usable_after) if written else (answer.map_before, answer.usable_before)
    trusted = usable or noise or (not written and answer.verdict in EXPLAINED)
    return Judgement(
        answer, written, right, noise, error is not None and (error <= GOOD_MAP_PERCENT or not trusted),
        bool(trusted) and error is not None and error > WRONG_MAP_PERCENT,
    )  # fmt: skip


HEADER = ("hidden law", "found", "held out, before and after", "map, before and after", "CPU, diagnose and discover")
METHODS = {"thresholded": "thresholded least squares", "pysindy": "pySINDy", "gplearn": "gplearn"}


def table(judgements: Sequence[Judgement], seed: int) -> str:
    """The page's tables: figures by class, and all answers."""
    compared = [m for m in METHODS if any(m in j.answer.baseline for j in judgements)]
    classes: dict[str, list[Judgement]] = {}
    for one in judgements:
        kind = one.answer.kind
        classes.setdefault(kind.split(":")[0].replace("_", " ") if ":" in kind else "laws", []).append(one)
    figures = [(name, *map(count, classes.values())) for name, count in FIGURES]
    counted = [("figure", *classes), *(row for row in figures if set(row[1:]) != {"-"})]
    rows = [_cells(one, compared) for one in judgements]
    return f"Seed {seed}.\n\n{_markdown(counted)}\n\n{_markdown([[*HEADER, *(METHODS[m] for m in compared)], *rows])}\n"


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    head, *rest = rows
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rest))


def _ratio(of: Callable[[Judgement], bool], among: Callable[[Judgement], bool]) -> Callable[[Sequence[Judgement]], str]:
    """How many are so, of those that count."""

    def count(judgements: Sequence[Judgement]) -> str:
        counted = [one for one in judgements if among(one)]
        return f"{sum(map(of, counted))} of {len(counted)}" if counted else "-"

    return count


def _cpu(judgements: Sequence[Judgement]) -> str:
    ratio = [one.answer.discover_s / one.answer.diagnose_s for one in judgements if one.is_open]
    return f"{statistics.median(ratio):.1f}, {max(ratio):.1f}" if ratio else "-"


def _leaves_noise(method: str) -> Callable[[Judgement], bool]:
    return lambda one: (one.answer.baseline.get(method, {}).get("after") or math.inf) <= NOISE


def _compared(method: str) -> Callable[[Judgement], bool]:
    return lambda one: one.is_open and method in one.answer.baseline


FIGURES: Sequence[tuple[str, Callable[[Sequence[Judgement]], str]]] = (
    ("more than noise is left without a law", _ratio(lambda j: j.is_open, lambda j: True)),
    ("of these: place, quantity and phase right", _ratio(lambda j: j.is_right, lambda j: j.is_open)),
    ("a law that is wrong", _ratio(lambda j: j.is_written and not j.is_right, lambda j: j.is_open)),
    (f"at most {NOISE} times the noise left", _ratio(lambda j: j.is_left_to_noise, lambda j: j.is_open)),
    (
        f"map within {GOOD_MAP_PERCENT} %, or stated not to be usable",
        _ratio(lambda j: j.is_good_map, lambda j: j.answer.map_before is not None),
    ),
    (
        f"trusted though more than {WRONG_MAP_PERCENT:g} % off",
        _ratio(lambda j: j.is_usable_but_wrong, lambda j: j.answer.map_before is not None),
    ),
    ("CPU of `discover` over that of `diagnose`: median, largest", _cpu),
    *(
        figure
        for method in ("thresholded", "pysindy")
        for figure in (
            (
                f"{METHODS[method]}: first term right",
                _ratio(partial(Judgement.has_right_term, method=method), _compared(method)),
            ),
            (
                f"{METHODS[method]}: at most {NOISE} times the noise left",
                _ratio(_leaves_noise(method), _compared(method)),
            ),
        )
    ),
    ("gplearn: an expression of the right quantity alone", _ratio(Judgement.has_right_quantity, _compared("gplearn"))),
)
"""Counts of the answers of a class."""


def _cells(one: Judgement, compared: Sequence[str]) -> list[str]:
    answer = one.answer
    laws = "; ".join(
        f"{' '.join(word.replace('_', ' ') for word in place if word)}: {formula}"
        for place, formula in zip(answer.places, answer.formulas, strict=True)
    )
    found = f"{'right' if one.is_right else 'wrong'}: {laws}" if one.is_written else _plain(answer.outcome)
    if one.is_explained:
        found = f"{_plain(answer.verdict)} by the library"
    elif not one.is_open:
        found = "no more than noise is left"
    maps = " / ".join("-" if x is None else f"{x:.2f} %" for x in (answer.map_before, answer.map_after))
    cells = [
        one.hidden.text if ":" not in answer.kind else f"{answer.kind} {one.hidden.text}",
        found,
        f"{answer.before:.2f} / {answer.after:.2f}" if not one.is_explained else "-",
        maps,
        f"{answer.diagnose_s:.0f} s / {answer.discover_s:.0f} s",
        *(_of_method(one, method) for method in compared),
    ]
    # A bar would end the cell.
    return [re.sub(r"[|](.+?)[|]", r"abs(\1)", cell) for cell in cells]


def _of_method(one: Judgement, method: str) -> str:
    found = one.answer.baseline.get(method)
    if found is None:
        return "-"
    if method == "gplearn":
        used = ", ".join(map(_plain, found["first"])) or "a constant"
        return f"{'right' if one.has_right_quantity() else 'wrong'}: of {used}; {100 * found['left']:.0f} % left"
    after = "-" if found["after"] is None else f"{found['after']:.2f}"
    return f"{'right' if one.has_right_term(method) else 'wrong'}, {found['terms']} terms, {after}"


def _plain(name: str) -> str:
    return name.replace("_", " ")

"""What of an answer is right, and the table of all."""

from __future__ import annotations

import re
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from tests.laws.examine import Answer
from tests.laws.subjects import Subject, subject

NOISE = 1.2
"""Held-out error, in units of its noise, up to which a law leaves no more than noise."""
WRONG_MAP_PERCENT = 1.0
GOOD_MAP_PERCENT = 0.3
EXPLAINED = ("clean", "explained", "explained_in_another_form")


@dataclass(frozen=True)
class Judgement:
    """An answer beside its truth.

    Attributes
    ----------
    is_written : bool
        Whether a law was written.
    is_right : bool
        Whether one law was written, at the hidden one's place, over its quantity, in its phase.
    is_left_to_noise : bool
    is_good_map : bool
        Whether the map is within `GOOD_MAP_PERCENT`, or stated not to be usable where it is not.
    is_usable_but_wrong : bool
        Whether a map that a user would trust is wrong: one that is stated to be usable, or that of an explained
        recording, or that with a law that leaves no more than noise.
    baseline_is_right : bool
        Whether the first term of thresholded least squares has the law's place, quantity and phase.
    """

    answer: Answer
    is_written: bool
    is_right: bool
    is_left_to_noise: bool
    is_good_map: bool
    is_usable_but_wrong: bool
    baseline_is_right: bool

    @property
    def is_explained(self) -> bool:
        """Whether the library has explained it without a law."""
        return self.answer.verdict in EXPLAINED

    @property
    def hidden(self) -> Subject:
        return subject(self.answer.kind, self.answer.seed)


def judge(answer: Answer) -> Judgement:
    """Hold an answer against what was hidden."""
    names = subject(answer.kind, answer.seed).names
    written = answer.outcome == "law"
    right = written and len(answer.places) == 1 and tuple(answer.places[0]) in names
    noise = written and answer.after <= NOISE
    error, usable = (answer.map_after, answer.usable_after) if written else (answer.map_before, answer.usable_before)
    trusted = usable or noise or (not written and answer.verdict in EXPLAINED)
    first = tuple(answer.baseline.get("first") or ())
    return Judgement(
        answer, written, right, noise, error is not None and (error <= GOOD_MAP_PERCENT or not trusted),
        bool(trusted) and error is not None and error > WRONG_MAP_PERCENT, first in names,
    )  # fmt: skip


HEADER = (
    "| hidden law | found | held out, before and after | map, before and after | CPU, diagnose and discover | "
    "thresholded least squares |"
)


def table(judgements: Sequence[Judgement], seed: int) -> str:
    """The page's table with a sentence on all."""
    rows = [HEADER, "| --- | --- | --- | --- | --- | --- |", *map(_row, judgements)]
    return "\n".join([f"Seed {seed}. {summary(judgements)}", "", *rows]) + "\n"


def summary(judgements: Sequence[Judgement]) -> str:
    """The counts in a few sentences."""
    count = len(judgements)
    ratio = [one.answer.discover_s / one.answer.diagnose_s for one in judgements]
    baseline = [one.answer.baseline["after"] for one in judgements if one.answer.baseline.get("after") is not None]
    return (
        f"Of {count} laws {sum(j.is_right for j in judgements)} have the right place, quantity and phase; "
        f"{sum(j.answer.verdict in EXPLAINED for j in judgements)} the library explains by itself; "
        f"{sum(j.is_left_to_noise for j in judgements)} leave at most {NOISE} times the noise; "
        f"of those written, {sum(j.is_written and not j.is_right for j in judgements)} wrong; "
        f"{sum(j.is_usable_but_wrong for j in judgements)} give a model to trust whose map is more than "
        f"{WRONG_MAP_PERCENT:g} % off. `discover` takes {statistics.median(ratio):.1f} times the CPU of `diagnose` "
        f"in the median, {max(ratio):.1f} at most. The first term of thresholded least squares is right in "
        f"{sum(j.baseline_is_right for j in judgements)}, and {sum(after <= NOISE for after in baseline)} of its sets "
        f"leave at most {NOISE} times the noise."
    )


def _row(one: Judgement) -> str:
    answer = one.answer
    laws = "; ".join(
        f"{' '.join(word.replace('_', ' ') for word in place if word)}: {formula}"
        for place, formula in zip(answer.places, answer.formulas, strict=True)
    )
    found = f"{'right' if one.is_right else 'wrong'}: {laws}" if one.is_written else _plain(answer.outcome)
    if answer.verdict in EXPLAINED:
        found = "the library explains it"
    maps = " / ".join("-" if x is None else f"{x:.2f} %" for x in (answer.map_before, answer.map_after))
    baseline = answer.baseline
    after = "-" if baseline.get("after") is None else f"{baseline['after']:.2f}"
    terms = f"{'right' if one.baseline_is_right else 'wrong'}, {baseline['terms']} terms, {after}" if baseline else "-"
    cells = (
        one.hidden.text if ":" not in answer.kind else f"{answer.kind} {one.hidden.text}",
        found,
        f"{answer.before:.2f} / {answer.after:.2f}" if answer.verdict not in EXPLAINED else "-",
        maps,
        f"{answer.diagnose_s:.0f} s / {answer.discover_s:.0f} s",
        terms,
    )
    # A bar would end the cell.
    row = " | ".join(re.sub(r"[|](.+?)[|]", r"abs(\1)", cell) for cell in cells)
    return f"| {row} |"


def _plain(name: str) -> str:
    return name.replace("_", " ")

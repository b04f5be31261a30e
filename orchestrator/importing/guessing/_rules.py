"""Derive a mapping's rules for segments from stretches of waveforms and from labels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Any

import numpy as np

from orchestrator.importing._source import Numbers
from orchestrator.importing.guessing._stages import Stretch
from protocols import SegmentStage

MAX_RULES = 1000
"""Largest number of stretches in a log of experiments."""
MAX_DIGITS = 10
"""Decimals of a second that are tried."""
_STAGES = {stage.value for stage in SegmentStage}

Rule = tuple[dict[str, Any], str]
"""An entry of `segments`, and its reason."""


def rules_by_time(found: Sequence[Stretch], time_s: Numbers) -> list[Rule]:
    """A rule for each stretch, from between its first row and the row before to the start of the next."""
    starts = [_between_rows(one.start_s, time_s) for one in found]
    rules = []
    for k, one in enumerate(found):
        span = {} if k == 0 else {"from_s": starts[k]}
        span |= {} if k == len(found) - 1 else {"to_s": starts[k + 1]}
        rules.append(({"stage": one.stage.value, **span}, _why(one)))
    return rules


def repeated_holds(rules: Sequence[Rule]) -> str:
    """That currents are held at distant times, perhaps at another PWM frequency; empty where they are not."""
    holds = [k for k, (rule, _) in enumerate(rules) if rule["stage"] == SegmentStage.RESISTANCE.value]
    again = [rules[k][0] for j, k in pairwise(holds) if k > j + 1]
    if not again:
        return ""
    start = f"from_s: {again[0]['from_s']}" if "from_s" in again[0] else f"label: {again[0].get('label')}"
    return (
        f"segments: currents are held again, after other stages ({start}): if at another PWM frequency, add "
        "`settings: {pwm_frequency_hz: ...}` there; without, one PWM frequency is assumed"
    )


def _between_rows(start_s: float, time_s: Numbers) -> float:
    """The shortest decimal in the middle half between a row and the one before: no rounding of stamps moves a row."""
    row = int(np.searchsorted(time_s, start_s))
    if row == 0:
        return start_s
    before_s = float(time_s[row - 1])
    low_s, high_s = (before_s + part * (start_s - before_s) for part in (0.25, 0.75))
    rounded = (math.floor(high_s * 10.0**digits) / 10.0**digits for digits in range(MAX_DIGITS))
    return next((x for x in rounded if x >= low_s), 0.5 * (low_s + high_s))


def rules_by_label(found: Mapping[str, Stretch | None]) -> list[Rule]:
    """A rule for each label that names a stage or has a stretch; labels of one stage with a prefix share one."""
    stages = {one: at.stage.value for one, at in found.items() if at is not None}
    stages |= {one: one for one in found if one in _STAGES}
    rules: list[Rule] = []
    for stage in dict.fromkeys(stages[one] for one in found if one in stages):
        labels = [one for one in found if stages.get(one) == stage]
        pattern = _pattern(labels, [one for one in found if one not in labels])
        if pattern is not None:
            rules.append(({"label": pattern, "stage": stage}, f"{len(labels)} labels: {_reason(labels[0], found)}"))
        else:
            rules += [({"label": one, "stage": stage}, _reason(one, found)) for one in labels]
    return rules


def _pattern(labels: Sequence[str], others: Sequence[str]) -> str | None:
    """The common prefix of three or more labels that no other label has."""
    first, last = min(labels), max(labels)  # all labels between these two share their prefix
    shared = next((k for k, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first))
    pattern = f"{first[:shared].rstrip('0123456789')}*"
    if len(labels) < 3 or len(pattern) < 2 or any(mark in pattern[:-1] for mark in "*?["):
        return None
    return None if any(fnmatchcase(other, pattern) for other in others) else pattern


def _reason(label: str, found: Mapping[str, Stretch | None]) -> str:
    stretch = found[label]
    return "the label says so" if label in _STAGES or stretch is None else _why(stretch)


def _why(one: Stretch) -> str:
    return {
        SegmentStage.GATES_OFF: "no voltage at all",
        SegmentStage.RESISTANCE: "currents that stand still",
        SegmentStage.CLASSICAL: "currents that move slowly",
        SegmentStage.INJECTION: f"the voltage has a line near {one.injected_hz or 0.0:.0f} Hz",
        SegmentStage.STEPS: "the voltage goes between plus and minus of one size",
    }[one.stage]

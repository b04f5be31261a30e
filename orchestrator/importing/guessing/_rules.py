"""Derive a mapping's rules for segments from stretches of waveforms and from labels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from orchestrator.importing.guessing._stages import Stretch
from protocols import SegmentStage

MAX_RULES = 1000
"""Largest number of stretches in a log of experiments."""
_STAGES = {stage.value for stage in SegmentStage}

Rule = tuple[dict[str, Any], str]
"""An entry of `segments`, and its reason."""


def rules_by_time(found: Sequence[Stretch]) -> list[Rule]:
    """A rule for each stretch, from its start to the start of the next."""
    rules = []
    for k, one in enumerate(found):
        span = {} if k == 0 else {"from_s": _just_before(one.start_s)}
        span |= {} if k == len(found) - 1 else {"to_s": _just_before(found[k + 1].start_s)}
        rules.append(({"stage": one.stage.value, **span}, _why(one)))
    return rules


def _just_before(time_s: float) -> float:
    """The time rounded down to a microsecond, so that rounding of a stamp's digits excludes no row."""
    return math.floor(time_s * 1e6) / 1e6


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

"""Assign a segment's id and its start on the experiment's clock."""

from __future__ import annotations

from bisect import bisect, insort
from collections import Counter

from orchestrator.importing._findings import Findings
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._splitting import RawSegment
from orchestrator.importing._timing import Stretch, at
from protocols import InputError


class Placing:
    """Assigns ids and starts in the order of the segments."""

    def __init__(self, mapping: ImportMapping, findings: Findings) -> None:
        self._mapping, self._findings = mapping, findings
        self._taken: set[str] = set()
        self._of_stage: Counter[str] = Counter()
        self._spans: list[tuple[float, float]] = []
        self._started_rules: set[int] = set()
        self._offset_s, self._file_is_new = 0.0, True

    def next_file(self) -> None:
        """Begin another file; its time stamps may restart."""
        self._offset_s, self._file_is_new = 0.0, True

    def place(self, raw: RawSegment, stretch: Stretch, samples: int, rate_hz: float) -> tuple[str, float]:
        """Id and start [s] of the next segment; raises `InputError` where it overlaps an earlier one."""
        start_s = self._start(raw, stretch, samples / rate_hz, 0.5 / rate_hz)
        insort(self._spans, (start_s, start_s + samples / rate_hz))
        self._file_is_new = False
        return self._id(raw), start_s

    def _id(self, raw: RawSegment) -> str:
        rule = self._mapping.segments[raw.rule]
        wanted = rule.id
        if wanted is None:
            number = self._of_stage[rule.stage.value]
            self._of_stage[rule.stage.value] += 1
            wanted = f"{rule.stage.value}-{number:03d}"
        segment_id, times = wanted, 1
        while segment_id in self._taken:
            times += 1
            segment_id = f"{wanted}.{times}"
        self._taken.add(segment_id)
        return segment_id

    def _start(self, raw: RawSegment, stretch: Stretch, seconds: float, slack_s: float) -> float:
        rule, stamp_s = self._mapping.segments[raw.rule], float(raw.time_s[stretch.rows[0]])
        if rule.start_s is not None and raw.rule not in self._started_rules:
            self._started_rules.add(raw.rule)
            self._offset_s = rule.start_s - stamp_s
        start_s = stamp_s + self._offset_s
        if self._overlaps(start_s, seconds, slack_s) and self._file_is_new and rule.start_s is None:
            # Each file has its own clock; the pause between files is unknown.
            self._offset_s = self._spans[-1][1] - stamp_s
            start_s = stamp_s + self._offset_s
            self._findings.note(
                "time_anew",
                f"{raw.path}: its time starts anew, placed right after the segment before; start_s of a segment says "
                "how long the pause was (windings cool in it)",
            )
        if self._overlaps(start_s, seconds, slack_s):
            raise InputError(
                str(raw.path),
                f"segments.{raw.rule}",
                f"{at(raw, stretch.rows[0])} lies within an earlier segment",
            )
        return start_s

    def _overlaps(self, start_s: float, seconds: float, slack_s: float) -> bool:
        # Spans are sorted and disjoint, so only the two neighbours can overlap.
        place = bisect(self._spans, (start_s, start_s))
        near = self._spans[max(place - 1, 0) : place + 1]
        return any(start_s < end - slack_s and start_s + seconds > begin + slack_s for begin, end in near)

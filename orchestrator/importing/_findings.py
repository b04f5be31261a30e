"""What an import found: refused with one line, or kept as a note; what counts as a finding is decided elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Set
from enum import StrEnum

from protocols import InputError


class Finding(StrEnum):
    """What looks wrong, and may yet be so: each can be accepted by its name."""

    CURRENT_UNIT = "current_unit"
    VOLTAGE_UNIT = "voltage_unit"
    BUS_UNIT = "bus_unit"
    ANGLE_UNIT = "angle_unit"
    TIME_UNIT = "time_unit"
    UNIT_IN_FILE = "unit_in_file"
    ZERO_SEQUENCE = "zero_sequence"
    SCALING = "scaling"
    POLARITY = "polarity"
    CONSTANT_CURRENT = "constant_current"
    CONSTANT_VOLTAGE = "constant_voltage"
    MOVING_ROTOR = "moving_rotor"
    TURNING_ROTOR = "turning_rotor"


class Findings:
    """Collects notes; of notes of one kind the first is kept, the others are counted."""

    def __init__(self, accepted: Set[Finding] = frozenset()) -> None:
        self._accepted = accepted
        self._first: dict[str, str] = {}
        self._count: dict[str, int] = {}
        self.dropped_rows: Counter[str] = Counter()
        """Rows of the files that went into no segment, by why."""

    def doubt(self, finding: Finding, where: str, field: str, text: str) -> None:
        """Refuse with an `InputError`, or note where the mapping accepts it."""
        if finding not in self._accepted:
            raise InputError(where, field, f"{text} (if it is really so: accept: [{finding}])")
        self.note(finding, f"{where}: {field}: {text} (accepted)")

    def note(self, kind: str, text: str) -> None:
        """Say it in the report."""
        self._first.setdefault(kind, text)
        self._count[kind] = self._count.get(kind, 0) + 1

    def notes(self) -> tuple[str, ...]:
        """One line a kind, in the order of their first appearance."""
        return tuple(
            text if self._count[kind] == 1 else f"{text}; the same {self._count[kind] - 1} times more"
            for kind, text in self._first.items()
        )

"""Findings of an import: each is an error of one line or a note; other modules decide which."""

from __future__ import annotations

from collections import Counter
from collections.abc import Set
from enum import StrEnum

from protocols import InputError


class Finding(StrEnum):
    """Suspicious data that may be correct; the mapping can accept each kind by its name."""

    CURRENT_UNIT = "current_unit"
    VOLTAGE_UNIT = "voltage_unit"
    BUS_UNIT = "bus_unit"
    ANGLE_UNIT = "angle_unit"
    TEMPERATURE_UNIT = "temperature_unit"
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
    """Collects notes; keeps the first note of each kind and counts the others."""

    def __init__(self, accepted: Set[Finding] = frozenset()) -> None:
        self._accepted = accepted
        self._first: dict[str, str] = {}
        self._count: dict[str, int] = {}
        self.dropped_rows: Counter[str] = Counter()
        """Number of rows that belong to no segment, by reason."""

    def doubt(self, finding: Finding, where: str, field: str, text: str) -> None:
        """Raise an `InputError`, or add a note where the mapping accepts the finding."""
        if finding not in self._accepted:
            raise InputError(where, field, f"{text} (if it is really so: accept: [{finding}])")
        self.note(finding, f"{where}: {field}: {text} (accepted)")

    def note(self, kind: str, text: str) -> None:
        """Add a note to the report."""
        self._first.setdefault(kind, text)
        self._count[kind] = self._count.get(kind, 0) + 1

    def notes(self) -> tuple[str, ...]:
        """One line per kind, in the order of first appearance."""
        return tuple(
            text if self._count[kind] == 1 else f"{text}; the same {self._count[kind] - 1} times more"
            for kind, text in self._first.items()
        )

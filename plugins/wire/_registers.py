"""The register table of `protocols/wire/registers.yaml`, and the drive's register file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal

from plugins.wire._codec import single
from plugins.wire._messages import AckStatus, PowerState


@dataclass(frozen=True)
class Register:
    """A register of the table."""

    index: int
    name: str
    access: Literal["read", "setup", "program"]
    text: str
    range: tuple[float, float]
    unit: str = ""
    whole: bool = False
    default: float = 0.0
    values: str | None = None
    """Name of the enumeration of its values."""
    bits: str | None = None
    """Name of the enumeration of its bits."""
    section: str = ""

    def refuses(self, value: float) -> AckStatus | None:
        """The reason why a value is invalid by the table, or None."""
        if not math.isfinite(value):
            return AckStatus.NOT_A_NUMBER
        # Bounds are rounded to singles, as values are, so that the bound itself is accepted.
        low, high = map(single, self.range)
        if not low <= value <= high or (self.whole and value != int(value)):
            return AckStatus.OUT_OF_RANGE
        return None


@cache
def registers() -> Mapping[str, Register]:
    """All registers by name, in order of their index."""
    import yaml

    text = (files("protocols") / "wire" / "registers.yaml").read_text(encoding="utf-8")
    by_name: dict[str, Register] = {}
    for section in yaml.safe_load(text):
        for entry in section["registers"]:
            low, high = entry.pop("range")
            register = Register(**entry, range=(float(low), float(high)), section=section["section"])
            by_name[register.name] = register
    return by_name


@cache
def _by_index() -> Mapping[int, Register]:
    return {register.index: register for register in registers().values()}


def register_index(name: str) -> int:
    """Index of a register; raises `KeyError`."""
    return registers()[name].index


def register_name(index: int) -> str | None:
    """Name of a register; None where the table has none of that index."""
    register = _by_index().get(index)
    return None if register is None else register.name


class RegisterFile:
    """The drive's registers: values, and checks of writes by the table.

    The drive checks its own limits and modes afterwards.
    """

    def __init__(self, own: Mapping[str, float] | None = None) -> None:
        self._values = {name: single(register.default) for name, register in registers().items()}
        for name, value in (own or {}).items():
            self[name] = value

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __setitem__(self, name: str, value: float) -> None:
        """Set a register from the drive's side, with any access."""
        self._values[registers()[name].name] = single(value)

    def values(self) -> Mapping[str, float]:
        """All values by name (a live view)."""
        return self._values

    def read(self, index: int) -> float | AckStatus:
        """The value, or `AckStatus.UNKNOWN`."""
        name = register_name(index)
        return AckStatus.UNKNOWN if name is None else self._values[name]

    def check(self, index: int, value: float, state: PowerState) -> AckStatus:
        """Status of a write by the table in this state, without writing."""
        register = _by_index().get(index)
        if register is None:
            return AckStatus.UNKNOWN
        if register.access == "read":
            return AckStatus.READ_ONLY
        closed = register.access == "setup" and state is not PowerState.DISARMED
        if closed or state in (PowerState.RUNNING, PowerState.STOPPING):
            return AckStatus.WRONG_STATE
        return register.refuses(value) or AckStatus.OK

    def write(self, index: int, value: float, state: PowerState) -> AckStatus:
        """Write a value if `check` permits it; returns the status."""
        status = self.check(index, value, state)
        if status is AckStatus.OK:
            self._values[_by_index()[index].name] = single(value)
        return status

"""The register table, and the drive's register file; the table itself is `protocols/wire/registers.yaml`."""

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
    """One register as the table has it."""

    index: int
    name: str
    access: Literal["read", "setup", "program"]
    text: str
    range: tuple[float, float]
    unit: str = ""
    whole: bool = False
    default: float = 0.0
    values: str | None = None
    """Name of the enumeration whose numbers it holds."""
    bits: str | None = None
    """Name of the enumeration whose bits it holds."""
    section: str = ""

    def refuses(self, value: float) -> AckStatus | None:
        """Why the table does not allow a value; None where it does."""
        if not math.isfinite(value):
            return AckStatus.NOT_A_NUMBER
        # The bounds go the way of the values: a bound that is no single must admit its own image.
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
    """The drive's registers: what they hold, and which writes the table allows.

    The drive's own reasons to refuse a value (past its limits, not in its modes) come after these.
    """

    def __init__(self, own: Mapping[str, float] | None = None) -> None:
        self._values = {name: single(register.default) for name, register in registers().items()}
        for name, value in (own or {}).items():
            self[name] = value

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __setitem__(self, name: str, value: float) -> None:
        """Set from the drive's side, whatever the access."""
        self._values[registers()[name].name] = single(value)

    def values(self) -> Mapping[str, float]:
        """All values by name: live, not a copy."""
        return self._values

    def read(self, index: int) -> float | AckStatus:
        """The value, or `unknown`."""
        name = register_name(index)
        return AckStatus.UNKNOWN if name is None else self._values[name]

    def check(self, index: int, value: float, state: PowerState) -> AckStatus:
        """Whether the table allows this write in this state; writes nothing."""
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
        """Write where the table allows it."""
        status = self.check(index, value, state)
        if status is AckStatus.OK:
            self._values[_by_index()[index].name] = single(value)
        return status

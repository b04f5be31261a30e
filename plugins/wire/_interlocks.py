"""Interlock inputs in the protocol: one bit each, in the order of their names in the drive's description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from protocols import DriveFault, FaultCause, InputError

INTERLOCKS_KEY = "interlocks"
"""Key of the description's line with their names, separated by commas."""
MAX_INTERLOCKS = 8
"""Interlock bits in a Measurement."""


def interlocks_line(names: Sequence[str]) -> str:
    """The description's line (device side); raises `InputError` for names that it cannot hold."""
    if len(names) > MAX_INTERLOCKS:
        raise InputError("wire", INTERLOCKS_KEY, f"{len(names)} inputs; the protocol has bits for {MAX_INTERLOCKS}")
    unfit = next((name for name in names if not name.strip() or "," in name or not name.isprintable()), None)
    if unfit is not None:
        raise InputError("wire", INTERLOCKS_KEY, f"{unfit!r} is not a name: expected printable text without a comma")
    return f"{INTERLOCKS_KEY}: {', '.join(name.strip() for name in names)}"


def interlocks_of(description: Mapping[str, str]) -> tuple[str, ...]:
    """Names by a drive's description (host side); raises `DriveFault` (wrong_data) where there are none."""
    names = tuple(name for part in description.get(INTERLOCKS_KEY, "").split(",") if (name := part.strip()))
    if not 0 < len(names) <= MAX_INTERLOCKS:
        message = (
            f"the drive has interlock inputs, but its description names {len(names)} (1 to {MAX_INTERLOCKS} expected)"
        )
        raise DriveFault(FaultCause.WRONG_DATA, message)
    return names


def open_interlocks(bits: int, names: Sequence[str]) -> tuple[str, ...]:
    """Names of the open inputs; an input without a name is listed by its number."""
    return tuple(names[k] if k < len(names) else f"input {k}" for k in range(bits.bit_length()) if bits >> k & 1)


def interlock_text(bits: int, names: Sequence[str]) -> str:
    """Message on open interlocks, with the action to take."""
    return f"interlock open: {', '.join(open_interlocks(bits, names)) or 'unknown'}; close it, and resume"

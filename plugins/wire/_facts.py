"""A drive's capabilities, facts and description: conversion to and from registers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import ValidationError

from plugins.wire._codec import single
from plugins.wire._interlocks import interlocks_of
from plugins.wire._messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, Capability
from plugins.wire._program import KINDS, Registers
from plugins.wire._registers import registers
from plugins.wire._rows import Channel, Scales
from protocols import Capabilities, DriveFault, DriveRefused, ExcitationKind, FaultCause

MAX_PWM_FREQUENCIES = 8


@dataclass(frozen=True)
class DriveFacts:
    """Properties of a drive beside `Capabilities`: memory, scales and modes."""

    bits: Capability
    channels: Channel
    scales: Scales
    memory_bytes: int
    block_bytes: int = 1020
    """Data bytes of a block on a serial line."""
    ripple_rate_max_hz: float = 0.0
    ripple_memory_rows: int = 0
    longest_program_s: float = 3600.0
    description: str = ""
    """Lines ``key: value`` in UTF-8."""


def capability_registers(capabilities: Capabilities, facts: DriveFacts) -> Registers:
    """The read-only registers of a drive (device side)."""
    pwm = (*capabilities.pwm_frequencies_hz[:MAX_PWM_FREQUENCIES], *([0.0] * MAX_PWM_FREQUENCIES))[:MAX_PWM_FREQUENCIES]
    return {
        "protocol_major": float(PROTOCOL_MAJOR),
        "protocol_minor": float(PROTOCOL_MINOR),
        "capability_bits": float(facts.bits),
        "description_bytes": float(len(facts.description.encode())),
        "sampling_frequency_hz": capabilities.sampling_frequency_hz,
        "pwm_frequency_hz": capabilities.pwm_frequency_hz,
        "dc_bus_voltage_v": capabilities.dc_bus_voltage_v,
        "voltage_delay_samples": capabilities.voltage_delay_samples,
        "max_current_a": capabilities.max_current_a,
        "max_voltage_v": capabilities.max_voltage_v,
        "watchdog_s": capabilities.watchdog_s or 0.0,
        "watchdog_covers": _mask(capabilities.watchdog_covers),
        "excitations": _mask(capabilities.excitations),
        "capture_channels": float(facts.channels),
        "capture_memory_bytes": float(facts.memory_bytes),
        "bulk_block_bytes": float(facts.block_bytes),
        **{f"pwm_choice_{k}": frequency for k, frequency in enumerate(pwm)},
        **facts.scales.as_registers(),
        "ripple_rate_max_hz": facts.ripple_rate_max_hz,
        "longest_program_s": facts.longest_program_s,
        "ripple_memory_rows": float(facts.ripple_memory_rows),
    }


def capabilities_of(
    values: Mapping[str, float], description: Mapping[str, str], longest_capture_s: float | None
) -> Capabilities:
    """A drive's capabilities from its registers and description (host side).

    `longest_capture_s` depends on memory, channels and the link, and is derived by the host.
    Raises `DriveRefused` for another major version, `DriveFault` (wrong_data) for inconsistent values.
    """
    if values["protocol_major"] != PROTOCOL_MAJOR:
        major = values["protocol_major"]
        raise DriveRefused(f"the drive speaks version {major:g} of the protocol, this host version {PROTOCOL_MAJOR}")
    _require_valid(values)
    values = {name: shortest_decimal(value) for name, value in values.items()}
    default_hz = values["pwm_frequency_hz"]
    bits = Capability(int(values["capability_bits"]))
    choices = {values[f"pwm_choice_{k}"] for k in range(MAX_PWM_FREQUENCIES)} - {0.0} | {default_hz}
    try:
        return Capabilities(
            name=description.get("name", "drive"),
            sampling_frequency_hz=values["sampling_frequency_hz"],
            pwm_frequency_hz=default_hz,
            pwm_frequencies_hz=tuple(sorted(choices)),
            dc_bus_voltage_v=values["dc_bus_voltage_v"],
            voltage_delay_samples=values["voltage_delay_samples"],
            max_current_a=values["max_current_a"],
            max_voltage_v=values["max_voltage_v"],
            longest_capture_s=longest_capture_s,
            excitations=_kinds(values["excitations"]),
            watchdog_s=values["watchdog_s"] or None,
            watchdog_covers=_kinds(values["watchdog_covers"]),
            has_brake=bool(bits & Capability.BRAKE),
            interlocks=interlocks_of(description) if bits & Capability.INTERLOCKS else (),
            motor_name=description.get("motor"),
        )
    except ValidationError as error:
        first = error.errors()[0]
        problem = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise DriveFault(FaultCause.WRONG_DATA, f"the drive's registers are inconsistent: {problem}") from None


def facts_of(values: Mapping[str, float]) -> DriveFacts:
    """The drive's facts from its registers, without the description (host side).

    Raises `DriveFault` (wrong_data) for a value outside the table's range.
    """
    _require_valid(values)
    return DriveFacts(
        bits=Capability(int(values["capability_bits"])),
        channels=Channel(int(values["capture_channels"])),
        scales=Scales.of(values),
        memory_bytes=int(values["capture_memory_bytes"]),
        block_bytes=int(values["bulk_block_bytes"]),
        ripple_rate_max_hz=values["ripple_rate_max_hz"],
        ripple_memory_rows=int(values["ripple_memory_rows"]),
        longest_program_s=values["longest_program_s"],
    )


def _require_valid(values: Mapping[str, float]) -> None:
    for register in registers().values():
        if register.access == "read" and register.name not in values:
            raise DriveFault(FaultCause.WRONG_DATA, f"register {register.name} was not read")
        status = register.refuses(values[register.name]) if register.name in values else None
        if status is not None:
            reason = status.name.lower().replace("_", " ")
            raise DriveFault(FaultCause.WRONG_DATA, f"register {register.name}: {values[register.name]:g} is {reason}")


def parse_description(data: bytes) -> dict[str, str]:
    """The description as a mapping; lines that are not ``key: value`` are skipped."""
    pairs = (line.partition(":") for line in data.decode("utf-8", "replace").splitlines())
    return {key.strip(): value.strip() for key, colon, value in pairs if colon}


def shortest_decimal(value: float) -> float:
    """The shortest decimal that rounds to this single: 0.2 for 0.20000000298.

    A limit of 5.6 A then does not exceed the 5.6 A that a drive sent.
    """
    if not math.isfinite(value):
        return value
    rounded = single(value)
    return next(short for digits in range(1, 10) if _rounds_to(short := float(f"{rounded:.{digits}g}"), rounded))


def _rounds_to(value: float, rounded: float) -> bool:
    try:
        return single(value) == rounded
    except OverflowError:  # rounded up beyond the largest single
        return False


def _mask(kinds: frozenset[ExcitationKind]) -> float:
    return float(sum(1 << bit for bit, kind in enumerate(KINDS) if kind in kinds))


def _kinds(mask: float) -> frozenset[ExcitationKind]:
    return frozenset(kind for bit, kind in enumerate(KINDS) if int(mask) >> bit & 1)

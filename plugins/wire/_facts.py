"""What a drive says of itself: capabilities and facts as registers, both ways, and its description."""

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
    """What a drive says of itself beyond `Capabilities`: its memory, scales and modes."""

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
    """UTF-8 lines ``key: value``."""


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
    """What the host tells the engine about a drive, from its registers and description.

    `longest_capture_s` follows from memory, channels and the link, which only the host knows.
    Raises `DriveRefused` for another major version, `DriveFault` (wrong_data) for numbers that make no drive.
    """
    if values["protocol_major"] != PROTOCOL_MAJOR:
        major = values["protocol_major"]
        raise DriveRefused(f"the drive speaks version {major:g} of the protocol, this host version {PROTOCOL_MAJOR}")
    _require_sound(values)
    values = {name: shortest_decimal(value) for name, value in values.items()}
    own = values["pwm_frequency_hz"]
    bits = Capability(int(values["capability_bits"]))
    choices = {values[f"pwm_choice_{k}"] for k in range(MAX_PWM_FREQUENCIES)} - {0.0} | {own}
    try:
        return Capabilities(
            name=description.get("name", "drive"),
            sampling_frequency_hz=values["sampling_frequency_hz"],
            pwm_frequency_hz=own,
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
        what = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise DriveFault(FaultCause.WRONG_DATA, f"the drive's registers describe no drive: {what}") from None


def facts_of(values: Mapping[str, float]) -> DriveFacts:
    """The rest of what a drive says of itself (host side); the description is read apart.

    Raises `DriveFault` (wrong_data) for a number that the table does not allow.
    """
    _require_sound(values)
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


def _require_sound(values: Mapping[str, float]) -> None:
    for register in registers().values():
        if register.access == "read" and register.name not in values:
            raise DriveFault(FaultCause.WRONG_DATA, f"register {register.name} was not read")
        status = register.refuses(values[register.name]) if register.name in values else None
        if status is not None:
            why = status.name.lower().replace("_", " ")
            raise DriveFault(FaultCause.WRONG_DATA, f"register {register.name}: {values[register.name]:g} is {why}")


def parse_description(data: bytes) -> dict[str, str]:
    """The description's lines; what is no ``key: value`` in UTF-8 is passed over."""
    pairs = (line.partition(":") for line in data.decode("utf-8", "replace").splitlines())
    return {key.strip(): value.strip() for key, colon, value in pairs if colon}


def shortest_decimal(value: float) -> float:
    """The number with fewest digits that has this single: 0.2 for 0.20000000298.

    So that a limit of 5.6 A is not above the 5.6 A that a drive sent.
    """
    if not math.isfinite(value):
        return value
    held = single(value)
    return next(short for digits in range(1, 10) if _is_held_as(short := float(f"{held:.{digits}g}"), held))


def _is_held_as(value: float, held: float) -> bool:
    try:
        return single(value) == held
    except OverflowError:  # rounded up past the largest single
        return False


def _mask(kinds: frozenset[ExcitationKind]) -> float:
    return float(sum(1 << bit for bit, kind in enumerate(KINDS) if kind in kinds))


def _kinds(mask: float) -> frozenset[ExcitationKind]:
    return frozenset(kind for bit, kind in enumerate(KINDS) if int(mask) >> bit & 1)

"""`fluxbench probe`: drives on this machine's ports and buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from plugins.command_line import AsJson, entry_point

if TYPE_CHECKING:
    from plugins.commands.probe._finding import Found, LinkName
    from protocols import DriveError

HELP_GROUP = "Measure"
"""Its place in the list of commands."""


NO_RIPPLE = "not demodulated on the drive"


def probe(
    serial: Annotated[
        list[str] | None,
        typer.Option("--serial", help="Look on this port (device, path, socket://host:port) only.", metavar="PORT"),
    ] = None,
    can: Annotated[
        list[str] | None,
        typer.Option("--can", help="Look on this bus only, as python-can names it.", metavar="INTERFACE:CHANNEL"),
    ] = None,
    baud_rate: Annotated[int, typer.Option(help="Baud rate of serial lines.")] = 921_600,
    bitrate: Annotated[int, typer.Option(help="Bit rate of CAN buses.")] = 1_000_000,
    fd: Annotated[bool, typer.Option("--fd", help="The buses are CAN FD.")] = False,
    as_json: AsJson = False,
) -> int:
    """Find drives on this machine's serial ports and CAN buses, and say what they can do. Moves nothing."""
    from plugins.commands.probe._finding import (
        Found,
        can_bus,
        found_on,
        links_of_this_machine,
        missing_package,
        serial_line,
    )
    from protocols import DriveError, InputError

    missing = next((port for port in serial or () if port.startswith("/") and not Path(port).exists()), None)
    if missing is not None:
        raise InputError("--serial", missing, "no such port; `fluxbench probe` alone looks on all")
    named = [serial_line(port, baud_rate) for port in serial or ()]
    named += [can_bus(*_split(bus), bitrate, fd) for bus in can or ()]
    drives: list[Found] = []
    silent: list[tuple[LinkName, str]] = []
    unsearched: dict[str, str] = {}
    for link in named or links_of_this_machine(baud_rate, bitrate, fd):
        try:
            for drive in found_on(link):
                if isinstance(drive, Found):
                    drives.append(drive)
                else:
                    silent.append((link, str(drive)))
        except DriveError as error:
            if (package := missing_package(error)) is None:
                silent.append((link, str(error) if named else _brief(error)))
            else:
                unsearched[link.text.partition(":")[0]] = package
    if named and not drives:
        lacking = [_not_searched(interface, package) for interface, package in unsearched.items()]
        raise DriveError("; ".join([*(why for _, why in silent), *lacking]))
    _print(drives, silent, unsearched, as_json)
    return 0


command = entry_point(probe, "Example: fluxbench probe")


def _brief(error: DriveError) -> str:
    """Why a link that nobody named has no drive: most are empty."""
    from protocols import DriveFault, FaultCause

    is_empty = isinstance(error, DriveFault) and error.cause is FaultCause.NO_ANSWER
    return "no answer" if is_empty else str(error)


def _split(bus: str) -> tuple[str, str]:
    from protocols import InputError

    interface, colon, channel = bus.partition(":")
    if not colon or not interface or not channel:
        raise InputError("probe", "--can", f"expected INTERFACE:CHANNEL, got {bus!r}")
    return interface, channel


def _print(
    drives: Sequence[Found], silent: Sequence[tuple[LinkName, str]], unsearched: Mapping[str, str], as_json: bool
) -> None:
    """Print what was found, or not; `unsearched` has the missing package of each interface that was not searched."""
    from orchestrator.formatting.sentences import cut, one_line, visible

    if as_json:
        import json

        looked = [{"link": link.text, "why": why} for link, why in silent]
        found = [drive.as_json() for drive in drives]
        print(visible(json.dumps({"drives": found, "no_drive": looked, "not_searched": unsearched})))
        return
    for drive in drives:
        print("\n".join(one_line(cut(line)) for line in _description(drive)))
    if not drives:
        print("No drive answered.")
    for link, why in silent:
        print(one_line(cut(f"no drive on {link.text}: {why}")))
    for interface, package in unsearched.items():
        print(_not_searched(interface, package))


def _not_searched(interface: str, package: str) -> str:
    return f"{interface}: not searched, Python package {package} is missing"


def _description(drive: Found) -> list[str]:
    from orchestrator.formatting.quantities import quantity, vector

    own, status = drive.capabilities, drive.status
    by_default = (921_600, 1_000_000, False)  # node 0 is among them
    named = {key: value for key, value in drive.settings.items() if key != "name" and value not in by_default}
    settings = " ".join(f"--set drive.{k}={str(v).lower() if isinstance(v, bool) else v}" for k, v in named.items())
    firmware, ripple_hz = drive.description.get("firmware", "not given"), drive.registers["ripple_rate_max_hz"]
    lines = [
        f"{own.name} on {drive.link.text}" + (f" node {drive.node}" if drive.node else ""),
        f"  motor      {own.motor_name or 'not given'}",
        f"  firmware   {firmware}",
        f"  sampling   {own.sampling_frequency_hz:g} Hz, PWM {', '.join(f'{f:g}' for f in own.pwm_frequencies_hz)} Hz",
        f"  reach      {own.max_current_a:g} A, {own.max_voltage_v:g} V of a bus of {own.dc_bus_voltage_v:g} V",
        f"  programs   {', '.join(sorted(own.excitations))}",
        f"  watchdog   {f'{own.watchdog_s:g} s' if own.watchdog_s else 'NONE: no dead man'}",
        f"  memory     {drive.registers['capture_memory_bytes']:g} bytes of capture",
        f"  ripple     {f'demodulated on the drive, up to {ripple_hz:g} rows a second' if ripple_hz else NO_RIPPLE}",
    ]
    if status is None:
        lines.append("  telemetry  none came")
    else:
        current = "" if drive.i_dq_a is None else f", i_dq {vector(*drive.i_dq_a)}"
        lines.append(f"  now        {status.state.name.lower()}, bus {quantity(status.v_dc, 'V', 4)}{current}")
        if drive.faults:
            lines.append(f"  faults     {', '.join(drive.faults)}")
    return [*lines, f"  use it     fluxbench run PROCEDURE --drive {drive.settings['name']} {settings}"]

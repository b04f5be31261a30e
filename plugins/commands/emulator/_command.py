"""`fluxbench emulate`: an emulated drive on a real line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from plugins.command_line import entry_point
from plugins.commands.emulator._bounds import BOUNDS

if TYPE_CHECKING:
    from plugins.commands.emulator._ports import Port
    from plugins.drives.simulated import SimulatedOptions
    from protocols import Motor

HELP_GROUP = "Try and prove"
"""Its place in the list of commands."""


Part = Annotated[
    float,
    typer.Option(min=0.0, max=1.0, metavar="P", help="Part of the frames that this happens to, in each direction."),
]
_NOT_HERE = {
    "watchdog_s": "use --watchdog",
    "realtime_factor": "use --speed",
    "longest_capture_s": "it follows from --memory-rows",
    "gap_s": "the emulated drive runs in real time",
    "faults": "kill, stop or disturb the emulator instead",
}


def emulate(
    serial: Annotated[
        Path | None, typer.Option("--serial", help="Make a pseudo-terminal and link it here.", metavar="PATH")
    ] = None,
    can: Annotated[
        str | None,
        typer.Option(
            "--can",
            metavar="INTERFACE:CHANNEL",
            help="Join this bus, as python-can names it. serial:PATH makes the terminal that its interface opens.",
        ),
    ] = None,
    node: Annotated[int, typer.Option(min=0, max=3, help="Node number on the CAN bus.")] = 0,
    fd: Annotated[bool, typer.Option("--fd", help="The bus is CAN FD.")] = False,
    bitrate: Annotated[int, typer.Option(help="Bit rate of the CAN bus.")] = 1_000_000,
    data_bitrate: Annotated[int, typer.Option(help="Bit rate of CAN FD's data phase.")] = 5_000_000,
    can_settings: Annotated[
        list[str] | None, typer.Option("--can-set", metavar="K=V", help="A further argument of python-can's interface.")
    ] = None,
    motor: Annotated[
        Path | None,
        typer.Option(
            help="Motor file; its section `drive` describes the plant. By default those of `demo`.", metavar="FILE"
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="K=V", help="An option of the simulated drive: plant.resistance_ohm=5."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed: noise, rest angle, lost frames.")] = 1,
    memory_rows: Annotated[int, typer.Option(min=1, help="Rows of four channels in the capture memory.")] = 8192,
    ring: Annotated[bool, typer.Option(help="Overwrite the oldest rows; else a longer capture is refused.")] = True,
    rate: Annotated[
        float | None,
        typer.Option(min=1.0, metavar="BYTES/S", help="Throughput of the line (a CAN bus: bit rate / 8)."),
    ] = None,
    watchdog: Annotated[float | None, typer.Option(min=0.0, help="Watchdog time [s]; 0: no watchdog.")] = None,
    longest_program: Annotated[float, typer.Option(min=0.0, help="Longest program that is accepted [s].")] = 3600.0,
    speed: Annotated[str, typer.Option(help="Simulated seconds per second, or max.", metavar="RATIO")] = "1",
    log: Annotated[
        Path | None, typer.Option(help="Log events to this file, one JSON object a line.", metavar="FILE")
    ] = None,
    state: Annotated[
        Path | None, typer.Option(help="Keep the plant's state in this directory.", metavar="FOLDER")
    ] = None,
    open_interlocks: Annotated[
        Path | None,
        typer.Option(help="File with the open interlocks, one of --set 'interlocks=[door]' a line.", metavar="FILE"),
    ] = None,
    priority: Annotated[bool, typer.Option(help="Ask for real-time priority, for a punctual watchdog.")] = True,
    drop: Part = 0.0,
    duplicate: Part = 0.0,
    reorder: Part = 0.0,
    corrupt: Part = 0.0,
) -> int:
    """Emulate a drive with the simulated motor on a serial line or a CAN bus, until SIGINT or SIGTERM."""
    from plugins.commands.emulator._device import Device
    from plugins.commands.emulator._emulation import LinkSettings, run_emulation
    from plugins.commands.emulator._line import Losses
    from plugins.commands.emulator._log import JsonLines, no_log
    from plugins.commands.emulator._programs import DeviceSettings
    from protocols import InputError

    if (serial is None) == (can is None):
        raise InputError("emulate", "", "give either --serial PATH or --can INTERFACE:CHANNEL")
    options, nameplate = _plant(motor, settings or (), watchdog)
    pace = _speed(speed)
    journal = no_log if log is None else JsonLines(log)
    own = DeviceSettings(
        memory_rows=memory_rows,
        ring=ring,
        longest_program_s=longest_program,
        speed=pace,
        directory=state,
        interlocks=open_interlocks,
    )
    port = _port(serial, can, node, fd, bitrate, data_bitrate, can_settings or ())
    device = Device(options, nameplate, seed, port.layout, own, journal)
    losses = Losses(drop, duplicate, reorder, corrupt)
    run_emulation(device, port, LinkSettings(rate, losses, seed, priority), journal)
    return 0


command = entry_point(emulate, "Example: fluxbench emulate --serial /tmp/fluxbench")


def _plant(motor: Path | None, settings: Sequence[str], watchdog: float | None) -> tuple[SimulatedOptions, Motor]:
    """Plant and nameplate of the procedure `demo` or a motor file, with the settings of the command line."""
    from orchestrator.config import read_procedure
    from orchestrator.registry.plugins import make_options
    from plugins.drives.simulated import SimulatedDrive, SimulatedOptions
    from protocols import InputError

    for setting in settings:
        name = setting.partition("=")[0].strip()
        if name in _NOT_HERE:
            raise InputError(f"--set {setting}", name, _NOT_HERE[name])
    loaded = read_procedure("demo", motor=motor, overrides=[f"drive.{setting}" for setting in settings])
    procedure = loaded.procedure
    if procedure.drive.name != SimulatedDrive.name:
        raise InputError(str(motor), "drive.name", f"expected {SimulatedDrive.name}, got {procedure.drive.name}")
    with loaded.locating_errors():
        options = make_options(SimulatedDrive, procedure.drive.options, "drive")
    assert isinstance(options, SimulatedOptions)
    own: dict[str, Any] = {} if options.overload_s is not None else {"overload_s": BOUNDS.overload_limit_s}
    if watchdog is not None:
        own["watchdog_s"] = watchdog or None
    return options.model_copy(update=own), procedure.motor


def _speed(text: str) -> float | None:
    from protocols import InputError

    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.01 <= speed <= 1e4:
        raise InputError("--speed", "", f"expected a number from 0.01 to 10000, or max; got {text}")
    return speed


def _port(
    serial: Path | None, can: str | None, node: int, fd: bool, bitrate: int, data_bitrate: int, settings: Sequence[str]
) -> Port:
    from plugins.commands.emulator._can_ports import CanPort, SerialCanPort
    from plugins.commands.emulator._ports import PtyPort
    from protocols import InputError

    if serial is not None:
        return PtyPort(serial)
    interface, colon, channel = (can or "").partition(":")
    if not colon or not interface or not channel:
        raise InputError("--can", can or "", "expected INTERFACE:CHANNEL, as in udp_multicast:239.74.163.2")
    if interface == "serial":
        if fd:
            raise InputError("--can", interface, "python-can's serial interface is classic only")
        return SerialCanPort(Path(channel), node)
    further: dict[str, Any] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals:
            raise InputError("--can-set", setting, "expected key=value")
        further[key.strip()] = _plain(value)
    return CanPort(interface, channel, node=node, fd=fd, bitrate=bitrate, data_bitrate=data_bitrate, settings=further)


def _plain(text: str) -> str | int | float | bool:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text

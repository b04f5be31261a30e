"""The emulator on a bus within this process, for tests with several nodes or with somebody who listens."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from plugins.commands.emulator import Device, DeviceSettings
from plugins.commands.emulator._can_ports import CanPort
from plugins.commands.emulator._emulation import Emulation, LinkSettings
from plugins.commands.emulator._log import no_log
from plugins.commands.emulator._ports import Port
from plugins.drives.can import CanDrive, CanOptions
from plugins.drives.simulated import SimulatedOptions
from protocols import DriveSetup, Motor
from tests.support.tiny import MOTOR

WATCHDOG_S = 1.0


@contextmanager
def emulated(channel: str, node: int = 0, *, fd: bool = True) -> Iterator[Device]:
    """An emulated drive in real time; its description's serial number is 10 + node."""
    port = CanPort("virtual", channel, node=node, fd=fd, bitrate=1_000_000, data_bitrate=5_000_000, settings={})
    with emulated_on(port, 10 + node) as device:
        yield device


@contextmanager
def emulated_on(port: Port, seed: int, speed: float | None = 1.0) -> Iterator[Device]:
    """An emulated drive on this port, from a thread of this process."""
    options = SimulatedOptions.model_validate({"watchdog_s": WATCHDOG_S})
    device = Device(options, Motor(**MOTOR), seed, port.layout, DeviceSettings(speed=speed))
    emulation, over = Emulation(device, port, LinkSettings(priority=False), no_log), threading.Event()
    port.publish()

    def run() -> None:
        while not over.is_set():
            emulation.turn()

    thread = threading.Thread(target=run, name=f"emulated {seed}", daemon=True)
    thread.start()
    try:
        yield device
    finally:
        over.set()
        thread.join()
        port.close()


@contextmanager
def connected(channel: str, node: int = 0, *, fd: bool = True, **options: object) -> Iterator[CanDrive]:
    """A host of that drive; bears silence for longer than on a bench, for both ends share one process."""
    own = CanOptions.model_validate(
        {"interface": "virtual", "channel": channel, "node": node, "fd": fd, "telemetry_period_s": 0.3} | options
    )
    drive = CanDrive(DriveSetup(motor=Motor(**MOTOR), options=own, seed=1))
    try:
        drive.connect()
        yield drive
    finally:
        drive.close()

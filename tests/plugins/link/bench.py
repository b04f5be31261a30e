"""Drives of both kinds connected to the small device, with a beating heart where one is needed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from plugins.drives.can import CanDrive, CanOptions
from plugins.drives.serial import SerialDrive, SerialOptions
from plugins.link import LinkDrive
from protocols import Capture, DriveSetup, Excitation, Limits, Motor
from tests.plugins.link.device import Device, Script, on_a_bus, on_a_pty
from tests.support.tiny import MOTOR

LIMITS = Limits(current_a=4.5, voltage_v=150.0, energy_j=100.0)
LINKS = ("serial", "can", "can fd")
_channels = count()


@dataclass
class Bench:
    """A device, and a drive that is not connected yet."""

    device: Device
    drive: LinkDrive

    @property
    def script(self) -> Script:
        return self.device.script


@contextmanager
def bench(link: str = "serial", script: Script | None = None, **options: Any) -> Iterator[Bench]:
    """The device behind this link; the drive is closed at the end.

    Silence is borne three times as long as on a bench, unless a test is about silence.
    """
    options = {"telemetry_period_s": 0.15} | options
    with ExitStack() as cleanup:
        if link == "serial":
            device, path = cleanup.enter_context(on_a_pty(script))
            drive: LinkDrive = SerialDrive(_setup(SerialOptions(port=path, **options)))
        else:
            channel, fd = f"bench-{next(_channels)}", link.endswith("fd")
            device = cleanup.enter_context(on_a_bus(channel, fd, script))
            own = CanOptions(interface="virtual", channel=channel, fd=fd, **options)
            drive = CanDrive(_setup(own))
        cleanup.callback(drive.close)
        yield Bench(device, drive)


def _setup(options: Any) -> DriveSetup:
    return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)


@contextmanager
def beating(drive: LinkDrive) -> Iterator[Callable[[], None]]:
    """A heart for the drive; gives what stops it."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(0.04):
            drive.heartbeat()

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()

    def stop() -> None:
        over.set()
        thread.join()

    try:
        yield stop
    finally:
        stop()


@contextmanager
def armed(link: str = "serial", script: Script | None = None, **options: Any) -> Iterator[Bench]:
    """Connected, armed and beating."""
    with bench(link, script, **options) as b:
        b.drive.connect()
        with beating(b.drive):
            b.drive.arm(LIMITS)
            yield b


def taken(drive: LinkDrive, excitation: Excitation) -> Capture:
    """All rows of an excitation as one capture."""
    blocks = [block for block in drive.execute(excitation) if len(block)]
    return Capture(
        start_s=blocks[0].start_s,
        sampling_frequency_hz=blocks[0].sampling_frequency_hz,
        i_ab=np.concatenate([block.i_ab for block in blocks]),
        v_ab=np.concatenate([block.v_ab for block in blocks]),
        v_dc=np.concatenate([block.v_dc for block in blocks]),
    )

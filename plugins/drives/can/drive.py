"""The drive `can`: the drive protocol of `plugins/wire` on a CAN bus, by python-can."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import BaseModel, Field

from plugins.link import LinkDrive, LinkOptions, Port
from plugins.wire import MAX_NODES
from protocols import DriveSetup

BitRate = Annotated[int, Field(ge=10_000)]


class CanOptions(LinkOptions):
    """Options of the drive `can`."""

    interface: Annotated[str, Field(min_length=1)] = "socketcan"
    """python-can's name of the interface."""
    channel: Annotated[str, Field(min_length=1, examples=["can0"])]
    node: Annotated[int, Field(ge=0, lt=MAX_NODES)] = 0
    """Node number of the drive on the bus."""
    bitrate: BitRate = 1_000_000
    fd: bool = False
    """CAN FD: captures are sent in frames of 64 bytes."""
    data_bitrate: BitRate = 5_000_000
    settings: Mapping[str, str | int | float | bool] = Field(default_factory=dict)
    """Further arguments of python-can's interface (see its documentation)."""


class CanDrive(LinkDrive):
    """A drive on a CAN bus; implements `Drive`, and `ResumableDrive` for its clock."""

    name: ClassVar[str] = "can"
    Options: ClassVar[type[BaseModel]] = CanOptions

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._bus: CanOptions = setup.options

    def open_port(self) -> Port:
        from plugins.drives.can._port import CanPort, classic_rate
        from plugins.drives.can._slcan import SETTINGS, SlcanPort

        bus = self._bus
        if bus.interface == "slcan" and not bus.fd and bus.settings.keys() <= SETTINGS:
            rate = classic_rate(bus.bitrate)
            return SlcanPort(bus.channel, bus.bitrate, rate, node=bus.node, settings=bus.settings)
        return CanPort(
            bus.interface,
            bus.channel,
            bus.bitrate,
            node=bus.node,
            fd=bus.fd,
            data_bitrate=bus.data_bitrate,
            settings=bus.settings,
        )

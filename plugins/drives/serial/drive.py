"""The drive `serial`: the drive protocol of `plugins/wire` on a serial line."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import BaseModel, Field

from plugins.link import LinkDrive, LinkOptions, Port
from protocols import DriveSetup


class SerialOptions(LinkOptions):
    """Options of the drive `serial`."""

    port: Annotated[str, Field(min_length=1, examples=["/dev/ttyUSB0"])]
    """A device, the path of a pseudo-terminal, or socket://host:port."""
    baud_rate: Annotated[int, Field(ge=1200)] = 921_600
    dtr: bool = True
    """Level of the DTR line, set before opening."""


class SerialDrive(LinkDrive):
    """A drive on a serial line; implements `Drive`, and `ResumableDrive` for its clock."""

    name: ClassVar[str] = "serial"
    Options: ClassVar[type[BaseModel]] = SerialOptions

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._line: SerialOptions = setup.options

    def open_port(self) -> Port:
        from plugins.drives.serial._port import SerialPort

        return SerialPort(self._line.port, self._line.baud_rate, dtr=self._line.dtr)

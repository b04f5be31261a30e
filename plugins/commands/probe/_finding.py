"""Finds drives on a link by reading registers and the description, which is harmless in every state."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from plugins.link import Host, Link, Port, link_errors
from plugins.link._host import fault_names
from plugins.wire import MAX_NODES, PROTOCOL_MAJOR, Fault, Status, capabilities_of, facts_of
from protocols import Capabilities, DriveError, DriveFault, DriveRefused, FaultCause

_NOT_PROBED = ("serial", "virtual")
"""Interfaces of python-can that are not probed: any serial port, and buses within this process."""

_NOT_INSTALLED = re.compile(r"(\w+) not installed")
"""python-can's words for a package that one of its interfaces needs."""


@dataclass(frozen=True)
class LinkName:
    """A link to be probed, and its settings in a procedure."""

    text: str
    settings: dict[str, Any]
    """Options of the drive plugin, with its name."""
    open: Callable[[int], Port]
    """Opens a port to the drive with this node number."""
    max_drives: int = 1
    """Largest number of drives on the link."""


@dataclass(frozen=True)
class Found:
    """A drive that answered."""

    answer_timeout_s: ClassVar[float] = 0.4
    """Time after which a silent drive counts as absent."""
    node_answer_timeout_s: ClassVar[float] = 0.2
    """As `answer_timeout_s`, for each possible drive of a bus, most of which are absent."""
    telemetry_timeout_s: ClassVar[float] = 0.3
    """Time in which telemetry has to arrive."""
    longest_period_s: ClassVar[float] = 10.0
    """Longest supported period of telemetry."""

    link: LinkName
    node: int
    capabilities: Capabilities
    description: dict[str, str]
    registers: dict[str, float]
    status: Status | None
    i_dq_a: tuple[float, float] | None

    @property
    def settings(self) -> dict[str, Any]:
        """Options of the drive plugin for this drive."""
        return self.link.settings | ({"node": self.node} if self.link.max_drives > 1 else {})

    @property
    def faults(self) -> tuple[str, ...]:
        """Latched faults, the cause first."""
        return () if self.status is None else fault_names(self.status)

    def as_json(self) -> dict[str, Any]:
        """The drive for `--json`."""
        status = self.status
        telemetry = status and {
            "state": status.state.name.lower(),
            "cause": None if status.cause is Fault.NONE else status.cause.name.lower(),
            "faults": self.faults,
            "v_dc_v": status.v_dc,
            "i_dq_a": self.i_dq_a,
        }
        return {
            "link": self.link.text,
            "drive": self.settings,
            "description": self.description,
            "capabilities": self.capabilities.model_dump(mode="json"),
            "registers": self.registers,
            "telemetry": telemetry,
        }


def serial_line(port: str, baud_rate: int) -> LinkName:
    """A serial line by its device, path or socket://host:port."""

    def opened(node: int) -> Port:
        from plugins.drives.serial._port import SerialPort

        return SerialPort(port, baud_rate)

    return LinkName(port, {"name": "serial", "port": port, "baud_rate": baud_rate}, opened)


def can_bus(interface: str, channel: str, bitrate: int, fd: bool) -> LinkName:
    """A CAN bus as python-can names it."""

    def opened(node: int) -> Port:
        from plugins.drives.can._port import CanPort

        return CanPort(interface, channel, bitrate, node=node, fd=fd)

    settings = {"name": "can", "interface": interface, "channel": channel, "bitrate": bitrate, "fd": fd}
    return LinkName(f"{interface}:{channel}", settings, opened, MAX_NODES)


def links_of_this_machine(baud_rate: int, bitrate: int, fd: bool) -> list[LinkName]:
    """All serial ports and CAN channels that pyserial and python-can detect."""
    import can
    from serial.tools import list_ports

    lines = [serial_line(port.device, baud_rate) for port in sorted(list_ports.comports())]
    with _without_logging("can"):
        buses = can.detect_available_configs()
    return lines + [
        can_bus(str(bus["interface"]), str(bus["channel"]), bitrate, fd)
        for bus in buses
        if bus["interface"] not in _NOT_PROBED
    ]


@contextmanager
def _without_logging(logger: str) -> Iterator[None]:
    """Suppress log messages of interfaces whose drivers are not installed."""
    log = logging.getLogger(logger)
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)


def found_on(name: LinkName) -> list[Found | DriveError]:
    """The drives on this link, and errors of incompatible ones.

    Raises `DriveFault` where the link cannot be opened or no drive answers.
    """
    results: list[Found | DriveError] = []
    silence: DriveFault | None = None
    for node in range(name.max_drives):
        try:
            results.append(_found(name, node))
        except DriveFault as fault:
            if fault.cause is not FaultCause.NO_ANSWER:
                raise
            silence = silence or fault
        except DriveRefused as refusal:
            results.append(refusal)
    if silence is not None and not results:
        raise silence
    return results


def missing_package(error: BaseException) -> str | None:
    """The Python package without which a bus cannot be opened, where that is the cause of an error."""
    import can

    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, can.CanInterfaceNotImplementedError) and (found := _NOT_INSTALLED.fullmatch(str(cause))):
            return found[1]
        cause = cause.__cause__
    return None


def _found(name: LinkName, node: int) -> Found:
    with link_errors(name.text):
        port = name.open(node)
    link = Link(port, Found.longest_period_s)
    try:
        return _identified(name, node, link)
    finally:
        link.close()


def _identified(name: LinkName, node: int, link: Link) -> Found:
    host = Host(link, Found.answer_timeout_s if name.max_drives == 1 else Found.node_answer_timeout_s)
    major = host.read("protocol_major")
    if major != PROTOCOL_MAJOR:
        where = link.port.where
        raise DriveRefused(f"{where}: a drive with version {major:g} of the protocol, not {PROTOCOL_MAJOR}")
    registers = host.own_registers()
    scales = facts_of(registers).scales
    description = host.description(registers, link.port.layout(int(registers["bulk_block_bytes"])))
    news = link.news
    link.wait(lambda: news.status is not None and news.measurement is not None, Found.telemetry_timeout_s)
    current = news.measurement and (scales.current_a * news.measurement.i_d, scales.current_a * news.measurement.i_q)
    capabilities = capabilities_of(registers, description, None)
    return Found(name, node, capabilities, description, registers, news.status, current)

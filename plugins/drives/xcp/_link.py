"""Communication with an ECU by the XCP master pyxcp: reading, writing, and the rows of one DAQ list."""

from __future__ import annotations

import importlib
import logging
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from plugins.drives.xcp._ecu import Layout, Rows
from plugins.link import ProcessClock
from protocols import DriveFault, DriveRefused, FaultCause, PluginError

T = TypeVar("T")
DAQ_LIST, ODT = 0, 0
IDENTIFICATION = {
    "IDF_ABS_ODT_NUMBER": 1,
    "IDF_REL_ODT_NUMBER_ABS_DAQ_LIST_NUMBER_BYTE": 2,
    "IDF_REL_ODT_NUMBER_ABS_DAQ_LIST_NUMBER_WORD": 3,
    "IDF_REL_ODT_NUMBER_ABS_DAQ_LIST_NUMBER_WORD_ALIGNED": 4,
}
TIMESTAMP = {"NO_TIME_STAMP": 0, "S1": 1, "S2": 2, "S4": 4}
MAX_WAITING_ROWS = 200_000
"""Rows that are queued for the host; further rows are lost and show as a gap."""
SOCKET_BYTES = 4_000_000
"""Requested size of the socket's receive buffer."""


def library() -> Any:
    """The module pyxcp, imported on connecting; raises `PluginError` where it is not installed.

    Its import replaces Python's display and exception hooks, which are restored. Its logging is disabled, since its
    errors are raised as faults of the drive.
    """
    hooks = sys.excepthook, sys.displayhook
    logger = logging.getLogger("pyxcp")
    logger.propagate = False
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    try:
        return SimpleNamespace(
            Master=importlib.import_module("pyxcp.master").Master,
            config=importlib.import_module("pyxcp.config"),
            types=importlib.import_module("pyxcp.types"),
            daq=importlib.import_module("pyxcp.transport.transport_ext").FrameCategory.DAQ,
        )
    except ImportError as error:
        problem = f"needs the XCP master pyxcp: pip install 'fluxbench[xcp]' ({error})"
        raise PluginError("drive", "xcp", problem) from error
    finally:
        sys.excepthook, sys.displayhook = hooks


class Arrivals:
    """Queue of the DAQ list's frames (a pyxcp policy), filled by pyxcp's thread and emptied by another."""

    def __init__(self, daq: Any) -> None:
        self._daq = daq
        self._frames: deque[bytes] = deque(maxlen=MAX_WAITING_ROWS)
        self.newest: tuple[float, bytes] = (0.0, b"")
        """Arrival of the last frame by the monotonic clock, and its content."""
        self.xcp_master: Any = None

    def feed(self, category: Any, counter: int, timestamp: int, payload: bytes) -> None:
        """Queue a frame."""
        if category == self._daq:
            frame = bytes(payload)
            self.newest = (time.monotonic(), frame)
            self._frames.append(frame)

    def finalize(self) -> None:
        """Nothing to finish: no file is written."""

    def clear(self) -> None:
        """Drop the queued frames."""
        self._frames.clear()

    def take(self) -> bytes:
        """Remove all queued frames and return them, concatenated."""
        # Those that are there now: of a flood, the next ones come faster than they are taken.
        frames = [self._frames.popleft() for _ in range(len(self._frames))]
        return b"".join(frames)


class Link:
    """Connection to an ECU; errors become `DriveFault` (link_lost), and a lost link stays lost.

    Parameters
    ----------
    host, port, protocol : str, int, str
        The ECU's address; "udp" or "tcp".
    address, extension : int
        Address of the variable `fluxbench`.
    timeout_s : float
        Timeout for an answer, and for the next row.
    """

    def __init__(self, host: str, port: int, protocol: str, address: int, extension: int, timeout_s: float) -> None:
        pyxcp = library()
        self.where = f"XCP at {host}:{port}"
        self._at, self._extension = address, extension
        self._timeout_s, self._types = timeout_s, pyxcp.types
        self._talk = threading.Lock()
        self.lost: DriveFault | None = None
        transport = pyxcp.config.Transport(create_daq_timestamps=False)
        transport.eth.host, transport.eth.port, transport.eth.protocol = host, port, protocol.upper()
        transport.eth.tcp_nodelay = True
        general = pyxcp.config.General(disable_error_handling=True)
        self._rows = Arrivals(pyxcp.daq)
        try:
            self._master = pyxcp.Master("eth", SimpleNamespace(general=general, transport=transport), self._rows)
        except Exception as error:  # pyxcp raises the errors of its parts, without a common base
            raise DriveFault(FaultCause.LINK_LOST, f"{self.where}: {self._reason(error)}") from error
        self._master.transport.get = self._answer
        self._master.transport._record_pdu = lambda *pdu: None  # diagnostics take most of a row's CPU time
        self._master.transport.process_event_packet = lambda packet: None  # the default prints it
        self.layout = Layout("<")
        self._head, self._quiet = 0, ProcessClock()

    def open(self, event: int) -> None:
        """Connect and start the DAQ list at the event; raises `DriveRefused` where the ECU cannot provide it."""
        self._call(self._connect)
        is_intel = str(self._master.slaveProperties.byteOrder) == "INTEL"
        self.layout = Layout("<" if is_intel else ">")
        if self._master.slaveProperties.bytesPerElement != 1:
            raise DriveRefused(f"{self.where}: addresses count words, expected octets")
        if not self._master.slaveProperties.supportsDaq:
            raise DriveRefused(f"{self.where}: does not support DAQ")
        self._call(lambda: self._measure(event))

    def _connect(self) -> None:
        self._master.transport.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BYTES)
        self._master.transport.connect()
        self._master.connect()

    def _measure(self, event: int) -> None:
        m, row = self._master, self.layout.row
        processor, resolution = m.getDaqProcessorInfo(), m.getDaqResolutionInfo()
        head = IDENTIFICATION[str(processor.daqKeyByte.Identification_Field)]
        stamp = TIMESTAMP[str(resolution.timestampMode.size)] if resolution.timestampMode.fixed else 0
        self._head = head + stamp
        if self._head + row.itemsize > m.slaveProperties.maxDto:
            message = f"a row takes {self._head + row.itemsize} octets, one message has {m.slaveProperties.maxDto}"
            raise DriveRefused(f"{self.where}: {message}")
        m.freeDaq()
        m.allocDaq(1)
        m.allocOdt(DAQ_LIST, 1)
        words = row.itemsize // self.layout.word.itemsize
        m.allocOdtEntry(DAQ_LIST, ODT, words)
        m.setDaqPtr(DAQ_LIST, ODT, 0)
        for word in range(words):
            m.writeDaq(0xFF, 4, self._extension, self._at + self.layout.row_at + 4 * word)
        m.setDaqListMode(0, DAQ_LIST, event, 1, 0)
        m.startStopDaqList(1, DAQ_LIST)

    def close(self) -> None:
        """Stop measuring, disconnect, and close the socket and its threads."""
        if self.lost is None:
            with suppress(DriveFault):
                self._call(lambda: self._master.startStopSynch(0))
                self._call(self._master.disconnect)
        self._master.close()

    # The variable

    def read(self, offset: int, octets: int) -> bytes:
        """Content of the variable from `offset` on."""
        m = self._master

        def upload() -> bytes:
            m.setMta(self._at + offset, self._extension)
            data = bytes(m.fetch(octets))
            if len(data) != octets:
                raise ValueError(f"{len(data)} octets answer a request for {octets}")
            return data

        return self._call(upload)

    def write(self, offset: int, data: bytes) -> None:
        """Write `data` into the variable from `offset` on."""
        m, max_bytes = self._master, self._master.slaveProperties.maxCto - 2

        def download() -> None:
            m.setMta(self._at + offset, self._extension)
            for first in range(0, len(data), max_bytes):
                m.download(data[first : first + max_bytes])

        self._call(download)

    # Rows

    def clear(self) -> None:
        """Drop the queued rows."""
        self._rows.clear()
        self._quiet = ProcessClock()

    def take(self) -> Rows:
        """The rows received since the last call, as `Layout.row`; raises `DriveFault` after `timeout_s` without one."""
        self.check()
        framed = np.dtype([("head", "V", self._head), ("row", self.layout.row)])
        octets = self._rows.take()
        if len(octets) % framed.itemsize:
            raise self._lose("rows of a wrong length")
        if octets:
            self._quiet = ProcessClock()
        elif self._quiet() > self._timeout_s:
            raise self._lose(f"no row for {self._timeout_s:g} s")
        rows: Rows = np.frombuffer(octets, framed)["row"]
        return rows

    def newest(self) -> np.void:
        """The next row from now on; raises `DriveFault` after `timeout_s` without one."""
        requested_s, waited_s = time.monotonic(), ProcessClock()
        while self._rows.newest[0] <= requested_s:
            self.check()
            if waited_s() > self._timeout_s:
                raise self._lose(f"no row for {self._timeout_s:g} s")
            time.sleep(0.001)
        octets = self._rows.newest[1][self._head :]
        if len(octets) != self.layout.row.itemsize:
            raise self._lose("rows of a wrong length")
        row: np.void = np.frombuffer(octets, self.layout.row)[0]
        return row

    def check(self) -> None:
        """Raises `DriveFault` where the link is lost."""
        if self.lost is not None:
            raise self.lost

    def _call(self, exchange: Callable[[], T]) -> T:
        """Run one exchange; where a command or its answer was lost, synchronise with the ECU and retry once."""
        self.check()
        with self._talk:
            try:
                with suppress(self._types.XcpTimeoutError):
                    return exchange()
                self._synchronise()
                return exchange()
            except DriveRefused:
                raise
            except Exception as error:  # as in `__init__`
                raise self._lose(self._reason(error)) from error

    def _synchronise(self) -> None:
        """Skip late answers, up to that of SYNCH (error 0), which the ECU sends last."""
        answer, waited_s = self._master.synch(), ProcessClock()
        while bytes(answer) != b"\0":
            if waited_s() > self._timeout_s:
                raise self._types.XcpTimeoutError("answers without a request, and none to SYNCH")
            answer = self._answer()[1:]

    def _answer(self) -> Any:
        """The next answer, in place of pyxcp's own wait."""
        # Each received row prolongs pyxcp's wait, so that it never ends after a lost answer. It also counts time in
        # which this process was suspended.
        transport, waited_s = self._master.transport, ProcessClock()
        with transport.resQueue_condition:
            while not transport.resQueue:
                if waited_s() > self._timeout_s:
                    raise self._types.XcpTimeoutError("no answer")
                transport.resQueue_condition.wait(0.02)
            return transport.resQueue.popleft()

    def _lose(self, why: str) -> DriveFault:
        fault = DriveFault(FaultCause.LINK_LOST, f"{self.where}: {why}")
        self.lost = self.lost or fault
        return fault

    def _reason(self, error: Exception) -> str:
        """The error in words: that of the ECU with its code, the system's, or what could not be read."""
        if isinstance(error, self._types.XcpResponseError):
            code = error.get_error_code()
            known = str(code) in self._types.XcpError.encmapping
            name = str(code) if known else f"{int(code):#04x}, which XCP does not define"
            return f"the ECU answers with the error {name}"
        if isinstance(error, OSError):
            return error.strerror or str(error)
        text = (str(error) or type(error).__name__).splitlines()[0]
        return text if isinstance(error, self._types.XcpTimeoutError) else f"an answer that cannot be read ({text})"

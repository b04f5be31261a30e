"""What a line is read and written by: a descriptor, a socket, or on Windows a port of pyserial; nothing here waits."""

from __future__ import annotations

import os
import select
import socket
import time
from typing import Any, ClassVar, Protocol


class Transport(Protocol):
    """An open connection that does not block; its calls raise `OSError`."""

    def fileno(self) -> int | None:
        """Descriptor that another process may write to, if any."""
        ...

    def is_readable(self, timeout_s: float) -> bool:
        """Whether there is something to read, or the other end is gone, within the time."""
        ...

    def is_writable(self, timeout_s: float) -> bool:
        """Whether something can be written within the time."""
        ...

    def read(self, max_bytes: int) -> bytes:
        """Received bytes; empty at the end of the connection."""
        ...

    def write(self, data: bytes) -> int:
        """Number of accepted bytes; raises `BlockingIOError` where there would be none."""
        ...

    def close(self) -> None: ...


class DescriptorTransport:
    """A device or pseudo-terminal by its descriptor; not on Windows."""

    def __init__(self, port: Any) -> None:
        self._port, self._fd = port, port.fileno()
        os.set_blocking(self._fd, False)
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(self._fd, select.POLLIN)
        self._writable.register(self._fd, select.POLLOUT)

    def fileno(self) -> int | None:
        return int(self._fd)

    def is_readable(self, timeout_s: float) -> bool:
        return bool(self._readable.poll(1e3 * timeout_s))

    def is_writable(self, timeout_s: float) -> bool:
        return bool(self._writable.poll(1e3 * timeout_s))

    def read(self, max_bytes: int) -> bytes:
        return os.read(self._fd, max_bytes)

    def write(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def close(self) -> None:
        self._port.close()


class SocketTransport:
    """A TCP connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        connection.setblocking(False)

    def fileno(self) -> int | None:
        return self._connection.fileno()

    def is_readable(self, timeout_s: float) -> bool:
        return bool(select.select([self._connection], [], [], timeout_s)[0])

    def is_writable(self, timeout_s: float) -> bool:
        return bool(select.select([], [self._connection], [], timeout_s)[1])

    def read(self, max_bytes: int) -> bytes:
        return self._connection.recv(max_bytes)

    def write(self, data: bytes) -> int:
        return self._connection.send(data)

    def close(self) -> None:
        self._connection.close()


class PortTransport:
    """A port of pyserial that was opened without timeouts, for systems where it has no descriptor to wait for."""

    period_s: ClassVar[float] = 0.5e-3
    """Period in which it is looked at."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def fileno(self) -> int | None:
        return None

    def is_readable(self, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while not self._port.in_waiting:
            if time.monotonic() >= deadline:
                return False
            time.sleep(PortTransport.period_s)
        return True

    def is_writable(self, timeout_s: float) -> bool:
        time.sleep(min(timeout_s, PortTransport.period_s))
        return True

    def read(self, max_bytes: int) -> bytes:
        return bytes(self._port.read(min(max_bytes, self._port.in_waiting)))

    def write(self, data: bytes) -> int:
        accepted = self._port.write(data)
        if not accepted:
            raise BlockingIOError
        return int(accepted)

    def close(self) -> None:
        self._port.close()

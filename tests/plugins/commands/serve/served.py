"""The page's server as a process of its own, and what a browser would ask of it."""

from __future__ import annotations

import http.client
import json
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from tests.support.forking import ForkedCommand
from tests.support.processes import start_fluxbench, wait_until


@dataclass(frozen=True)
class Reply:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def content(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Served:
    """A server that listens, and its token."""

    process: ForkedCommand
    folder: Path
    address: str

    @property
    def port(self) -> int:
        return int(urlsplit(self.address).port or 0)

    @property
    def token(self) -> str:
        return parse_qs(urlsplit(self.address).query)["token"][0]

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def cookie(self) -> dict[str, str]:
        return {"Cookie": f"fluxbench_{self.port}={self.token}"}

    def ask(self, method: str, path: str, headers: Mapping[str, str], body: bytes | None = None) -> Reply:
        """A request with these headers and no others of weight."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)) as line:
            line.request(method, path, body, dict(headers))
            answer = line.getresponse()
            return Reply(answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read())

    def get(self, path: str) -> Reply:
        """As the page asks."""
        return self.ask("GET", path, self.cookie)

    def post(self, path: str, body: Any) -> Reply:
        """As the page asks."""
        return self.ask("POST", path, {**self.cookie, "Origin": self.origin}, json.dumps(body).encode())

    def views(self) -> Iterator[dict[str, Any]]:
        """What the page receives, from now on."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)) as line:
            line.request("GET", "/events", headers=self.cookie)
            name = b""
            for row in line.getresponse():
                if row.startswith(b"data: ") and not name:
                    yield json.loads(row[6:])
                name = row[7:] if row.startswith(b"event: ") else b""

    def view_when(self, condition: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """The first view that is like that; there is none any more when the run has ended."""
        for view in self.views():
            if condition(view):
                return view
            assert view["going"], view["problem"]
        raise AssertionError("the server is gone")


@contextmanager
def serving(folder: Path) -> Iterator[Served]:
    """A server for a folder, ended with its run."""
    process = start_fluxbench("serve", folder)
    try:
        wait_until(lambda: "\n" in process.printed_so_far() or process.poll() is not None)
        yield Served(process, folder, process.printed_so_far().strip())
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)

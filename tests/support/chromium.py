"""A real browser without a window, driven over its debugging pipe; nothing is fetched from a network."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.pictures.report import browser
from tests.support.processes import wait_until

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-pipe",
)


class Tab:
    """One page of the browser."""

    def __init__(self, chromium: Chromium, session: str) -> None:
        self._chromium, self._session = chromium, session

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the DevTools protocol."""
        return self._chromium.call(method, parameters, self._session)

    def value(self, expression: str) -> Any:
        """What an expression of JavaScript comes to; a promise is waited for."""
        reported = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in reported:
            raise RuntimeError(json.dumps(reported["exceptionDetails"])[:500])
        return reported["result"].get("value")

    def until(self, expression: str, timeout_s: float = 60.0) -> None:
        """Wait until an expression is true."""
        wait_until(lambda: bool(self.value(expression)), timeout_s)

    def resize(self, width: int, height: int, *, phone: bool = False) -> None:
        """Give the page the size of a screen, a phone's with two pixels a pixel."""
        scale = 2 if phone else 1
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=phone
        )

    def shot(self, to: Path, *, whole: bool = False) -> Path:
        """A picture of what is seen, or of the whole page."""
        reported = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        to.write_bytes(base64.b64decode(reported["data"]))
        return to

    def close(self) -> None:
        """As a person closes a tab: at once."""
        self._chromium.call("Target.closeTarget", {"targetId": self._chromium.target_of(self._session)})


class Chromium:
    """The browser; `with_chromium` starts and ends one."""

    def __init__(self, writing: int, reading: int) -> None:
        self._writing, self._reading = writing, reading
        self._count, self._kept = 0, b""
        self._targets: dict[str, str] = {}
        self.complaints: list[str] = []
        """What the pages' consoles complained about."""

    def open(self, address: str) -> Tab:
        """A new tab at an address."""
        target = self.call("Target.createTarget", {"url": "about:blank"})["targetId"]
        session = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        self._targets[session] = target
        tab = Tab(self, session)
        for domain in ("Page", "Runtime", "Log"):
            tab.call(f"{domain}.enable")
        tab.call("Emulation.setFocusEmulationEnabled", enabled=True)  # seen, as if each had a window of its own
        tab.call("Page.navigate", url=address)
        return tab

    def target_of(self, session: str) -> str:
        """The page behind a session."""
        return self._targets[session]

    def call(self, method: str, parameters: dict[str, Any], session: str | None = None) -> dict[str, Any]:
        """One command, and its answer; what the browser tells meanwhile is looked through for complaints."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        os.write(self._writing, json.dumps(message).encode() + b"\0")
        while True:
            reported = self._next()
            if reported.get("id") == self._count:
                if "error" in reported:
                    raise RuntimeError(f"{method}: {reported['error']}")
                return dict(reported["result"])
            self._listen(reported)

    def _listen(self, reported: dict[str, Any]) -> None:
        if reported.get("method") == "Log.entryAdded" and reported["params"]["entry"]["level"] == "error":
            self.complaints.append(reported["params"]["entry"]["text"])
        elif reported.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(reported["params"]["exceptionDetails"])[:500])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._kept:
            data = os.read(self._reading, 1 << 16)
            if not data:
                raise RuntimeError("the browser is gone")
            self._kept += data
        line, _, self._kept = self._kept.partition(b"\0")
        return dict(json.loads(line))


def _high(descriptor: int) -> int:
    """The same under a number that is in nobody's way."""
    moved = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 20)
    os.close(descriptor)
    return moved


@contextmanager
def with_chromium() -> Iterator[Chromium]:
    """A browser with a profile of its own; raises `FileNotFoundError` where there is none."""
    program = browser()
    if program is None:
        raise FileNotFoundError("no browser")
    to_read, writing = map(_high, os.pipe())
    reading, to_write = map(_high, os.pipe())
    profile = tempfile.mkdtemp(prefix="chromium-")
    # It reads from descriptor 3 and writes to 4.
    moved = f'exec 3<&{to_read} 4>&{to_write} {to_read}<&- {to_write}>&-; exec "$@"'
    process = subprocess.Popen(
        ["bash", "-c", moved, "bash", program, *FLAGS, f"--user-data-dir={profile}"],
        pass_fds=(to_read, to_write),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(to_read)
    os.close(to_write)
    try:
        yield Chromium(writing, reading)
    finally:
        os.close(writing)
        process.terminate()
        try:
            process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        os.close(reading)
        time.sleep(0.2)
        shutil.rmtree(profile, ignore_errors=True)

"""Starts viewers as processes of their own, bound to this machine alone; brings no data."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Literal
from urllib.parse import quote

from orchestrator.operating_system.processes import LastingProcess
from orchestrator.operating_system.signals import STOP_SIGNALS, handlers
from plugins.streams.rerun._live import HOST, address
from plugins.streams.rerun._tape import executable


def has_display() -> bool:
    """Whether a window could be opened here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def best_view() -> Literal["spawn", "web"]:
    """A window where there is a display, else a page for the browser."""
    return "spawn" if has_display() else "web"


def page_url(port: int, web_port: int, source: str | None = None) -> str:
    """What a browser on this machine opens to see what the server on `port` takes, or another source."""
    return f"{page_origin(web_port)}/?url={quote(source or address(port), safe='')}"


def page_origin(web_port: int) -> str:
    """Of the viewer's page, as a browser names it."""
    return f"http://{HOST}:{web_port}"


def viewer_words(
    port: int,
    memory_limit: str,
    *,
    web_port: int | None = None,
    headless: bool = False,
    files: Sequence[Path | str] = (),
) -> list[str]:
    """The command line of a viewer: a window, a page's server (`web_port`), or nothing that is seen (`headless`)."""
    words = [executable(), "--bind", HOST, "--port", str(port), "--hide-welcome-screen"]
    if web_port is not None:
        words += ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", memory_limit]
    else:
        words += ["--memory-limit", memory_limit, *(["--headless"] if headless else [])]
    return words + [str(file) for file in files]


def start(words: Sequence[str], extra: Mapping[str, str] | None = None) -> LastingProcess:
    """Start a viewer: it outlives this process, and has nothing to say that belongs into the run's terminal."""
    return LastingProcess(words, {"RERUN_APP_ONLY": "true", **(extra or {})})


@contextmanager
def interruptible() -> Iterator[None]:
    """Stop signals end the block as Ctrl-C does: by `KeyboardInterrupt`, so that what it started is stopped."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's alone
        return
    with handlers(dict.fromkeys((number for number in STOP_SIGNALS if number != signal.SIGINT), interrupt)):
        yield


def tied(words: Sequence[str]) -> list[str]:
    """The command line that ends with the process that starts it, even a killed one, where the system can do that."""
    setpriv = shutil.which("setpriv") if sys.platform == "linux" else None
    return [setpriv, "--pdeathsig", "TERM", "--", *words] if setpriv else list(words)

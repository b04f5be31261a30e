"""An operator at the other end of a pipe: answers and stops come as lines of JSON, and silence ends the run.

Each line is one object: ``{"answer": "yes", "question": PROMPT}``, ``{"stop": REASON}``, or ``{}`` as a keepalive.
Without a line for `silence_s`, or at the end of the pipe, no one could stop the run: it then stops by itself, as when a
terminal is closed.
"""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from orchestrator.engine._interrupts import Interrupts
from orchestrator.formatting.sentences import shown
from orchestrator.operating_system.inputs import wait_for_input

MAX_LINE_BYTES = 1 << 16
POLL_PERIOD_S = 0.2


class RemoteOperator:
    """Asks whoever is at the other end of a pipe; `listening` has to be at work meanwhile.

    Parameters
    ----------
    through : str
        The operator's interface ("page"); kept in the journal with each answer.
    descriptor : int
        Descriptor of the pipe's reading end.
    silence_s : float
        Time without a line after which the run is stopped.
    """

    def __init__(self, through: str, descriptor: int = 0, silence_s: float = 10.0) -> None:
        self.through = through
        self._descriptor, self._silence_s = descriptor, silence_s
        self._answers: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._done = threading.Event()

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        """Wait for an answer to this question; answers to others are ignored."""
        while True:
            interrupts.check()
            try:
                question, answer = self._answers.get(timeout=POLL_PERIOD_S)
            except queue.Empty:
                continue
            if question == prompt and answer in ("yes", "no"):
                return answer == "yes"

    @contextmanager
    def listening(self, interrupts: Interrupts) -> Iterator[None]:
        """Read the pipe, on a thread of its own, while the block lasts."""
        thread = threading.Thread(target=self._listen, args=(interrupts,), name="operator's line", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._done.set()
            thread.join()

    def _listen(self, interrupts: Interrupts) -> None:
        received_s, rest = time.monotonic(), b""
        while not self._done.is_set():
            if not wait_for_input(self._descriptor, POLL_PERIOD_S):
                if time.monotonic() - received_s > self._silence_s:
                    return interrupts.stop(f"the operator's {self.through} has been silent for {self._silence_s:g} s")
                continue
            data = os.read(self._descriptor, 4096)
            if not data:
                return interrupts.stop(f"the operator's {self.through} is gone")
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self._take(_object(line), interrupts)
            received_s, rest = time.monotonic(), rest[-MAX_LINE_BYTES:]
        return None

    def _take(self, message: dict[str, Any], interrupts: Interrupts) -> None:
        if "stop" in message:
            interrupts.stop(shown(f"{message['stop']}"))
        elif "answer" in message:
            self._answers.put((str(message.get("question")), str(message["answer"])))


def _object(line: bytes) -> dict[str, Any]:
    """The line's JSON object; empty where it is none."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}

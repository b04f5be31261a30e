"""Publishes a run's messages to the journal, which must store them, and to the streams, which may miss some."""

from __future__ import annotations

from orchestrator.engine.streaming import Dispatcher
from orchestrator.runs import Journal
from protocols import DiagnosisStep, LawLearned, MapEstimated, Message, SamplesCaptured, UnderWay


class RunLog:
    """Journal and streams of one run behind one call.

    Parameters
    ----------
    journal : Journal
        Gets every message without arrays; its errors are the run's.
    dispatcher : Dispatcher
        Gets every message; never an error.
    """

    def __init__(self, journal: Journal, dispatcher: Dispatcher) -> None:
        self._journal, self._dispatcher = journal, dispatcher

    def publish(self, message: Message, *, durable: bool = False) -> None:
        """Publish; `durable` returns only when the journal is on the disk.

        Raises `StorageError` where the journal can no longer be written; the streams get the
        message nevertheless.
        """
        self._dispatcher.publish(message)
        if not isinstance(message, SamplesCaptured | MapEstimated | DiagnosisStep | LawLearned | UnderWay):
            self._journal.append(message, durable=durable)

    def before_prompt(self) -> None:
        """Let the streams catch up, so that a question stands below what led to it."""
        self._dispatcher.drain(timeout_s=2.0)

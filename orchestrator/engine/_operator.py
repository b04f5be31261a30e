"""The operator, who confirms manual steps of a run."""

from __future__ import annotations

import sys
from typing import Protocol

from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._remote import RemoteOperator
from orchestrator.formatting.sentences import cut, visible
from orchestrator.operating_system.inputs import wait_for_input
from protocols import InputError, OperatorAnswered, OperatorAsked, RunAborted

SAFE_BENCH_WORDS = "I have made the bench safe"
"""Statement with which a procedure's own answers count on a real drive; kept in the journal."""


class Operator(Protocol):
    """A person, or what stands in for one."""

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        """Ask and wait; True for yes. Raises `RunInterrupted` after a request to stop."""
        ...


class AbsentOperator:
    """No operator: every question that the procedure does not answer ends the run.

    Parameters
    ----------
    words : str, optional
        `SAFE_BENCH_WORDS`: the procedure's answers count on a real drive too. Default: on simulated ones only.

    Raises
    ------
    InputError
        Other words.
    """

    def __init__(self, words: str | None = None) -> None:
        if words not in (None, SAFE_BENCH_WORDS):
            raise InputError("--unattended", "", f'expected "{SAFE_BENCH_WORDS}", spelled out; got {cut(repr(words))}')
        self.words = words

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        raise RunAborted(f"nobody is there to answer: {prompt}")


class TerminalOperator:
    """Asks on the terminal; a signal ends the waiting."""

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        print(f"{visible(cut(prompt))} [yes/no] ", end="", flush=True)
        while True:
            interrupts.check()
            if not wait_for_input(sys.stdin.fileno(), 0.2):
                continue
            line = sys.stdin.readline()
            answer = line.strip().lower()
            if answer in ("yes", "y"):
                return True
            if answer in ("no", "n"):
                return False
            if line == "":
                interrupts.check()
                raise RunAborted(f"nobody is there any more to answer: {prompt}")
            print("please answer yes or no: ", end="", flush=True)


class Questions:
    """Asks the operator, and keeps questions and answers in the journal.

    On a real drive a procedure answers for a person only where the run was started with `SAFE_BENCH_WORDS`.
    """

    def __init__(self, operator: Operator, interrupts: Interrupts, log: RunLog, *, simulated: bool) -> None:
        self._operator, self._interrupts, self._log = operator, interrupts, log
        self._words = operator.words if isinstance(operator, AbsentOperator) else None
        self._canned_counts = simulated or self._words is not None

    def put(self, prompt: str, *, answered: bool) -> None:
        """Require the answer yes, from the procedure where it has `answered` and its answer counts.

        Raises
        ------
        RunAborted
            The answer is no, or no operator is present.
        """
        self._log.publish(OperatorAsked(prompt=prompt))
        if answered and self._canned_counts:
            self._log.publish(OperatorAnswered(answer="yes", by="procedure", words=self._words or ""), durable=True)
            return
        if answered and isinstance(self._operator, AbsentOperator):
            problem = "the procedure's own answer counts on a simulated drive only"
            raise RunAborted(
                f'nobody is there to answer: {prompt} ({problem}, or with --unattended "{SAFE_BENCH_WORDS}")'
            )
        self._log.before_prompt()
        agreed = self._operator.confirm(prompt, self._interrupts)
        through = self._operator.through if isinstance(self._operator, RemoteOperator) else ""
        answer = OperatorAnswered(answer="yes" if agreed else "no", by="operator", through=through)
        self._log.publish(answer, durable=True)
        if not agreed:
            raise RunAborted(f"the operator answered no to: {prompt}")

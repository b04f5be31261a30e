"""Whoever answers when a run needs a deed done by hand."""

from __future__ import annotations

import select
import sys
from typing import Protocol

from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.presentation.sentences import cut, visible
from protocols import OperatorAnswered, OperatorAsked, RunAborted


class Operator(Protocol):
    """A person, or what stands in for one."""

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        """Ask and wait; True for yes. Raises `RunInterrupted` where a stop is asked for meanwhile."""
        ...


class AbsentOperator:
    """Nobody is there: every question that the procedure does not answer ends the run."""

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        raise RunAborted(f"nobody is there to answer: {prompt}")


class TerminalOperator:
    """Asks on the terminal; a signal ends the waiting."""

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        print(f"{visible(cut(prompt))} [yes/no] ", end="", flush=True)
        while True:
            interrupts.check()
            ready, _, _ = select.select([sys.stdin], [], [], 0.2)
            if not ready:
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
    """Puts questions to the operator, and keeps them and their answers in the journal."""

    def __init__(self, operator: Operator, interrupts: Interrupts, log: RunLog) -> None:
        self._operator, self._interrupts, self._log = operator, interrupts, log

    def put(self, prompt: str, *, answered: bool) -> None:
        """Have a question answered with yes, by the procedure where that has `answered` it.

        Raises
        ------
        RunAborted
            The answer is no, or nobody is there.
        """
        self._log.say(OperatorAsked(prompt=prompt))
        if answered:
            self._log.say(OperatorAnswered(answer="yes", by="procedure"), durable=True)
            return
        self._log.before_prompt()
        agreed = self._operator.confirm(prompt, self._interrupts)
        self._log.say(OperatorAnswered(answer="yes" if agreed else "no", by="operator"), durable=True)
        if not agreed:
            raise RunAborted(f"the operator said no to: {prompt}")

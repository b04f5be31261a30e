"""What the rooms of the suite cost in CPU seconds, beside what they may cost: a table at its end, which gates nothing.

A test's seconds are its process's and those of the programs that ended within it, with what pytest does around it.
Why there is a budget, and how tests are divided into fast and slow ones: docs/decisions/0035.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Generator

import pytest

BUDGET_S = {
    "orchestrator/diagnosis": 40,
    "orchestrator/interface": 36,
    "plugins/streams": 25,
    "plugins/drives": 20,
    "orchestrator/engine": 18,
    "tests": 16,
}
"""CPU seconds that a room may take on two cores with nothing else to do; see `OTHERS_S`."""
OTHERS_S = 12
SHOWN = 5


class Budget:
    """A plugin of pytest: counts in each worker, adds and prints where the reports arrive."""

    def __init__(self) -> None:
        self._last_s = _cpu_s()
        self._spent_s: defaultdict[str, float] = defaultdict(float)

    def pytest_collection_finish(self) -> None:
        """What was spent until now is no room's."""
        self._last_s = _cpu_s()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Tell with each phase of a test what was spent since the phase before it."""
        report = yield
        now_s = _cpu_s()
        report.user_properties = [*report.user_properties, ("cpu_s", now_s - self._last_s)]
        self._last_s = now_s
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add it to its room."""
        for name, spent_s in report.user_properties:
            if name == "cpu_s" and isinstance(spent_s, float):
                self._spent_s[room_of(report.nodeid)] += spent_s

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
        """The rooms that cost the most."""
        if config.args_source is not pytest.Config.ArgsSource.TESTPATHS or config.option.markexpr != "not slow":
            return
        terminalreporter.section("CPU seconds of the rooms")
        whole = sum(self._spent_s.values())
        for room, spent_s in sorted(self._spent_s.items(), key=lambda spent: -spent[1])[:SHOWN]:
            terminalreporter.write_line(f"{spent_s:6.1f} of {budget_s(room):3d}  {room}")
        terminalreporter.write_line(f"{whole:6.1f} in all")


def room_of(nodeid: str) -> str:
    """The first two folders below `tests`, or what there is of them."""
    return "/".join(nodeid.partition("::")[0].removeprefix("tests/").split("/")[:-1][:2]) or "tests"


def budget_s(room: str) -> int:
    """What a room may take."""
    return BUDGET_S.get(room, OTHERS_S)


def _cpu_s() -> float:
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system

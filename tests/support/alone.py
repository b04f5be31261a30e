"""Tests of real links that failed beside other tests have to pass alone: `--alone FILE` writes and reads which."""

from __future__ import annotations

from pathlib import Path

import pytest

REAL_TIME = ("tests/plugins/link/", "tests/plugins/drives/", "tests/plugins/commands/probe/")
"""Tests of processes that answer each other within tenths of a second."""


class Alone:
    """Writes what failed, if all of it is real time; where the file is there already, runs that alone."""

    def __init__(self, file: Path) -> None:
        self._file, self._failed = file, set[str]()
        self._wanted = set(file.read_text(encoding="utf-8").splitlines()) if file.is_file() else None

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if self._wanted is not None:
            items[:] = [item for item in items if item.nodeid in self._wanted]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed.add(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput") or self._wanted is not None:
            return
        if self._failed and all(name.startswith(REAL_TIME) for name in self._failed):
            self._file.write_text("\n".join(sorted(self._failed)), encoding="utf-8")

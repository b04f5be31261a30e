"""Memory is counted in bytes, and unknown where the system does not report it."""

from __future__ import annotations

import sys

import psutil
import pytest

from orchestrator.operating_system.memory import peak_memory, spare_memory


def test_the_peak_is_at_least_what_is_in_use() -> None:
    peak = peak_memory()
    assert peak is not None
    assert 0.5 * psutil.Process().memory_info().rss < peak < psutil.virtual_memory().total


@pytest.mark.posix
def test_a_limit_on_the_address_space_counts_as_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (1 << 20, 1 << 20))
    assert spare_memory() == 0


def test_a_system_without_limits_of_processes_reports_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    assert peak_memory() is None
    assert 0 < (spare_memory() or 0) < psutil.virtual_memory().total

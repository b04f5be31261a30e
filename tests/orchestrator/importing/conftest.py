"""The measurement that the tests spoil."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.orchestrator.importing.benches import Bench, held_current, phase_log


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A held current, logged in phases, with nothing wrong in it."""
    return Bench(tmp_path, *phase_log(*held_current()))

"""Fixtures over the benches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.benches import PM400, SERVO, TRACTION, Bench


@pytest.fixture
def pm400() -> Bench:
    return PM400


@pytest.fixture(params=[PM400, SERVO, TRACTION], ids=["400 W", "48 V servo", "28 kW"])
def bench(request: pytest.FixtureRequest) -> Bench:
    found: Bench = request.param
    return found


@pytest.fixture
def every_stage() -> Callable[[], list[dict[str, Any]]]:
    """One of each stage, everything left to scale."""
    kinds = ("gates_off", "alignment", "lock_check", "resistance", "classical", "injection", "estimate")
    return lambda: [{"kind": kind} for kind in kinds]

"""The lag between voltage and current, by edges, or by a sine's phase where the resistance is known."""

from __future__ import annotations

import pytest

from orchestrator.numerics.alignment import alignment_of
from tests.orchestrator.importing.test_findings import injection
from tests.support.cases import few


@pytest.mark.parametrize("sine", [False, True], ids=["edges", "phase"])
@few("late", [1.4, 0.0, 1.0, -2.0], fast=2)
def test_the_lag_is_reported(late: float, sine: bool) -> None:
    found = alignment_of(*injection(late=late, sine=sine), ohm=4.25 if sine else None)
    assert found is not None
    assert found.lag_rows == pytest.approx(late, abs=0.05)
    assert found.by_edges is not sine


def test_of_a_sine_nothing_is_reported_without_the_resistance_and_little_is_lost_where_that_is_off() -> None:
    i, v = injection(late=1.0, sine=True)
    assert alignment_of(i, v) is None
    found = alignment_of(i, v, ohm=1.3 * 4.25)
    assert found is not None
    assert found.lag_rows == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("late", [0.0, 1.0])
def test_what_current_control_adds_to_a_sine_makes_no_edges(late: float) -> None:
    found = alignment_of(*injection(late=late, sine=True, trembling_v=1.5), ohm=4.25)
    assert found is not None
    assert not found.by_edges
    assert found.lag_rows == pytest.approx(late, abs=0.1)

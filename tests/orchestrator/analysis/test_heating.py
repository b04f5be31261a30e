from __future__ import annotations

import pytest

from orchestrator.analysis import COPPER_PER_K, temperature_rise
from protocols import ResistanceReading


def reading(start_s: float, ohm: float, std_ohm: float = 0.0) -> ResistanceReading:
    return ResistanceReading(start_s=start_s, value_ohm=ohm, std_ohm=std_ohm)


def test_copper_that_warms_by_forty_kelvin_is_read_as_forty_kelvin() -> None:
    rise = temperature_rise([reading(0.0, 4.25), reading(5.0, 4.9), reading(9.0, 4.25 * (1.0 + 40.0 * COPPER_PER_K))])
    assert rise is not None
    assert rise.value == pytest.approx(40.0)
    assert (rise.low, rise.high, rise.unit) == (rise.value, rise.value, "K")


def test_its_interval_is_that_of_both_readings() -> None:
    rise = temperature_rise([reading(0.0, 4.0, 0.004), reading(9.0, 4.0, 0.003)])
    assert rise is not None
    assert rise.high == pytest.approx(1.96 * 0.005 / 4.0 / COPPER_PER_K)
    assert rise.low == pytest.approx(-rise.high)


def test_one_reading_tells_no_rise() -> None:
    assert temperature_rise([reading(0.0, 4.0)]) is None

"""The map by integration against the motor's own."""

from __future__ import annotations

import pytest

from tests.plugins.estimators.recordings import (
    classical_of,
    flux_error_percent,
)


def test_classical_map_is_right_to_a_few_thousandths() -> None:
    rms, worst = flux_error_percent(classical_of(False).map)
    assert rms < 0.2
    assert worst < 0.5


@pytest.mark.slow
def test_what_integration_would_be_without_the_inverter_is_stated() -> None:
    (remark,) = (remark for remark in classical_of(True).remarks if remark.code == "inverter_loss")
    assert remark.values["apart_percent"] == pytest.approx(45.0, rel=0.1)
    assert "inverter_loss" not in {remark.code for remark in classical_of(False).remarks}

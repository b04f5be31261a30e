"""What `add` put into a model last, `remove` takes out by returning to the model before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from orchestrator.diagnosis import add_effects, remove_effect
from orchestrator.diagnosis.reporting.earlier_models import earlier_model, keep_earlier
from orchestrator.recording import Recording, read_model, write_model
from plugins.effects.inverter import DeviceDrop, VoltageBias
from protocols import Effect, MotorModel


@pytest.fixture
def without(kept: Path) -> MotorModel:
    return read_model(kept)


@pytest.fixture
def added(without: MotorModel) -> MotorModel:
    """The model with one effect more."""
    more = without.effects[0].model_copy(update={"name": "voltage_bias"})
    restated, last = without.ladder[-1].model_copy(update={"chi2": 1.01}), without.ladder[-1]
    ladder = (*without.ladder[:-1], restated, last.model_copy(update={"added": "voltage_bias"}))
    return without.model_copy(update={"effects": (*without.effects, more), "ladder": ladder})


def test_a_model_is_found_again_by_the_effect_that_was_added_to_it(
    without: MotorModel, added: MotorModel, tmp_path: Path
) -> None:
    assert earlier_model(tmp_path, "voltage_bias", added) is None
    keep_earlier(tmp_path, "voltage_bias", without)
    assert earlier_model(tmp_path, "voltage_bias", added) == without


@pytest.mark.parametrize("change", ["another motor", "more effects", "another course", "not the last"])
def test_a_model_that_was_changed_otherwise_since_has_no_earlier_one(
    change: str, without: MotorModel, added: MotorModel, tmp_path: Path
) -> None:
    keep_earlier(tmp_path, "voltage_bias", without)
    first, *rest = added.ladder
    every: dict[str, dict[str, Any]] = {
        "another motor": {"recording": "another"},
        "more effects": {"effects": (*added.effects, added.effects[0].model_copy(update={"name": "bus_sag"}))},
        "another course": {"ladder": (first.model_copy(update={"chi2": 9.0}), *rest)},
        "not the last": {"ladder": (*added.ladder, added.ladder[-1].model_copy(update={"added": "bus_sag"}))},
    }
    assert earlier_model(tmp_path, "voltage_bias", added.model_copy(update=every[change])) is None


@pytest.mark.slow
def test_add_and_remove_state_the_same_two_errors(
    with_dead_time: Recording, without: MotorModel, tmp_path: Path
) -> None:
    write_model(tmp_path, without)
    library: list[Effect] = [DeviceDrop(), VoltageBias()]
    added = add_effects(with_dead_time, ["voltage_bias"], library, out=tmp_path).remarks[0]
    removed = remove_effect(with_dead_time, "voltage_bias", library, out=tmp_path).remarks[0]
    assert (added.code, removed.code) == ("does_not_help", "not_needed")
    assert [removed.values["after_v"], removed.values["before_v"]] == pytest.approx(
        [added.values["before_v"], added.values["after_v"]], rel=1e-3
    )
    again = read_model(tmp_path)
    assert [e.name for e in again.effects] == [e.name for e in without.effects]
    assert again.magnetics.coefficients_j == pytest.approx(without.magnetics.coefficients_j, rel=1e-3)

"""Parameters as quantities of a data sheet, with intervals that follow from the parameters' own."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.reporting.derived import derived_quantities
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from protocols import DriveRecord, Effect, ParameterValue, PluginError
from tests.orchestrator.diagnosis.pieces import plan, prepared

MANIFEST = prepared(plan()).manifest
DRIVE = DriveRecord(name="bench", sampling_frequency_hz=1e4, pwm_frequency_hz=1e4, dc_bus_voltage_v=500.0)
WITHIN_2_PERCENT = {"voltage_v": ParameterValue(value=1.0, low=0.98, high=1.02, unit="V")}


def active(effect: Effect, **values: float) -> EffectTerm:
    (candidate,) = scaled_library([effect], MANIFEST)
    absent = candidate.absent()
    return EffectTerm(candidate, {**absent.values, **values}, absent.free)


def test_a_dead_time_is_its_voltage_over_frequency_and_bus_voltage() -> None:
    found = derived_quantities(active(DeadTime(), voltage_v=1.0), WITHIN_2_PERCENT, DRIVE)
    assert set(found) == {"dead_time"}
    told = found["dead_time"]
    assert told.unit == "s"
    assert (told.value, told.low, told.high) == pytest.approx((200e-9, 196e-9, 204e-9))


def test_the_charge_of_a_swing_is_told_where_the_form_shows_it() -> None:
    found = derived_quantities(active(DeadTime(), voltage_v=1.0, threshold_a=0.1, charged=1.0), {}, DRIVE)
    assert found["charge_of_a_swing"].value == pytest.approx(0.1 * 200e-9)


def test_without_a_pwm_frequency_no_dead_time_is_told() -> None:
    drive = DRIVE.model_copy(update={"pwm_frequency_hz": None})
    assert derived_quantities(active(DeadTime(), voltage_v=1.0), {}, drive) == {}


def test_a_drop_has_its_forward_voltage_and_other_effects_have_nothing() -> None:
    assert derived_quantities(active(DeviceDrop(), voltage_v=0.9), {}, DRIVE)["forward_voltage"].value == 0.9
    assert derived_quantities(active(VoltageBias()), {}, DRIVE) == {}


def test_an_effect_whose_code_fails_is_named() -> None:
    class Broken(DeadTime):
        def derived(self, p: DeadTime.Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
            raise ZeroDivisionError

    with pytest.raises(PluginError, match="dead_time: derived: ZeroDivisionError"):
        derived_quantities(active(Broken(), voltage_v=1.0), {}, DRIVE)

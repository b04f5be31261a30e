"""What was found, as it is reported: intervals hold what was put in, the map's own rungs have sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.findings import (
    credible_effects,
    derived_quantities,
    effect_remarks,
    found_effects,
    map_effects,
    typical_size,
)
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import SlotHarmonics
from plugins.effects.resistance import WindingHeating
from protocols import DriveRecord, Effect, FoundEffect, ParameterValue, PluginError, Remark
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias
from tests.orchestrator.diagnosis.pieces import L_D, L_Q, fitter, free_model, plan, prepared, with_voltage

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))


def test_intervals_hold_what_was_put_in_and_are_as_wide_as_requested() -> None:
    fit = fitted_bias(MAKER)
    (effect,) = found_effects(MAKER, fit, {}, {"voltage_bias": ["current_offset"]})
    assert effect.twins == ("current_offset",)
    for name, truth in (("bias_a_v", 0.3), ("bias_b_v", -0.15)):
        reported = effect.parameters[name]
        assert reported.value is not None
        assert reported.low is not None
        assert reported.high is not None
        assert reported.low < truth < reported.high
        assert reported.unit == "V"


def test_the_typical_size_is_that_of_the_drive_s_data_sheet_where_there_is_one() -> None:
    drive = DriveRecord(name="x", sampling_frequency_hz=10e3, pwm_frequency_hz=10e3, dc_bus_voltage_v=500.0)
    for effect, unit in ((DeadTime(), "s"), (DeviceDrop(), "V"), (VoltageBias(), "V")):
        candidate = scaled_library([effect], MAKER.prepared.manifest)[0]
        first = candidate.named(candidate.amplitudes[0])
        typical = typical_size(candidate.absent().moved(first.name, 0.3), drive)
        assert typical.unit == unit
        assert typical.value == pytest.approx(first.typical / 5e6 if unit == "s" else first.typical)


def test_of_what_only_a_second_angle_shows_nothing_is_stated_at_one() -> None:
    bias = fitted_bias(MAKER)
    slots = scaled_library([SlotHarmonics()], MAKER.prepared.manifest)[0]
    fit = MAKER.fit(bias.model.with_active([*bias.model.active, slots.absent()]))
    reported = {effect.name: list(effect.parameters) for effect in found_effects(MAKER, fit, {}, {})}
    assert reported["slot_harmonics"] == ["relative"]
    assert reported["voltage_bias"] == ["bias_a_v", "bias_b_v"]


def test_a_map_that_is_constant_has_neither_saturation_nor_cross_saturation() -> None:
    fit = MAKER.relinearise(free_model(), held=True)
    saturation, cross = map_effects(fit, {"saturation": 1.0, "cross_saturation": 0.0})
    assert saturation.parameters["relative_change"].value == pytest.approx(0.0, abs=1e-9 * (L_D + L_Q))
    assert cross.relative_size == pytest.approx(0.0, abs=1e-9)


class Talkative(VoltageBias):
    def remarks(self, p: VoltageBias.Parameters) -> list[Remark]:
        return [Remark.of("in_a", "{volts:.1f} V in a", volts=p.bias_a_v)]


class Faulty(VoltageBias):
    def remarks(self, p: VoltageBias.Parameters) -> list[Remark]:
        raise KeyError("no such leg")


def _by(effect: VoltageBias) -> Fit:
    fit = fitted_bias(MAKER)
    (active,) = fit.model.active
    candidate = replace(active.candidate, effect=effect)
    return replace(fit, model=fit.model.with_active([replace(active, candidate=candidate)]))


def test_an_effect_that_is_named_says_what_its_parameters_mean() -> None:
    (stated,) = effect_remarks(_by(Talkative()), {"voltage_bias"})
    assert (stated.code, stated.text) == ("voltage_bias.in_a", "voltage_bias: 0.3 V in a")
    assert effect_remarks(_by(Talkative()), set()) == []
    assert effect_remarks(_by(VoltageBias()), {"voltage_bias"}) == []


def test_an_effect_that_fails_to_say_it_is_named() -> None:
    with pytest.raises(PluginError, match=r"voltage_bias.*remarks: KeyError"):
        effect_remarks(_by(Faulty()), {"voltage_bias"})


def test_what_takes_away_less_than_is_left_is_not_listed() -> None:
    some = [
        FoundEffect(name=name, parameters={}, twins=(), relative_size=1.0, log_evidence=20.0, share=share)
        for name, share in (("a", 0.5), ("b", 0.02))
    ]
    assert [effect.name for effect in credible_effects(some, 0.42, 3.0)] == ["a"]
    assert [effect.name for effect in credible_effects(some, 0.0, 3.0)] == ["a", "b"]


@pytest.mark.parametrize(("left", "listed"), [(0.1, ["a"]), (0.0, ["a", "b"])])
def test_what_takes_away_many_times_the_error_while_something_is_left_is_not_listed(
    left: float, listed: list[str]
) -> None:
    some = [
        FoundEffect(name=name, parameters={}, twins=(), relative_size=1.0, log_evidence=20.0, share=share)
        for name, share in (("a", 0.5), ("b", 30.0))
    ]
    assert [effect.name for effect in credible_effects(some, left, 3.0)] == listed


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
    reported = found["dead_time"]
    assert reported.unit == "s"
    assert (reported.value, reported.low, reported.high) == pytest.approx((200e-9, 196e-9, 204e-9))


def test_the_charge_of_a_swing_is_reported_where_the_form_shows_it() -> None:
    found = derived_quantities(active(DeadTime(), voltage_v=1.0, threshold_a=0.1, charged=1.0), {}, DRIVE)
    assert found["charge_of_a_swing"].value == pytest.approx(0.1 * 200e-9)


def test_without_a_pwm_frequency_no_dead_time_is_reported() -> None:
    drive = DRIVE.model_copy(update={"pwm_frequency_hz": None})
    assert derived_quantities(active(DeadTime(), voltage_v=1.0), {}, drive) == {}


def test_a_winding_that_warms_by_a_kelvin_per_watt_gains_the_resistance_of_copper_per_kelvin() -> None:
    found = derived_quantities(active(WindingHeating(), rise_per_watt=0.00393), {}, DRIVE)["thermal_resistance"]
    assert found.value == pytest.approx(1.0)
    assert found.unit == "K/W"


def test_a_drop_has_its_forward_voltage_and_other_effects_have_nothing() -> None:
    assert derived_quantities(active(DeviceDrop(), voltage_v=0.9), {}, DRIVE)["forward_voltage"].value == 0.9
    assert derived_quantities(active(VoltageBias()), {}, DRIVE) == {}


def test_an_effect_whose_code_fails_is_named() -> None:
    class Broken(DeadTime):
        def derived(self, p: DeadTime.Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
            raise ZeroDivisionError

    with pytest.raises(PluginError, match="dead_time: derived: ZeroDivisionError"):
        derived_quantities(active(Broken(), voltage_v=1.0), {}, DRIVE)

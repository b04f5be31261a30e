"""A parameter that a bound has stopped is reported with the bound, as declared and as scaled to the machine."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, MachineScale, scaled_library
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.reporting.benefit import added_remark
from orchestrator.diagnosis.reporting.parameter_bounds import bound_remarks, bounds_reached
from orchestrator.formatting.quantities import number
from plugins.effects.inverter import DeadTime
from plugins.effects.iron import Hysteresis
from protocols import Contrast, Correction, Effect, EffectLayer, EffectParameters, Signals, amplitude, shape
from tests.orchestrator.diagnosis.fitting.test_fit import ERROR_V, with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), ERROR_V))


class Narrow:
    """A bias along alpha with bounds that the recording's 0.3 V exceed."""

    name: ClassVar[str] = "narrow_bias"
    summary: ClassVar[str] = "A constant voltage along alpha."
    signature: ClassVar[str] = "A constant residual."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        bias_v: float = amplitude("V", typical=0.05, prior_width=0.1, low=-0.1, high=0.1)
        knee_a: float = shape("A", typical=0.1, prior_width=1.0, low=0.001, high=2.0)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab - np.array([p.bias_v, 0.0]))


class Wide(Narrow):
    class Parameters(EffectParameters):
        bias_v: float = amplitude("V", typical=0.05, prior_width=0.1, low=-5.0, high=5.0)


def term(effect: Effect, **values: float) -> EffectTerm:
    (candidate,) = scaled_library([effect], MAKER.prepared.manifest)
    return EffectTerm(candidate, {**candidate.absent().values, **values}, (*candidate.amplitudes, *values))


@pytest.mark.parametrize("effect", [Narrow(), guarded(Narrow())], ids=["library", "of a file"])
def test_an_effect_at_its_bound_may_help_and_its_bound_is_stated(effect: Effect) -> None:
    bare = MAKER.fit(free_model())
    after = MAKER.fit(with_free(bare.model, MAKER, effect))
    volts = MachineScale.of(MAKER.prepared.manifest).volts
    scaled = "" if volts == 1.0 else f", scaled by {number(volts, 2)} to this machine"
    remark = added_remark("narrow_bias", bare, after, None)
    assert remark.code == "helps_at_bound"
    assert remark.text.startswith("narrow bias may help: the held-out error falls from ")
    assert remark.text.endswith(f"but its bias is at its bound {1e2 * volts:.3g} mV (high = 100 mV{scaled})")
    (noted,) = bound_remarks(after)
    assert noted.code == "at_bound"
    assert f"narrow_bias: bias is at its bound {1e2 * volts:.3g} mV (high = 100 mV{scaled})" in noted.text
    assert bound_remarks(after, {"narrow_bias"}) == []


def test_an_effect_within_wide_bounds_helps_without_a_remark() -> None:
    bare = MAKER.fit(free_model())
    after = MAKER.fit(with_free(bare.model, MAKER, Wide()))
    assert added_remark("narrow_bias", bare, after, None).code == "helps"
    assert bound_remarks(after) == []


def test_the_factor_by_which_the_nameplate_scales_a_bound_is_stated() -> None:
    manifest = MAKER.prepared.manifest
    drive = manifest.drive.model_copy(update={"dc_bus_voltage_v": 48.0})
    (candidate,) = scaled_library([Narrow()], manifest.model_copy(update={"drive": drive}))
    low = candidate.named("bias_v").low
    at = EffectTerm(candidate, {**candidate.absent().values, "bias_v": low}, candidate.amplitudes)
    assert bounds_reached(at) == {"bias_v": "−8.89 mV (low = −100 mV, scaled by 0.089 to this machine)"}


def test_a_shape_next_to_its_bound_counts_and_one_that_is_not_free_does_not() -> None:
    low = term(Narrow()).candidate.named("knee_a").low
    assert list(bounds_reached(term(Narrow(), knee_a=1.001 * low))) == ["knee_a"]
    assert bounds_reached(term(Narrow(), knee_a=1.5 * low)) == {}
    absent = term(Narrow())
    assert bounds_reached(EffectTerm(absent.candidate, {**absent.values, "knee_a": low}, ("bias_v",))) == {}


@pytest.mark.parametrize("effect", [Hysteresis(), DeadTime()], ids=lambda effect: effect.name)
def test_an_absent_amplitude_is_at_no_bound(effect: Effect) -> None:
    assert bounds_reached(term(effect)) == {}

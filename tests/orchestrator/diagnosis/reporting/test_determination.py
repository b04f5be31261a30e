"""An effect whose size a recording does not determine is neither said to help nor to be absent."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.benefit import added_remark
from orchestrator.diagnosis.reporting.determination import undeterminable_words, undetermined_words
from orchestrator.diagnosis.reporting.findings import found_effects
from orchestrator.numerics.frames import from_phases, to_phases
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import Contrast, Correction, Effect, EffectLayer, EffectParameters, Signals, amplitude
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared


class Choke:
    """An inductance in series with phase a, which at one rotor angle is a part of the map."""

    name: ClassVar[str] = "choke"
    summary: ClassVar[str] = "A choke in phase a."
    signature: ClassVar[str] = "A residual against di_a/dt."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        inductance_h: float = amplitude("H", typical=1e-3, prior_width=3e-3, low=-0.1, high=0.1)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        i_a = to_phases(signals.i_ab)[:, 0]
        loss = np.zeros((len(i_a), 3))
        loss[:, 0] = p.inductance_h * np.append(np.diff(i_a), 0.0) * signals.sampling_frequency_hz
        return Correction(v_ab=signals.v_ab - from_phases(loss))


class NeedsGatesOffTwice(Choke):
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.GATES_OFF, Contrast.SECOND_PWM_FREQUENCY)


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(prepared(plan(sparse=True)))


@pytest.fixture(scope="module")
def bare(maker: Fitter) -> Fit:
    return maker.fit(free_model())


def grown(maker: Fitter, effect: Effect) -> Fit:
    return maker.fit(with_free(free_model(), maker, effect))


def test_what_the_map_takes_up_is_not_determined_whether_fitted_or_not(maker: Fitter, bare: Fit) -> None:
    after = grown(maker, Choke())
    (found,) = found_effects(maker, after, {}, {})
    text = undetermined_words(after, found)
    assert text.startswith("this recording cannot determine it (its inductance to ±")
    assert text.endswith("take it up; the rotor locked at a second angle may tell it from them")
    assert "mH, where 1.04 mH is typical)" in text
    (candidate,) = scaled_library([Choke()], maker.prepared.manifest)
    assert undeterminable_words(maker, bare, candidate).endswith(text.partition("where ")[2])
    remark = added_remark("choke", bare, after, found)
    assert remark.code == "undetermined"
    assert remark.text == f"choke does not help, nor is it excluded: {text}"


def test_what_an_effect_declares_to_need_is_named_where_the_recording_lacks_it(maker: Fitter, bare: Fit) -> None:
    (candidate,) = scaled_library([NeedsGatesOffTwice()], maker.prepared.manifest)
    text = undeterminable_words(maker, bare, candidate)
    assert text.endswith("take it up; needs direct currents at a second PWM frequency")


@pytest.mark.parametrize("effect", [VoltageBias(), DeadTime()])
def test_what_holds_show_is_determined(maker: Fitter, bare: Fit, effect: Effect) -> None:
    (candidate,) = scaled_library([effect], maker.prepared.manifest)
    assert undeterminable_words(maker, bare, candidate) == ""
    after = grown(maker, effect)
    (found,) = found_effects(maker, after, {}, {})
    assert undetermined_words(after, found) == ""

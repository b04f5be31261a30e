"""How much of an effect's signal another one imitates in a recording, whatever they declare."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.fitting.imitation import imitated_shares, resembling
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import Contrast
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


class SameBias(VoltageBias):
    name: ClassVar[str] = "same_bias"
    needs: ClassVar[tuple[Contrast, ...]] = ()


def test_an_effect_s_signal_is_imitated_by_its_like_alone() -> None:
    maker = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.1])))
    library = scaled_library([VoltageBias(), guarded(SameBias()), DeadTime()], maker.prepared.manifest)
    fit = maker.fit(with_free(free_model(), maker, VoltageBias()))
    shares = imitated_shares(maker, fit, "voltage_bias", library)
    assert list(shares) == ["same_bias", "dead_time"]
    assert shares["same_bias"] > 0.95
    assert shares["dead_time"] < 0.5
    assert resembling(maker, fit, "voltage_bias", library) == ["same_bias"]

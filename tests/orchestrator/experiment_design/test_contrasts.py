"""The stages of every contrast bring it about, scaled to the bench."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from orchestrator.diagnosis.selection.contrasts import holds
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.experiment_design.contrasts import STAGES, Bench, minutes, round_for_people
from orchestrator.experiment_design.separation import planned_pieces
from protocols import Contrast, Saturated
from tests.orchestrator.diagnosis.selection.test_contrasts import bare, only, setup

__all__ = ["setup"]

WITH_STAGES = [contrast for contrast in Contrast if contrast is not Contrast.SECOND_ANGLE]


def test_every_contrast_is_in_the_catalogue() -> None:
    assert set(STAGES) == set(Contrast)


@pytest.mark.parametrize("contrast", WITH_STAGES)
def test_what_its_stages_measure_brings_a_contrast_about(setup: DiagnosisSetup, contrast: Contrast) -> None:
    before = bare(setup.prepared)
    model = baseline_model(setup, Saturated())

    @cache
    def planned(number: int) -> tuple[SegmentData, ...]:
        stage = STAGES[contrast](Bench.of(setup))[number]
        return tuple(piece for piece, _ in planned_pieces(setup, model, stage))

    for number in range(len(STAGES[contrast](Bench.of(setup)))):
        pieces = planned(number)
        if contrast is Contrast.ANCHOR:
            # Measured at the end of an experiment whose first hold was the same.
            first = replace(pieces[0], signals=replace(pieces[0].signals, start_s=0.0))
            assert holds(only(before, first, *before.pieces, *pieces), contrast)
        elif contrast is Contrast.LONG_HOLD:
            # A plan stands for a hold by a part of it.
            n = round(30.0 * pieces[0].signals.sampling_frequency_hz)
            part = pieces[0].signals
            names = ("i_ab", "v_ab", "i_m_ab", "v_dc", "theta_rad", "resistance_ohm", "heat_j")
            whole: dict[str, Any] = {
                name: np.resize(getattr(part, name), (n, *getattr(part, name).shape[1:])) for name in names
            }
            signals = replace(part, **whole)
            assert holds(only(before, *before.pieces, replace(pieces[0], signals=signals)), contrast)
        else:
            assert holds(only(before, *before.pieces, *pieces), contrast)


def test_stages_are_scaled_from_the_injection_there_was(setup: DiagnosisSetup) -> None:
    bench = Bench.of(setup)
    assert (bench.injection_hz, bench.injection_v) == (500.0, 40.0)
    (second,) = STAGES[Contrast.SECOND_INJECTION_AMPLITUDE](bench)
    assert (second["frequency_hz"], second["amplitudes_v"]) == (500.0, [20.0, 10.0])
    without = replace(setup, prepared=only(setup.prepared, *setup.prepared.pieces[:1]))
    likely = Bench.of(without)
    assert likely.injection_hz == 500.0
    # A square wave of this voltage swings the flux by a fifth of L_d I, both ways.
    assert likely.injection_v / (4.0 * likely.injection_hz) == pytest.approx(0.2 * 0.04325 * setup.current_a)


def test_ripple_of_twice_the_frequency_is_left_out_where_samples_are_too_few(setup: DiagnosisSetup) -> None:
    bench = Bench.of(setup)
    stages = STAGES[Contrast.SECOND_INJECTION_FREQUENCY]
    assert [s["frequency_hz"] for s in stages(bench)] == [250.0, 1000.0]
    assert [s["frequency_hz"] for s in stages(replace(bench, sampling_hz=3999.0))] == [250.0]


def test_a_stage_takes_as_long_as_its_points_and_repetitions() -> None:
    stage = {"points_a": [[0, 0], [1, 0]], "amplitudes_v": [1, 2, 3], "duration_s": 1.5, "settle_s": 0.5}
    assert minutes(stage) == pytest.approx(2 * 3 * 2.0 / 60.0)


def test_numbers_are_for_a_person() -> None:
    assert [round_for_people(x) for x in (2.3456, -1e-12, 1234.5)] == [2.35, 0.0, 1230.0]
    assert str(round_for_people(-1e-12)) == "0.0"

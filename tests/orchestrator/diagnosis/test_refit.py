"""A model that is refitted by hand is on a map as fine as the data ask for then."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from orchestrator.diagnosis import _refit
from orchestrator.diagnosis._refit import _refine_map, add_effects, unchanged_model
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.recording import Recording, open_recording, read_model
from plugins.effects.inverter import DeadTime, DeviceDrop
from protocols import Effect, Saturated
from tests.orchestrator.diagnosis.fitting.conftest import setup

__all__ = ["setup"]


@pytest.mark.slow
def test_a_map_gets_the_detail_that_is_requested_when_nothing_else_is_missing(sharp: DiagnosisSetup) -> None:
    """A coarse one does while an effect is missing, and would keep its error when that is added."""
    coarse = sharp.fitter.fit(baseline_model(sharp, Saturated()))
    fine = _refine_map(sharp, coarse)
    assert max(fine.model.space.grid.cells) > max(coarse.model.space.grid.cells)
    assert fine.chi2_per_dof - 1.0 < 0.5 * (coarse.chi2_per_dof - 1.0)


@pytest.mark.parametrize(("gain", "is_better"), [(1e3, True), (3.0, False)])
def test_one_of_two_similar_effects_is_added_anew_after_the_other_and_kept_where_that_fits_better(
    setup: DiagnosisSetup, gain: float, is_better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = {c.name: c for c in scaled_library([DeadTime(), DeviceDrop()], setup.prepared.manifest)}
    bare = setup.fitter.fit(baseline_model(setup, Saturated()))
    both = bare.model.with_active([c.absent().moved("voltage_v", 0.1) for c in library.values()])
    fit = replace(setup.fitter.evaluate(both, bare.linearisation), dof=1.0)  # as if much were left
    tried: list[str] = []

    def anew(setup: DiagnosisSetup, others: Fit, candidate: CandidateEffect) -> Fit:
        tried.append(candidate.name)
        assert candidate.name not in others.model.names
        return others

    monkeypatch.setattr(_refit, "with_effect", anew)
    monkeypatch.setattr(_refit, "resembling_pairs", lambda *_: [("dead_time", "device_drop")])
    monkeypatch.setattr(_refit, "evidence_gain", lambda *_: gain)
    found = _refit._with_similar_ones_anew(setup, fit, ["device_drop"], library)
    assert set(tried) == {"dead_time", "device_drop"}
    assert (found is not fit) is is_better


@pytest.mark.parametrize("again", [False, True])
def test_a_map_that_is_fine_enough_stays(setup: DiagnosisSetup, again: bool) -> None:
    fit = setup.fitter.fit(baseline_model(setup, Saturated()))
    if again:
        fit = _refine_map(setup, fit)
    assert _refine_map(setup, fit) is fit


def test_an_add_into_a_folder_without_a_model_says_that_it_left_the_recording_s_own(
    with_dead_time: Recording, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = Path(shutil.copytree(with_dead_time.path, tmp_path / "copy"))
    monkeypatch.setattr(
        "orchestrator.diagnosis._refit._added", lambda *_: unchanged_model(read_model(kept), ["device_drop"])
    )
    library: list[Effect] = [DeviceDrop(), DeadTime()]
    without = add_effects(open_recording(copy), ["dead_time"], library, out=tmp_path / "elsewhere")
    assert "no_model" not in [remark.code for remark in without.remarks]
    shutil.copy(kept / "model.json", copy)
    report = add_effects(open_recording(copy), ["dead_time"], library, out=tmp_path / "elsewhere")
    assert report.remarks[0].code == "no_model"
    assert "the model began without the effects of the recording's own" in report.remarks[0].text

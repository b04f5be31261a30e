"""The model's own error as noise: as large as it is, where it is, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.uncertainty.model_error import with_model_error
from orchestrator.diagnosis.weak_form.noise import kind_of
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import ModelNoise, SegmentStage
from tests.orchestrator.diagnosis.pieces import R_S, Plan, fitter, free_model, hold, plan, prepared

TURN = 2.0 * np.pi * np.arange(40) / 40


def _campaign() -> list[Plan]:
    return plan() + [Plan(SegmentStage.RESISTANCE, hold(2.0 * np.cos(t), 2.0 * np.sin(t))) for t in TURN]


def _bumpy(made: PreparedRecording, sigma_v: float) -> PreparedRecording:
    """Holds whose voltage is off, each by its own amount: a form that no effect has."""
    rng = np.random.default_rng(2)
    pieces = [
        replace(p, signals=replace(p.signals, v_ab=p.signals.v_ab + rng.normal(0.0, sigma_v, 2)))
        if p.stage is SegmentStage.RESISTANCE
        else p
        for p in made.pieces
    ]
    return replace(made, pieces=tuple(pieces))


def test_noise_alone_is_no_more_than_it_is() -> None:
    noise = with_model_error(ModelNoise(), fitter(prepared(_campaign())).fit(free_model()))
    # Ninety rows of a hold tell a variance to 15 %; three of these, and never less than the readings' own.
    for factors in noise.variance_factors.values():
        assert all(1.0 <= factor < 1.6 for factor in factors)


def test_what_errs_at_rest_is_weighed_there_and_all_is_noise_then() -> None:
    maker = fitter(_bumpy(prepared(_campaign()), 0.02))
    fit = maker.fit(free_model())
    assert fit.chi2_per_dof > 3.0
    noise, weighed = ModelNoise(), maker
    for _ in range(3):
        noise = with_model_error(noise, fit)
        weighed = maker.with_noise(noise)
        fit = weighed.fit(fit.model)
    assert min(noise.variance_factors["rest"]) > 20.0
    moving = [f for kind, factors in noise.variance_factors.items() if kind != "rest" for f in factors]
    assert max(moving) < 2.0
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=0.15)
    # R_s is as uncertain as forty readings that are off by 20 mV at 2 A make it, not by the readings' noise.
    assert abs(fit.model.r_s - R_S) < 4.0 * 0.02 / 2.0 / np.sqrt(40.0)


@pytest.mark.slow
def test_what_was_weighed_once_is_weighed_the_same_again() -> None:
    maker = fitter(_bumpy(prepared(_campaign()), 0.02))
    noise, fit = ModelNoise(), maker.fit(free_model())
    found = []
    for _ in range(6):
        noise = with_model_error(noise, fit)
        found.append(np.concatenate(list(noise.variance_factors.values())))
        fit = maker.with_noise(noise).fit(fit.model)
    np.testing.assert_allclose(found[-1], found[-2], rtol=0.1)


def test_a_frame_of_another_noise_is_made_anew() -> None:
    maker = fitter(prepared(plan(sparse=True)))
    frame = maker.frame(free_model())
    modes = {kind_of(p): (4.0,) * len(p.windows.carriers) for p in maker.prepared.pieces}
    wider = maker.with_noise(ModelNoise(variance_factors=modes))
    old, new = frame.pieces[1], wider.frame(replace(free_model(), space=frame.space), frame).pieces[1]
    np.testing.assert_allclose(new.white_basis, 0.5 * old.white_basis, rtol=1e-9)

"""The verdict asks for little beside the first error, and little in itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import excitation_v, left_of_excitation
from orchestrator.diagnosis.judgement.judge import judge
from orchestrator.diagnosis.judgement.verdict import (
    fitted_verdict,
    held_out_chi2,
    prediction_gain,
    residual_fraction_of,
    verdict_record,
)
from plugins.effects.inverter import DeadTime
from protocols import SegmentStage, Verdict
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias
from tests.orchestrator.diagnosis.pieces import fitter, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def fit() -> Fit:
    found = fitted_bias(fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0]))))
    return replace(found, dof=4000.0)  # as of a recording in which chance makes little


def verdict_of(before: Fit, after: Fit, effects: int) -> Verdict:
    return judge(verdict_record(before, after, effects)).verdict


def _with_chi2(fit: Fit, chi2: float) -> Fit:
    return replace(fit, chi2=chi2 * fit.dof)


@pytest.mark.parametrize(
    ("before", "after", "effects", "verdict"),
    [
        (1.02, 1.02, 0, "clean"),
        (500.0, 1.05, 1, "explained"),
        (900.0, 1.4, 1, "explained"),  # a fiftieth of the error
        (900.0, 2.2, 1, "mostly_explained"),  # a twenty-seventh, but more than another form makes
        (101.0, 2.0, 1, "mostly_explained"),  # a tenth
        (11.0, 2.2, 1, "unknown_remains"),  # a third
        (500.0, 500.0, 0, "unknown_remains"),
    ],
)
def test_verdict_asks_for_little_beside_the_first_error_and_little_in_itself(
    fit: Fit, before: float, after: float, effects: int, verdict: str
) -> None:
    assert verdict_of(_with_chi2(fit, before), _with_chi2(fit, after), effects) == verdict


@pytest.mark.parametrize(
    ("widths", "chi2", "verdict"),
    [(3.0, 2.2, "mostly_explained"), (5.0, 2.2, "unknown_remains"), (5.0, 1.4, "explained")],
)
def test_a_form_bent_further_than_such_effects_are_stands_in_for_another_where_something_is_left(
    fit: Fit, widths: float, chi2: float, verdict: str
) -> None:
    (dead_time,) = scaled_library([DeadTime()], fit.prepared.manifest)
    bent = dead_time.absent().release("leg_a_longer").moved("leg_a_longer", widths)
    strained = replace(fit, model=fit.model.with_active([*fit.model.active, bent]))
    assert verdict_of(_with_chi2(strained, 900.0), _with_chi2(strained, chi2), 1) == verdict


def _leaving(fit: Fit, chi2: float, part: float) -> Fit:
    """A fit that leaves so much of chi2, and of the excitation this part of what is material."""
    left = replace(
        _with_chi2(fit, chi2),
        volts=tuple(np.ones_like(e) for e in fit.volts),
        residual=tuple(np.full_like(e, np.sqrt(chi2)) for e in fit.residual),
    )
    volt = part * fit.criteria.materiality.material_voltage / left_of_excitation(left)
    return replace(left, volts=tuple(volt * e for e in left.volts))


@pytest.mark.parametrize(
    ("part", "chi2", "verdict"),
    [(0.5, 4.0, "mostly_explained"), (2.0, 4.0, "unknown_remains"), (1e-3, 9.0, "unknown_remains")],
)
def test_what_no_engineer_would_miss_is_forgiven_near_the_noise_and_not_far_beyond_it(
    fit: Fit, part: float, chi2: float, verdict: str
) -> None:
    assert verdict_of(_with_chi2(fit, 1e6), _leaving(fit, chi2, part), 1) == verdict


@pytest.mark.parametrize(
    ("part", "chi2", "verdict"),
    [
        (0.5, 1.35, "clean"),
        (2.0, 1.12, "unknown_remains"),
        (0.5, 1.5, "unknown_remains"),
        (0.05, 1.5, "clean"),
        (0.05, 2.5, "unknown_remains"),
    ],
)
def test_noise_a_little_larger_than_the_readings_say_is_noise_where_it_does_not_matter(
    fit: Fit, part: float, chi2: float, verdict: str
) -> None:
    left = _leaving(fit, chi2, part)
    assert verdict_of(left, left, 0) == verdict


def test_what_chance_makes_of_few_readings_is_noise(fit: Fit) -> None:
    for dof, beyond in ((4000.0, 1.45), (50.0, 1.7)):
        few = replace(fit, dof=dof)
        chance = _with_chi2(few, 1.0 + 2.0 * np.sqrt(2.0 / dof))
        assert verdict_of(chance, chance, 0) == "clean"
        assert verdict_of(_with_chi2(few, beyond), _with_chi2(few, beyond), 0) == "unknown_remains"


def test_what_is_left_is_a_ratio_of_amplitudes(fit: Fit) -> None:
    assert residual_fraction_of(101.0, _with_chi2(fit, 2.0)) == pytest.approx(0.1)
    assert residual_fraction_of(1.05, _with_chi2(fit, 1.05)) == 0.0
    assert residual_fraction_of(101.0, _with_chi2(fit, 0.9)) == 0.0


def test_what_only_the_held_out_part_shows_is_not_explained(fit: Fit) -> None:
    off = [e + 2.0 if p.held_out else e for p, e in zip(fit.prepared.pieces, fit.residual, strict=True)]
    worse = replace(_with_chi2(fit, 1.0), residual=tuple(off))
    held_out = verdict_record(worse, worse, 1).held_out_chi2
    assert held_out is not None
    assert held_out - 1.0 > worse.criteria.verdict.mostly_explained_excess_chi2
    assert verdict_of(_with_chi2(fit, 900.0), _with_chi2(fit, 1.0), 1) == "explained"
    assert verdict_of(_with_chi2(fit, 900.0), worse, 1) != "explained"
    assert fitted_verdict(_with_chi2(fit, 900.0), worse) == "explained"  # and decides on no name


def test_a_worse_prediction_of_held_out_stages_is_a_loss_by_its_squares(fit: Fit) -> None:
    off = [e + 0.5 if p.held_out else e for p, e in zip(fit.prepared.pieces, fit.residual, strict=True)]
    worse = replace(fit, residual=tuple(off))
    rows = sum(len(e) for p, e in zip(fit.prepared.pieces, fit.residual, strict=True) if p.held_out)
    before, after = held_out_chi2(fit), held_out_chi2(worse)
    assert before is not None
    assert after is not None
    assert prediction_gain(fit, fit) == 0.0
    assert prediction_gain(worse, fit) == pytest.approx(-0.5 * rows * (after - before) / max(before, 1.0))


def _denied(fit: Fit, sigmas: float, of_material: float) -> Fit:
    """A fit of which the reading without current leaves so much, in its noise and in what would be material."""
    off = [p.stage is SegmentStage.GATES_OFF for p in fit.prepared.pieces]
    assert any(off)
    volts = of_material * fit.criteria.materiality.material_voltage * excitation_v(fit)
    return replace(
        _with_chi2(fit, 1.0),
        residual=tuple(np.full_like(e, sigmas) if o else e for o, e in zip(off, fit.residual, strict=True)),
        volts=tuple(np.full_like(e, volts) if o else e for o, e in zip(off, fit.volts, strict=True)),
    )


@pytest.mark.parametrize(
    ("sigmas", "of_material", "verdict"),
    [(8.0, 1.5, "unknown_remains"), (1.5, 1.5, "explained"), (8.0, 0.01, "explained")],
)
def test_what_a_reading_without_current_denies_is_not_explained_however_few_its_equations(
    fit: Fit, sigmas: float, of_material: float, verdict: str
) -> None:
    assert verdict_of(_with_chi2(fit, 500.0), _denied(fit, sigmas, of_material), 1) == verdict

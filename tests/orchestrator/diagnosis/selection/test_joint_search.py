"""All effects together: those that are there are found beside those that are not, whatever the order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import BLOCKS, block_scatter
from orchestrator.diagnosis.selection import joint_search as joint_search_module
from orchestrator.diagnosis.selection.joint_search import (
    backward_elimination,
    fit_full_model,
    forward_step,
    free_own_shapes,
    free_remaining_shapes,
    joint_search,
    log_bayes_factors,
    merge_indistinguishable,
    probabilities,
    redundant_terms,
    refit,
    swap_step,
    without_effect,
)
from orchestrator.diagnosis.selection.scoring import LinearView, Score, score
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.sensors import CurrentOffset
from protocols import Effect
from tests.orchestrator.diagnosis.pieces import Array, fitter, free_model, plan, prepared, with_voltage

BIAS_V = np.array([0.3, -0.1])


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), BIAS_V))


@pytest.fixture(scope="module")
def library(maker: Fitter) -> tuple[CandidateEffect, ...]:
    effects: list[Effect] = [DeadTime(), RotorMisalignment(), VoltageBias(), PhaseResistanceImbalance()]
    return scaled_library(effects, maker.prepared.manifest)


@pytest.fixture(scope="module")
def fit(maker: Fitter, library: tuple[CandidateEffect, ...]) -> Fit:
    return joint_search(maker, free_own_shapes(maker, fit_full_model(maker, free_model(), library)), library)[0]


def test_what_is_there_is_found_and_what_is_not_is_not(fit: Fit) -> None:
    assert fit.model.names == ("voltage_bias",)
    assert fit.model.active[0].values["bias_a_v"] == pytest.approx(BIAS_V[0], rel=0.02)
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / fit.dof))


def test_the_order_of_the_library_does_not_matter(
    maker: Fitter, library: tuple[CandidateEffect, ...], fit: Fit
) -> None:
    again, _ = joint_search(
        maker, free_own_shapes(maker, fit_full_model(maker, free_model(), library[::-1])), library[::-1]
    )
    assert again.model.names == fit.model.names
    assert again.objective == pytest.approx(fit.objective, rel=1e-3)


def test_nothing_is_found_where_nothing_is_hidden(library: tuple[CandidateEffect, ...]) -> None:
    clean = fitter(prepared(plan(sparse=True)))
    found, indistinguishable = joint_search(
        clean, free_own_shapes(clean, fit_full_model(clean, free_model(), library)), library
    )
    assert found.model.names == ()
    assert indistinguishable == {}


def test_evidence_is_what_the_density_at_nothing_says(
    maker: Fitter, library: tuple[CandidateEffect, ...], fit: Fit
) -> None:
    """For one amplitude: log N(0; 0, 1) - log N(0; x, s), from the fit's own normal matrix."""
    bias = fit.model.active[0]
    one = fit.model.with_active([replace(bias, free=("bias_a_v",))])
    single = maker.evaluate(one, maker.linearise(one))
    factor = log_bayes_factors(single)["voltage_bias"]
    noise = np.linalg.inv(single.projected()[0] / single.chi2_per_dof + np.eye(1))[0, 0]
    between = block_scatter(single)[0] ** 2 / BLOCKS
    x, s = bias.standardised_value("bias_a_v"), math.sqrt(noise + between)
    assert factor == pytest.approx(math.log(s) + 0.5 * (x / s) ** 2)
    assert redundant_terms(single) == []
    assert probabilities(single)["voltage_bias"] == pytest.approx(1.0)


def test_an_effect_of_no_size_can_go(maker: Fitter, library: tuple[CandidateEffect, ...], fit: Fit) -> None:
    more = fit.model.with_active([*fit.model.active, library[0].absent()])
    beside = maker.evaluate(more, maker.linearise(more))
    assert redundant_terms(beside) == ["dead_time"]
    assert probabilities(beside)["dead_time"] < 0.2


def test_what_blocks_disagree_on_stays_where_much_is_lost_with_it(
    maker: Fitter, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joint_search_module, "block_scatter", lambda f: np.full(len(f.model.free), 10.0))
    assert "voltage_bias" in redundant_terms(fit)
    assert backward_elimination(maker, fit).model.names == fit.model.names


def test_an_effect_makes_room_for_one_that_does_better_in_its_place(maker: Fitter) -> None:
    both = scaled_library([CurrentOffset(), VoltageBias()], maker.prepared.manifest)
    wrong = refit(maker, free_model().with_active([both[0].absent()]))
    assert swap_step(maker, wrong, both, names=[])[0] is wrong
    right, indistinguishable = swap_step(maker, wrong, both)
    assert right.model.names == ("voltage_bias",)
    assert set(indistinguishable) <= {"voltage_bias"}
    assert swap_step(maker, right, both)[0].model.names == ("voltage_bias",)


def test_what_is_left_without_an_effect_is_more(maker: Fitter, fit: Fit) -> None:
    assert without_effect(maker, fit, "voltage_bias").chi2 > 10.0 * fit.chi2


def _lost_to(dead_time: DeadTime.Parameters, made: PreparedRecording) -> dict[str, Array]:
    """The voltage that a dead time takes in each segment."""
    taken = {}
    for piece in made.pieces:
        left = DeadTime().correct(piece.signals, dead_time).v_ab
        assert left is not None
        taken[piece.segment.id] = np.asarray(piece.signals.v_ab - left, dtype=np.float64)
    return taken


def test_an_effect_that_asks_for_what_another_takes_is_requested_when_that_is_there(
    maker: Fitter, library: tuple[CandidateEffect, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[list[str]] = []

    def jealous(view: LinearView) -> list[Score]:
        """The first time a misaligned rotor promises a fifth of what the largest does."""
        scores = score(view)
        most = max(s.gain for s in scores)
        reported.append([s.candidate.name for s in scores])
        return [
            replace(s, gain=0.2 * most) if len(reported) == 1 and s.candidate.name == "rotor_misalignment" else s
            for s in scores
        ]

    monkeypatch.setattr(joint_search_module, "score", jealous)
    found = forward_step(maker, maker.fit(free_model()), library)
    assert found.model.names == ("voltage_bias",)
    assert "voltage_bias" in reported[0]
    assert "voltage_bias" not in reported[1]


def test_a_form_is_requested_once_more_where_something_is_left() -> None:
    made = prepared(plan(sparse=True))
    (dead_time,) = scaled_library([DeadTime()], made.manifest)
    maker = fitter(with_voltage(made, _lost_to(DeadTime.Parameters(voltage_v=2.0, threshold_a=0.4), made)))
    rigid = refit(maker, free_model().with_active([dead_time.absent()]))
    formed = free_remaining_shapes(maker, rigid)
    assert rigid.chi2_per_dof > 1.5 > formed.chi2_per_dof
    assert formed.model.active[0].values["threshold_a"] == pytest.approx(0.4, rel=0.1)
    assert free_remaining_shapes(maker, formed) is formed


def test_a_dead_time_all_within_its_commutation_is_reached_from_its_second_form() -> None:
    made = prepared(plan(), noise_a=0.002)
    library = scaled_library([DeadTime(), PhaseResistanceImbalance()], made.manifest)
    (dead_time, _), drive = library, made.pieces[0].signals.drive
    assert drive is not None
    true = DeadTime.Parameters(voltage_v=2.0, threshold_a=2.5, switched=1.0, grading=0.5)
    lost = _lost_to(true, made)
    maker = fitter(with_voltage(made, lost))
    fit = fit_full_model(maker, free_model(), library)
    (begun,) = (a for a in fit.model.active if a.name == "dead_time")
    assert begun.values["threshold_a"] == dead_time.named("threshold_a").other_form
    reported = next(a for a in free_own_shapes(maker, fit).model.active if a.name == "dead_time")
    assert reported.values["voltage_v"] == pytest.approx(2.0, rel=0.1)
    assert reported.values["threshold_a"] == pytest.approx(2.5, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("softness", [0.15, 0.75])
def test_two_effects_of_one_kind_are_no_more_than_one_of_another_form(softness: float) -> None:
    made = prepared(plan(), noise_a=0.002)
    library = scaled_library([DeadTime(), DeviceDrop()], made.manifest)
    true = DeadTime.Parameters(voltage_v=0.8, threshold_a=0.1, softness=softness)
    lost = _lost_to(true, made)
    maker = fitter(with_voltage(made, lost))
    # One PWM frequency: only their forms tell them apart.
    both = [
        c.absent().moved(c.amplitudes[0], x).release("threshold_a") for c, x in zip(library, (-0.1, 0.6), strict=True)
    ]
    fit, gone = merge_indistinguishable(maker, refit(maker, free_model().with_active(both)))
    assert len(fit.model.active) == 1
    assert gone == {fit.model.names[0]: [next(c.name for c in library if c.name != fit.model.names[0])]}
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / fit.dof))


def test_of_two_effects_of_one_kind_the_lesser_stays_where_it_alone_has_the_form() -> None:
    """A dead time that charges capacitances all along, reported as much of a drop and a little of itself."""
    made = prepared(plan(), noise_a=5e-4)
    library = scaled_library([DeadTime(), DeviceDrop()], made.manifest)
    true = DeadTime.Parameters(voltage_v=4.8, threshold_a=0.3, charged=1.0)
    maker = fitter(with_voltage(made, _lost_to(true, made)))
    both = [
        c.absent().moved(c.amplitudes[0], x).release("threshold_a") for c, x in zip(library, (0.1, 2.0), strict=True)
    ]
    start = refit(maker, free_model().with_active(both))
    alone = joint_search_module._sufficient_alone(maker, start, "dead_time", "device_drop")
    assert alone is not None
    assert alone[0] == "dead_time"
    (kept,) = alone[1].model.active
    assert kept.values["voltage_v"] == pytest.approx(4.8, rel=5e-3)
    assert kept.values["charged"] == pytest.approx(1.0, abs=0.05)

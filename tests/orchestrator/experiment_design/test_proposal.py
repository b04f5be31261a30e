"""The next experiment: predicted by the fitted model, fast, and a stage that a procedure takes as it is."""

from __future__ import annotations

import time
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.first_models import first_steps
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.experiment_design.proposal import catalogue, next_experiment
from orchestrator.experiment_design.separation import confounded_pair, planned_pieces, separation
from orchestrator.recording import Recording
from orchestrator.stages import parse_stage
from plugins.effects.inverter import DeadTime, DeviceDrop
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, Effect

ONE_PWM, TWO_PWM = 0, 1


@pytest.fixture(scope="module")
def setup(with_dead_time: Recording) -> DiagnosisSetup:
    return open_for_diagnosis(with_dead_time)


@pytest.fixture(scope="module")
def library(setup: DiagnosisSetup) -> dict[str, CandidateEffect]:
    effects: list[Effect] = [DeadTime(), DeviceDrop(), CurrentOffset()]
    return {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}


@pytest.fixture(scope="module")
def fit(setup: DiagnosisSetup, library: dict[str, CandidateEffect]) -> Fit:
    return with_effect(setup, first_steps(setup, "saturated", library)[-1].fit, library["dead_time"])


def holds(stages: list[dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The dense holds at the drive's own PWM frequency, and those at two."""
    one, two = [s for s in stages if s["kind"] == "resistance"][:2]
    assert "pwm_frequencies_hz" not in one
    return one, two


@pytest.mark.slow
def test_a_second_pwm_frequency_separates_dead_time_from_the_devices_drop_and_one_does_not(
    setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]
) -> None:
    pair = confounded_pair(setup, fit, fit.model.active[-1], library["device_drop"])
    assert pair is not None
    imitation = pair.model.active[-1].values["voltage_v"]
    assert imitation == pytest.approx(0.8, rel=0.15)  # the drop that looks like it at one PWM frequency
    one, two = (separation(setup, pair, stage) for stage in holds(catalogue(setup)))
    assert two > 100.0 * max(one, 1.0)


def test_what_is_already_separated_gains_little_by_reading_gates_off(
    setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]
) -> None:
    pair = confounded_pair(setup, fit, fit.model.active[-1], library["device_drop"])
    assert pair is not None
    assert separation(setup, pair, {"kind": "gates_off", "duration_s": 2.0}) < 1.0


def test_more_time_separates_more(setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]) -> None:
    pair = confounded_pair(setup, fit, fit.model.active[-1], library["device_drop"])
    assert pair is not None
    _, stage = holds(catalogue(setup))
    assert separation(setup, pair, {**stage, "duration_s": 1.0}) > 1.2 * separation(setup, pair, stage)


def test_the_best_a_minute_is_proposed_within_a_second(
    setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]
) -> None:
    began = time.process_time()
    proposal = next_experiment(setup, fit, list(library.values()), "dead_time", "device_drop")
    assert time.process_time() - began < 3.0  # one second on a machine with nothing else to do
    assert proposal is not None
    assert proposal.stage == holds(catalogue(setup))[1]
    assert proposal.minutes == pytest.approx(8 * 2 * 1.0 / 60.0, abs=0.01)


def test_an_effect_that_is_not_in_the_model_is_separated_as_large_as_it_would_be(
    setup: DiagnosisSetup, library: dict[str, CandidateEffect]
) -> None:
    bare = first_steps(setup, "saturated", library)[-1].fit
    proposal = next_experiment(setup, bare, list(library.values()), "device_drop", "dead_time")
    assert proposal is not None
    assert proposal.separates == ("device_drop", "dead_time")
    assert "pwm_frequencies_hz" in proposal.stage


@pytest.mark.slow
def test_what_no_stage_separates_is_what_both_effects_need(setup: DiagnosisSetup, fit: Fit) -> None:
    def needing(*contrasts: Contrast) -> list[CandidateEffect]:
        class First(CurrentOffset):
            name: ClassVar[str] = "first"
            needs: ClassVar[tuple[Contrast, ...]] = contrasts

        class Second(First):
            name: ClassVar[str] = "second"

        # The two do the very same: nothing tells them apart, whatever is measured.
        return list(scaled_library([First(), Second()], setup.prepared.manifest))

    def proposed(*contrasts: Contrast) -> str | None:
        proposal = next_experiment(setup, fit, needing(*contrasts), "first", "second")
        return None if proposal is None else proposal.stage["kind"]

    assert proposed() is None
    assert proposed(Contrast.SECOND_INJECTION_FREQUENCY) == "injection"
    assert proposed(Contrast.GATES_OFF) is None, "that was measured already"
    assert proposed(Contrast.SECOND_ANGLE) is None, "no stage by itself locks the rotor at another angle"


def test_a_long_hold_is_predicted_to_warm_the_winding(setup: DiagnosisSetup, fit: Fit) -> None:
    (short, _), (long, _) = (
        planned_pieces(setup, fit.model, {"kind": "resistance", "points_a": [[2.0, 0.0]], "duration_s": seconds})[0]
        for seconds in (1.0, 31.0)
    )
    power = 1.5 * 4.25 * 2.0**2
    assert long.signals.heat_j[0] - short.signals.heat_j[0] == pytest.approx(15.0 * power)
    losses = long.signals.losses
    assert losses is not None
    assert float(np.sum(losses.power_w[:-1] * np.diff(losses.time_s))) == pytest.approx(
        float(setup.prepared.pieces[-1].signals.heat_j[-1]) + 31.0 * power, rel=0.02
    )


def test_every_stage_of_the_catalogue_is_a_procedure_s(setup: DiagnosisSetup) -> None:
    for stage in catalogue(setup):
        parse_stage(stage, "catalogue", "stage")

"""The next experiment: predicted by the fitted model, fast, and a stage that a procedure takes as it is."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, ClassVar

import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.first_models import first_steps
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.experiment_design.proposal import catalogue, is_measured, next_experiment
from orchestrator.experiment_design.separation import confounded_pair, separation
from orchestrator.recording import Recording
from plugins.effects.inverter import DeadTime, DeviceDrop
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, Effect, Inseparable, NextExperiment

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


@pytest.mark.slow
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
    assert isinstance(proposal, NextExperiment)
    assert proposal.stage == holds(catalogue(setup))[1]
    assert proposal.minutes == pytest.approx(8 * 2 * 1.0 / 60.0, abs=0.01)


def test_an_effect_that_is_not_in_the_model_is_separated_as_large_as_it_would_be(
    setup: DiagnosisSetup, library: dict[str, CandidateEffect]
) -> None:
    bare = first_steps(setup, "saturated", library)[-1].fit
    proposal = next_experiment(setup, bare, list(library.values()), "device_drop", "dead_time")
    assert isinstance(proposal, NextExperiment)
    assert proposal.separates == ("device_drop", "dead_time")
    assert "pwm_frequencies_hz" in proposal.stage


def test_a_stage_is_measured_where_the_recording_holds_its_points_and_settings(setup: DiagnosisSetup) -> None:
    two = holds(catalogue(setup))[1]
    gates_off = {"kind": "gates_off", "duration_s": 2.0}
    assert not is_measured(setup, two), "the recording has one PWM frequency"
    assert is_measured(setup, gates_off)
    assert is_measured(setup, {**gates_off, "duration_s": 10.0})


@pytest.mark.slow
def test_what_no_stage_separates_is_inseparable_unless_an_operator_can_separate_it(
    setup: DiagnosisSetup, fit: Fit
) -> None:
    def needing(*contrasts: Contrast) -> list[CandidateEffect]:
        class First(CurrentOffset):
            name: ClassVar[str] = "first"
            needs: ClassVar[tuple[Contrast, ...]] = contrasts

        class Second(First):
            name: ClassVar[str] = "second"

        # The two do the very same: nothing tells them apart, whatever is measured.
        return list(scaled_library([First(), Second()], setup.prepared.manifest))

    def proposed(*contrasts: Contrast) -> NextExperiment | Inseparable | None:
        return next_experiment(setup, fit, needing(*contrasts), "first", "second")

    for contrasts in ((), (Contrast.SECOND_INJECTION_FREQUENCY,), (Contrast.GATES_OFF,)):
        found = proposed(*contrasts)
        assert isinstance(found, Inseparable)
        assert found.best_sigmas < found.least_sigmas == 5.0
    assert proposed(Contrast.SECOND_ANGLE) is None, "no stage by itself locks the rotor at another angle"


def test_the_predicted_separation_is_that_of_the_size_found(
    setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]
) -> None:
    active = fit.model.active[-1]
    pair = confounded_pair(setup, fit, active, library["device_drop"])
    proposal = next_experiment(setup, fit, list(library.values()), "dead_time", "device_drop")
    assert isinstance(proposal, NextExperiment)
    assert proposal.sigmas is not None
    assert pair is not None
    assert proposal.sigmas.value**2 == pytest.approx(separation(setup, pair, proposal.stage))
    assert proposal.sigmas.high - proposal.sigmas.value > 1.9  # the measurement's own noise at least


def test_a_small_effect_is_separated_by_longer_readings_and_a_tiny_one_by_nothing(
    setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]
) -> None:
    def of_size(factor: float) -> NextExperiment | Inseparable | None:
        *others, active = fit.model.active
        smaller = replace(active, values={**active.values, "voltage_v": factor * active.values["voltage_v"]})
        small = replace(fit, model=fit.model.with_active([*others, smaller]))
        return next_experiment(setup, small, list(library.values()), "dead_time", "device_drop")

    whole = of_size(1.0)
    assert isinstance(whole, NextExperiment)
    assert whole.sigmas is not None
    longer = of_size(2.5 / whole.sigmas.value)
    assert isinstance(longer, NextExperiment)
    assert longer.stage["duration_s"] > whole.stage["duration_s"]
    assert isinstance(of_size(0.5 / whole.sigmas.value), Inseparable)


def test_where_a_declared_contrast_is_missing_only_its_stages_are_proposed(
    setup: DiagnosisSetup, fit: Fit, library: dict[str, CandidateEffect]
) -> None:
    class Drop(DeviceDrop):
        name: ClassVar[str] = "drop"
        needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_INJECTION_FREQUENCY,)

    class Dead(DeadTime):
        needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_INJECTION_FREQUENCY,)

    pair = list(scaled_library([Dead(), Drop()], setup.prepared.manifest))
    found = next_experiment(setup, fit, pair, "dead_time", "drop")
    # Holds at two PWM frequencies would separate them most, but the two would still count as indistinguishable.
    assert isinstance(found, Inseparable) or found is None or found.stage["kind"] == "injection"

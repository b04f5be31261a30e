"""The next experiment: predicted by the fitted model, fast, and a stage that a procedure takes as it is."""

from __future__ import annotations

import time
from typing import Any

import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.experiment_design.proposal import catalogue, next_experiment
from orchestrator.diagnosis.experiment_design.separation import rivals, separation
from orchestrator.diagnosis.fitting.baseline import Start
from orchestrator.diagnosis.fitting.candidates import Candidate, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.forward_search import with_effect
from orchestrator.diagnosis.selection.workflow import first_steps
from orchestrator.recording import Recording
from orchestrator.stages import parse_stage
from plugins.effects.inverter import DeadTime, DeviceDrop
from plugins.effects.sensors import CurrentOffset
from protocols import Effect

ONE_PWM, TWO_PWM = 0, 1


@pytest.fixture(scope="module")
def start(with_dead_time: Recording) -> Start:
    return open_for_diagnosis(with_dead_time)


@pytest.fixture(scope="module")
def library(start: Start) -> dict[str, Candidate]:
    effects: list[Effect] = [DeadTime(), DeviceDrop(), CurrentOffset()]
    return {c.name: c for c in scaled_library(effects, start.prepared.manifest)}


@pytest.fixture(scope="module")
def fit(start: Start, library: dict[str, Candidate]) -> Fit:
    return with_effect(start.fitter, first_steps(start, "saturated", library)[-1].fit, library["dead_time"])


def holds(stages: list[dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The dense holds at the drive's own PWM frequency, and those at two."""
    one, two = [s for s in stages if s["kind"] == "resistance"][:2]
    assert "pwm_frequencies_hz" not in one
    return one, two


def test_a_second_pwm_frequency_separates_dead_time_from_the_devices_drop_and_one_does_not(
    start: Start, fit: Fit, library: dict[str, Candidate]
) -> None:
    pair = rivals(start, fit, "dead_time", library["device_drop"])
    assert pair is not None
    imitation = pair.model.active[-1].values["voltage_v"]
    assert imitation == pytest.approx(0.8, rel=0.15)  # the drop that looks like it at one PWM frequency
    one, two = (separation(start, pair, stage) for stage in holds(catalogue(start)))
    assert two > 100.0 * max(one, 1.0)


def test_what_is_already_told_apart_gains_little_by_reading_gates_off(
    start: Start, fit: Fit, library: dict[str, Candidate]
) -> None:
    pair = rivals(start, fit, "dead_time", library["device_drop"])
    assert pair is not None
    assert separation(start, pair, {"kind": "gates_off", "duration_s": 2.0}) < 1.0


def test_more_time_separates_more(start: Start, fit: Fit, library: dict[str, Candidate]) -> None:
    pair = rivals(start, fit, "dead_time", library["device_drop"])
    assert pair is not None
    _, stage = holds(catalogue(start))
    assert separation(start, pair, {**stage, "duration_s": 1.0}) > 1.2 * separation(start, pair, stage)


def test_the_best_a_minute_is_proposed_within_a_second(start: Start, fit: Fit, library: dict[str, Candidate]) -> None:
    began = time.process_time()
    proposal = next_experiment(start, "dead_time", "device_drop", fit, list(library.values()))
    assert time.process_time() - began < 3.0  # one second on a machine with nothing else to do
    assert proposal is not None
    assert proposal.stage == holds(catalogue(start))[1]
    assert proposal.minutes == pytest.approx(8 * 2 * 1.0 / 60.0, abs=0.01)


@pytest.mark.parametrize(
    ("first", "second", "kind"),
    [
        ("current_offset", "voltage_bias", "gates_off"),
        ("dead_time", "device_drop", "resistance"),
        ("eddy_currents", "hysteresis", "injection"),
        ("eddy_currents", "skin_effect", "injection"),
        ("winding_heating", "bus_sag", "resistance"),
        ("slot_harmonics", "brake_compliance", "classical"),
        ("something", "else", "resistance"),
    ],
)
def test_where_nothing_can_be_predicted_the_table_has_the_word(
    start: Start, first: str, second: str, kind: str
) -> None:
    proposal = next_experiment(start, first, second)
    assert proposal is not None
    assert proposal.stage["kind"] == kind
    assert proposal.separates == (first, second)
    assert proposal.minutes is not None
    assert 0.01 < proposal.minutes < 5.0


def test_every_stage_of_the_catalogue_is_a_procedure_s(start: Start) -> None:
    for stage in catalogue(start):
        parse_stage(stage, "catalogue", "stage")

"""Sampling rates and delays that are not the manifest's."""

from __future__ import annotations

import dataclasses

import pytest

from orchestrator.recording import open_recording
from orchestrator.recording_checks import CorrectedRecording, find_convention
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.survey import survey
from tests.blind.campaign import Campaign, record
from tests.blind.hidden import draw_case
from tests.blind.stepping import record_steps, usual
from tests.support.rewriting import Rewritten


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Rewritten:
    """Voltage steps alone, 20 samples from one turn to the next."""
    bench = dataclasses.replace(draw_case("clean", 1, 7).bench, drive_delay_samples=0.0)
    folder = tmp_path_factory.mktemp("stepped") / "steps"
    return Rewritten.of(open_recording(record_steps(bench, usual(bench, 130.0, 0.03), folder)))


@pytest.fixture(scope="module")
def sines(tmp_path_factory: pytest.TempPathFactory) -> Rewritten:
    """Injection of a sine, on a plant with eddy currents: they turn its phase as well."""
    bench = dataclasses.replace(draw_case("clean", 1, 7).bench, drive_delay_samples=0.0)
    bench = dataclasses.replace(bench, plant=bench.plant._replace(eddy_ohm=1500.0, substeps=10))
    short = Campaign(
        second_pwm=False, second_amplitude=False, classical=False, sine=True, injection_s=0.1, dwell_s=0.05
    )
    return Rewritten.of(open_recording(record(bench, short, tmp_path_factory.mktemp("sines"))))


@pytest.mark.parametrize("rows", [-2, -1, 0])
def test_the_phase_of_a_sine_tells_its_lag(sines: Rewritten, rows: int) -> None:
    convention = find_convention(sines.late(rows))
    assert (convention is None) if rows == 0 else (convention is not None and convention.correction.add == -rows)


def test_the_phase_of_a_sine_tells_a_declared_delay_that_is_not_there(sines: Rewritten) -> None:
    convention = find_convention(sines.driven(voltage_delay_samples=1.0))
    assert convention is not None
    assert convention.correction.text == "set drive.voltage_delay_samples to 0"


def test_a_sine_s_phase_that_iron_loss_makes_is_no_voltage_before_its_time(sines: Rewritten) -> None:
    assert find_convention(sines.late(1)) is None


@pytest.mark.parametrize("factor", [2.0, 10.0, 0.5, 0.1, 1.25, 0.8])
def test_a_wrong_sampling_rate_is_named(right: Rewritten, factor: float) -> None:
    wrong = right.driven(sampling_frequency_hz=factor * right.manifest.drive.sampling_frequency_hz)
    convention = find_convention(wrong)
    assert convention is not None
    assert convention.kind == "sampling_rate"
    assert convention.correction.factor == pytest.approx(1.0 / factor, rel=1e-2)
    assert find_convention(CorrectedRecording(wrong, convention.correction)) is None


@pytest.mark.parametrize("rows", [-2, -1, 1, 2])
def test_a_voltage_early_or_late_by_whole_samples_is_named(right: Rewritten, rows: int) -> None:
    wrong = right.late(rows)
    convention = find_convention(wrong)
    assert convention is not None
    assert (convention.kind, convention.correction.add) == ("delay", -rows)
    assert find_convention(CorrectedRecording(wrong, convention.correction)) is None


def test_a_declared_delay_that_is_not_there_is_named(right: Rewritten) -> None:
    convention = find_convention(right.driven(voltage_delay_samples=1.0))
    assert convention is not None
    assert convention.correction.text == "set drive.voltage_delay_samples to 0"


@pytest.mark.parametrize("rows", [-3, -2, 1])
def test_the_edges_of_voltage_steps_tell_their_lag(stepped: Rewritten, rows: int) -> None:
    wrong = stepped.late(rows)
    convention = find_convention(wrong)
    assert convention is not None
    assert (convention.kind, convention.correction.add) == ("delay", -rows)
    assert find_convention(CorrectedRecording(wrong, convention.correction)) is None


def test_voltage_steps_that_are_right_break_no_convention(stepped: Rewritten) -> None:
    assert find_convention(stepped) is None


@pytest.mark.parametrize("ratio", [0.5, 0.7, 1.5, 3.0, 10.0])
def test_a_strong_leak_is_left_to_the_diagnosis_and_taken_for_no_early_voltage(right: Rewritten, ratio: float) -> None:
    siemens = ratio * leak_of_one_sample(right)
    leaking = right.captured(lambda c: {"i_ab": c.i_ab + siemens * c.v_ab, "i_abc": None})
    found = find_convention(leaking)
    assert found is None or found.kind != "delay"


def test_a_voltage_before_its_time_has_both_hypotheses(right: Rewritten) -> None:
    found = find_convention(right.late(1))
    assert found is not None
    assert "a current that follows the voltage at once" in found.evidence


def leak_of_one_sample(right: Rewritten) -> float:
    """Ts / L of the mean axis [S]."""
    response = Responses(survey(right, lambda: None)).impulse_response
    assert response is not None
    return float(response.weights.sum())

"""A model held against a recording: where it fails, in numbers, and nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.diagnosis import bare_model_step, compare_recording, model_step
from orchestrator.recording import Recording, read_model
from plugins.effects.inverter import DeviceDrop
from protocols import MotorModel, RecordingError

ALWAYS = ["one_pwm_frequency"]
"""What these recordings lack."""


def test_comparison_says_where_the_model_fails(misaligned: Recording, tmp_path: Path) -> None:
    report = compare_recording(misaligned, out=tmp_path)
    stages = {s.stage: s for s in report.stages}
    assert report.chi2 is not None
    assert report.chi2 > 5.0
    assert (stages["classical"].chi2 or 0.0) > (stages["resistance"].chi2 or 99.0)
    assert report.worst[0].segment.startswith("classical")
    # Errors and floors of the stages are over the same samples, and so are those over all.
    assert (stages["classical"].rms_v or 0.0) > 2.0 * (stages["classical"].noise_rms_v or 99.0)
    assert (report.worst[0].rms_v or 0.0) > 2.0 * (report.worst[0].noise_rms_v or 99.0)
    assert (report.rms_v or 0.0) > 2.0 * (report.noise_floor.rms_v or 99.0)
    # The injection takes a few seconds in all, of which noise alone breaks reciprocity by a quarter of a percent.
    assert (report.parity.d_percent or 0.0) > 2.0 * (report.reciprocity_percent or 99.0)
    assert (report.parity.q_percent or 0.0) > 3.0 * (report.reciprocity_percent or 99.0)


def test_what_is_right_is_noise_everywhere(clean: Recording, tmp_path: Path) -> None:
    report = compare_recording(clean, out=tmp_path)
    assert report.model == "saturated"
    assert report.chi2 == pytest.approx(1.0, abs=0.05)
    assert {s.stage for s in report.stages} == {s.stage.value for s in clean.segments()}
    assert all((s.chi2 or 0.0) < 1.5 for s in report.stages)
    limits = {s.stage: s.chi2_of_noise or 0.0 for s in report.stages}
    # Few values of noise have a large chi2 now and then, many never.
    assert limits["gates_off"] > 1.5 * limits["classical"] > 1.5
    assert report.rms_v == pytest.approx(report.noise_floor.rms_v, rel=0.1)
    assert report.noise_floor.rms_v is not None
    # A mean over a window has its own noise: the worst of some forty is not many times the usual one.
    assert (report.worst[0].rms_v or 99.0) < 4.0 * report.noise_floor.rms_v
    errors = [segment.rms_v or 0.0 for segment in report.worst]
    assert errors == sorted(errors, reverse=True)
    assert [remark.code for remark in report.remarks] == [*ALWAYS, "no_model"]
    assert not list(tmp_path.iterdir())


def test_the_step_of_the_bare_model_has_no_effect_and_the_error_of_the_comparison(misaligned: Recording) -> None:
    step = bare_model_step(misaligned)
    assert (step.index, step.effects) == (0, ())
    assert step.chi2 > 5.0
    assert step.rms_v > 2.0 * step.noise_rms_v


@pytest.mark.slow
def test_each_pwm_frequency_of_a_stage_has_a_row_of_its_own(at_two_pwm_frequencies: Recording, tmp_path: Path) -> None:
    rows = compare_recording(at_two_pwm_frequencies, out=tmp_path).stages
    of_holds = {row.pwm_frequency_hz: row.rms_v or 0.0 for row in rows if row.stage == "resistance"}
    (low, usual), (high, twice) = sorted(of_holds.items())
    assert high == 2.0 * (low or 0.0)
    # What dead time loses is twice as much, of which the fitted R_s hides more at the usual frequency.
    assert twice > 1.8 * usual
    assert len({row.pwm_frequency_hz for row in rows if row.stage == "injection"}) == 1


@pytest.mark.slow
def test_a_linear_model_s_flux_wanders_from_what_the_sweeps_integrate(clean: Recording) -> None:
    linear, saturated = (compare_recording(clean, model=model).crossings for model in ("linear", "saturated"))
    for axis in ("d_percent", "q_percent"):
        assert getattr(linear, axis) > 3.0 * getattr(saturated, axis) > 0.0


def test_the_model_that_lies_there_is_taken_as_it_is(with_dead_time: Recording, kept: Path) -> None:
    report = compare_recording(with_dead_time, [DeviceDrop()], out=kept)
    assert report.model == "saturated + device_drop"
    assert report.chi2 == pytest.approx(read_model(kept).ladder[-1].chi2, rel=1e-9)
    assert [remark.code for remark in report.remarks] == ALWAYS
    step = model_step(with_dead_time, read_model(kept), [DeviceDrop()])
    assert (step.added, step.effects) == ("device_drop", ("device_drop",))
    assert step.chi2 == pytest.approx(report.chi2, rel=1e-9)


def test_a_model_of_another_recording_is_stated_to_be_one(clean: Recording, kept: Path) -> None:
    model: MotorModel = read_model(kept).model_copy(update={"recording": "another"})
    report = compare_recording(clean, [DeviceDrop()], model=model)
    assert [remark.code for remark in report.remarks] == [*ALWAYS, "model_of_another"]
    assert "fitted to another" in report.remarks[-1].text


def test_a_model_that_cannot_be_read_is_named(clean: Recording, tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text("{")
    with pytest.raises(RecordingError, match=r"model\.json"):
        compare_recording(clean, out=tmp_path)

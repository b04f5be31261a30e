"""Models and effects by whatever names them, results where they are wanted."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fluxbench
from orchestrator.experiment_design.proposal import next_experiment
from orchestrator.interface.api import add, chosen_effects, chosen_model, compare, diagnose, estimate, map_of, remove
from orchestrator.interface.api.analysing import estimates_folder
from orchestrator.recording import read_model
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import (
    Estimate,
    FluxMap,
    FluxMapEstimate,
    InputError,
    MotorModel,
    PluginError,
    RecordingError,
    RecordingReader,
    ResistanceEstimate,
)

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"


class Bias(VoltageBias):
    """The installed effect under a name of one's own."""

    name = "my_bias"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kept model of a recording with an effect of one's own."""
    folder = tmp_path_factory.mktemp("out")
    report = add(DATA, "my_bias", effects=[Bias()], out=folder)
    assert [rung.added for rung in report.ladder] == [None, "my_bias"]
    return folder


@pytest.mark.slow
def test_an_effect_of_one_s_own_is_a_candidate(out: Path) -> None:
    report = compare(DATA, effects=[Bias()], out=out)
    assert report.model == "saturated + my_bias"
    assert report.notes[-1] == "my_bias: in the model already"
    with pytest.raises(PluginError, match="my_bias: in the model, but not installed"):
        compare(DATA, out=out)


def test_an_own_effect_of_the_model_is_missed_with_the_file_that_it_is_from(out: Path) -> None:
    (effect,) = read_model(out).effects
    assert effect.file == __file__
    with pytest.raises(PluginError, match=rf"my_bias: in the model, but not installed; pass `--effects {__file__}`"):
        add(DATA, "my_bias", out=out)
    assert [kept.file for kept in read_model(out).effects] == [__file__]


def test_a_model_is_named_by_its_file_or_is_itself(out: Path) -> None:
    model = chosen_model(out / "model.json")
    assert isinstance(model, MotorModel)
    assert chosen_model(model) is model
    assert chosen_model("linear") == "linear"
    assert chosen_model(None) is None
    with pytest.raises(InputError, match="neither linear, saturated nor a file; did you mean 'saturated'"):
        chosen_model("staurated")
    with pytest.raises(RecordingError, match=r"none\.json: cannot be read"):
        chosen_model(out / "none.json")


def test_a_model_s_map_is_the_map_of_what_has_it(out: Path) -> None:
    whole, by_path = map_of(out), map_of(out / "model.json")
    assert whole.equals(by_path)
    assert whole.psi_d.dims == ("i_d", "i_q")
    assert whole.psi_d.attrs["units"] == "Wb"
    assert np.isfinite(whole.psi_d).any()


def test_two_effects_of_one_name_are_refused() -> None:
    assert "my_bias" in [effect.name for effect in chosen_effects([Bias()])]
    with pytest.raises(PluginError, match="dead_time: an effect of that name exists already"):
        chosen_effects([type("Another", (DeadTime,), {})()])


def test_an_installed_effect_that_is_given_anew_takes_its_own_place() -> None:
    names = [effect.name for effect in chosen_effects([DeadTime()])]
    assert names == [*(e.name for e in chosen_effects() if e.name != "dead_time"), "dead_time"]


def test_results_go_where_they_are_wanted(tmp_path: Path) -> None:
    estimate(DATA, estimators=["resistance"], out=tmp_path)
    assert (tmp_path / "results" / "estimates.json").is_file()
    assert not (DATA / "results").exists()
    with pytest.raises(InputError, match="is not a directory"):
        estimate(DATA, out=tmp_path / "results" / "estimates.json")


def test_an_estimator_alone_leaves_the_results_of_all_unchanged(tmp_path: Path) -> None:
    recording = Path(shutil.copytree(DATA, tmp_path / "recording"))
    (recording / "results").mkdir()
    (recording / "results" / "estimates.json").write_text("of all")
    estimate(recording, estimators=["resistance"])
    assert (recording / "results" / "estimates.json").read_text() == "of all"
    assert (recording / "estimators" / "resistance" / "results" / "estimates.json").is_file()
    assert estimates_folder(recording, ["injection", "resistance"], None).name == "injection+resistance"
    assert estimates_folder(recording, [], None) == recording


def test_estimates_are_given_as_they_come_before_anything_is_written(tmp_path: Path) -> None:
    found: list[Estimate] = []

    def keep(estimate: Estimate) -> None:
        assert not (tmp_path / "results").exists()
        found.append(estimate)

    report = fluxbench.estimate(DATA, estimators=["resistance", "injection"], out=tmp_path, on_estimate=keep)
    (resistance,) = [estimate for estimate in found if isinstance(estimate, ResistanceEstimate)]
    assert report.resistance == resistance
    assert [isinstance(estimate, FluxMapEstimate) for estimate in found if estimate is not resistance] == [True]
    fluxbench.estimate(DATA, estimators=["resistance"], out=tmp_path / "unrequested")


@pytest.mark.slow
def test_a_diagnosis_brings_report_words_and_steps(tmp_path: Path) -> None:
    messages: list[str] = []
    diagnosis = diagnose(DATA, out=tmp_path, material_flux_percent=0.4, tell=messages.append)
    assert diagnosis.report.verdict == "clean"
    assert diagnosis.report.materiality is not None
    assert diagnosis.report.materiality.flux_percent == pytest.approx(0.4)
    assert diagnosis.report.materiality.voltage_percent == pytest.approx(0.5)
    assert messages[-1] == "computing the intervals"
    assert diagnosis.words.likely_cause
    assert len(diagnosis.steps) == len(diagnosis.report.ladder)
    with pytest.raises(PluginError, match="dead_time: not in the model; it has no effects"):
        remove(DATA, "dead_time", out=tmp_path)


def test_a_diagnosis_is_requested_to_propose_the_next_experiment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen: dict[str, Any] = {}

    def diagnose_and_keep(recording: object, effects: object, **options: Any) -> tuple[None, str]:
        seen.update(options)
        return None, "kept"

    monkeypatch.setattr("orchestrator.diagnosis.diagnose_and_keep", diagnose_and_keep)
    assert str(diagnose(DATA, out=tmp_path)) == "kept"
    assert seen["propose"] is next_experiment


def test_a_diagnosis_of_some_segments_sees_these_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: list[RecordingReader] = []

    def diagnose_and_keep(recording: RecordingReader, effects: object, **options: Any) -> tuple[None, str]:
        seen.append(recording)
        return None, "kept"

    monkeypatch.setattr("orchestrator.diagnosis.diagnose_and_keep", diagnose_and_keep)
    every = [segment.id for segment in fluxbench.open(DATA).segments]
    wanted = [every[3], every[1]]
    fluxbench.diagnose(DATA, segments=wanted, out=tmp_path)
    fluxbench.diagnose(DATA, out=tmp_path)
    assert [[segment.id for segment in recording.segments()] for recording in seen] == [sorted(wanted), every]


def test_a_segment_that_there_is_not_is_one_clear_error(tmp_path: Path) -> None:
    known = fluxbench.open(DATA).segments[0].id
    with pytest.raises(RecordingError, match="injection-999: no such segment") as refused:
        fluxbench.diagnose(DATA, segments=[known, "injection-999"], out=tmp_path)
    assert "\n" not in str(refused.value)
    assert not any(tmp_path.iterdir())


def test_a_flux_map_is_a_model(tmp_path: Path) -> None:
    estimate(DATA, estimators=["resistance", "injection"], out=tmp_path)
    assert isinstance(chosen_model(tmp_path), FluxMap)

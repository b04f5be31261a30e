"""The report's diagnosis: the slots first, then the ladder, pictures before and after, words for what is missing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

from orchestrator.diagnosis import SavedDiagnosis, save_diagnosis
from orchestrator.diagnosis.fitting.progress import SearchRecorder
from orchestrator.formatting.names import VERDICTS
from orchestrator.formatting.quantities import quantity
from plugins.streams.report import _diagnosis_content as findings
from plugins.streams.report import _diagnosis_figures, write_report
from plugins.streams.report._diagnosis_figures import (
    _rising,
    hidden_sequence,
    ladder_figure,
    plane_figures,
    unevenness,
)
from plugins.streams.report._diagnosis_pictures import diagnosis_pictures, learned_pictures, step_pictures
from protocols import DiagnosisStep, Reason
from tests.orchestrator.discovery.test_command import a_discovery
from tests.plugins.streams.example_run import a_run_directory
from tests.plugins.streams.report.example_diagnosis import (
    PHASES,
    WORDS,
    a_diagnosis,
    inverter_residual,
    some_steps,
)
from tests.support.undrawn import draw_nothing


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        return a_page(tmp_path_factory.mktemp("diagnosed"))


def a_page(folder: Path) -> str:
    run = a_run_directory(folder / "run")
    save_diagnosis(run, a_diagnosis(), WORDS, some_steps())
    return write_report(run).read_text(encoding="utf-8")


def saved(**changes: object) -> SavedDiagnosis:
    return SavedDiagnosis(a_diagnosis(**changes), WORDS, some_steps())


def words_of(page: str) -> str:
    bare = re.sub(r"<style>.*?</style>|<[^>]*>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", bare)


def test_the_slots_stand_first_in_print_characters(page: str) -> None:
    text = words_of(page)
    assert text.index("Explained") < text.index("Where it fails") < text.index("R_s 4.6 → 4.31 Ω") < text.index("Run")
    assert "To decide" not in text  # that is what to do now, at the top
    assert "1480 mV rms" in text
    assert "95 % −0.399 to 0.401" in text
    assert "−3 ± 2 mV" in text
    assert "+-" not in text


def test_every_picture_of_the_diagnosis_is_on_the_page(page: str) -> None:
    titles = [
        "The error ladder",
        "The library, fitted together",
        "Residual on the current plane",
        "Residual against each phase",
        "Flux loop on d",
        "Flux loop on q",
        "Evenness in i_q",
        "Ripple, measured and predicted",
        "A sweep, measured and simulated",
        "R_s against the heat",
    ]
    places = [page.index(f"<h3>{title}") for title in titles]
    assert places == sorted(places)
    assert page.count("<img") == 16 + 16


@pytest.mark.slow
def test_the_page_stays_small(tmp_path: Path) -> None:
    assert 500_000 < len(a_page(tmp_path)) < 5_000_000


@pytest.mark.usefixtures("undrawn")
def test_a_page_without_a_diagnosis_says_how_to_make_one(tmp_path: Path) -> None:
    text = words_of(write_report(a_run_directory(tmp_path / "run")).read_text(encoding="utf-8"))
    assert "not diagnosed: fluxbench diagnose run names what it misses" in text
    assert "The error ladder" not in text


@pytest.mark.usefixtures("undrawn")
def test_a_damaged_diagnosis_is_named_and_the_rest_reported(tmp_path: Path) -> None:
    run = a_run_directory(tmp_path / "run")
    save_diagnosis(run, a_diagnosis(), WORDS, some_steps())
    (run / "results" / "diagnosis.npz").write_bytes(b"no archive")
    text = words_of(write_report(run, draws=False).read_text(encoding="utf-8"))
    assert "diagnosis.npz" in text
    assert "Flux map usable" in text


@pytest.mark.usefixtures("undrawn")
def test_without_steps_the_ladder_is_drawn_from_the_report() -> None:
    found = SavedDiagnosis(a_diagnosis(), WORDS, ())
    assert [p.title for p in diagnosis_pictures(found)] == ["The error ladder", "The library, fitted together"]


@pytest.mark.usefixtures("undrawn")
def test_one_rung_is_drawn_without_a_before() -> None:
    report = a_diagnosis(verdict="clean", effects=[], ladder=a_diagnosis().model_dump()["ladder"][:1])
    found = SavedDiagnosis(report, WORDS, some_steps()[:1])
    pictures = list(diagnosis_pictures(found))
    assert len(pictures) == 10
    assert not any(picture.beside for picture in pictures)


def test_the_ladders_legend_is_whole_beside_long_names(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(_diagnosis_figures, "uri", figures.append)
    ladder = [rung.model_copy(update={"added": "phase_resistance_imbalance"}) for rung in a_diagnosis().ladder]
    ladder_figure(ladder, 0.004)
    (figure,) = figures
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["fitted", "held out", "noise floor"]
    extent = legend.get_window_extent()
    assert 0.0 <= extent.x0 < extent.x1 <= figure.bbox.width


def test_the_library_begins_with_what_was_added_and_marks_what_was_detected_but_not_added(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(_diagnosis_figures, "uri", figures.append)
    shares = {"dead_time": 0.9, "winding_heating": 0.05}
    found = a_diagnosis().effects[0]
    effects = [found.model_copy(update={"name": name, "share": share}) for name, share in shares.items()]
    joint = [
        {
            "name": "bus_sag",
            "relative_size": 0.01,
            "z": -5.1,
            "parameter": "voltage_v",
            "size": {"value": 1e-3, "low": 0.7e-3, "high": 1.3e-3, "unit": "V"},
        },
        {"name": "winding_heating", "relative_size": 1.6, "z": 79.0},
        {"name": "hysteresis", "relative_size": 0.4, "z": 0.5},
        {"name": "dead_time", "relative_size": 0.6, "z": 44962.0},
    ]
    list(diagnosis_pictures(SavedDiagnosis(a_diagnosis(effects=effects, joint=joint), WORDS, ())))
    axes = figures[-1].axes[0]
    names = [text.get_text() for text in axes.get_yticklabels()]
    assert names == ["dead time", "winding heating", "bus sag", "hysteresis"]
    assert [text.get_text().strip() for text in axes.texts] == [
        "added",
        "added",
        "not added;\n  voltage at most 1.3 mV",
        "",
    ]


def test_tables_tell_values_with_their_intervals_and_twins() -> None:
    assert findings.effect_rows(saved()) == [
        ("dead time", "voltage", "400.0 mV", "399.0 to 401.0", "device drop"),
        ("", "sharpness", "−15·10⁶", "", ""),
    ]
    small = a_diagnosis().effects[0].model_copy(update={"name": "eddy_currents", "twins": ()})
    rows = findings.effect_rows(saved(minor=[small]))
    assert rows[2] == (
        "eddy currents (immaterial)",
        "voltage",
        "400.0 mV",
        "399.0 to 401.0",
        "none",
    )
    assert findings.ladder_rows(saved()) == [
        ("the model alone", "5489", "300 mV", "350 mV", "60 mA"),
        ("+ dead time", "1.02", "4.1 mV", "4.2 mV", "5 mA"),
        ("noise floor", "1", "4 mV", "4 mV", ""),
    ]


def test_look_alikes_are_ties_and_what_only_the_joint_fit_asks_for() -> None:
    assert findings.alike_rows(saved()) == [
        ("dead time", "device drop", "fits as well in its place"),
        (
            "bus sag",
            "–",
            "not added: 5.1 standard deviations from zero with all effects fitted at once, but adding it improves the "
            "fit too little",
        ),
        ("skin effect", "–", "detected, but too small to be named"),
    ]


def test_what_was_not_added_is_stated_with_the_most_that_it_may_be() -> None:
    size = {"value": 0.00093, "low": 0.00055, "high": 0.00131, "unit": "V"}
    entry = {"name": "device_drop", "relative_size": 0.001, "z": 4.8, "parameter": "voltage_v", "size": size}
    ((_, _, how),) = findings.alike_rows(saved(joint=[entry], effects=[], traces=[]))
    assert how.startswith("not added: voltage at most 1.31 mV (95 %) beside what was added; 4.8 standard deviations")
    screen = {
        "step": 16, "move": "screen", "data": "whole", "effects": ["device_drop"], "measure": "chi2", "score": 22.1,
        "threshold": 32.4, "chi2_before": 1.0, "chi2_after": None, "decision": "rejected", "evaluations": 1.0,
        "seconds": 1.0,
    }  # fmt: skip
    ((_, _, why),) = findings.alike_rows(saved(joint=[entry], effects=[], traces=[], search=[screen]))
    assert "adding it lowers the summed χ² by 22.1, and 32.4 are needed (step 16)" in why


def test_the_next_experiment_is_a_procedure_s_own_text() -> None:
    proposal = findings.experiment(saved())
    assert proposal is not None
    assert yaml.safe_load(proposal.yaml) == {"stages": [a_diagnosis().model_dump()["next_experiment"]["stage"]]}
    assert proposal.reason == "Tells dead time from device drop, 16 s."
    assert findings.experiment(saved(next_experiment=None)) is None


def test_numbers_that_are_missing_are_stated_to_be() -> None:
    rungs = [{"added": None, "chi2": None, "rms_v": None, "heldout_rms_v": None, "current_rms_a": None}]
    found = saved(ladder=rungs, unexplained={"fraction": None, "shape": []}, joint=[])
    assert findings.ladder_rows(found)[0] == ("the model alone", *["–"] * 4)
    assert findings.leftover_text(found) == ""


def with_residual(residual_abc: np.ndarray, i_abc: np.ndarray) -> DiagnosisStep:
    rows = {"i_abc": i_abc, "residual_abc_v": residual_abc, "stage": ("classical",) * len(i_abc)}
    return some_steps()[0].model_copy(update=rows)


def test_an_inverter_s_residual_falls_on_one_curve_once_the_zero_sequence_is_back() -> None:
    i_abc = np.random.default_rng(3).uniform(-3.0, 3.0, (3000, 2)) @ PHASES.T
    hidden = inverter_residual(i_abc)
    curve = 0.4 * np.tanh(i_abc / 0.05)
    far = np.abs(i_abc) > 0.3
    assert np.std((hidden - curve)[far]) > 0.1
    put_back = hidden_sequence(with_residual(hidden, i_abc))
    assert put_back is not None
    # A constant more or less cannot be seen; what is left is what the finite knots miss near zero.
    assert np.std((hidden + put_back - curve)[far]) < 0.03


def test_what_is_no_inverter_s_doing_is_drawn_as_it_is() -> None:
    rng = np.random.default_rng(4)
    i_abc = rng.uniform(-3.0, 3.0, (3000, 2)) @ PHASES.T
    noise = rng.normal(0.0, 0.1, (3000, 2)) @ PHASES.T
    constant = np.broadcast_to([0.2, -0.05, -0.15], i_abc.shape)
    assert hidden_sequence(with_residual(noise, i_abc)) is None
    assert hidden_sequence(with_residual(constant + 0.1 * noise, i_abc)) is None
    assert hidden_sequence(with_residual(noise[:3], i_abc[:3])) is None


@pytest.mark.usefixtures("undrawn")
def test_pictures_after_are_drawn_enlarged_and_say_their_sign_and_what_r_s_took() -> None:
    before, after = some_steps()
    assert before.resistance is not None
    course = before.resistance.model_copy(update={"model_ohm": 1.1 * before.resistance.model_ohm})
    before = before.model_copy(update={"resistance": course})
    pictures = {picture.title: picture for picture in step_pictures(before, after)}
    plane = pictures["Residual on the current plane"]
    phases = pictures["Residual against each phase's own current"]
    for picture in (plane, phases):
        assert picture.beside
        assert picture.enlarged
        assert picture.caption.startswith("Residual: the recording's voltage less the model's")
    before_ohm, after_ohm = (
        quantity(float(step.resistance.model_ohm[0]), "ohm", 4) for step in (before, after) if step.resistance
    )
    assert f"R_s where the winding is coldest is {before_ohm} before and {after_ohm} after" in phases.caption
    assert "is put back" in phases.caption
    assert "a slope that differs from phase to phase leaves steps" in phases.caption
    (alone,) = (p for p in step_pictures(after, after) if p.title == "Residual against each phase's own current")
    assert "leaves steps" not in alone.caption


@pytest.mark.usefixtures("undrawn")
def test_waveforms_are_drawn_before_and_after_with_the_sizes_of_both_errors() -> None:
    before, after = some_steps()
    drawn = {picture.title: picture for picture in step_pictures(before, after)}
    alone = {picture.title: picture for picture in step_pictures(before, before)}
    for title, unit in (
        ("Flux loop on d", "mWb"),
        ("Ripple, measured and predicted", "mA/V"),
        ("A sweep, measured and simulated", "mA"),
    ):
        assert drawn[title].beside
        assert re.search(rf"rms [\d.]+ {unit} before, [\d.]+ {unit} after\.", drawn[title].caption)
        assert not alone[title].beside
        assert re.search(rf"rms [\d.]+ {unit}\.", alone[title].caption)


FLUXES = ("psi_measured", "psi_model")


@pytest.mark.usefixtures("undrawn")
def test_a_flux_loop_says_how_far_noise_alone_opens_it() -> None:
    (step, *_), opens = some_steps(), "moves them apart by up to"
    noisy = step.model_copy(update={"loops": tuple(one.model_copy(update={"noise_wb": 1e-4}) for one in step.loops)})
    unknown, known = ({p.title: p.caption for p in step_pictures(s, s)}["Flux loop on d"] for s in (step, noisy))
    assert f"{opens} 0.2 mWb (95 %)" in known
    assert opens not in unknown


@pytest.mark.usefixtures("undrawn")
def test_evenness_states_both_measured_fluxes_and_is_drawn_enlarged_where_what_is_left_is_small() -> None:
    before, after = some_steps()
    flat = [one.model_copy(update={n: 0.1 * getattr(one, n) for n in FLUXES}) for one in after.loops]
    after = after.model_copy(update={"loops": tuple(flat)})
    title = "Evenness in i_q"
    drawn, alone = ({p.title: p for p in step_pictures(before, one)}[title] for one in (after, before))
    number = r"[\d.·⁻⁰-⁹]+ mWb"
    assert re.search(
        f"measured {number} before, {number} after, .*; model {number} before, {number} after", drawn.caption
    )
    assert drawn.enlarged
    assert re.search(f"measured {number}; model {number}\\.", alone.caption)
    assert not alone.enlarged


def test_the_uneven_part_of_a_flux_is_what_is_odd_in_i_q() -> None:
    i_q = np.linspace(-3.0, 3.0, 301)
    even, odd = 0.01 * i_q**2, 0.002 * i_q
    psi = np.stack([even + odd, i_q], axis=1)
    assert unevenness(psi, i_q) == pytest.approx(1e3 * float(np.sqrt(np.mean(odd**2))), rel=1e-6)


@pytest.mark.usefixtures("undrawn")
def test_of_a_model_that_was_changed_since_the_diagnosis_the_pictures_are_the_present_ones() -> None:
    after = some_steps()[-1]
    present = after.model_copy(update={"effects": ("bus_sag",)})
    captions = [picture.caption for picture in diagnosis_pictures(saved(), present)]
    assert any("After: with bus sag" in caption for caption in captions)
    assert not any("After: with dead time" in caption for caption in captions)


@pytest.mark.usefixtures("undrawn")
def test_the_phases_picture_says_at_which_pwm_frequencies_it_was_measured() -> None:
    step = some_steps()[0]
    rows = np.full(len(step.time_s), 1e4)
    caption = figures_caption(step.model_copy(update={"pwm_frequency_hz": rows}))
    assert "PWM frequency: 10 kHz." in caption
    rows = np.where(np.arange(len(rows)) < 100, 2e4, rows)
    caption = figures_caption(step.model_copy(update={"pwm_frequency_hz": rows}))
    assert "PWM at 10 kHz, black marks at 20 kHz" in caption


def figures_caption(step: DiagnosisStep) -> str:
    return next(
        picture.caption for picture in step_pictures(step, step) if picture.title.startswith("Residual against")
    )


def test_a_sweep_s_way_up_is_reported_from_its_way_down() -> None:
    time = np.linspace(0.0, 1.0, 400)
    sweep = np.interp(time, [0, 0.125, 0.375, 0.625, 0.875, 1], [0, 1, 1, -1, -1, 0])
    rising = _rising(sweep)
    assert rising[20:130].all()
    assert not rising[160:330].any()
    assert rising[365:390].all()


def test_a_plane_with_one_current_only_is_drawn() -> None:
    step = some_steps()[0]
    still = step.model_copy(update={"i_dq": np.zeros_like(step.i_dq)})
    panels = plane_figures(still, still)
    assert panels.before.startswith("data:image/svg+xml")
    assert panels.after == ""


@pytest.mark.usefixtures("undrawn")
def test_results_that_were_kept_elsewhere_are_reported(tmp_path: Path) -> None:
    save_diagnosis(tmp_path, a_diagnosis(), WORDS, some_steps())
    text = words_of(write_report(tmp_path).read_text(encoding="utf-8"))
    assert "Explained" in text
    assert "The error ladder" in text


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_readings_of_the_estimates_are_drawn_without_a_journal(tmp_path: Path) -> None:
    run = a_run_directory(tmp_path / "run")
    (run / "journal.jsonl").unlink()
    file = run / "results" / "estimates.json"
    kept = json.loads(file.read_text())
    kept["resistance"]["readings"] = [{"start_s": 1.0, "value_ohm": 4.4, "std_ohm": 0.01}] * 3
    file.write_text(json.dumps(kept))
    assert "3 readings while the current was constant" in words_of(write_report(run).read_text(encoding="utf-8"))


def test_the_reasons_stand_below_the_verdict_and_the_search_is_folded(tmp_path: Path, undrawn: None) -> None:
    run = a_run_directory(tmp_path / "run")
    recorder = SearchRecorder()
    recorder.record("screen", ["dead_time"], measure="chi2", score=60000.0, threshold=32.0)
    recorder.record("add", ["dead_time"], measure="log_evidence", score=812.0, threshold=16.0, taken=True)
    reason = Reason(quantity="chi2_per_dof", value=1.02, limit=1.08, sentence="chi2 is 1.02; noise makes up to 1.08.")
    report = a_diagnosis(reasons=[reason], search=recorder.events, reproduces_current_percent=0.4)
    save_diagnosis(run, report, WORDS, some_steps())
    page = write_report(run).read_text(encoding="utf-8")
    text = words_of(page)
    assert text.index("Explained") < text.index("χ² is 1.02; noise makes up to 1.08.") < text.index("Where it fails")
    assert "0.4 % of its range (rms)" in text
    (folded,) = (part for part in re.findall(r"<details>.*?</details>", page, flags=re.S) if "Steps of" in part)
    first = words_of(folded).split("decision ")[1]
    assert first.startswith("1 screen whole dead time Δχ² 60000 Δχ² 32 – refitted next 2")
    assert "Steps of the search (2)" in folded


def test_a_diagnosis_without_reasons_has_no_empty_list(page: str) -> None:
    assert "Steps of the search" not in page
    assert 'class="reasons"' not in page


def test_a_learned_law_has_its_curve_behind_the_diagnosis_pictures() -> None:
    (picture,) = learned_pictures(a_discovery())
    assert picture.uri.startswith("data:image/svg+xml;base64,")
    assert "as a function of its own current. y = a tanh(i / b)." in picture.caption
    assert "9 without it, 1.01 with it" in picture.caption
    assert list(learned_pictures(None)) == list(learned_pictures(a_discovery(outcome="no_law", laws=()))) == []


def test_a_learned_law_is_a_step_of_the_ladder_once_it_is_added() -> None:
    last = findings.ladder_rows(saved(), a_discovery(), ("+ mine",))[-2]
    assert last == ("+ mine (learned)", "1.02", "", "4 mV", "")
    assert findings.ladder_rows(saved(), a_discovery()) == findings.ladder_rows(saved())


def test_the_heading_says_that_something_is_missing_only_where_something_is() -> None:
    missing = {verdict: "missing" in findings.heading(verdict) for verdict in VERDICTS}
    assert not any(missing[verdict] for verdict in ("clean", "explained", "explained_in_another_form"))
    assert missing["unknown_remains"]

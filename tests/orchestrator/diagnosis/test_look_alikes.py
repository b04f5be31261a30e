"""A third party's look-alikes are twins where a recording cannot part them, and are parted like built-in ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orchestrator.diagnosis import Diagnosis, diagnose_recording, guarded, in_words
from orchestrator.experiment_design.proposal import next_experiment
from orchestrator.recording import Recording
from orchestrator.registry.plugins import PluginKind, installed, load_effects_file

ROOT = Path(__file__).parents[3]
BROUGHT = {"lost_at_edges", "lost_in_switches"}


def diagnosed(recording: Recording, out: Path) -> Diagnosis:
    library = [guarded(effect()) for effect in load_effects_file(Path(__file__).with_name("look_alikes.py"))]
    assert {effect.name for effect in library} == BROUGHT
    return diagnose_recording(recording, library, out=out, propose=next_experiment)


@pytest.fixture(scope="module")
def one(with_dead_time: Recording, tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    return diagnosed(with_dead_time, tmp_path_factory.mktemp("one"))


@pytest.mark.slow
def test_with_one_pwm_frequency_each_is_the_other_s_twin(one: Diagnosis) -> None:
    (effect,) = one.report.effects
    assert {effect.name, *effect.twins} == BROUGHT
    assert effect.parameters["lost_v"].value == pytest.approx(0.8, rel=0.01)


@pytest.mark.slow
def test_holds_at_a_second_pwm_frequency_are_proposed(one: Diagnosis) -> None:
    proposal = one.report.next_experiment
    assert proposal is not None
    assert set(proposal.separates) == BROUGHT
    assert proposal.stage["pwm_frequencies_hz"] == [10_000.0, 20_000.0]


@pytest.mark.slow
def test_words_say_what_was_not_measured_and_what_no_measurement_shows(one: Diagnosis) -> None:
    words = in_words(one)
    assert ", direct currents at a second PWM frequency, was not measured" in words.what_it_looks_like
    assert words.if_added.endswith("What is lost in proportion to the current is resistance.")


@pytest.mark.slow
def test_with_two_pwm_frequencies_they_are_parted(at_two_pwm_frequencies: Recording, tmp_path: Path) -> None:
    report = diagnosed(at_two_pwm_frequencies, tmp_path).report
    assert [(effect.name, effect.twins) for effect in report.effects] == [("lost_at_edges", ())]
    assert report.verdict == "explained"
    assert report.next_experiment is None


def test_no_effect_s_name_is_in_the_orchestrator() -> None:
    names = [info.name for info in installed(PluginKind.EFFECTS)]
    assert len(names) >= 18
    # One of them is a word of the language too: it may be stated, but is no key or entry of anything.
    compound, words = ("|".join(n for n in names if ("_" in n) == is_compound) for is_compound in (True, False))
    spelt = re.compile(rf"\b(?:{compound})\b|[\"'](?:{words})[\"']")
    for file in sorted((ROOT / "orchestrator").rglob("*")):
        if file.suffix in (".py", ".txt"):
            found = spelt.findall(file.read_text(encoding="utf-8"))
            assert not found, f"{file.relative_to(ROOT)} names {found}"

"""A written law is an effect that keeps the contract, and does what the flexible law's place does."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.discovery import places as at
from orchestrator.discovery import quantities as of
from orchestrator.discovery.bases import MEMORIES, CurveBasis, LineBasis, MemoryBasis
from orchestrator.discovery.forms import CURVES, FormFit
from orchestrator.discovery.hypotheses import ALL, KINDS, A, Hypothesis, Phases
from orchestrator.discovery.law import Law, Line, Table
from orchestrator.discovery.laws import loaded
from orchestrator.discovery.places import Place, of_three_sensors
from orchestrator.discovery.quantities import Quantity
from orchestrator.discovery.writing import OF_READINGS, NamedLaw, sentence_of, source_of
from orchestrator.registry.plugins import load_effects_file
from orchestrator.testing import EffectConformance, exciting_signals
from protocols import Correction, Effect, ParameterRole, SignalBatch, Signals
from tests.orchestrator.testing.kit_runner import failures

FORMS = {form.name: form for form in CURVES}
STORY = ("Found on a recording.", "Constants there.")


@cache
def signals() -> Signals:
    """The kit's signals, 30 s after the start."""
    return replace(exciting_signals(), start_s=30.0)


def law_of(place: Place, quantity: Quantity, phases: Phases, form: str) -> Law:
    """A law of typical size over the range of the kit's signals."""
    x = quantity.of(signals())
    top = float(np.abs(x).max())
    parity = "odd" if form in FORMS and FORMS[form].parity == "odd" else "none"
    size = {"V": 0.5, "A": 0.05, "ohm": 0.3, "1": 0.02, "rad": 0.02}[place.unit.split("/")[0]]
    if place.factor is not None:
        size /= float(np.abs(place.factor.of(signals())).max())
    if form == "line":
        basis = LineBasis(49.97, 0.01, place.of_phases)
        sizes = tuple(size * part for part in (1.0, -0.4, 0.3, 0.8)[: basis.size])
        return Law(Hypothesis(place, quantity, phases, basis, size), Line(sizes, 49.97, 0.01))
    if form in (*MEMORIES, "long lag"):
        kind = form.removeprefix("long ")
        scale = 0.2 * top if kind == "play" else 2e-3 if kind == form else 0.2
        hypothesis = Hypothesis(place, quantity, phases, MemoryBasis(kind, (1.0,)), size)
        return Law(hypothesis, FormFit(None, size / top, scale, 1.0, 0.0))
    hypothesis = Hypothesis(place, quantity, phases, CurveBasis(0.0, top, 8, parity), size)  # type: ignore[arg-type]
    if form == "table":
        return Law(hypothesis, Table(np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 9) ** 2, top, size, "odd"))
    known = FORMS[form]
    size = size / top**known.power_of_x
    power = known.powers[-1] if known.power_name == "sharpness" else 1.5
    return Law(hypothesis, FormFit(known, size, 0.4 * top, power, 0.0))


def effect_of(law: Law) -> Effect:
    three = of_three_sensors(SignalBatch.of([signals()]))
    return loaded(source_of([NamedLaw(law, "some_law", STORY)], {}, three))


CASES = [
    (at.LEG_VOLTAGE, of.PHASE_CURRENT, A, "tanh"),
    (at.LEG_VOLTAGE, of.PHASE_CURRENT, ALL, "play"),
    (at.PULSE_VOLTAGE, of.PHASE_CURRENT, ALL, "root"),
    (at.READING, of.PHASE_CURRENT, ALL, "play"),
    (at.VOLTAGE_GAIN, of.TIME, ALL, "settling"),
    (at.READING, of.PHASE_CURRENT, A, "power"),
    (at.READING, of.NEXT_CURRENT, A, "proportional"),
    (at.READING, of.PHASE_CURRENT, ALL, "table"),
    (at.READING, of.TIME, A, "straight"),
    (at.READING_GAIN, of.TIME, A, "straight"),
    (at.RESISTANCE, of.TIME, ALL, "step"),
    (at.LEG_RESISTANCE, of.HEAT, A, "straight"),
    (at.ANGLE, of.CURRENT_Q, ALL, "fraction"),
    (at.ANGLE, of.TORQUE, ALL, "proportional"),
    (at.ANGLE, of.TORQUE, ALL, "late"),
    (at.MAGNETISING, of.PHASE_FLUX, A, "lag"),
    (at.MAGNETISING_D, of.HEAT, ALL, "saturating"),
    (at.LEG_RESISTANCE, of.HEAT, A, "cooling"),
    (at.RESISTANCE, of.HEAT, ALL, "cooling"),
    (at.ANGLE, of.ROTOR_ANGLE, ALL, "harmonic 2"),
    (at.READING, of.CURRENT_SLOPE, A, "tanh"),
    (at.READING, of.CURRENT, A, "straight"),
    (at.LEG_VOLTAGE_BY_TIME, of.PHASE_CURRENT, A, "tanh"),
    (at.LEG_VOLTAGE_BY_HEAT, of.PHASE_CURRENT, ALL, "logarithm"),
    (at.READING_BY_TIME, of.PHASE_CURRENT, A, "proportional"),
    (at.PULSE_VOLTAGE_BY_TIME, of.PHASE_CURRENT, ALL, "tanh"),
    (at.READING, of.TIME, ALL, "line"),
    (at.LEG_VOLTAGE, of.TIME, ALL, "line"),
    (at.VOLTAGE_GAIN, of.TIME, ALL, "line"),
    (at.MAGNETISING, of.PHASE_FLUX, A, "long lag"),
]


@pytest.mark.parametrize(("place", "quantity", "phases", "form"), CASES, ids=lambda v: getattr(v, "name", str(v)))
def test_a_written_law_passes_the_kit_of_effects(
    place: Place, quantity: Quantity, phases: Phases, form: str, tmp_path: Path
) -> None:
    written = type(effect_of(law_of(place, quantity, phases, form)))

    class Kit(EffectConformance):
        def make_effect(self) -> Effect:
            return written()

        def signals(self) -> Signals:
            return signals()

    failed = failures(Kit(), tmp_path)
    # It is a file's effect, and has no entry point.
    failed.pop("test_entry_point_leads_to_the_effect", None)
    assert failed == {}


@pytest.mark.parametrize(("place", "quantity", "phases", "form"), CASES, ids=lambda v: getattr(v, "name", str(v)))
def test_a_written_law_does_what_its_place_does(place: Place, quantity: Quantity, phases: Phases, form: str) -> None:
    law = law_of(place, quantity, phases, form)
    effect, batch = effect_of(law), SignalBatch.of([signals()])
    values = {p.name: p.value for p in law.parameters}
    written = effect.correct(signals(), effect.Parameters(**values)).arrays
    if isinstance(law.form, Line):
        of_line = law.hypothesis
        expected = place.apply(batch, of_line.values(of_line.columns(batch), np.array(law.form.sizes))).arrays
        for name, array in expected.items():
            np.testing.assert_allclose(written[name], array, atol=1e-12)
        return
    if place.over_interval or isinstance(law.form, Table) or law.form.form is None:
        assert set(written) == set(place.apply(batch, _zeros(place, batch)).arrays)
        return
    # A sensor's error depends on the current before it.
    inverted = place in (at.READING, at.READING_BY_TIME) and quantity in OF_READINGS
    true = batch.corrected(Correction(i_ab=written["i_ab"])) if inverted else batch
    x = quantity.of(true)
    y = law.form.size * law.form.form.of(x, law.form.scale, law.form.power)
    if place.of_phases:
        y = (y if quantity.of_phases else y[:, None]) * np.array(phases)
    expected = place.apply(batch, y).arrays
    assert set(written) == set(expected)
    for name, array in expected.items():
        np.testing.assert_allclose(written[name], array, rtol=1e-9, atol=1e-5 if inverted else 1e-12)


def _zeros(place: Place, batch: SignalBatch) -> Any:
    return np.zeros((batch.samples, 3)) if place.of_phases else np.zeros(batch.samples)


def test_the_text_says_what_was_found() -> None:
    law = law_of(at.LEG_VOLTAGE, of.PHASE_CURRENT, A, "tanh")
    text = source_of([NamedLaw(law, "poor_joint", STORY)], {"V": 0.5}, False)
    assert text.startswith('"""y = a tanh(i / b): a voltage that each leg loses')
    assert "Found on a recording." in text
    assert "class PoorJoint:" in text
    assert 'size_v: float = amplitude("V", typical=1.0' in text  # 0.5 V here, and 1 V on the machine of twice the volts


def test_every_kind_of_law_has_a_sentence() -> None:
    basis = CurveBasis(0.0, 1.0, 8, "none")
    sentences = {sentence_of(Hypothesis(p, q, phases, basis, 1.0)) for p, q, _, which in KINDS for phases in which}
    assert len(sentences) == len({(p.name, q.name, phases) for p, q, _, which in KINDS for phases in which})
    assert all(sentence.endswith(".") for sentence in sentences)


def test_two_laws_are_two_classes_of_one_file(tmp_path: Path) -> None:
    first = law_of(at.READING, of.PHASE_CURRENT, ALL, "table")
    second = law_of(at.READING, of.NEXT_CURRENT, A, "table")
    path = tmp_path / "both.py"
    path.write_text(source_of([NamedLaw(first, "one"), NamedLaw(second, "other")], {}, False), encoding="utf-8")
    assert [effect.name for effect in load_effects_file(path)] == ["one", "other"]


@pytest.mark.parametrize(
    "text", ['a"""\nraise SystemExit', "\\N{no such}", "\\x", "ends in \\", "null \0 and \udcff", "x" * 300 + "\\"]
)
def test_what_a_recording_is_called_cannot_spoil_the_file(text: str) -> None:
    law = law_of(at.LEG_VOLTAGE, of.PHASE_CURRENT, ALL, "tanh")
    source = source_of([NamedLaw(law, "some_law", (f"Learned from {text}.",))], {}, False)
    assert loaded(source).name == "some_law"


@pytest.mark.parametrize("name", ["none", "true", "correction", "signals", "effect_parameters", "x", "y2", "np"])
def test_a_law_may_be_called_like_what_its_file_needs(name: str) -> None:
    law = law_of(at.READING, of.PHASE_CURRENT, ALL, "table")
    effect = loaded(source_of([NamedLaw(law, name)], {}, False))
    assert effect.name == name
    values = {p.name: p.typical for p in effect.Parameters.declared()}
    assert effect.correct(signals(), effect.Parameters(**values)).i_ab is not None


def test_a_frequency_and_the_place_of_a_step_are_written_with_all_the_digits_that_are_known() -> None:
    line = law_of(at.READING, of.TIME, ALL, "line")
    assert isinstance(line.form, Line)
    known = replace(line, form=replace(line.form, frequency_hz=49.969995))
    step = law_of(at.ANGLE, of.TIME, ALL, "step")
    assert isinstance(step.form, FormFit)
    sharp = replace(step, form=replace(step.form, scale=26.89352, power=1.3e5))
    for law, value in ((known, 49.969995), (sharp, 26.89352)):
        shapes = [p for p in effect_of(law).Parameters.declared() if p.role is ParameterRole.SHAPE]
        assert shapes[0].typical == pytest.approx(value, rel=1e-6)


def test_a_long_lag_may_remember_any_part_of_the_last_way() -> None:
    law = law_of(at.MAGNETISING, of.PHASE_FLUX, A, "long lag")
    effect = effect_of(law)
    values = {p.name: p.value for p in law.parameters}
    (far,) = effect.random_directions(signals(), effect.Parameters(**values))  # type: ignore[attr-defined]
    change = np.abs(far.i_m_ab - signals().i_m_ab)[:, 0]
    after = int(values["lag_s"] * signals().sampling_frequency_hz)
    if after < len(change):
        assert change[after] == pytest.approx(change[0] / np.e, rel=0.01)
    assert change[0] > 0.0
    still = replace(signals(), came_from_ab=None)
    (none,) = effect.random_directions(still, effect.Parameters(**values))  # type: ignore[attr-defined]
    np.testing.assert_array_equal(none.i_m_ab, still.i_m_ab)
    short = effect_of(law_of(at.MAGNETISING, of.PHASE_FLUX, A, "lag"))
    assert not hasattr(short, "random_directions")


def test_a_play_may_begin_anywhere_within_its_radius() -> None:
    law = law_of(at.READING, of.PHASE_CURRENT, ALL, "play")
    effect = effect_of(law)
    values = {p.name: p.value for p in law.parameters}
    directions = effect.random_directions(signals(), effect.Parameters(**values))  # type: ignore[attr-defined]
    assert len(directions) == 3
    first = np.abs(directions[0].i_ab - signals().i_ab)
    # Of an error in one of three readings two thirds are left in the vector.
    assert first[0] == pytest.approx([2.0 / 3.0 * values["size"] * values["radius_a"] / np.sqrt(3.0), 0.0])
    assert first[-1].max() < 1e-12  # the current has swung over by more than the radius since
    # On its way from far away it may have overshot and come back.
    far = effect.random_directions(replace(signals(), came_from_ab=np.array([[9.0, 0.0]])), effect.Parameters(**values))  # type: ignore[attr-defined]
    np.testing.assert_allclose(far[0].i_ab, directions[0].i_ab)
    without = effect_of(law_of(at.READING, of.PHASE_CURRENT, ALL, "tanh"))
    assert not hasattr(without, "random_directions")

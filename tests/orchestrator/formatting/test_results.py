"""A diagnosis as rows: sizes are listed, parameters of a form counted; notes and benefits are sentences."""

from __future__ import annotations

from typing import Any

import pytest

from orchestrator.formatting.results import (
    PART_MEANING,
    PROBABILITY_MEANING,
    STAND_IN,
    benefit_line,
    has_other_chi2,
    joint_bound,
    ladder_rows,
    mutual_twins,
    objection_words,
    parameter_rows,
    part_notes,
    resistance_course,
    share_notes,
    share_rows,
    size_in_words,
    trace_words,
)
from protocols import (
    Companion,
    FoundEffect,
    JointEntry,
    Materiality,
    ParameterValue,
    Remark,
    ResistanceEstimate,
    ResistanceReading,
    Rung,
)
from tests.plugins.streams.example_run import a_report
from tests.plugins.streams.report.example_diagnosis import a_diagnosis


def effect(**change: Any) -> FoundEffect:
    volts = ParameterValue(value=0.8, low=0.7, high=0.9, unit="V")
    bent = ParameterValue(value=0.2, low=0.0, high=0.5, unit="1", bends_form=True)
    dead_time = ParameterValue(value=148e-9, low=130e-9, high=167e-9, unit="s")
    given: dict[str, Any] = {
        "name": "dead_time",
        "parameters": {"voltage_v": volts, "softness": bent, "wider": bent},
        "derived": {"dead_time": dead_time},
        "twins": (),
        "relative_size": 0.1,
        "log_evidence": 900.0,
    }
    return FoundEffect(**{**given, **change})


def test_sizes_and_what_they_mean_for_the_drive_are_listed_and_the_rest_is_counted() -> None:
    assert parameter_rows(effect()) == [
        ("voltage", "800 mV", "700 to 900"),
        ("dead time", "148 ns", "130 to 167"),
        ("form", "2 more in model.json", ""),
    ]


def test_an_interval_that_holds_zero_is_marked() -> None:
    sure = ParameterValue(value=0.3, low=0.2, high=0.4, unit="ohm")
    other = ParameterValue(value=0.105, low=-0.054, high=0.265, unit="ohm")
    found = effect(parameters={"extra_a_ohm": sure, "extra_b_ohm": other}, derived={})
    assert parameter_rows(found) == [
        ("extra a", "300 mΩ", "200 to 400"),
        ("extra b", "105 mΩ", "−54 to 265; zero fits too"),
    ]


def test_where_two_are_determined_together_alone_zero_is_not_offered_by_itself() -> None:
    total = Companion(effect="device_drop", parameter="voltage_v", total=0.8, total_low=0.79, total_high=0.81)
    together = ParameterValue(value=0.1, low=-2.0, high=2.2, unit="V", determined_with=total)
    time = ParameterValue(value=1e-8, low=-2e-7, high=2.2e-7, unit="s")
    assert [row[2] for row in parameter_rows(effect(parameters={"voltage_v": together}, derived={"dead": time}))] == [
        "−2000 to 2200; only its sum with device drop voltage is determined: 800 mV (95 %: 790 to 810)",
        "−200 to 220; likewise",
    ]
    knee = Companion(effect="dead_time", parameter="threshold_a")
    with_knee = together.model_copy(update={"determined_with": knee})
    (row,) = parameter_rows(effect(parameters={"voltage_v": with_knee}, derived={}))
    assert row[2].endswith(
        "; zero fits too if current below which it fades changes with it: only a combination is determined"
    )


def test_the_joint_fit_bounds_what_was_not_added() -> None:
    size = ParameterValue(value=0.00093, low=0.00055, high=0.00131, unit="V")
    entry = JointEntry(name="device_drop", relative_size=0.001, z=4.8, parameter="voltage_v", size=size)
    assert joint_bound(entry) == "voltage at most 1.31 mV"
    report = a_diagnosis(joint=[entry.model_dump()], traces=["device_drop", "bus_sag"])
    assert trace_words(report) == ["device drop (voltage at most 1.31 mV)", "bus sag"]
    loss = ParameterValue(value=9e3, low=5e3, high=None, unit="ohm")
    strong = entry.model_copy(update={"parameter": "core_loss_ohm", "size": loss})
    assert joint_bound(strong) == "core loss at least 5 kΩ"
    assert joint_bound(entry.model_copy(update={"size": None})) == ""
    nothing = ParameterValue(value=0.0, low=0.0, high=0.0, unit="V")
    assert joint_bound(entry.model_copy(update={"size": nothing})) == ""


def test_of_two_effects_that_resemble_each_other_each_is_the_others() -> None:
    slots, angle, delay = (effect(name=name) for name in ("slot_harmonics", "rotor_misalignment", "voltage_delay"))
    slots = slots.model_copy(update={"twins": ("rotor_misalignment",)})
    assert mutual_twins([slots, angle, delay]) == {
        "slot_harmonics": ("rotor_misalignment",),
        "rotor_misalignment": ("slot_harmonics",),
        "voltage_delay": (),
    }


def test_a_step_of_the_ladder_names_effects_that_have_no_step_of_their_own() -> None:
    def step(added: str | None, *effects: str) -> Rung:
        return Rung(added=added, chi2=1.0, rms_v=0.1, heldout_rms_v=None, current_rms_a=None, effects=effects)

    offset, small = "current_offset", "eddy_currents"
    ladder = [step(None), step(offset, offset), step("hysteresis", offset, small, "hysteresis")]
    assert [row[0] for row in ladder_rows(ladder)] == [
        "the model alone", "+ current offset", "+ hysteresis (with eddy currents)",
    ]  # fmt: skip
    assert ladder_rows([step(None), step(offset, offset, small)])[1][0] == "+ current offset (with eddy currents)"


def test_a_refit_whose_error_differs_from_the_diagnosis_is_noticed() -> None:
    def ladder(chi2: float) -> list[Rung]:
        common = {"rms_v": 0.1, "heldout_rms_v": None, "current_rms_a": None}
        rungs = [("a", chi2, ("a",)), ("b", 1.0, ("a", "b"))]
        return [Rung(added=added, chi2=c, effects=effects, **common) for added, c, effects in rungs]

    assert has_other_chi2(ladder(539.0), ladder(452.0))
    assert not has_other_chi2(ladder(453.0), ladder(452.0))
    assert not has_other_chi2(ladder(539.0)[:1], ladder(539.0)[1:])


def test_the_course_of_the_resistance_says_when_it_was_read() -> None:
    readings = tuple(ResistanceReading(start_s=t, value_ohm=4.3, std_ohm=0.01) for t in (7.5, 81.7))
    course = ResistanceEstimate(value_ohm=4.31, low=4.30, high=4.32, first_ohm=4.30, last_ohm=4.32, readings=readings)
    assert resistance_course(course) == "4.300 Ω at 7.5 s, 4.320 Ω at 82 s"
    of_model = course.model_copy(update={"readings": ()})
    assert resistance_course(of_model) == "4.300 Ω in the first segment, 4.320 Ω in the last"
    remark = Remark(code="model.of_the_model", text="R_s is that of the whole model")
    of_model = course.model_copy(update={"remarks": (remark,)})  # beside the readings, which have other values
    assert resistance_course(of_model) == "4.300 Ω in the first segment, 4.320 Ω in the last"
    assert resistance_course(course.model_copy(update={"last_ohm": 4.3001})) == "unchanged over the recording"
    coarse = course.model_copy(update={"low": -3.0, "high": 22.0})
    assert resistance_course(coarse) == "4 Ω at 7.5 s, 4 Ω at 82 s"


def test_a_share_above_the_whole_error_and_a_cause_that_is_not_material_are_explained() -> None:
    limits = Materiality(flux_percent=0.2, voltage_percent=0.5)
    report = a_diagnosis().model_copy(update={"materiality": limits, "minor": ()})
    meaning, first, second = share_notes(report.model_copy(update={"effects": (effect(share=2.28, material=False),)}))
    assert meaning == PART_MEANING
    assert first.startswith("error without it above 100 %: without this effect")
    assert second.startswith("dead time: a cause of the measured error, but not material: ")
    assert "less than 0.2 % of the rated flux" in second
    for whole in (0.9, 1.004):  # the second is written as 100 %
        report = report.model_copy(update={"effects": (effect(share=whole, material=True),)})
        assert share_notes(report) == [PART_MEANING]


def test_the_error_without_an_effect_names_the_kind_of_stage_and_a_twin_shares_the_probability() -> None:
    drop = effect(name="device_drop", share=1.62, share_in="classical", probability=0.9999, twins=("dead_time",))
    (row,) = share_rows([drop])
    assert row[2:4] == ("162 % (sweeps)", "> 99.9 % (it or dead time)")
    assert PROBABILITY_MEANING in part_notes([drop])
    both = share_rows([drop, effect(share=0.5, probability=0.98)])  # each is there beside the other
    assert [row[2:4] for row in both] == [("162 % (sweeps)", "> 99.9 %"), ("50 %", "98.0 %")]


def test_effects_beside_something_unknown_may_stand_in_for_it() -> None:
    report = a_diagnosis(verdict="unknown_remains", unexplained={"fraction": 0.9, "shape": ()})
    assert report.leaves_most
    assert STAND_IN in share_notes(report)
    assert STAND_IN not in share_notes(a_diagnosis(verdict="explained"))


def test_a_size_is_stated_beside_what_is_typical() -> None:
    typical = ParameterValue(value=1.48e-6, low=None, high=None, unit="s")
    assert (
        size_in_words(effect().model_copy(update={"relative_size": 0.137, "typical": typical}))
        == "148 ns (typical: 1.5 µs)"
    )
    assert size_in_words(effect().model_copy(update={"relative_size": 4.017})) == "402 % of the typical size"
    ohms = ParameterValue(value=4e3, low=None, high=None, unit="ohm")  # of an effect that is strong where it is small
    eddy = effect(parameters={"iron_ohm": ohms}, derived={}, relative_size=0.25)
    typical = ParameterValue(value=1e3, low=None, high=None, unit="ohm")
    assert size_in_words(eddy.model_copy(update={"typical": typical})) == "4 kΩ (typical: 1 kΩ)"


@pytest.mark.parametrize(
    ("code", "line"),
    [
        ("helps", "It did."),
        ("not_needed", "It did."),
        ("does_not_help", "It did; `fluxbench remove runs/a dead_time` removes it again."),
        ("needed", "It did; `fluxbench add runs/a dead_time` puts it back."),
    ],
)
def test_a_change_that_did_not_help_says_how_to_undo_it(code: str, line: str) -> None:
    remark = Remark(code=code, values={"effect": "dead_time"}, text="It did")
    assert benefit_line(remark, "runs/a") == line
    assert benefit_line(remark, "runs/a", " --effects f.py") == line.replace("dead_time`", "dead_time --effects f.py`")


def test_an_objection_to_a_map_does_not_repeat_the_name_of_its_method() -> None:
    report = a_report()
    assert objection_words(report, Remark(code="few", text="few points").by("injection")) == "few points"
    assert objection_words(report, Remark(code="few", text="few points").by("other")) == "other: few points"

"""The course of a search: a sentence for each move that changed the model or kept an effect in it."""

from __future__ import annotations

from orchestrator.formatting.search_summary import noise_note, search_notes, search_summary
from protocols import SearchEvent


def moves(*events: dict[str, object]) -> list[str]:
    return search_summary(recorded(*events))


def recorded(*events: dict[str, object]) -> list[SearchEvent]:
    common: dict[str, object] = {
        "effects": (),
        "data": "whole",
        "decision": "accepted",
        "evaluations": 1.0,
        "seconds": 1.0,
    }
    return [SearchEvent.model_validate(common | {"step": k} | e) for k, e in enumerate(events, 1)]


def chi2(before: float, after: float | None) -> dict[str, object]:
    return {"chi2_before": before, "chi2_after": after}


def refit(name: str, score: float, after: float) -> dict[str, object]:
    return {"move": "refit", "effects": (name,), "decision": "tested", "data": "part", "score": score} | chi2(
        80.0, after
    )


def test_an_added_effect_stands_beside_the_best_of_the_others() -> None:
    lines = moves(
        {"move": "baseline", "chi2_after": 900.0},
        {"move": "screen", "effects": ("dead_time", "device_drop"), "decision": "tested", "data": "part"},
        refit("dead_time", 9.0, 2.0),
        refit("device_drop", 7.0, 5.0),
        refit("bus_sag", 1.0, 70.0),
        {"move": "add", "effects": ("dead_time",), "data": "part", **chi2(80.0, 2.0)},
    )
    assert lines == [
        "1. the search begins at chi2 900",
        "on a part of the recording, which is faster; chi2 is that of this part:",
        "6. dead time is added: chi2 80 → 2; device drop instead would leave 5",
    ]


def test_after_all_effects_together_it_says_which_are_new() -> None:
    lines = moves(
        {"move": "add", "effects": ("dead_time",), **chi2(80.0, 20.0)},
        {"move": "full_model", "effects": ("dead_time", "bus_sag", "hysteresis"), **chi2(20.0, 1.0)},
        {"move": "remove", "effects": ("hysteresis",), **chi2(1.0, 1.01)},
    )
    assert lines[1] == (
        "2. no single one promises half of what all absent ones do together, so all 3 effects that it can show are "
        "fitted together: chi2 20 → 1"
    )
    assert lines[2] == "3. hysteresis is removed, which the data do not require: chi2 1 → 1.01; bus sag is new"


def test_all_effects_together_follow_where_two_leave_more_than_noise() -> None:
    lines = moves(
        {"move": "add", "effects": ("dead_time",), **chi2(80.0, 20.0)},
        {"move": "add", "effects": ("bus_sag",), **chi2(20.0, 9.0)},
        {"move": "full_model", "effects": ("dead_time", "bus_sag", "hysteresis"), **chi2(9.0, 1.0)},
    )
    assert lines[-1].startswith("3. bus sag and dead time leave more than noise, so all 3 effects")


def test_a_map_that_hardly_changes_chi2_has_the_evidence_that_decided_beside_it() -> None:
    evidence = {"measure": "log_evidence", "score": 7.21, "threshold": 3.0}
    chi2_of_all = {"measure": "objective", "score": 4.36, "threshold": 0.0}
    assert moves({"move": "finer_map", **chi2_of_all, **chi2(1.213, 1.212)}) == [
        "1. a finer flux map is taken: chi2 1.213 → 1.212; the summed chi2 falls by 4.36, 0 needed"
    ]
    assert moves({"move": "finer_map", **evidence, **chi2(1.213, 1.212)}) == [
        "1. a finer flux map is taken: chi2 1.213 → 1.212; log evidence rises by 7.21 nat, 3 needed"
    ]


def test_numbers_that_the_summary_leaves_out_are_accounted_for() -> None:
    begins, trial = (
        {"move": "baseline", "chi2_after": 29.7},
        {"move": "noise", "decision": "rejected", **chi2(2.0, 2.0)},
    )
    assert search_notes(recorded(begins)) == []
    assert search_notes(recorded(begins, trial))[0].startswith("numbers left out: trials that changed nothing")


def test_it_says_what_kept_an_effect_and_why_none_is_missing() -> None:
    lines = moves(
        {"move": "screen", "effects": ("bus_sag",), "decision": "rejected", "score": 50.0, "threshold": 60.0},
        {"move": "screen", "effects": ("hysteresis",), "decision": "rejected", "score": 14.5, "threshold": 32.0},
        {"move": "remove", "effects": ("dead_time",), "decision": "rejected", **chi2(1.0, 80.0)},
        {"move": "swap", "effects": ("device_drop", "dead_time"), "decision": "rejected", "note": "both do as well",
         **chi2(1.0, 1.02)},
        {"move": "name", "effects": ("bus_sag",), "decision": "rejected", "measure": "share", "score": 0.02,
         "threshold": 0.05},
        {"move": "name", "effects": ("dead_time",), "decision": "rejected", "measure": "share", "score": 0.64,
         "threshold": 0.57, "note": "what is left could imitate it"},
        {"move": "finer_map", "decision": "rejected", **chi2(1.0, 0.99)},
    )  # fmt: skip
    assert lines == [
        "2. no absent effect is worth adding: the best, hysteresis, lowers the summed chi2 by 14.5, 32 needed",
        "3. dead time stays: without it chi2 is 80",
        "4. device drop in place of dead time: the recording does not separate the two, chi2 1 with dead time, "
        "1.02 with device drop",
        "5. bus sag is in the model and no cause: 2 % of the first error, 5 % needed",
        "6. dead time is in the model and no cause, although it is 64 % of the first error and 57 % are needed: "
        "what is left could imitate it",
    ]


def test_effects_beside_one_that_explains_the_recording_alone_are_removed_for_that_reason() -> None:
    without = {"move": "remove", "effects": ("bus_sag",), "measure": "chi2_per_dof", "score": 1.214, "threshold": 1.4,
               "note": "the strongest one alone explains the recording", **chi2(1.01, 1.214)}  # fmt: skip
    needed = without | {"effects": ("dead_time",), "decision": "rejected", "note": ""} | chi2(1.214, 1.9)
    assert moves(without, needed) == [
        "1. bus sag is removed (the strongest one alone explains the recording): chi2 1.01 → 1.214, where "
        "explained allows up to 1.4",
        "2. dead time stays: without it chi2 is 1.9, where explained allows up to 1.4",
    ]
    both = needed | {"effects": ("dead_time", "hysteresis")}
    (line,) = moves(both)
    assert line.endswith("stay: without them chi2 is 1.9, where explained allows up to 1.4")
    by_evidence = needed | {"measure": "log_evidence", "threshold": -16.0}
    assert moves(by_evidence, needed, by_evidence) == [
        "2. dead time stays: without it chi2 is 1.9, where explained allows up to 1.4"
    ]


def test_a_form_counts_where_it_matters_and_every_change_of_noise_and_map() -> None:
    lines = moves(
        {"move": "free_shape", "effects": ("dead_time",), **chi2(2.0, 1.95)},
        {"move": "free_shape", "effects": ("dead_time",), **chi2(2.0, 1.1)},
        {"move": "noise", **chi2(1.1, 1.0)},
        {"move": "finer_map", **chi2(1.1, 1.0)},
        {"move": "remove", "effects": ("bus_sag",), "measure": "block_scatter", "score": 0.31, "threshold": 0.2},
    )
    assert [line.split(". ")[0] for line in lines] == ["2", "3", "4", "5"]
    assert lines[-1] == "5. bus sag is removed: the size differs by 31 % between parts of the recording"


def test_an_added_effect_that_leaves_more_than_another_has_the_reason_beside_it() -> None:
    lines = moves(
        refit("dead_time", 9.0, 2.0),
        refit("device_drop", 7.0, 1.9),
        {"move": "add", "effects": ("dead_time",), "data": "part", **chi2(80.0, 2.0)},
    )
    assert lines[-1].endswith(
        "device drop instead would leave 1.9, with less log evidence, which decides and counts parameters and usual "
        "sizes, too"
    )


def test_a_swap_that_the_recording_does_not_decide_is_said_to_be_one_and_nothing_is_repeated() -> None:
    stays = {"move": "remove", "effects": ("dead_time",), "decision": "rejected", **chi2(1.0, 80.0)}
    swap = {"move": "swap", "effects": ("device_drop", "dead_time"), "note": "both do as well", **chi2(1.13, 1.08)}
    lines = moves(stays, stays, swap, swap | {"data": "part"})
    assert lines[0] == "1. dead time stays: without it chi2 is 80"
    assert lines[1].endswith("place of dead time: chi2 1.13 → 1.08, two that the recording does not separate")
    assert len(lines) == 4
    assert lines[-1].endswith("two that this part does not separate")


def test_a_tie_is_stated_once_whatever_its_direction() -> None:
    there = {"move": "swap", "effects": ("device_drop", "dead_time"), "note": "both do as well", **chi2(1.13, 1.08)}
    back = there | {"effects": ("dead_time", "device_drop"), "decision": "rejected"} | chi2(1.08, 1.13)
    (line,) = moves(there, back)
    assert line.startswith("1. device drop takes the place of dead time")
    part = there | {"decision": "rejected", "data": "part"}
    assert [line.split(" in place")[0] for line in moves(part, back)] == ["2. dead time"]


def test_what_an_effect_leaves_without_it_is_told_from_the_ladder_once() -> None:
    stays = {"move": "remove", "effects": ("dead_time",), "decision": "rejected", **chi2(1.0, 80.0)}
    (note,) = search_notes(recorded(stays, stays | {"effects": ("bus_sag",)}))
    assert note.startswith("without it: the other effects are refitted")
    assert "ladder" in note
    others = search_notes(recorded(stays | {"data": "part"}, stays | {"decision": "accepted"}))
    assert not any("without it" in note for note in others)


def test_noise_that_was_counted_on_the_way_explains_another_first_chi2() -> None:
    begins, noise = {"move": "baseline", "chi2_after": 29.71}, {"move": "noise", "data": "part", **chi2(1.2, 0.96)}
    assert noise_note(recorded(begins, noise)) == (
        "These values count the noise as step 2 of the search does; the search begins at chi2 29.71, before that step."
    )
    assert noise_note(recorded(begins, noise | {"decision": "rejected"})) == ""

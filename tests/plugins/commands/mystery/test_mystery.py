"""A mystery from outside: measured once, guessed at, revealed; and the run directory never tells."""

from __future__ import annotations

import json
import shutil
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from orchestrator.recording import open_recording
from orchestrator.runs import private_directory
from plugins.commands.mystery import draw, judge, read_guess, sealed_effects
from plugins.commands.mystery._command import _print_hidden, _print_verdict, command
from plugins.commands.mystery._guessing import ACCEPTED_NAME
from protocols import DriveFault, FaultCause, InputError, RecordingError, SegmentStage

NUMBER = 7


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mystery") / "run"
    with redirect_stdout(StringIO()) as printed:
        assert command([str(NUMBER), "--out", str(path), "--quiet"]) == 0
    assert printed.getvalue() == ""
    return path


@pytest.fixture(autouse=True)
def none_accepted_before(run: Path) -> None:
    (private_directory(run) / ACCEPTED_NAME).unlink(missing_ok=True)


def verdict_on(capsys: pytest.CaptureFixture[str], path: Path, *words: str) -> str:
    capsys.readouterr()
    assert command([str(NUMBER), "--out", str(path), *words]) == 0
    return capsys.readouterr().out


@pytest.mark.slow
def test_its_run_is_a_recording_with_every_stage_that_tells_effects_apart(run: Path) -> None:
    segments = open_recording(run).segments()
    assert {SegmentStage.GATES_OFF, SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION} <= {
        segment.stage for segment in segments
    }
    assert len({s.settings.get("pwm_frequency_hz") for s in segments if s.stage == SegmentStage.RESISTANCE}) == 2
    assert len({s.settings["amplitude_v"] for s in segments if s.stage == SegmentStage.INJECTION}) == 2
    assert sum("anchor" in segment.settings for segment in segments) == 4


def test_the_truth_never_enters_the_run_directory(run: Path) -> None:
    hidden = draw(NUMBER).plant["effects"]
    assert hidden
    content = b"".join(file.read_bytes() for file in run.iterdir() if file.is_file())
    for name in hidden:
        assert name.encode() not in content
    assert dict(sealed_effects(run)).keys() == hidden.keys()


def test_a_guess_is_judged_and_the_rest_not_given_away(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, *others = draw(NUMBER).plant["effects"]
    printed = verdict_on(capsys, run, "--guess", first)
    assert f"{first}: right; no size was given\n" in printed
    assert f"{len(others)} more" in printed
    assert not any(name in printed for name in others)


def test_nothing_is_a_wrong_guess_where_something_is_hidden(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hidden = len(draw(NUMBER).plant["effects"])
    assert verdict_on(capsys, run, "--guess", "nothing").startswith(f"nothing: wrong; {hidden} are hidden.\n")
    wrong = f"bus_sag: not in this motor\n{hidden} are hidden.\n"
    assert verdict_on(capsys, run, "--guess", "bus_sag").startswith(wrong)


def test_what_was_right_before_counts_and_stays_sealed(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = list(draw(NUMBER).plant["effects"])
    for k, name in enumerate(names):
        printed = verdict_on(capsys, run, "--guess", name)
        assert all(f"{other}: right in an earlier guess\n" in printed for other in names[:k])
        left = len(names) - k - 1
        assert ("all there is" if left == 0 else f"{left} more") in printed
    found = json.loads(verdict_on(capsys, run, "--guess", names[0], "--json"))["guess"]
    assert found["complete"]
    assert "covered" not in found
    assert not any(name.encode() in file.read_bytes() for name in names for file in run.iterdir() if file.is_file())


def test_the_whole_truth_is_all_there_is(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "all there is" in verdict_on(capsys, run, "--guess", ",".join(draw(NUMBER).plant["effects"]))


def test_reveal_tells_names_and_sizes(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(verdict_on(capsys, run, "--guess", "nothing", "--reveal", "--json"))
    assert not found["guess"]["complete"]
    for name, parameters in draw(NUMBER).plant["effects"].items():
        assert found["hidden"][name].items() >= parameters.items()


def test_a_hidden_effect_is_revealed_in_the_words_of_the_report(capsys: pytest.CaptureFixture[str]) -> None:
    _print_hidden({"skin_effect": {"extra_ohm": 2.72}, "voltage_bias": {"bias_a_v": 0.0521, "bias_b_v": -0.385}})
    first, second, note = capsys.readouterr().out.splitlines()
    # The corner was not drawn: it is the plant's usual one.
    assert first == "skin_effect: extra 2.72 Ω, corner 60 Hz*"
    assert second == "voltage_bias: bias a 52.1 mV, bias b −385 mV"
    assert "may lie outside the diagnosis' interval" in note


def test_a_size_is_graded_without_the_true_one(capsys: pytest.CaptureFixture[str]) -> None:
    hidden = {"dead_time": {"voltage_v": 2.0, "threshold_a": 0.1}}
    for guess, size in (
        ("dead_time", "no size was given"),
        ("dead_time=1.9V", "voltage 1.9 V is right within 10 %"),
        ("dead_time=1.5V", "voltage 1.5 V is too small, by less than half"),
    ):
        _print_verdict(judge(read_guess(guess), hidden))
        assert capsys.readouterr().out.startswith(f"dead_time: right; {size}\n")


def test_guesses_and_wrong_names_are_counted(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verdict_on(capsys, run, "--guess", "nothing").endswith("\nGuess 1; no wrong name so far.\n")
    assert verdict_on(capsys, run, "--guess", "bus_sag").endswith("\nGuess 2; 1 wrong name so far.\n")
    counted = json.loads(verdict_on(capsys, run, "--guess", "bus_sag", "--json"))["guess"]
    assert (counted["guesses"], counted["wrong_names"]) == (3, 2)


def test_a_guess_that_fits_as_well_is_as_good(capsys: pytest.CaptureFixture[str]) -> None:
    hidden = {"current_filter": {"time_constant_s": 1e-5}}
    _print_verdict(judge(read_guess("voltage_delay"), hidden, None, lambda *_: True))
    first, last = capsys.readouterr().out.splitlines()
    assert first == "voltage_delay: as good: it fits this recording as well as what is hidden"
    assert last == "That is all there is."


def test_what_the_run_caused_is_present_and_not_one_of_the_hidden(capsys: pytest.CaptureFixture[str]) -> None:
    caused = {"rotor_misalignment": {"angle_rad": 0.02}}
    _print_verdict(judge(read_guess("rotor_misalignment"), {"skin_effect": {"extra_ohm": 2.0}}, caused))
    first, last = capsys.readouterr().out.splitlines()
    assert first == (
        "rotor_misalignment: present, but not one of the hidden: the run itself caused it, as its alignment left the "
        "rotor at an angle"
    )
    assert last == "1 is hidden."


def test_wrong_names_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    _print_verdict(judge(read_guess("skin_effect,bus_sag,dead_time"), {"skin_effect": {"extra_ohm": 2.0}}))
    assert "2 of 3 names are wrong.\n" in capsys.readouterr().out


def test_what_the_recording_does_not_show_need_not_be_named(capsys: pytest.CaptureFixture[str]) -> None:
    hidden = {"voltage_delay": {"delay_s": 2e-5}, "current_filter": {"time_constant_s": 2e-6}}
    _print_verdict(judge(read_guess("voltage_delay"), hidden, shows=lambda _: False))
    _, second, last = capsys.readouterr().out.splitlines()
    assert second.startswith("1 more is hidden, but too small, or too similar")
    assert last == "That is all that this recording shows."


def test_a_size_of_one_rotor_angle_is_not_graded(capsys: pytest.CaptureFixture[str]) -> None:
    hidden = {"slot_harmonics": {"relative": 0.03}}
    _print_verdict(judge(read_guess("slot_harmonics=-0.02"), hidden))
    first = capsys.readouterr().out.splitlines()[0]
    assert first == "slot_harmonics: right; relative −0.02 belongs to this angle alone, and is not graded"


def test_reveal_tells_too_what_the_run_itself_caused(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    turned = {"rotor_misalignment": {"angle_rad": 0.02}}
    monkeypatch.setattr("plugins.commands.mystery._guessing.caused_effects", lambda _: turned)
    reported = verdict_on(capsys, run, "--reveal")
    assert "rotor_misalignment: not hidden; the run itself caused it, as its alignment" in reported
    assert "at an angle: angle 20 mrad" in reported
    hidden = {"rotor_misalignment": {"angle_rad": 0.018}}
    monkeypatch.setattr("plugins.commands.mystery._guessing.sealed_effects", lambda _: hidden)
    assert "rotor_misalignment: with what the run itself caused, the recording has angle 20 mrad" in verdict_on(
        capsys, run, "--reveal"
    )
    monkeypatch.setattr("plugins.commands.mystery._guessing.sealed_effects", lambda _: turned)
    assert "with what the run itself caused" not in verdict_on(capsys, run, "--reveal")
    # The run's own angle differs by less than its words: one line is enough.
    hidden = {"rotor_misalignment": {"angle_rad": 0.01999}}
    assert "with what the run itself caused" not in verdict_on(capsys, run, "--reveal")


def test_a_run_that_a_fault_ended_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = DriveFault(FaultCause.OVERCURRENT, "9 A")
    monkeypatch.setattr("plugins.commands.mystery._command._run", lambda *_: fault)
    with pytest.raises(DriveFault):
        command([str(NUMBER), "--out", str(tmp_path / "run")])
    assert f"`fluxbench resume {tmp_path / 'run'}` continues" in capsys.readouterr().err


def test_requested_again_it_is_not_measured_again(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (run / "journal.jsonl").read_bytes()
    said = verdict_on(capsys, run)
    assert "fluxbench diagnose" in said
    # The pictures to guess from come before the diagnosis, which gives most of it away.
    assert said.index(f"{run / 'report.html'}:\n  fluxbench report {run}\n") < said.index("fluxbench diagnose")
    assert (run / "journal.jsonl").read_bytes() == before


def test_a_mystery_that_was_not_made_cannot_be_guessed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="fluxbench mystery 3"):
        command(["3", "--guess", "nothing", "--out", str(tmp_path / "none")])


def test_a_lost_answer_is_stated_in_one_line(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    with pytest.raises(RecordingError, match="sealed"):
        command([str(NUMBER), "--reveal", "--out", str(copy)])


def test_its_run_has_a_report_and_a_view_like_every_other(run: Path) -> None:
    assert {"report.html", "view.rrd"} <= {file.name for file in run.iterdir()}


@pytest.mark.parametrize("words", [(), ("--guess", "nothing"), ("--reveal",)])
def test_one_that_was_killed_is_to_be_resumed_first(run: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    lines = (copy / "journal.jsonl").read_text().splitlines(keepends=True)
    (copy / "journal.jsonl").write_text("".join(lines[: len(lines) // 2]))
    with pytest.raises(InputError, match=f"fluxbench resume {copy}"):
        command([str(NUMBER), "--out", str(copy), *words])


@pytest.mark.parametrize("words", [(), ("--guess", "nothing"), ("--reveal",)])
def test_another_mystery_is_not_judged_by_this_ones_answer(run: Path, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=f"not mystery {NUMBER + 1}"):
        command([str(NUMBER + 1), "--out", str(run), *words])


@pytest.mark.parametrize(
    ("words", "problem"), [(["-1"], "whole number"), (["--", "-2"], "whole number"), (["3", "--out", ""], "--out")]
)
def test_what_cannot_be_a_mystery_is_one_line(words: list[str], problem: str) -> None:
    with pytest.raises(InputError, match=problem) as caught:
        command(words)
    assert "\n" not in str(caught.value)


def test_a_number_that_was_read_off_in_per_cent_is_told_how_to_be_written(capsys: pytest.CaptureFixture[str]) -> None:
    hidden = {"bus_sag": {"per_watt": 5e-6}}
    for guess, end in (
        (
            "bus_sag=0.00055",
            "is more than twice the true one; a number alone is in SI, here 1/W: for per cent write bus_sag=0.00055%",
        ),
        ("bus_sag=0.00052%", "is right within 10 %"),
        ("bus_sag=0.005", "is more than twice the true one"),
    ):
        _print_verdict(judge(read_guess(guess), hidden))
        assert capsys.readouterr().out.splitlines()[0].endswith(end)


def test_it_says_before_a_guess_what_its_recording_cannot_tell_apart(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = verdict_on(capsys, run)
    assert "no rotor locked at a second angle: rotor_misalignment, sampling_offset and slot_harmonics" in printed
    assert "second PWM frequency" not in printed  # it has two

"""The scorer: what counts as right, what it refuses, and that it needs numpy alone."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from orchestrator.benchmark import scorer
from tests.support.benchmark_set import FLUX, right_answers, write_answers, write_set


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_set(tmp_path / "set")


def scored(folder: Path, answers: list[dict[str, Any]]) -> dict[str, Any]:
    file = write_answers(folder / "answers.jsonl", answers)
    return scorer.summary(scorer.scores_of(file, folder / "truth"))


def test_a_perfect_answer_scores_full(folder: Path) -> None:
    found = scored(folder, right_answers())
    assert (found["right"], found["verdict_right"], found["main_right"], found["exact"]) == (4, 4, 2, 3)
    assert (found["sizes_inside"], found["resistance_inside"], found["usable_though_off"]) == (3, 4, 0)
    assert found["map_percent"] == 0.0
    assert found["map_inside_percent"] == 100.0


def test_answers_of_other_recordings_score_worse(folder: Path) -> None:
    answers = right_answers()
    shuffled = [{**answers[k], "id": answer["id"]} for k, answer in zip((3, 0, 1, 2), answers, strict=True)]
    assert scored(folder, shuffled)["right"] == 0


def test_a_twin_counts_as_the_name_and_another_name_does_not(folder: Path) -> None:
    answers = right_answers()
    answers[1]["names"] = [{"name": "device_drop"}]
    answers[2]["names"] = [{"name": "eddy_currents"}, {"name": "hysteresis"}]
    found = scored(folder, answers)
    assert (found["right"], found["main_right"], found["false_names"]) == (3, 1, 1)


def test_names_beside_a_foreign_cause_are_not_judged_but_the_verdict_is(folder: Path) -> None:
    answers = right_answers()
    answers[3]["names"] = [{"name": "dead_time"}]
    assert scored(folder, answers)["right"] == 4
    answers[3]["verdict"] = "explained"
    assert scored(folder, answers)["right"] == 3


def test_a_map_that_is_called_usable_and_is_off_is_wrong(folder: Path) -> None:
    answers = right_answers()
    answers[0]["flux_wb"] = [[d + 0.01, q] for d, q in FLUX]
    found = scored(folder, answers)
    assert (found["right"], found["usable_though_off"]) == (3, 1)
    answers[0]["usable"] = False
    assert scored(folder, answers)["right"] == 4
    answers[0] |= {"usable": True, "flux_wb": [FLUX[0], None, None]}
    assert scored(folder, answers)["usable_though_off"] == 1, "a map of one point of three is none"


def test_a_size_is_held_against_the_truth_and_its_interval(folder: Path) -> None:
    answers = right_answers()
    answers[1]["names"][0] |= {"size": 8.8, "low": 8.7, "high": 8.9}
    (score,) = [
        s for s in scorer.scores_of(write_answers(folder / "a", answers), folder / "truth") if s["id"] == "r002"
    ]
    assert score["sizes"] == [pytest.approx(0.1)]
    assert score["size_inside"] == [False]


def test_a_missing_answer_is_wrong_unless_left_out(folder: Path) -> None:
    file = write_answers(folder / "answers.jsonl", right_answers()[:2])
    assert [s["right"] for s in scorer.scores_of(file, folder / "truth")] == [True, True, False, False]
    assert len(scorer.scores_of(file, folder / "truth", answered=True)) == 2


def test_a_changed_truth_is_refused_before_it_is_used(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = folder / "truth" / "r002.json"
    file.write_text(file.read_text().replace("8.0", "8.5"))
    answers = write_answers(folder / "answers.jsonl", right_answers())
    assert scorer.main([str(answers), str(folder / "truth")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert "r002.json: not the truth that was sealed" in printed.err


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("[]", "expected an object"),
        ('{"id": "r001", "verdict": "fine"}', "verdict: expected one of"),
        ('{"id": "r001", "verdict": "clean", "names": ["dead_time"]}', "names: expected a list of objects"),
        ('{"id": "r001", "verdict": "clean", "names": [{"name": "gremlins"}]}', "gremlins is none of the effects"),
        ('{"id": "r001", "verdict": "explained", "names": [{"name": "dead_time", "size": 1, "unit": "mV"}]}', "unit V"),
        ('{"id": "r001", "verdict": "clean", "resistance_ohm": 4.3}', "resistance_ohm: expected an object"),
        ('{"id": "r001", "verdict": "clean", "flux_wb": [[NaN, 0]]}', "flux_wb: expected a list"),
        ('{"id": "r999", "verdict": "clean"}', "no recording of this set"),
        ("{", "line 1"),
    ],
)
def test_what_is_no_answer_is_refused_in_one_line(folder: Path, line: str, problem: str) -> None:
    file = folder / "answers.jsonl"
    file.write_text(line + "\n")
    with pytest.raises(scorer.ScoreError, match=problem) as refused:
        scorer.scores_of(file, folder / "truth")
    assert "\n" not in str(refused.value)


def test_it_is_one_file_that_needs_numpy_alone(folder: Path) -> None:
    answers = write_answers(folder / "answers.jsonl", right_answers())
    alone = folder / "scorer.py"
    alone.write_text(Path(scorer.__file__).read_text())
    allowed = (
        "import sys; import numpy; sys.modules.update(pydantic=None, orchestrator=None, protocols=None, scipy=None)"
    )
    run = f"{allowed}; import runpy; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", run, str(alone), str(answers), str(folder / "truth"), "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["all"]["right"] == 4


def test_the_table_tells_own_plants_from_outer_ones_and_lists_the_worst(folder: Path) -> None:
    answers = right_answers()
    answers[1]["names"] = [{"name": "eddy_currents"}]
    file = write_answers(folder / "answers.jsonl", answers)
    text = scorer.report(scorer.scores_of(file, folder / "truth"))
    assert "single   own" in text
    assert (
        "r002 single, own, test: hidden dead_time x1; stated explained: eddy_currents; missed: main name, 1 false"
        in text
    )

"""`fluxbench benchmark`: the three commands, the baselines' scripts, and the page's way in for a stranger."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import plugins.commands.benchmark as module
from orchestrator.benchmark import Row, scorer
from plugins.commands.benchmark import command
from protocols import InputError
from tests.blind.benchmark import plants
from tests.blind.benchmark.make import make_set
from tests.blind.campaign import Campaign
from tests.support.benchmark_set import right_answers, write_answers, write_set

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples" / "benchmark"
HOLDS = Campaign(
    second_pwm=False, classical=False, second_amplitude=False, anchors=False, injection=False, dwell_s=0.04
)
METHODS = ("least_squares", "thresholded", "lasso", "gaussian_process")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of one recording of holds alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plants.CAMPAIGNS, "holds", HOLDS)
        folder = tmp_path_factory.mktemp("set")
        make_set([Row("r900", "single", "blind", "single", 0, 1, "pm400", "holds", "", False)], folder)
        return folder


def test_score_prints_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_set(tmp_path / "set")
    answers = write_answers(folder / "answers.jsonl", right_answers())
    assert command(["score", str(answers), str(folder / "truth")]) == 0
    assert "4 of 4 recordings answered" in capsys.readouterr().out
    assert command(["score", str(answers), str(folder / "truth"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["all"]["right"] == 4


def test_score_refuses_a_truth_that_was_changed_in_one_line(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    answers = write_answers(folder / "answers.jsonl", right_answers())
    (folder / "truth" / "r001.json").write_text("{}")
    with pytest.raises(InputError, match="not the truth that was sealed") as refused:
        command(["score", str(answers), str(folder / "truth")])
    assert refused.value.exit_code == 2
    assert "\n" not in str(refused.value)


def test_score_names_the_line_and_the_field_of_what_is_no_answer(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    file = write_answers(
        folder / "answers.jsonl", [*right_answers(), {"id": "r005", "verdict": "clean", "mood": "good"}]
    )
    with pytest.raises(InputError, match=r"answers.jsonl: line 5: mood"):
        command(["score", str(file), str(folder / "truth")])


def test_make_needs_the_source_tree_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "__file__", str(tmp_path / "site-packages/plugins/commands/benchmark.py"))
    with pytest.raises(InputError, match="fluxbench benchmark make: needs the source tree"):
        command(["make", str(tmp_path)])


def test_run_refuses_a_folder_that_is_no_set(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"benchmark.json: not the manifest of a benchmark's set"):
        command(["run", str(tmp_path), "--out", str(tmp_path / "answers.jsonl")])


def test_run_keeps_the_answers_that_are_there(small: Path, tmp_path: Path) -> None:
    out = write_answers(tmp_path / "answers.jsonl", [{"id": "r900", "verdict": "unknown"}])
    before = out.read_text()
    assert command(["run", str(small), "--out", str(out)]) == 0
    assert out.read_text() == before


def test_the_page_s_script_answers_a_recording_and_the_scorer_scores_it(small: Path, tmp_path: Path) -> None:
    page = (ROOT / "docs" / "benchmark.md").read_text()
    (shown,) = re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    assert shown == (EXAMPLES / "first_answer.py").read_text()
    script = [sys.executable, str(EXAMPLES / "first_answer.py"), str(small), "r900"]
    line = subprocess.run(script, capture_output=True, text=True, check=True).stdout
    (tmp_path / "answers.jsonl").write_text(line)
    (score,) = scorer.scores_of(tmp_path / "answers.jsonl", small / "truth")
    assert score["answered"]
    assert score["resistance_percent"] < 300.0


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_baseline_answers_in_the_form_that_is_scored(method: str, small: Path, tmp_path: Path) -> None:
    out = tmp_path / "answers.jsonl"
    assert command(["run", str(small), "--out", str(out), "--method", method]) == 0
    (score,) = scorer.scores_of(out, small / "truth")
    assert score["answered"]


@pytest.mark.slow
def test_fluxbench_answers_in_the_form_that_is_scored(small: Path, tmp_path: Path) -> None:
    out = tmp_path / "answers.jsonl"
    assert command(["run", str(small), "--out", str(out)]) == 0
    (score,) = scorer.scores_of(out, small / "truth")
    assert score["answered"]


def test_the_commands_of_the_page_have_the_options_that_it_says(capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "benchmark.md").read_text()
    lines = re.findall(r"fluxbench benchmark (make|run|score)((?: [^\s`|]+)*)", page)
    assert {verb for verb, _ in lines} == {"make", "run", "score"}
    for verb, words in lines:
        command([verb, "--help"])
        shown = capsys.readouterr().out
        assert all(word in shown for word in words.split() if word.startswith("--")), (verb, words)
    command(["--help"])
    assert "Example: fluxbench benchmark run" in capsys.readouterr().out
    assert {method for method in METHODS if f"--method {method}" in page} == set(METHODS)

"""What to do about a diagnosed model: what comes first, and the commands with the run's own name."""

from __future__ import annotations

from orchestrator.diagnosis.reporting.advice import advice_on
from orchestrator.formatting.deciding import DISCOVER_FIRST, experiment_to_decide
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis


def test_where_an_unknown_remains_its_law_comes_before_the_experiment_and_is_named_once() -> None:
    report = a_diagnosis().model_copy(update={"verdict": "unknown_remains"})
    assert report.next_experiment is not None
    decide = f"{DISCOVER_FIRST}; {experiment_to_decide(report.next_experiment)}"
    text = advice_on(report, WORDS.model_copy(update={"to_decide": decide}), None, "runs/mine").text
    assert text.startswith(
        "`fluxbench discover runs/mine` looks for the law that is missing; `fluxbench run --from runs/"
    )
    assert text.count("discover") == 1
    without = report.model_copy(update={"next_experiment": None})
    words = WORDS.model_copy(update={"to_decide": f"{DISCOVER_FIRST}; no experiment tells more"})
    assert advice_on(without, words, None, "runs/mine").text == (
        "`fluxbench discover runs/mine` looks for the law that is missing; no experiment tells more."
    )

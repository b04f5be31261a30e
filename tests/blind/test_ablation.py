from importlib import import_module
from inspect import signature

import pytest

from tests.blind.ablation import ROOM, RULES, Rule, is_same, main, observing


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.label)
def test_a_rule_s_function_is_there_and_is_given_what_it_gives_back(rule: Rule) -> None:
    function = getattr(import_module(f"{ROOM}.{rule.module}"), rule.name)
    rule.nothing(dict.fromkeys(signature(function).parameters))


def test_rules_are_themselves_again_afterwards() -> None:
    moves = import_module(f"{ROOM}.selection.environment_moves")
    before = moves.with_detected_quantiser
    with observing(without=["environment_moves.with_detected_quantiser"]) as seen:
        assert moves.with_detected_quantiser is not before
        assert moves.with_detected_quantiser("setup", None, []) == "setup"
        assert seen["environment_moves.with_detected_quantiser"].calls == 0
    assert moves.with_detected_quantiser is before


def test_results_are_the_same_that_lead_on_in_the_same_way() -> None:
    fit, other = object(), object()
    assert is_same((fit, {}), (fit, {}))
    assert not is_same((fit, {}), (other, {}))
    assert not is_same((fit, {"dead_time": ["device_drop"]}), (fit, {}))
    assert not is_same(fit, None)


def test_a_rule_that_is_none_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--seed", "1", "--recordings", "nowhere", "--answers", "nowhere.jsonl", "--without", "repolished"]
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1

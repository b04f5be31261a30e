"""Every public method of an effect is one that a diagnosis calls, with arguments that it takes."""

from __future__ import annotations

import functools
from typing import Any

import pytest

from orchestrator.registry.plugin_methods import hook_problem
from orchestrator.registry.plugins import PluginKind, make_plugins
from protocols import EFFECT_HOOKS, Correction, hook_of

KNOWN = "correct, shows_in, measured, remarks, derived, random_directions, correct_batch, random_directions_batch"


def an_effect(**members: Any) -> type[Any]:
    return type("AnEffect", (), {"correct": lambda self, signals, p: Correction(), **members})


@pytest.mark.parametrize("effect", make_plugins(PluginKind.EFFECTS), ids=lambda effect: str(effect.name))
def test_every_installed_effect_has_known_methods_alone(effect: Any) -> None:
    assert hook_problem(type(effect)) is None


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("random_direction", "random_directions"),
        ("show_in", "shows_in"),
        ("measure", "measured"),
        ("remark", "remarks"),
        ("correct_batches", "correct_batch"),
        ("random_direction_batch", "random_directions_batch"),
        ("correct_all", "correct"),
    ],
)
def test_a_misspelt_method_is_named_with_the_one_that_is_meant(written: str, meant: str) -> None:
    problem = hook_problem(an_effect(**{written: lambda self, signals: ()}))
    assert problem == f"method {written!r} is never called: an effect has {KNOWN}; did you mean {meant!r}?"


def test_a_misspelt_method_of_a_base_class_is_found() -> None:
    base = an_effect(random_direction=lambda self, signals, p: ())
    assert "'random_direction' is never called" in str(hook_problem(type("Derived", (base,), {})))


@pytest.mark.parametrize(
    "helper", [lambda self: 1, staticmethod(lambda: 1), classmethod(lambda cls: 1), functools.partial(int, 1)]
)
def test_a_helper_of_any_kind_begins_with_an_underscore(helper: Any) -> None:
    assert hook_problem(an_effect(_lagged=helper)) is None
    problem = hook_problem(an_effect(lagged=helper))
    assert problem is not None
    assert problem.startswith("method 'lagged' is never called")
    assert problem.endswith("a method of its own begins with an underscore")


def test_attributes_properties_and_nested_classes_are_an_effect_s_own() -> None:
    own = {"limit_a": 3.0, "doubted": None, "half": property(lambda self: 0.5), "Settings": type("Settings", (), {})}
    assert hook_problem(an_effect(**own)) is None


CALLS: list[tuple[str, Any, Any]] = [
    ("shows_in(signals)", lambda self, one: True, lambda self: True),
    ("measured(segments)", lambda self, some: None, lambda self, some, motor: None),
    ("remarks(parameters)", lambda self, p: [], lambda self: []),
    ("derived(parameters, drive)", lambda self, p, drive: {}, lambda self, p: {}),
    ("random_directions(signals, parameters)", lambda self, one, p: (), lambda self, one: ()),
    ("correct_batch(batch, parameters)", lambda self, some, p=None: 0, lambda self, some, *, p: 0),
    ("random_directions_batch(batch, parameters)", lambda self, *some: (), lambda self, some, p, motor: ()),
]


@pytest.mark.parametrize(("call", "right", "wrong"), CALLS)
def test_a_method_that_does_not_take_its_arguments_is_named_with_them(call: str, right: Any, wrong: Any) -> None:
    name = call.partition("(")[0]
    assert hook_problem(an_effect(**{name: right})) is None
    assert hook_problem(an_effect(**{name: wrong})) == f"method {name!r} cannot be called as {call}"


def test_arguments_are_reported_of_every_known_method() -> None:
    assert [call.partition("(")[0] for call, _, _ in CALLS] == list(EFFECT_HOOKS)


def test_a_static_method_takes_its_arguments_without_the_effect() -> None:
    assert hook_problem(an_effect(shows_in=staticmethod(lambda signals: True))) is None
    assert hook_problem(an_effect(shows_in=classmethod(lambda cls, signals: True))) is None
    wrong = an_effect(shows_in=staticmethod(lambda self, signals: True))
    assert hook_problem(wrong) == "method 'shows_in' cannot be called as shows_in(signals)"


def test_what_is_no_method_where_one_is_expected_is_named() -> None:
    assert "method 'random_directions' is missing: write def random_directions(self, signals, parameters)" in str(
        hook_problem(an_effect(random_directions=3.0))
    )


def test_a_method_s_former_name_counts_unless_the_effect_has_both() -> None:
    former: dict[str, Any] = {"doubts": lambda self, signals, p: ("one",)}
    assert hook_problem(an_effect(**former)) is None
    found = hook_of(an_effect(**former)(), "random_directions")
    assert found is not None
    assert found(None, None) == ("one",)
    problem = hook_problem(an_effect(**former, random_directions=former["doubts"]))
    assert problem == "method 'doubts' is the former name of 'random_directions', and the effect has both"


def test_an_effect_has_a_hook_where_it_has_its_method_and_has_not_switched_it_off() -> None:
    base = an_effect(random_directions=lambda self, signals, p: ("one",))
    found = hook_of(base(), "random_directions")
    assert found is not None
    assert found(None, None) == ("one",)
    assert hook_of(base(), "measured") is None
    assert hook_of(type("Sure", (base,), {"random_directions": None})(), "random_directions") is None

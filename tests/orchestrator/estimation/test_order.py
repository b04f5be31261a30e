"""Estimators run after those whose products they require."""

from __future__ import annotations

import itertools
from typing import ClassVar

import pytest

from orchestrator.estimation.estimation import in_order
from protocols import Estimate, Estimator, PluginError
from tests.orchestrator.estimation.made_up import Injected, Mapper, OneEnergy, Resistance, Ripples, Sweeps


def test_whatever_order_they_come_in_each_follows_what_it_requires() -> None:
    four: list[Estimator] = [Resistance(), Sweeps(), Ripples(), OneEnergy()]
    for shuffled in itertools.permutations(four):
        assert in_order(shuffled) == four


def test_what_nobody_produces_is_not_waited_for() -> None:
    assert [estimator.name for estimator in in_order([OneEnergy(), Ripples()])] == ["ripples", "one_energy"]


def test_one_that_requires_its_own_kind_runs_after_the_others_of_it() -> None:
    class Mean(Sweeps):
        name: ClassVar[str] = "mean"
        requires: ClassVar[tuple[type[Estimate], ...]] = (Sweeps.produces,)

    assert [estimator.name for estimator in in_order([Mean(), Sweeps()])] == ["sweeps", "mean"]


def test_a_circle_is_named() -> None:
    class Backwards(Mapper):
        name: ClassVar[str] = "backwards"
        requires: ClassVar[tuple[type[Estimate], ...]] = (Injected,)
        produces: ClassVar[type[Estimate]] = Sweeps.produces

    with pytest.raises(PluginError, match=r"circle: .*backwards.*") as reported:
        in_order([Backwards(), Ripples()])
    assert "ripples" in str(reported.value)

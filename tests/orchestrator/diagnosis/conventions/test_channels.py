"""Dead and clipped channels, and noise in the place of a current."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis.conventions import find_convention
from protocols import Capture, NotMeasuredError
from tests.support.rewriting import Field, Rewritten, gain


@pytest.mark.parametrize(("phase", "sensors"), [("a", "ab"), ("b", "ab"), ("c", "ac"), ("a", "abc"), ("c", "abc")])
def test_a_dead_phase_is_named(right: Rewritten, phase: str, sensors: str) -> None:
    found = find_convention(right.phases("i_ab", gain(phase, 0.0), sensors))
    assert found is not None
    assert found.kind == "dead_channel"
    assert f"phase {phase}" in found.what


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_a_channel_that_stays_where_it_is_is_named(right: Rewritten, value: float) -> None:
    found = find_convention(right.captured(lambda c: {"i_ab": c.i_ab * [1.0, 0.0] + [0.0, value]}))
    assert found is not None
    assert found.what == "i_beta looks dead"


def test_a_phase_that_is_only_dead_in_its_own_column_is_named(right: Rewritten) -> None:
    found = find_convention(right.captured(lambda c: {"i_abc": np.ones((len(c), 3)) * c.i_ab[:, :1] * [1.0, 1.0, 0.0]}))
    assert found is not None
    assert found.what == "the current of phase c looks dead"


@pytest.mark.parametrize(("field", "limit", "name"), [("i_ab", 1.5, "currents"), ("v_ab", 20.0, "voltages")])
def test_clipped_readings_are_named_with_their_limit(right: Rewritten, field: Field, limit: float, name: str) -> None:
    found = find_convention(right.captured(lambda c: {field: np.clip(getattr(c, field), -limit, limit)}))
    assert found is not None
    assert found.kind == f"clipped_{name}"
    assert f"{limit:g}" in found.what


def test_noise_in_the_place_of_a_current_is_refused(right: Rewritten, rng: np.random.Generator) -> None:
    def noise(c: Capture) -> dict[str, Any]:
        return {"i_ab": rng.normal(0.0, 1.0, c.i_ab.shape)}

    with pytest.raises(NotMeasuredError, match="noise, and no current"):
        find_convention(right.captured(noise))


def test_noise_in_the_place_of_one_channel_is_named(right: Rewritten, rng: np.random.Generator) -> None:
    found = find_convention(
        right.captured(lambda c: {"i_ab": c.i_ab * [1.0, 0.0] + [0.0, 1.0] * rng.normal(0.0, 1.0, (len(c), 1))})
    )
    assert found is not None
    assert found.what == "i_beta looks dead"

"""The answer of the benchmark: what the model takes, the scorer takes."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from orchestrator.benchmark import effect_sizes
from orchestrator.benchmark.scorer import _check
from protocols.benchmark import BenchmarkAnswer

NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)
POINTS = st.lists(st.none() | st.tuples(NUMBERS, NUMBERS), max_size=4)


@st.composite
def named(draw: st.DrawFn) -> dict[str, Any]:
    name = draw(st.sampled_from(sorted(effect_sizes())))
    if draw(st.booleans()):
        return {"name": name}
    low, size, high = sorted(draw(st.tuples(NUMBERS, NUMBERS, NUMBERS)))
    return {"name": name, "size": size, "unit": effect_sizes()[name].unit, "low": low, "high": high}


ANSWERS = st.fixed_dictionaries(
    {"id": st.text(min_size=1, max_size=8), "verdict": st.sampled_from(["clean", "explained", "unknown"])},
    optional={
        "names": st.lists(named(), max_size=3),
        "resistance_ohm": st.fixed_dictionaries({"value": NUMBERS}),
        "flux_wb": POINTS,
        "flux_std_wb": POINTS,
        "usable": st.booleans(),
        "seconds": st.floats(0.0, 1e6),
    },
)


@given(ANSWERS)
def test_an_answer_survives_its_line_of_json_and_the_scorer_takes_it(raw: dict[str, Any]) -> None:
    answer = BenchmarkAnswer.model_validate_json(json.dumps(raw))
    line = answer.model_dump_json(exclude_none=True)
    assert BenchmarkAnswer.model_validate_json(line) == answer
    _check(json.loads(line), {name: size.unit for name, size in effect_sizes().items()})


@pytest.mark.parametrize(
    "wrong",
    [
        {"verdict": "fine"},
        {"seconds": -1.0},
        {"usable": "yes", "comment": "mine"},
        {"names": [{"name": "dead_time", "size": 1.0}]},
        {"names": [{"name": "dead_time", "size": 1.0, "unit": "V", "low": 2.0, "high": 1.0}]},
        {"names": [{"name": "dead_time", "low": 2.0}]},
    ],
)
def test_what_is_no_answer_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        BenchmarkAnswer.model_validate({"id": "r001", "verdict": "clean", **wrong})

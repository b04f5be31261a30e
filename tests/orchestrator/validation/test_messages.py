"""Pydantic's errors in one line: the place in the file, and the nearest valid key."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, ValidationError

from orchestrator.validation.messages import Problem, first_problem, nearest, suggestion
from protocols import Strict


class Round(Strict):
    kind: Literal["round"]
    radius_m: float


class Square(Strict):
    kind: Literal["square"]
    side_m: float
    offsets_m: tuple[tuple[float, float], ...] | None = None


class Border(Strict):
    width_m: float
    style: Literal["solid", "dashed"] = "solid"


class Drawing(Strict):
    border: Border | None = None
    edge: Literal["sharp", "soft"] = "sharp"
    shapes: tuple[Annotated[Round | Square, Field(discriminator="kind")], ...]
    frame: Square | None = None
    count: int = 0
    delay_s: float | tuple[float, float, float] = 0.0


def problem_of(raw: dict[str, Any]) -> Problem:
    with pytest.raises(ValidationError) as caught:
        Drawing.model_validate(raw)
    return first_problem(caught.value, Drawing, raw)


@pytest.mark.parametrize(
    ("raw", "field", "text"),
    [
        ({"shapes": [], "shape": 1}, "shape", "unknown key; did you mean 'shapes'?"),
        ({"shape": []}, "shape", "unknown key; did you mean 'shapes'?"),
        ({"shapes": [{"kind": "square", "sides_m": 1}]}, "shapes.0.sides_m", "unknown key; did you mean 'side_m'?"),
        ({"shapes": [{"kind": "round", "radius_m": 1, "x": 1}]}, "shapes.0.x", "unknown key; valid: kind, radius_m"),
        ({"shapes": [], "frame": {"kind": "square", "side": 1}}, "frame.side", "unknown key; did you mean 'side_m'?"),
        ({"shapes": [{"kind": "round"}]}, "shapes.0.radius_m", "missing"),
        ({"shapes": [{"kind": "rond"}]}, "shapes.0.kind", "unknown kind 'rond'; did you mean 'round'?"),
        ({"shapes": [{"radius_m": 1}]}, "shapes.0", "kind is missing"),
        ({"shapes": [{"kind": "round", "radius_m": "1 m"}]}, "shapes.0.radius_m", "expected a number, got '1 m'"),
        ({"shapes": 3}, "shapes", "expected a list, got 3"),
        (
            {"shapes": [], "edge": {"width_m": 1}},
            "edge",
            "expected 'sharp' or 'soft', got {'width_m': 1}; for width_m there is border.width_m",
        ),
        ({"shapes": [], "radius_m": 1}, "radius_m", "unknown key; for radius_m there is shapes.radius_m"),
        ({"shapes": [], "frame": 3}, "frame", "expected keys and values, got 3"),
        ({"shapes": [], "count": 1.5}, "count", "expected a whole number, got 1.5"),
        (
            {"shapes": [{"kind": "square", "side_m": 1, "offsets_m": [[0, 0], [0, "x"]]}]},
            "shapes.0.offsets_m.1.1",
            "expected a number, got 'x'",
        ),
        ({"shapes": [], "delay_s": "x"}, "delay_s", "expected a number in s, got 'x'"),
        ({"shapes": [], "delay_s": "0,5"}, "delay_s", "expected a number in s, got '0,5': write a decimal point, 0.5"),
        ({"shapes": [], "delay_s": [1, "x", 3]}, "delay_s.1", "expected a number in s, got 'x'"),
        ({"shapes": [], "delay_s": [1, 2]}, "delay_s.2", "missing"),
        (
            {"shapes": [], "delay_s": [1, 2, 3, 4]},
            "delay_s",
            "tuple should have at most 3 items after validation, not 4, got [1, 2, 3, 4]",
        ),
    ],
)
def test_a_problem_is_stated_where_it_was_written(raw: dict[str, Any], field: str, text: str) -> None:
    problem = problem_of(raw)
    assert (problem.field, problem.text) == (field, text)


def test_a_long_value_is_cut_short() -> None:
    assert len(problem_of({"shapes": "x" * 1000}).text) < 100


def test_what_is_like_nothing_lists_everything() -> None:
    assert nearest("xyz", ["round", "square"]) is None
    assert suggestion("xyz", {"square", "round"}) == "valid: round, square"
    assert suggestion("xyz", []) == "none is valid here"

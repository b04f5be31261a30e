"""Base models and the array type: arrays are held by reference, checked for dtype and shape.

Nothing here copies an array, and no array is ever turned into a list of floats: a JSON dump of
a model that holds arrays describes them by dtype and shape.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self, cast, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

RealArray = NDArray[np.floating[Any]]
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))


def _number_as_such(value: Any) -> Any:
    """Numbers are numbers: pydantic by itself takes true for 1, and "4" for 4."""
    if isinstance(value, bool | str | bytes):
        raise PydanticCustomError("float_type", "Input should be a number")
    return value


def _whole_number_as_such(value: Any) -> Any:
    if isinstance(value, bool | str | bytes):
        raise PydanticCustomError("int_type", "Input should be a whole number")
    return value


_AS_SUCH = {"float": _number_as_such, "int": _whole_number_as_such}


def strict_numbers(schema: Any) -> Any:
    """A core schema whose numbers take neither booleans nor text; what is a whole number may still be written 4.0."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(strict_numbers, schema))
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") in _AS_SUCH:
        return core_schema.no_info_before_validator_function(_AS_SUCH[schema["type"]], cast(CoreSchema, schema))
    if schema.get("type") == "function-before" and schema["function"].get("function") in _AS_SUCH.values():
        return schema  # of a model within a model
    return {key: strict_numbers(value) for key, value in schema.items()}


class _StrictNumbers(BaseModel):
    """Base of all models of files."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return cast(CoreSchema, strict_numbers(handler(source)))


class Strict(_StrictNumbers):
    """A frozen model for what people write: unknown keys and non-finite numbers are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class Lenient(_StrictNumbers):
    """A frozen model for files of other tools: unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


@dataclass(frozen=True)
class Shape:
    """Annotation that checks an array's dtype (float32 or float64) and shape, without a copy.

    Each entry is a length, or a name: names that recur within a model must agree in length.
    """

    dims: tuple[int | str, ...]

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        def check(value: object) -> RealArray:
            problem = self.problem(value)
            if problem is not None:
                raise PydanticCustomError("array", "{problem}", {"problem": problem})
            return cast(RealArray, value)

        return core_schema.no_info_plain_validator_function(
            check,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda a: {"dtype": str(a.dtype), "shape": list(a.shape)}, when_used="json"
            ),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "object", "description": f"array of shape {self}, held outside JSON"}

    def problem(self, value: object) -> str | None:
        """What was expected instead of `value`; None where it is such an array."""
        if not isinstance(value, np.ndarray):
            return f"expected a numpy array, got {type(value).__name__}"
        if value.dtype not in _FLOATS:
            return f"expected float32 or float64, got {value.dtype}"
        fits = value.ndim == len(self.dims) and all(
            isinstance(want, str) or want == have for want, have in zip(self.dims, value.shape, strict=True)
        )
        return None if fits else f"expected shape {self}, got {value.shape}"

    def __str__(self) -> str:
        return "(" + ", ".join(map(str, self.dims)) + ("," if len(self.dims) == 1 else "") + ")"


Samples = Annotated[RealArray, Shape(("n",))]
"""One value a sample, shape (n,)."""

Vectors = Annotated[RealArray, Shape(("n", 2))]
"""One two-axis vector a sample, shape (n, 2): time first, then axis."""

Phases = Annotated[RealArray, Shape(("n", 3))]
"""One value a phase and sample, shape (n, 3)."""


class ArrayModel(BaseModel):
    """A frozen model that holds arrays by reference; named dimensions must agree across fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, use_attribute_docstrings=True)

    @model_validator(mode="after")
    def _dimensions_agree(self) -> Self:
        shapes = {name: m for name, f in type(self).model_fields.items() for m in f.metadata if isinstance(m, Shape)}
        problem = lengths_problem(shapes, self)
        if problem is not None:
            raise PydanticCustomError("array", "{name} {problem}", {"name": problem[0], "problem": problem[1]})
        return self


def shapes_of(holder: type) -> dict[str, Shape]:
    """The shape of each field of a class that is annotated with one, also of those that may be None."""
    hints = get_type_hints(holder, include_extras=True)
    shapes = {name: _shape_in(hint) for name, hint in hints.items()}
    return {name: shape for name, shape in shapes.items() if shape is not None}


def arrays_problem(shapes: Mapping[str, Shape], optional: Collection[str], holder: object) -> tuple[str, str] | None:
    """The first field of `holder` whose array is not of its dtype, shape or length, and what was expected of it.

    Those that are `optional` may be None. No array is copied.
    """
    for name, shape in shapes.items():
        array = getattr(holder, name)
        problem = None if array is None and name in optional else shape.problem(array)
        if problem is not None:
            return name, problem
    return lengths_problem(shapes, holder)


def lengths_problem(shapes: Mapping[str, Shape], holder: object) -> tuple[str, str] | None:
    """The first field of `holder` whose array differs in a named dimension from those before it, and how."""
    sizes: dict[str, tuple[str, int]] = {}
    for name, shape in shapes.items():
        array = getattr(holder, name)
        if array is None:
            continue
        for dim, size in zip(shape.dims, array.shape, strict=True):
            first, expected = sizes.setdefault(dim, (name, size)) if isinstance(dim, str) else (name, size)
            if size != expected:
                return name, f"has length {size}, but {first} has {expected}"
    return None


def _shape_in(hint: Any) -> Shape | None:
    shapes = (m for m in getattr(hint, "__metadata__", ()) if isinstance(m, Shape))
    inner = (_shape_in(part) for part in get_args(hint))
    return next(shapes, None) or next((shape for shape in inner if shape is not None), None)

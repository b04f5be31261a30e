"""Base models and the array type: arrays are held by reference, checked for dtype and shape.

Nothing here copies an array, and no array is ever turned into a list of floats: a JSON dump of
a model that holds arrays describes them by dtype and shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Self, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

RealArray = NDArray[np.floating[Any]]


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
    """What all models of files have in common."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return cast(CoreSchema, strict_numbers(handler(source)))


class Strict(_StrictNumbers):
    """A frozen model for what people write: unknown keys and non-finite numbers are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class Lenient(_StrictNumbers):
    """A frozen model for what other tools write: unknown keys are passed over."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


@dataclass(frozen=True)
class Shape:
    """Annotation that checks an array's dtype (float32 or float64) and shape, without a copy.

    Each entry is a length, or a name: names that recur within a model must agree in length.
    """

    dims: tuple[int | str, ...]

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        def check(value: object) -> RealArray:
            if not isinstance(value, np.ndarray):
                raise PydanticCustomError("array", "expected a numpy array, got {got}", {"got": type(value).__name__})
            if value.dtype not in (np.float32, np.float64):
                raise PydanticCustomError("array", "expected float32 or float64, got {got}", {"got": str(value.dtype)})
            fits = value.ndim == len(self.dims) and all(
                isinstance(want, str) or want == have for want, have in zip(self.dims, value.shape, strict=True)
            )
            if not fits:
                raise PydanticCustomError(
                    "array", "expected shape {want}, got {got}", {"want": str(self), "got": str(value.shape)}
                )
            return value

        return core_schema.no_info_plain_validator_function(
            check,
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda a: {"dtype": str(a.dtype), "shape": list(a.shape)}, when_used="json"
            ),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "object", "description": f"array of shape {self}, held outside JSON"}

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
        sizes: dict[str, tuple[str, int]] = {}
        for name, field in type(self).model_fields.items():
            array = getattr(self, name)
            shape = next((m for m in field.metadata if isinstance(m, Shape)), None)
            if shape is None or array is None:
                continue
            for dim, size in zip(shape.dims, array.shape, strict=True):
                if not isinstance(dim, str):
                    continue
                first, expected = sizes.setdefault(dim, (name, size))
                if size != expected:
                    raise PydanticCustomError(
                        "array",
                        "{name} has length {size}, but {first} has {expected}",
                        {"name": name, "size": size, "first": first, "expected": expected},
                    )
        return self

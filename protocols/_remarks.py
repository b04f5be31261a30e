"""Remarks on a result: a code for programs, the values, and a sentence."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import AliasChoices, BeforeValidator, Field, computed_field

from protocols._base import Lenient


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_finite)]
"""Finite, or null."""


class Remark(Lenient):
    """A remark; what decides anything looks at its code and values, never at its words."""

    code: str
    """What it is about, in snake_case: ``branches_differ``; in a report behind its estimator's name and a point."""
    values: dict[str, Number | str] = Field(default_factory=dict)
    """The figures in the sentence, under names with their units: ``apart_percent``."""
    text: str

    @classmethod
    def of(cls, code: str, text: str, /, **values: float | str | None) -> Self:
        """A remark whose sentence is made of its values: `text` is a format string of their names."""
        return cls(code=code, values=values, text=text.format_map(values))

    def by(self, source: str) -> Remark:
        """The remark with its source before code and text."""
        return Remark(code=f"{source}.{self.code}", values=self.values, text=f"{source}: {self.text}")


def _remarked(given: object) -> object:
    """Results of before remarks had codes hold their sentences alone."""
    if not isinstance(given, list | tuple):
        return given
    return tuple(Remark(code="remark", text=one) if isinstance(one, str) else one for one in given)


Noted = Annotated[
    tuple[Remark, ...],
    BeforeValidator(_remarked),
    Field(validation_alias=AliasChoices("remarks", "notes")),
]
"""The remarks of a report, under the name that older files have for them too; bare sentences are taken for remarks."""

Remarks = Annotated[
    tuple[Remark, ...],
    BeforeValidator(_remarked),
    Field(validation_alias=AliasChoices("remarks", "notes", "reasons")),
]
"""The remarks of an estimate: as `Noted`, or under ``reasons``."""


class Remarked(Lenient):
    """A report with remarks; `notes` has their sentences alone."""

    remarks: Noted = ()

    @computed_field  # type: ignore[prop-decorator]
    @property
    def notes(self) -> tuple[str, ...]:
        """The remarks' sentences."""
        return tuple(remark.text for remark in self.remarks)

    def with_remark(self, remark: Remark) -> Self:
        """A copy with one more remark."""
        return self.model_copy(update={"remarks": (*self.remarks, remark)})

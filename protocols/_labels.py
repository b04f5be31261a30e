"""Tags and notes that a person gives a run afterwards: ``labels.json`` in its folder."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from protocols._base import Strict

Text = Annotated[str, Field(min_length=1, max_length=2000)]


class RunLabels(Strict):
    """Tags and notes of a run; they replace those with which it was started."""

    format: Literal["fluxbench-labels"] = "fluxbench-labels"
    version: Literal[1] = 1
    tags: Annotated[tuple[Text, ...], Field(max_length=100)] = ()
    notes: Annotated[tuple[Text, ...], Field(max_length=100)] = ()

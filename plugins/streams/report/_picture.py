"""A picture's place on the page; draws nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Picture:
    """A picture, or in its place the reason why there is none."""

    title: str
    caption: str
    uri: str = ""
    beside: str = ""
    """A second picture of the same, after; then the first one is before."""

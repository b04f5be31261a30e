"""Colours of every picture the project draws: one colour means one thing, in the viewer as on the page.

The eight are Okabe and Ito's (https://jfly.uni-koeln.de/color/), distinguishable for colour-blind readers too.
Nothing here draws.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from protocols import Basis

BLACK = "#000000"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
YELLOW = "#F0E442"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"

D_AXIS, Q_AXIS = SKY, ORANGE
MODEL = VERMILION
"""Results of a model: fits, predictions."""
MEASURED_ON_PAPER, MEASURED_ON_SCREEN = BLACK, "#F2F2F2"
METHODS: dict[Basis | None, str] = {Basis.INJECTION: PURPLE, Basis.INTEGRATION: GREEN, Basis.ENERGY: VERMILION}
"""Colour of a map by its basis; an energy is the model itself."""
PHASES = (BLUE, YELLOW, "#BDBDBD")
"""a, b, c."""
GUIDE, GRID, TEXT, SCREEN = "#8C8C8C", "#3A3F44", "#B4BAC0", "#14171A"
"""Limits and targets, grids, text, and the viewer's dark background."""
AT_REST, COMPUTING, ENERGISED = "#565B60", "#8A9096", ("#E6E6E6", "#C4C8CC")
ENDED_WELL, ENDED_BADLY = GREEN, VERMILION
"""States: the brighter the more current flows; the two ends have their own."""

_SEQUENTIAL = ("#440154", "#472D7B", "#3B528B", "#2C728E", "#21918C", "#28AE80", "#5EC962", "#ADDC30", "#FDE725")
_DIVERGING = ("#B35806", "#E08214", "#FDB863", "#FEE0B6", "#F7F7F7", "#D8DAEB", "#B2ABD2", "#8073AC", "#542788")
"""Anchors of viridis (https://bids.github.io/colormap/) and of PuOr (https://colorbrewer2.org/)."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#RRGGBB``, each 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def packed(colour: str) -> int:
    """``#RRGGBB`` as the viewer takes it: 0xRRGGBBAA, opaque."""
    return int(colour[1:], 16) << 8 | 0xFF


def packed_all(colours: Iterable[str]) -> NDArray[np.uint32]:
    """Several colours in the viewer's form."""
    return np.array([packed(colour) for colour in colours], dtype=np.uint32)


def sequential(fractions: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colours for values from 0 (dark) to 1 (bright); shape (..., 4), transparent where not finite."""
    return _blend(_SEQUENTIAL, fractions)


def diverging(fractions: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colours for values about a middle at 0.5; shape (..., 4), transparent where not finite."""
    return _blend(_DIVERGING, fractions)


def opaque(colours: NDArray[np.uint8], behind: str) -> NDArray[np.uint8]:
    """The colours over a background, for outputs without transparency."""
    out = colours.copy()
    out[colours[..., 3] == 0] = (*rgb(behind), 255)
    return out


def _blend(anchors: tuple[str, ...], fractions: NDArray[np.floating]) -> NDArray[np.uint8]:
    table = np.array([rgb(anchor) for anchor in anchors], dtype=np.float64)
    known = np.isfinite(fractions)
    place = np.clip(np.where(known, fractions, 0.0), 0.0, 1.0) * (len(table) - 1)
    out = np.empty((*np.shape(fractions), 4), dtype=np.uint8)
    for channel in range(3):
        out[..., channel] = np.interp(place, np.arange(len(table)), table[:, channel])
    out[..., 3] = np.where(known, 255, 0)
    return out

"""Axes for the viewer's flat views, which have none: grid, ticks and words as lines and labelled points.

`Chart` maps two quantities of any units onto a sheet of paper; `plane` is the current plane at equal scales, in
amperes. Both fill the same view whatever the numbers, so that a layout knows none. The sheet's y axis points down, as
the viewer's does; a word hangs below the place that it is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from orchestrator.formatting.colours import GRID, GUIDE, TEXT, packed, packed_all
from orchestrator.formatting.quantities import number
from plugins.streams.rerun._tape import ALWAYS, Entry, When, entry
from protocols import RealArray

WIDTH, HEIGHT = 160.0, 90.0
MARGIN = (18.0, 8.0, 24.0, 18.0)
"""Left, right, above and below a chart, in its own units."""
_HAIR_POINTS, _LINE_POINTS, _INVISIBLE_POINTS = -0.5, -1.0, -0.01
"""Radii in points of the screen, as negative numbers are."""


def ticks(low: float, high: float, wanted: int = 5) -> list[float]:
    """Round numbers from `low` to `high`, steps of 1, 2 or 5."""
    span = high - low
    if not math.isfinite(span) or span <= 0.0:
        return [low]
    raw = span / wanted
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(m * size for m in (1.0, 2.0, 5.0, 10.0) if m * size >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


@dataclass(frozen=True)
class Chart:
    """A pair of axes at `path`; a logarithmic x axis where `log_x`."""

    path: str
    x: tuple[float, float]
    y: tuple[float, float]
    x_label: str
    y_label: str
    log_x: bool = False

    def place(self, x: RealArray | Sequence[float], y: RealArray | Sequence[float]) -> RealArray:
        """Where values lie on the sheet, shape (n, 2); what is beyond the axes stays on their edge."""
        return np.stack([_scaled(x, self.x, self.log_x) * WIDTH, (1.0 - _scaled(y, self.y)) * HEIGHT], axis=1)

    def furniture(self, when: When = ALWAYS, title: str = "", y_ticks: bool = True) -> list[Entry]:
        """Frame, grid, ticks and words."""
        at_x = _decades(*self.x) if self.log_x else ticks(*self.x)
        at_y = ticks(*self.y) if y_ticks else []
        lines = [self.place([v, v], self.y) for v in at_x] + [self.place(self.x, [v, v]) for v in at_y]
        frame = self.place([self.x[0], self.x[1], self.x[1], self.x[0], self.x[0]], [*np.repeat(self.y, 2), self.y[0]])
        below, left = HEIGHT + 2.0, -8.0
        words = [(float(self.place([v], [self.y[0]])[0, 0]), below, number(v, 3)) for v in at_x]
        # A word hangs below its place, by half its height.
        words += [(left, float(self.place([self.x[0]], [v])[0, 1]) - 3.5, number(v, 3)) for v in at_y]
        words += [(WIDTH / 2, HEIGHT + 9.5, self.x_label), (WIDTH * 0.12, -11.0, self.y_label)]
        if title:
            words.append((WIDTH / 2, -20.0, title))
        words = [word for word in words if word[2]]
        return [
            lined(f"{self.path}/axes/grid", when, lines, GRID, _HAIR_POINTS, 1.0),
            lined(f"{self.path}/axes/frame", when, [frame], GUIDE, _HAIR_POINTS, 2.0),
            worded(f"{self.path}/axes/words", when, words),
        ]

    def line(
        self,
        name: str,
        when: When,
        x: RealArray,
        y: RealArray,
        colour: str,
        radius: float = _LINE_POINTS,
        layer: float = 20.0,
    ) -> Entry:
        """A curve; the higher its layer, the further in front."""
        return lined(f"{self.path}/{name}", when, [self.place(x, y)], colour, radius, layer)

    def legend(self, when: When, names: Sequence[tuple[str, str]]) -> Entry:
        """Names, each in its colour, above the chart."""
        at = np.array([[WIDTH * (0.42 + 0.5 * (k + 0.5) / len(names)), -11.0] for k in range(len(names))])
        labels, colours = zip(*names, strict=True)
        words = rr.Points2D(at, labels=labels, show_labels=True, colors=packed_all(colours), radii=_INVISIBLE_POINTS)
        return entry(f"{self.path}/legend", when, words)

    def points(self, name: str, when: When, x: RealArray, y: RealArray, colour: str, radius: float = -1.5) -> Entry:
        """Dots."""
        return dotted(f"{self.path}/{name}", when, self.place(x, y), colour, radius)


def chart_bounds() -> tuple[tuple[float, float], tuple[float, float]]:
    """What a view has to show of a chart, in x and y."""
    left, right, above, below = MARGIN
    return (-left, WIDTH + right), (-above, HEIGHT + below)


def plane(path: str, reach_a: float, limit_a: float | None = None, when: When = ALWAYS) -> list[Entry]:
    """The current plane in amperes below `path`, i_q upwards, out to `reach_a`; the limit as a circle."""
    at = ticks(-reach_a, reach_a, 6)
    lines = [np.array([[v, -reach_a], [v, reach_a]]) for v in at] + [
        np.array([[-reach_a, v], [reach_a, v]]) for v in at
    ]
    cross = [np.array([[0.0, -reach_a], [0.0, reach_a]]), np.array([[-reach_a, 0.0], [reach_a, 0.0]])]
    words = [(v, -1.03 * reach_a, number(v, 3)) for v in at]
    words += [(-1.1 * reach_a, v + 0.04 * reach_a, number(v, 3)) for v in at]
    words += [(0.0, -1.12 * reach_a, "i_d [A]"), (-1.0 * reach_a, 1.13 * reach_a, "i_q [A]")]
    out = [
        entry(path, when, rr.Transform3D(scale=[1.0 / reach_a, -1.0 / reach_a, 1.0])),
        lined(f"{path}/axes/grid", when, lines, GRID, _HAIR_POINTS, 1.0),
        lined(f"{path}/axes/cross", when, cross, GUIDE, _HAIR_POINTS, 2.0),
        worded(f"{path}/axes/words", when, words),
    ]
    if limit_a is not None:
        turn = np.linspace(0.0, 2.0 * math.pi, 181)
        circle = limit_a * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        out.append(lined(f"{path}/axes/limit", when, [circle], GUIDE, _LINE_POINTS))
    return out


def plane_bounds(bar: bool = False) -> tuple[tuple[float, float], tuple[float, float]]:
    """What a view has to show of the current plane (and a colour bar beside it), in x and y."""
    return (-1.2, 1.65 if bar else 1.1), (-1.2, 1.3)


def colour_bar(
    path: str, when: When, reach_a: float, colours: NDArray[np.uint8], span: tuple[float, float], unit: str
) -> list[Entry]:
    """A column beside the plane: `colours` (n, 4) from below, ticks over `span`, the unit above."""
    low, high = span
    image = np.ascontiguousarray(colours[:, None, :].repeat(2, axis=1))
    height = 1.8 * reach_a
    at = ticks(low, high, 4)
    words = [
        (1.48 * reach_a, -0.86 * reach_a + height * (v - low) / (high - low), number(v, 3)) for v in at if high > low
    ] + [(1.3 * reach_a, 1.1 * reach_a, unit)]
    return [
        picture(f"{path}/bar", when, image, (1.2 * reach_a, -0.9 * reach_a), (0.15 * reach_a, height)),
        worded(f"{path}/bar_words", when, words),
    ]


def picture(
    path: str, when: When, image: NDArray[np.uint8], corner: tuple[float, float], size: tuple[float, float]
) -> Entry:
    """Colours (rows, columns, 4) over a rectangle, row 0 at `corner`."""
    rows, columns = image.shape[:2]
    place = rr.Transform3D(translation=[*corner, 0.0], scale=[size[0] / columns, size[1] / rows, 1.0])
    return entry(path, when, place, rr.Image(image, color_model="RGBA", draw_order=-20.0), array_bytes=image.nbytes)


def lined(
    path: str, when: When, strips: Sequence[RealArray], colour: str, radius: float = _LINE_POINTS, layer: float = 20.0
) -> Entry:
    """Lines of one colour."""
    size = sum(strip.nbytes for strip in strips)
    return entry(
        path, when, rr.LineStrips2D(strips, colors=packed(colour), radii=radius, draw_order=layer), array_bytes=size
    )


def dotted(path: str, when: When, at: RealArray, colour: str | NDArray[np.uint8], radius: float = -1.5) -> Entry:
    """Dots at (x, y), shape (n, 2), of one colour or one each (n, 4)."""
    colours = packed(colour) if isinstance(colour, str) else colour
    return entry(path, when, rr.Points2D(at, colors=colours, radii=radius), array_bytes=at.nbytes)


def worded(path: str, when: When, words: Sequence[tuple[float, float, str]]) -> Entry:
    """Words about (x, y)."""
    at = np.array([word[:2] for word in words], dtype=np.float64).reshape(-1, 2)
    labels = [word[2] for word in words]
    return entry(
        path, when, rr.Points2D(at, labels=labels, show_labels=True, colors=packed(TEXT), radii=_INVISIBLE_POINTS)
    )


def reach(values: RealArray, part: float = 1.0) -> tuple[float, float]:
    """A range about zero that holds the given part of the values, and is never empty."""
    known = np.abs(values[np.isfinite(values)])
    largest = float(np.quantile(known, part)) if known.size else 0.0
    return (-1.05 * largest, 1.05 * largest) if largest > 0.0 else (-1.0, 1.0)


def _scaled(values: RealArray | Sequence[float], span: tuple[float, float], log: bool = False) -> RealArray:
    given, ends = np.asarray(values, dtype=np.float64), np.asarray(span, dtype=np.float64)
    if log:
        given, ends = np.log10(np.maximum(given, 1e-300)), np.log10(ends)
    out: RealArray = np.clip((given - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
    return out


def _decades(low: float, high: float) -> list[float]:
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    fine = [m * 10.0**p for p in powers for m in ((1.0, 2.0, 5.0) if len(powers) <= 4 else (1.0,))]
    return [v for v in fine if low * 0.999 <= v <= high * 1.001]

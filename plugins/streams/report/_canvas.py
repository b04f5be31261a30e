"""What all pictures of the report have in common: size, type, and the way into the page. Knows no data.

Type is sized for a phone: a picture 330 pixels wide still has letters of ten. What is dense is drawn as
pixels inside the vector graphics, which keeps the page small.
"""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 4.6, 3.5
PHASES_ON_PAPER = ("#0072B2", "#A89600", "#6E6E6E")
"""a, b, c: the hues of the viewer's phases, dark enough for white paper."""
BEFORE_COLOUR = "#9AA0A6"
"""The model that the ladder starts from, where it is drawn beside the last one."""
SMALL, NORMAL = 10, 11
_DPI = 130


def new_figure(width: float = WIDTH_IN, height: float = HEIGHT_IN) -> tuple[Figure, Axes]:
    """A figure with one pair of axes."""
    figure = empty_figure(width, height)
    return figure, bare(figure.add_subplot())


def empty_figure(width: float = WIDTH_IN, height: float = HEIGHT_IN) -> Figure:
    """A figure without axes."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def bare(axes: Axes) -> Axes:
    """Axes without the frame's upper and right side."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=SMALL)
    return axes


def name_axes(axes: Axes, x: str, y: str) -> None:
    """Axis labels with units, and a grid that stays behind."""
    axes.set_xlabel(x, fontsize=NORMAL)
    axes.set_ylabel(y, fontsize=NORMAL)
    axes.grid(alpha=0.25, lw=0.6)
    axes.set_axisbelow(True)


def legend_above(axes: Axes, columns: int, handles: list[Any] | None = None, names: list[str] | None = None) -> None:
    """The legend over the axes, where it hides nothing; of all that has a label, where nothing else is given."""
    if handles is None or names is None:
        handles, names = axes.get_legend_handles_labels()
    axes.legend(
        handles,
        names,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=columns,
        frameon=False,
        fontsize=SMALL,
        handlelength=1.4,
        columnspacing=1.0,
    )


def uri(figure: Figure) -> str:
    """The figure as a data URI of an SVG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=_DPI, metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")

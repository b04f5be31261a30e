"""Common parts of figures by matplotlib: sizes, labels, legends, and conversion for a page. Knows no data.

Type is sized for a phone: a picture 330 pixels wide still has letters of ten. Dense parts are drawn as pixels inside
the vector graphics, which keeps a page small. Matplotlib is imported when the first figure is made.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from orchestrator.extras import require
from orchestrator.formatting.sentences import visible
from protocols import Basis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Style:
    """Measures of a figure.

    Attributes
    ----------
    width_in, height_in : float
        Default size of a figure [inch]: two side by side on a page of A4.
    small_pt, normal_pt : float
        Ticks and legends; axis labels.
    dpi : float
        Resolution of parts drawn as pixels.
    """

    width_in: float = 4.6
    height_in: float = 3.5
    small_pt: float = 10.0
    normal_pt: float = 11.0
    dpi: float = 130.0


STYLE = Style()
BEFORE_COLOUR = "#9AA0A6"
"""The ladder's first model, where it is drawn beside the last one."""
PHASES_ON_PAPER = ("#0072B2", "#A89600", "#6E6E6E")
"""a, b, c: the hues of the viewer's phases, dark enough for white paper."""
CURRENT_LABELS = {"d": "$i_d$ [A]", "q": "$i_q$ [A]"}
BASIS_LINES: dict[Basis | None, str] = {Basis.INTEGRATION: "--", Basis.INJECTION: "-"}
"""Line of a map by its basis: dashed for integration, solid for injection, dotted for others."""


def new_figure(width: float = STYLE.width_in, height: float = STYLE.height_in) -> tuple[Figure, Axes]:
    """A figure with one pair of axes."""
    figure = empty_figure(width, height)
    return figure, bare(figure.add_subplot())


def empty_figure(width: float = STYLE.width_in, height: float = STYLE.height_in) -> Figure:
    """A figure without axes; raises `MissingExtraError` where matplotlib is not installed."""
    require("report", "a picture")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def bare(axes: Axes) -> Axes:
    """Axes without the frame's upper and right side, each tick with its whole number: no offset stands beside them."""
    axes.ticklabel_format(useOffset=False)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=STYLE.small_pt)
    return axes


def name_axes(axes: Axes, x: str, y: str) -> None:
    """Axis labels with units, and a grid that stays behind."""
    axes.set_xlabel(x, fontsize=STYLE.normal_pt)
    axes.set_ylabel(y, fontsize=STYLE.normal_pt)
    axes.grid(alpha=0.25, lw=0.6)
    axes.set_axisbelow(True)


def current_plane(axes: Axes) -> None:
    """Axes of the current plane, both on one scale."""
    axes.set_aspect("equal", adjustable="box")
    name_axes(axes, *CURRENT_LABELS.values())


def label(text: str, max_length: int = 40) -> str:
    """An external name as a picture's text: short, without mathematics and control characters."""
    plain = visible(text.replace("\n", " "))
    return (plain if len(plain) <= max_length else plain[: max_length - 1] + "…").replace("$", r"\$")


def signed_scale(values: Any, margin: float = 1.0) -> dict[str, Any]:
    """Colours for values about zero, which is white."""
    largest = margin * float(abs(values).max()) or 1.0
    return {"cmap": "PuOr", "vmin": -largest, "vmax": largest}


def legend_above(axes: Axes, columns: int, handles: list[Any] | None = None, names: list[str] | None = None) -> None:
    """The legend above the axes, where it hides nothing; by default of all labelled artists."""
    if handles is None or names is None:
        handles, names = axes.get_legend_handles_labels()
    axes.legend(
        handles,
        names,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=columns,
        frameon=False,
        fontsize=STYLE.small_pt,
        handlelength=1.4,
        columnspacing=1.0,
    )


def uri(figure: Figure) -> str:
    """The figure as a data URI of an SVG."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    FigureCanvasSVG(figure)
    layout = figure.get_layout_engine()
    if layout is not None:  # one separate layout: matplotlib would draw the whole figure twice otherwise
        layout.execute(figure)
        figure.set_layout_engine(None)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=STYLE.dpi, metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")

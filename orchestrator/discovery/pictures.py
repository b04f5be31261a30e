"""The picture of a discovery: the flexible law with its band, and the formula that is written."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.discovery.bases import MEMORIES, memory_response
from orchestrator.discovery.forms import CURVES
from orchestrator.discovery.report import Discovery, FoundForm, FoundLaw
from orchestrator.formatting.drawing import bare, empty_figure, legend_above, name_axes, uri
from orchestrator.numerics.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAND_SIGMAS = 1.96
CURVE_COLOUR, FORM_COLOUR = "#0072B2", "#D55E00"


def curve_picture(found: Discovery) -> bytes | None:
    """An SVG of each law's curve; None where there is no law, or none has a curve."""
    laws = [law for law in found.laws if law.curve]
    if not laws:
        return None
    figure = empty_figure(4.6 * len(laws), 3.5)
    for axes, law in zip(figure.subplots(1, len(laws), squeeze=False)[0], laws, strict=True):
        draw_law(bare(axes), law)
    return base64.b64decode(uri(figure).split(",", 1)[1])


def draw_law(axes: Axes, law: FoundLaw) -> None:
    """The flexible law with its band, and the formulas that do as well, in axes of their own."""
    x, y, std = (np.array([getattr(p, of) for p in law.curve]) for of in ("x", "y", "std"))
    axes.fill_between(x, y - BAND_SIGMAS * std, y + BAND_SIGMAS * std, color=CURVE_COLOUR, alpha=0.2, lw=0)
    axes.plot(x, y, color=CURVE_COLOUR, label="flexible, 95 %")
    for form in law.forms[:2]:
        values = form_values(form, x)
        if values is not None:
            axes.plot(x, values, color=FORM_COLOUR, ls="--" if form is law.forms[0] else ":", label=form.formula)
    unit = f" [{law.unit}]" if law.unit != "1" else ""
    symbol = law.symbol.replace("_", " ")
    name_axes(axes, f"{symbol} [{law.quantity_unit}]", f"{law.place.replace('_', ' ')}{unit}")
    legend_above(axes, 2)


def form_values(form: FoundForm, x: Array) -> Array | None:
    """A form's values; None of a table."""
    if form.name == "line":
        sine, cosine, *_, frequency = (c.value for c in form.constants)
        turns = 2.0 * np.pi * frequency * x
        return np.asarray(sine * np.sin(turns) + cosine * np.cos(turns), dtype=np.float64)
    constants = {c.name.split("_")[0]: c.value for c in form.constants}
    if form.name in MEMORIES:
        (shape,) = (c.value for c in form.constants[1:])
        return constants["size"] * memory_response(form.name, x, shape)
    known = {f.name: f for f in CURVES}.get(form.name)
    if known is None:
        return None
    values = known.of(x, constants.get(known.scale_name, 1.0), constants.get(known.power_name, 1.0))
    return np.asarray(constants["size"] * values)

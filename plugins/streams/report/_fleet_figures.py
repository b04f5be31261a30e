"""Pictures of a fleet's report: each quantity over time beside its distribution, and how far each recording is out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from orchestrator.formatting.colours import BLACK, BLUE, GUIDE, SKY, VERMILION
from orchestrator.formatting.drawing import bare, empty_figure, label, legend_above, name_axes, new_figure, uri
from orchestrator.formatting.quantities import Scale
from protocols.fleet_report import ControlChart, Distances, FleetQuantity, Histogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def quantity_figure(quantity: FleetQuantity) -> str:
    """A quantity's course with its control limits, and beside it how often which value is met."""
    figure = empty_figure()
    scale = _scale(quantity)
    factor = 10.0**-scale.power
    name = label(quantity.label, 24) + (f" [{scale.unit}]" if scale.unit else "")
    if quantity.chart is None:
        axes = bare(figure.add_subplot())
        _bars(axes, quantity.histogram, factor, across=False)
        _limits(axes.axvline, quantity, factor)
        name_axes(axes, name, "recordings")
        return uri(figure)
    course, beside = figure.subplots(1, 2, sharey=True, width_ratios=(3.0, 1.0))
    bare(course)
    bare(beside)
    _course(course, quantity.chart, factor)
    _bars(beside, quantity.histogram, factor, across=True)
    for axes in (course, beside):
        _limits(axes.axhline, quantity, factor)
    name_axes(course, "", name)
    name_axes(beside, "recordings", "")
    _few_dates(course)
    legend_above(course, 3)
    return uri(figure)


def distance_figure(distances: Distances) -> str:
    """How far each recording is from the middle, over how far one of a clean fleet may be."""
    from matplotlib.ticker import LogLocator, NullLocator

    figure, axes = new_figure()
    place = np.array([point.recording for point in distances.points])
    ratio = np.array([point.ratio for point in distances.points])
    out = ratio > 1.0
    axes.plot(place[~out], ratio[~out], ".", color=BLUE, ms=4)
    axes.plot(place[out], ratio[out], "D", color=VERMILION, ms=5, label="unlike the others")
    axes.axhline(1.0, color=GUIDE, lw=1.2, ls="--", label="limit")
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    name_axes(axes, "recording", "robust distance over its limit")
    legend_above(axes, 2)
    return uri(figure)


def _scale(quantity: FleetQuantity) -> Scale:
    middle = quantity.middle or 0.0
    half = quantity.spread or abs(middle) or 1.0
    return Scale.of(middle, middle - half, middle + half, quantity.unit)


def _course(axes: Axes, chart: ControlChart, factor: float) -> None:
    times = [point.at for point in chart.points]
    value, average, lower, upper = (
        factor * np.array([getattr(point, name) for point in chart.points])
        for name in ("value", "average", "lower", "upper")
    )
    axes.fill_between(times, lower, upper, color=SKY, alpha=0.3, lw=0, label="limits")  # type: ignore[arg-type]
    axes.plot(times, value, ".", color=BLACK, ms=2.5, label="measured")  # type: ignore[arg-type]
    axes.plot(times, average, "-", color=BLUE, lw=1.3, label="average")  # type: ignore[arg-type]
    beyond = (average < lower) | (average > upper)
    axes.plot(np.array(times)[beyond], average[beyond], "o", color=VERMILION, ms=3.5)


def _few_dates(axes: Axes, most: int = 4) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    places = AutoDateLocator(minticks=2, maxticks=most)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(places)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(places))  # type: ignore[no-untyped-call]


def _bars(axes: Axes, bins: Histogram | None, factor: float, *, across: bool) -> None:
    if bins is None:
        return
    edges = factor * np.array(bins.edges)
    draw = axes.barh if across else axes.bar
    draw(edges[:-1], bins.counts, np.diff(edges), align="edge", color=SKY, edgecolor="white", lw=0.4)


def _limits(line: object, quantity: FleetQuantity, factor: float) -> None:
    if quantity.capability is None or not callable(line):
        return
    for limit in (quantity.capability.low, quantity.capability.high):
        if limit is not None:
            line(factor * limit, color=VERMILION, lw=1.2, ls="--")

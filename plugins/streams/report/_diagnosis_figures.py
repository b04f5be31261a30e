"""The diagnosis in pictures: the ladder, the residual before and after, ripple, flux loops, R_s over the heat.

Black is measured, vermilion is what the model says. Before and after stand side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from orchestrator.formatting.colours import BLACK, BLUE, D_AXIS, GUIDE, MODEL, Q_AXIS
from orchestrator.formatting.drawing import (
    CURRENT_LABELS,
    PHASES_ON_PAPER,
    STYLE,
    bare,
    current_plane,
    empty_figure,
    label,
    legend_above,
    name_axes,
    new_figure,
    uri,
)
from orchestrator.formatting.names import plain, rung_name
from orchestrator.formatting.quantities import number, quantity
from orchestrator.formatting.results import joint_bound
from protocols import CurrentExcerpt, DiagnosisStep, FluxLoop, JointEntry, RealArray, ResistanceCourse, Rung

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Shown = TypeVar("Shown")
SURE_Z = 4.0
"""Size over standard deviation from which chance is no explanation."""
_TIGHT: dict[str, Any] = {"handletextpad": 0.1, "columnspacing": 0.8, "markerscale": 1.4}


def ladder_figure(ladder: Sequence[Rung], floor_v: float) -> str:
    """rms residual over the noise floor after each added effect, fitted and held out; the floor as a line.

    Reads downwards, so that names have room on a phone.
    """
    height = max(1.7, 1.15 + 0.42 * len(ladder))
    figure, axes = new_figure(STYLE.width_in, height)
    places = np.arange(len(ladder))
    for volts, colour, mark, name, shift in (
        ([rung.rms_v for rung in ladder], BLACK, "o", "fitted", -0.09),
        ([rung.heldout_rms_v for rung in ladder], BLUE, "D", "held out", 0.09),
    ):
        values = np.array([np.nan if one is None else one for one in volts]) / floor_v
        if np.isfinite(values).any():
            axes.plot(values, places + shift, "-", color=colour, lw=1.2, alpha=0.5)
            axes.plot(values, places + shift, mark, color=colour, ms=6, label=name)
    axes.axvline(1.0, color=GUIDE, lw=1.2, ls="--", label="noise floor")
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, 0.8), max(high, 3.0))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set_yticks(places, [label(rung_name(rung.added, k)) for k, rung in enumerate(ladder)])
    axes.set_ylim(len(ladder) - 0.5, -0.5)
    name_axes(axes, "rms residual over noise", "")
    # Beside long names the axes are narrower than the legend.
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=STYLE.small_pt, **_TIGHT)
    return uri(figure)


@dataclass(frozen=True)
class _Plane:
    """The current plane in cells: edges [A], rms residual (d, q) and mean residual (2, d, q) [V]; NaN where empty."""

    edges_d: RealArray
    edges_q: RealArray
    rms: RealArray
    mean: RealArray


@dataclass(frozen=True)
class Panels:
    """The same drawn of the first model and of the last."""

    before: str
    after: str = ""
    """Empty where the two models are one."""
    enlarged: str = ""
    """Empty where the last model's own scale is not much finer."""


MIN_TOP_IN_VOLT: float = 2.0
"""Size of a scale from which it is in volts and not in millivolts."""
ENLARGED_BELOW: float = 0.4
"""Size of the last residual over the first one's from which it is drawn on a scale of its own, too."""


def plane_figures(before: DiagnosisStep, after: DiagnosisStep) -> Panels:
    """The residual in each cell of the current plane, rms as colour, mean as arrow."""
    cells = [_cells(step) for step in (before, after)]
    return _panels(cells, [_top(cell.rms[np.isfinite(cell.rms)], 98) for cell in cells], _plane, before is after)


def _panels(shown: Sequence[Shown], tops: Sequence[float], draw: Callable[[Shown, float], str], is_one: bool) -> Panels:
    (first, last), (top, own) = shown, tops
    if is_one:
        return Panels(draw(first, top))
    return Panels(draw(first, top), draw(last, top), draw(last, own) if own < ENLARGED_BELOW * top else "")


def _top(sizes: RealArray, percentile: float) -> float:
    """The size that a scale has to hold."""
    return float(np.percentile(sizes, percentile)) or 1.0 if len(sizes) else 1.0


def _cells(step: DiagnosisStep, along: int = 13) -> _Plane:
    """The residual by cells, so many along the longer side."""
    used = np.array([stage != "gates_off" for stage in step.stage])
    i, residual = step.i_dq[used], step.residual_dq_v[used]
    low, high = (i.min(axis=0), i.max(axis=0)) if len(i) else (-np.ones(2), np.ones(2))
    side = max(float((high - low).max()), 1e-9) / along
    edges = []
    for axis in range(2):
        # Cells lie centred about zero, so that a sweep along an axis is one row of them.
        first, last = np.floor(low[axis] / side + 0.5), np.floor(high[axis] / side + 0.5)
        edges.append((np.arange(first, last + 2) - 0.5) * side)
    shape = (len(edges[0]) - 1, len(edges[1]) - 1)
    cell = np.digitize(i[:, 0], edges[0][1:-1]) * shape[1] + np.digitize(i[:, 1], edges[1][1:-1])
    count = np.bincount(cell, minlength=shape[0] * shape[1]).astype(np.float64)
    count[count == 0.0] = np.nan

    def average(x: RealArray) -> RealArray:
        return np.asarray(np.bincount(cell, x, len(count)) / count).reshape(shape)

    mean = np.array([average(residual[:, k]) for k in range(2)])
    return _Plane(edges[0], edges[1], np.sqrt(average((residual**2).sum(axis=1))), mean)


def _plane(cells: _Plane, top_v: float) -> str:
    figure, axes = new_figure(STYLE.width_in, STYLE.width_in * 0.78)
    unit, per_volt = _unit_of(top_v)
    size, top = per_volt * cells.rms.T, 1.15 * per_volt * top_v
    mesh = axes.pcolormesh(cells.edges_d, cells.edges_q, size, cmap="YlGnBu", vmin=0.0, vmax=top, rasterized=True)
    d, q = (0.5 * (edges[1:] + edges[:-1]) for edges in (cells.edges_d, cells.edges_q))
    grid_d, grid_q = np.meshgrid(d, q, indexing="ij")
    shown = np.hypot(*np.nan_to_num(cells.mean)) > 0.03 * top_v  # below, an arrow is a dot
    axes.quiver(
        grid_d[shown],
        grid_q[shown],
        cells.mean[0][shown],
        cells.mean[1][shown],
        color=BLACK,
        scale=top_v / 0.3,  # the longest arrow is so many inches long
        scale_units="inches",
        width=0.006,
        headwidth=4,
        pivot="mid",
    )
    bar = figure.colorbar(mesh, ax=axes, shrink=0.95)
    bar.set_label(f"rms residual [{unit}]", fontsize=STYLE.small_pt)
    bar.ax.tick_params(labelsize=STYLE.small_pt)
    current_plane(axes)
    return uri(figure)


def phase_figures(before: DiagnosisStep, after: DiagnosisStep) -> Panels:
    """Residual of each phase over that phase's current, the three laid over each other."""
    shown = [_phases_of(step) for step in (before, after)]
    tops = [1.15 * _top_of_phases(phases) for phases in shown]
    return _panels(shown, tops, _phases, before is after)


@dataclass(frozen=True)
class _PhaseResidual:
    """Phase currents and residuals, (n, 3) each, and the PWM frequency of each row, (n,); None where unknown."""

    current_a: RealArray
    residual_v: RealArray
    pwm_hz: RealArray | None


def _phases_of(step: DiagnosisStep) -> _PhaseResidual:
    driven = _is_driven(step)
    current = np.asarray(step.i_abc[driven], dtype=np.float64)
    residual = np.asarray(step.residual_abc_v[driven], dtype=np.float64)
    put_back = hidden_sequence(step)
    pwm_hz = None if step.pwm_frequency_hz is None else np.asarray(step.pwm_frequency_hz[driven], dtype=np.float64)
    return _PhaseResidual(current, residual if put_back is None else residual + put_back, pwm_hz)


def _is_driven(step: DiagnosisStep) -> NDArray[np.bool_]:
    return np.array([stage != "gates_off" for stage in step.stage], dtype=bool)


def _top_of_phases(shown: _PhaseResidual) -> float:
    """The size [V] that holds nearly all points, and nearly all of each other PWM frequency, which are few."""
    rows = [np.ones(len(shown.residual_v), dtype=bool), *_other_pwm_frequencies(shown).values()]
    return max(_top(np.abs(shown.residual_v[one]).ravel(), 99.5) for one in rows)


def _unit_of(top_v: float) -> tuple[str, float]:
    """The unit of a scale up to this size, and how much of it a volt is."""
    return ("V", 1.0) if top_v >= MIN_TOP_IN_VOLT else ("mV", 1e3)


def _phases(shown: _PhaseResidual, top_v: float) -> str:
    figure, axes = new_figure()
    unit, per_volt = _unit_of(top_v)
    current, residual = shown.current_a, per_volt * shown.residual_v
    for phase, colour in enumerate(PHASES_ON_PAPER):
        axes.plot(current[:, phase], residual[:, phase], ".", color=colour, ms=2.5, alpha=0.25, rasterized=True)
    for phase, (name, colour) in enumerate(zip("abc", PHASES_ON_PAPER, strict=True)):
        at, middle = _medians(current[:, phase], residual[:, phase])
        axes.plot(at, middle, "-", color="white", lw=4.0)
        axes.plot(at, middle, "-", color=colour, lw=2.0, label=f"phase {name}")
    for (pwm_hz, rows), mark in zip(_other_pwm_frequencies(shown).items(), "x+1234", strict=False):
        of_all = current[rows].ravel(), residual[rows].ravel()
        axes.plot(*of_all, mark, color=BLACK, ms=4, mew=0.8, label=f"PWM {quantity(pwm_hz, 'Hz')}")
    axes.axhline(0.0, color=GUIDE, lw=0.8)
    axes.set_ylim(-per_volt * top_v, per_volt * top_v)
    name_axes(axes, "current of the phase [A]", f"residual of the phase [{unit}]")
    legend_above(axes, 4)
    return uri(figure)


def _other_pwm_frequencies(shown: _PhaseResidual) -> dict[float, NDArray[np.bool_]]:
    """The rows of each PWM frequency but the usual one."""
    if shown.pwm_hz is None or not len(shown.pwm_hz):
        return {}
    several, counts = np.unique(shown.pwm_hz, return_counts=True)
    usual = several[counts.argmax()]
    return {float(pwm_hz): shown.pwm_hz == pwm_hz for pwm_hz in several if pwm_hz != usual}


MIN_EXPLAINED_BY_ONE_CURVE: float = 0.5
"""Part of the residual's square that one curve for all phases has to explain, for its mean to be put back."""


def hidden_sequence(step: DiagnosisStep) -> RealArray | None:
    """The voltage of each row that a star connection hides, (n, 1), of a residual that is one curve of each current.

    Three equal voltages cause no current: of errors f(i_a), f(i_b), f(i_c) only f(i_k) - mean f is seen. One piecewise
    linear f for all phases is fitted to that; its mean is the hidden part (a component-plus-residual plot). None where
    such an f explains less than `MIN_EXPLAINED_BY_ONE_CURVE`: of anything else it is an artefact.
    """
    driven = _is_driven(step)
    i_abc = np.asarray(step.i_abc[driven], dtype=np.float64)
    residual_abc = np.asarray(step.residual_abc_v[driven], dtype=np.float64)
    knots = _bins(i_abc)
    if len(i_abc) <= len(knots):
        return None
    hats = np.stack([np.interp(i_abc, knots, unit) for unit in np.eye(len(knots))], axis=-1)
    centred = hats - hats.mean(axis=1, keepdims=True)
    curve = np.linalg.lstsq(centred.reshape(-1, len(knots)), residual_abc.ravel(), rcond=1e-6)[0]
    left = float(np.sum((residual_abc - centred @ curve) ** 2))
    if left > (1.0 - MIN_EXPLAINED_BY_ONE_CURVE) * float(np.sum(residual_abc**2)):
        return None
    return np.asarray((hats @ curve).mean(axis=1, keepdims=True))


def _bins(x: RealArray, count: int = 25) -> RealArray:
    """Edges over the range of x, finer towards zero, where inverters act."""
    even = np.linspace(-1.0, 1.0, count + 1)
    return np.asarray((float(np.abs(x).max(initial=0.0)) or 1.0) * np.sign(even) * even**2)


def _medians(x: RealArray, y: RealArray) -> tuple[RealArray, RealArray]:
    """Median of y in bins of x that hold enough of it."""
    edges = _bins(x)
    place = np.digitize(x, edges[1:-1])
    full = [k for k in range(len(edges) - 1) if (place == k).sum() >= 5]
    return (
        np.array([np.median(x[place == k]) for k in full]),
        np.array([np.median(y[place == k]) for k in full]),
    )


def loop_figures(before: FluxLoop | None, after: FluxLoop) -> Panels:
    """Flux over current of one sweep; below, what was measured less what the map says, going up and down."""
    loops = [after] if before is None else [before, after]
    which = 0 if after.swept_axis == "d" else 1
    top = 1.05 * max(
        np.abs(_about_mean(psi, which)).max() for one in loops for psi in (one.psi_measured, one.psi_model)
    )
    return Panels(*(_loop(one, which, top) for one in loops))


def loop_error(loop: FluxLoop) -> float:
    """rms of measured less model along the swept axis [mWb]."""
    return _rms(_about_mean(loop.psi_measured - loop.psi_model, 0 if loop.swept_axis == "d" else 1))


def _loop(loop: FluxLoop, which: int, top_mwb: float) -> str:
    figure, above, below = _two_panels()
    axis, current, rising = "dq"[which], loop.i_dq[:, which], _rising(loop.i_dq[:, which])
    measured, model = (_about_mean(psi, which) for psi in (loop.psi_measured, loop.psi_model))
    above.plot(current, measured, "-", color=BLACK, lw=2.4, label="measured, $\\int (v - R_s i)\\,dt$")
    above.plot(current, model, "--", color=MODEL, lw=1.4, label="model")
    above.set_ylim(-top_mwb, top_mwb)
    name_axes(above, "", rf"$\psi_{axis}$ [mWb]")
    legend_above(above, 2)
    apart = _about_mean(loop.psi_measured - loop.psi_model, which)
    below.plot(current[rising], apart[rising], ".", color=MODEL, ms=3.5, label="current rising")
    below.plot(current[~rising], apart[~rising], "o", color=MODEL, ms=3.0, mfc="none", mew=0.7, label="falling")
    name_axes(below, CURRENT_LABELS[axis], "measured less\nmodel [mWb]")
    handles, names = below.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False, fontsize=STYLE.small_pt, **_TIGHT)
    return uri(figure)


def evenness_figures(before: FluxLoop | None, after: FluxLoop) -> Panels:
    """The d axis's flux over i_q of a sweep of q: a symmetric machine's is the same on both sides."""
    loops = [after if before is None else before, after]
    tops = [1.1 * max(np.abs(_about_mean(psi, 0)).max() for psi in (one.psi_measured, one.psi_model)) for one in loops]
    return _panels(loops, [max(tops), tops[1]], _evenness, before is None)


def unevenness(psi: RealArray, i_q: RealArray) -> float:
    """rms of the part of a sweep's d-axis flux that is odd in i_q, and linear or cubic in it [mWb]."""
    x = i_q / np.abs(i_q).max()
    powers = np.stack([np.ones_like(x), x, x**2, x**3, x**4], axis=1)
    of = np.linalg.lstsq(powers, _about_mean(psi, 0), rcond=None)[0]
    return _rms(powers[:, 1::2] @ of[1::2])


def _evenness(loop: FluxLoop, top_mwb: float) -> str:
    figure, axes = new_figure()
    i_q = loop.i_dq[:, 1]
    axes.plot(i_q, _about_mean(loop.psi_measured, 0), "-", color=BLACK, lw=2.4, label="measured")
    axes.plot(i_q, _about_mean(loop.psi_model, 0), "--", color=MODEL, lw=1.4, label="model")
    axes.axvline(0.0, color=GUIDE, lw=0.8)
    axes.set_ylim(-top_mwb, top_mwb)
    name_axes(axes, CURRENT_LABELS["q"], r"$\psi_d$ [mWb]")
    legend_above(axes, 2)
    return uri(figure)


def _about_mean(psi: RealArray, which: int) -> RealArray:
    """One axis of a flux about its mean [mWb]: an integral knows no constant."""
    return np.asarray(1e3 * (psi[:, which] - psi[:, which].mean()))


def _rms(x: RealArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _rising(current: RealArray) -> Any:
    """Where a sweep goes up; in its plateaus, as before them."""
    width = max(3, len(current) // 40)
    smooth = np.convolve(current, np.ones(width) / width, mode="same")
    slope = np.gradient(smooth)
    sign = np.where(np.abs(slope) > 0.25 * np.abs(slope).max(), np.sign(slope), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
    return sign[last] > 0.0


def ripple_figures(before: Sequence[CurrentExcerpt], after: Sequence[CurrentExcerpt]) -> Panels:
    """Ripple of i_d per volt injected, two amplitudes over each other; below, measured less predicted."""
    shown = [after] if not before else [before, after]
    top = 1.1 * max(float(np.abs(ripple).max()) for excerpts in shown for one in excerpts for ripple in _ripples(one))
    return Panels(*(_ripple(excerpts, top) for excerpts in shown))


def ripple_error(excerpts: Sequence[CurrentExcerpt]) -> float:
    """rms of measured less predicted, over all amplitudes [mA/V]."""
    return _rms(np.concatenate([measured - predicted for measured, predicted in map(_ripples, excerpts)]))


def _ripple(excerpts: Sequence[CurrentExcerpt], top: float) -> str:
    figure, above, below = _two_panels()
    styles = (("s", "none", "--"), ("o", BLACK, "-")) if len(excerpts) > 1 else (("o", BLACK, "-"),)
    for excerpt, (mark, fill, line) in zip(excerpts, styles, strict=True):
        time, volts = 1e3 * excerpt.time_s, f"{excerpt.amplitude_v or 1.0:g} V"
        measured, predicted = _ripples(excerpt)
        above.plot(time, measured, mark, color=BLACK, mfc=fill, ms=4.5, label=f"measured, {volts}")
        above.plot(time, predicted, line, color=MODEL, lw=1.5, label=f"model, {volts}")
        below.plot(time, measured - predicted, line, color=MODEL, lw=1.3)
    above.set_ylim(-top, top)
    name_axes(above, "", "ripple of $i_d$ [mA/V]")
    handles, names = above.get_legend_handles_labels()
    # Columns are filled one after the other: the model's curves are the second.
    order = np.argsort([name.startswith("model") for name in names], kind="stable")
    legend_above(above, 2, [handles[k] for k in order], [names[k] for k in order])
    name_axes(below, "time [ms]", "measured less\nmodel [mA/V]")
    return uri(figure)


def _ripples(excerpt: CurrentExcerpt) -> tuple[RealArray, RealArray]:
    """Measured and predicted ripple of i_d about its mean, per volt injected [mA/V]."""
    volts = excerpt.amplitude_v or 1.0
    measured, predicted = (
        np.asarray(1e3 * (i[:, 0] - i[:, 0].mean()) / volts) for i in (excerpt.measured_a, excerpt.predicted_a)
    )
    return measured, predicted


def _two_panels() -> tuple[Figure, Axes, Axes]:
    """What there is above, what is wrong with it below, on one abscissa."""
    figure = empty_figure(STYLE.width_in, 1.25 * STYLE.height_in)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    return figure, bare(above), bare(below)


def sweep_figures(before: CurrentExcerpt | None, after: CurrentExcerpt) -> Panels:
    """Both currents of a sweep, measured and simulated from the voltage alone; below, what the simulation misses."""
    shown = [after] if before is None else [before, after]
    top = 1.1 * max(float(np.abs(i).max()) for one in shown for i in (one.measured_a, one.predicted_a))
    return Panels(*(_sweep(one, top) for one in shown))


def sweep_error(excerpt: CurrentExcerpt) -> float:
    """rms of measured less simulated, both axes together as a vector [A]."""
    return float(np.sqrt(2.0)) * _rms(excerpt.measured_a - excerpt.predicted_a)


def _sweep(excerpt: CurrentExcerpt, top_a: float) -> str:
    figure, above, below = _two_panels()
    time, styles = excerpt.time_s, ((4.5, "-"), (1.8, "--"))  # where both currents are one, both are still seen
    for axis, (colour, (width, line)) in enumerate(zip((D_AXIS, Q_AXIS), styles, strict=True)):
        name = f"$i_{'dq'[axis]}$"
        above.plot(time, excerpt.measured_a[:, axis], "-", color=colour, lw=width, label=f"{name} measured")
        above.plot(time, excerpt.predicted_a[:, axis], ":", color=BLACK, lw=1.0, label=None if axis else "simulated")
        apart = 1e3 * (excerpt.measured_a - excerpt.predicted_a)[:, axis]
        below.plot(time, apart, line, color=colour, lw=1.2, label=name)
    above.set_ylim(-top_a, top_a)
    name_axes(above, "", "current [A]")
    legend_above(above, 3)
    name_axes(below, "time [s]", "measured less\nsimulated [mA]")
    handles, names = below.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False, fontsize=STYLE.small_pt, **_TIGHT)
    return uri(figure)


def heat_figures(before: ResistanceCourse | None, after: ResistanceCourse) -> Panels:
    """What each dwell asks for as R_s over the heat put into the winding, and the model's R_s."""
    return Panels(*(_heat(one) for one in (before, after) if one is not None))


def _heat(course: ResistanceCourse) -> str:
    figure, axes = new_figure()
    heat, order = 1e-3 * course.heat_j, np.argsort(course.heat_j)
    axes.plot(heat, course.measured_ohm, "o", color=BLACK, ms=4, label="holds and injection points")
    axes.plot(heat[order], course.model_ohm[order], "-", color=MODEL, lw=1.5, label="model")
    name_axes(axes, "heat put into the winding [kJ]", r"$R_s$ [$\Omega$]")
    legend_above(axes, 2)
    return uri(figure)


def _not_added(entry: JointEntry) -> str:
    bound = joint_bound(entry)
    return f"not added;\n  {bound}" if bound else "not added"


def joint_figure(joint: Sequence[JointEntry], added: Collection[str]) -> str:
    """The whole library fitted at once, over the standard deviation; filled are the effects that the model has.

    Parameters
    ----------
    joint : sequence of JointEntry
    added : collection of str
        Effects that the model has.
    """
    figure, axes = new_figure(STYLE.width_in, max(1.8, 0.9 + 0.32 * len(joint)))
    sizes = [max(abs(entry.z or 0.0), 1.0) for entry in joint]
    for place, (entry, size) in enumerate(zip(joint, sizes, strict=True)):
        is_added = entry.name in added
        axes.barh(
            place,
            size - 1.0,
            left=1.0,
            height=0.62,
            color=MODEL if is_added else "none",
            edgecolor=MODEL if is_added else GUIDE,
        )
        mark = "added" if is_added else _not_added(entry) if size >= SURE_Z else ""
        axes.text(size, place, f"  {mark}", va="center", fontsize=STYLE.small_pt - 1)
    axes.axvline(SURE_Z, color=GUIDE, lw=1.2, ls="--")
    axes.set_xscale("log")
    axes.set_xlim(1.0, max(10.0, *sizes) ** 1.25)
    axes.locator_params(axis="x", numticks=5)
    axes.xaxis.set_major_formatter(lambda value, _: number(value))
    axes.xaxis.set_minor_formatter("")
    axes.set_yticks(range(len(joint)), [label(plain(entry.name)) for entry in joint])
    axes.set_ylim(len(joint) - 0.4, -0.6)
    name_axes(axes, "size over its standard deviation", "")
    axes.grid(axis="y", visible=False)
    return uri(figure)

"""Changes from the first run to each of the others, and whether they exceed the noise of both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.results import USABILITY_WORDS
from orchestrator.interface.comparison._run_summary import RunSummary, spread_of
from orchestrator.numerics.types import Array
from protocols import InputError, Interval, Number, Remark, Strict, Usability

COPPER_PER_K = 0.00393
"""Relative rise of copper's resistance, at 20 C (IEC 60028)."""
POINTS_PER_CURVE = 61
MIN_MAP_CHANGE_SIGMAS = 2.0
"""Multiple of its own error that a map's change has to exceed: errors of neighbouring points are correlated."""


class RunEntry(Strict):
    """A run of the comparison, and its verdict."""

    name: str
    path: str
    created: str
    motor: str
    method: str | None
    usable: bool
    usability: Usability
    verdict: str | None
    """None: not diagnosed."""


class Quantity(Strict):
    """One number in each of the runs."""

    name: str
    unit: str
    values: tuple[Interval | None, ...]
    """Values with 95 % intervals; null where a run has none."""
    changed: tuple[bool | None, ...]
    """Whether it differs from the first run beyond both intervals; null where undecided. The first is null."""


class MapChange(Strict):
    """The change of one run's map against the first one's, where both were measured; flux relative to zero current."""

    run: int
    rms_percent: Number
    """In % of the rated flux, like all percentages here."""
    largest_percent: Number
    largest_at: tuple[float, float] | None
    """(i_d, i_q) [A]."""
    noise_percent: Number
    """Change that the errors of both maps would cause; null where either has none."""
    changed: bool | None
    slide_a: Number
    """Shift of the first map along i_d, as a warming magnet causes it, fitted together with a common gain."""
    gain_percent: Number
    """Common gain of the map, as a sensor's gain causes it."""
    left_percent: Number
    """rms of the change that shift and gain do not explain."""


class FluxCurve(Strict):
    """Flux linkage of a run along one axis, with no current along the other and relative to zero current."""

    run: int
    axis: Literal["d", "q"]
    current_a: tuple[float, ...]
    flux_wb: tuple[float, ...]
    """Along the same axis as the current."""


class RunsComparison(Strict):
    """A comparison of runs; the JSON contract of `fluxbench compare RUN RUN... --json`."""

    runs: tuple[RunEntry, ...]
    quantities: tuple[Quantity, ...]
    effects: tuple[Quantity, ...]
    """Sizes of the diagnoses' effects, named effect: parameter; null where a run has none. Effects that a run cannot
    distinguish are one."""
    maps: tuple[MapChange, ...]
    curves: tuple[FluxCurve, ...]
    """For drawing the maps over each other; those of runs without a map are missing."""
    remarks: tuple[Remark, ...]
    """Changes beyond noise, or their absence; and reasons that leave a change undecided."""


@dataclass(frozen=True)
class ComparedRuns:
    """The comparison and its runs, for drawing."""

    comparison: RunsComparison
    runs: tuple[RunSummary, ...]

    def flux_change(self, run: int) -> Array:
        """Flux of a run minus that of the first on the first one's grid [Wb], shape (d, q, 2); NaN where unknown."""
        first = self.runs[0]
        assert first.surface is not None  # callers check that there are maps
        out = np.full((*first.surface.known.shape, 2), np.nan)
        places, difference = _differences(first, self.runs[run])
        out[tuple(places.T)] = difference
        return out


def compare_runs(paths: Sequence[Path]) -> ComparedRuns:
    """Compare runs with the first of them.

    Raises
    ------
    InputError
        For fewer than two runs.
    RecordingError
        Where a path is no recording, or was not estimated.
    """
    if len(paths) < 2:
        raise InputError("compare", "RUN", "expected two runs or more")
    runs = tuple(RunSummary.of(path) for path in paths)
    quantities = (_quantity("R_s", "ohm", [run.resistance() for run in runs]), *_of_maps(runs))
    effects = tuple(_of_effects(runs))
    maps = tuple(_map_change(runs[0], run, k) for k, run in enumerate(runs) if k)
    names = _names([run.path.resolve() for run in runs])
    comparison = RunsComparison(
        runs=tuple(_run_of(run, name) for run, name in zip(runs, names, strict=True)),
        quantities=quantities,
        effects=effects,
        maps=maps,
        curves=tuple(_curves(runs)),
        remarks=tuple(_remarks(runs, names, quantities, effects, maps)),
    )
    return ComparedRuns(comparison, runs)


def _names(paths: Sequence[Path]) -> list[str]:
    """Names of the runs: their folders', with parent folders where names would be equal."""
    depth = 1
    while len({path.parts[-depth:] for path in paths}) < len({*paths}):
        depth += 1
    return ["/".join(path.parts[-depth:]) for path in paths]


def _run_of(run: RunSummary, name: str) -> RunEntry:
    return RunEntry(
        name=name,
        path=str(run.path),
        created=run.manifest.created,
        motor=run.manifest.motor.name,
        method=run.estimates.method,
        usable=run.estimates.usable,
        usability=run.estimates.usability,
        verdict=None if run.diagnosis is None else run.diagnosis.report.verdict,
    )


def _quantity(name: str, unit: str, values: Sequence[Interval | None]) -> Quantity:
    first = values[0]
    changed = tuple(None if not k or v is None or first is None else _beyond(first, v) for k, v in enumerate(values))
    return Quantity(name=name, unit=unit, values=tuple(values), changed=changed)


def _beyond(first: Interval, other: Interval) -> bool | None:
    """Whether two values differ by more than the facing halves of their intervals, root of the sum of squares."""
    low, high = sorted((first, other), key=lambda interval: interval.value)
    tolerance = float(np.hypot(low.high - low.value, high.value - high.low))
    return None if tolerance == 0.0 else high.value - low.value > tolerance


def _of_maps(runs: Sequence[RunSummary]) -> list[Quantity]:
    """Inductances at rest and at the rated torque current, and the flux at the latter."""
    reach = [float(run.flux_map.i_q[-1]) for run in runs if run.flux_map is not None]
    if not reach:
        return []
    rated = runs[0].manifest.motor.rated_current_a
    current = min([*reach, *([rated] if rated else [])])
    out = []
    for i_q, where in ((0.0, "at rest"), (current, f"at i_q = {current:.3g} A")):
        at_point = [dict(run.map_values(np.array([0.0, i_q]))) for run in runs]
        for name in at_point[0]:
            # At rest the flux is zero by definition, and the cross inductance by symmetry.
            if i_q or name in ("l_dd", "l_qq"):
                unit = "Wb" if name.startswith("psi") else "H"
                symbol = name.replace("l_", "L_")
                out.append(_quantity(f"{symbol} {where}", unit, [values[name] for values in at_point]))
    return out


def _of_effects(runs: Sequence[RunSummary]) -> list[Quantity]:
    twins = [run.twins_of(runs[0]) for run in runs]
    sizes = [run.effects(named) for run, named in zip(runs, twins, strict=True)]
    names = dict.fromkeys(key for effects in sizes for key in effects)
    out = []
    for effect, parameter in names:
        others = dict.fromkeys(plain(other) for named in twins for other, name in named.items() if name == effect)
        label = " or ".join([plain(effect), *others])
        values = [effects.get((effect, parameter)) for effects in sizes]
        unit = next((v.unit for v in values if v is not None), "1")
        row = _quantity(f"{label}: {parameter_words(parameter)}", unit, values)
        # An effect that one diagnosis has and another has not counts as changed.
        here = [
            run.diagnosis is not None and any(e == effect for e, _ in f) for run, f in zip(runs, sizes, strict=True)
        ]
        changes = tuple(
            True if k and run.diagnosis and runs[0].diagnosis and here[k] != here[0] else changed
            for k, (run, changed) in enumerate(zip(runs, row.changed, strict=True))
        )
        out.append(row.model_copy(update={"changed": changes}))
    return out


def _map_change(first: RunSummary, other: RunSummary, k: int) -> MapChange:
    if first.surface is None or other.surface is None or first.flux_map is None or other.flux_map is None:
        return _no_map(k)
    places, change = _differences(first, other)
    if len(places) < 3:
        return _no_map(k)
    at = np.column_stack((first.surface.i_d[places[:, 0]], first.surface.i_q[places[:, 1]]))
    rated = first.manifest.motor.rated_current_a or float(np.abs(at).max())
    rated_wb = _rated_flux(first, min(rated, float(first.surface.i_q[-1])))
    lengths = np.linalg.norm(change, axis=1)
    noise = np.hypot(spread_of(first.flux_map, at), spread_of(other.flux_map, at))
    known = np.isfinite(noise).any()
    noise_wb = float(np.sqrt(np.nanmean(noise**2))) if known else None
    rms = float(np.sqrt(np.mean(lengths**2)))
    slide, gain, rest = _slide_and_gain(first, at, change)
    worst = int(np.argmax(lengths))
    return MapChange(
        run=k,
        rms_percent=100.0 * rms / rated_wb,
        largest_percent=100.0 * float(lengths[worst]) / rated_wb,
        largest_at=(float(at[worst, 0]), float(at[worst, 1])),
        noise_percent=None if noise_wb is None else 100.0 * noise_wb / rated_wb,
        changed=None if noise_wb is None else rms > MIN_MAP_CHANGE_SIGMAS * noise_wb,
        slide_a=slide,
        gain_percent=100.0 * gain,
        left_percent=100.0 * rest / rated_wb,
    )


def _curves(runs: Sequence[RunSummary]) -> Iterator[FluxCurve]:
    for number, run in enumerate(runs):
        if run.surface is None:
            continue
        for k, (axis, reach) in enumerate((("d", run.surface.i_d), ("q", run.surface.i_q))):
            at = np.zeros((POINTS_PER_CURVE, 2))
            at[:, k] = np.linspace(reach[0], reach[-1], POINTS_PER_CURVE)
            at = at[run.surface.inside(at)]
            flux = run.surface.psi(at)[:, k] - run.surface.psi(np.zeros((1, 2)))[0, k]
            yield FluxCurve(run=number, axis=axis, current_a=tuple(at[:, k]), flux_wb=tuple(flux))


def _no_map(k: int) -> MapChange:
    names = (name for name in MapChange.model_fields if name != "run")
    return MapChange(run=k, **dict.fromkeys(names))


def _differences(first: RunSummary, other: RunSummary) -> tuple[NDArray[np.int_], Array]:
    """Nodes of the first map (k, 2) that the other has measured too, and the flux's difference there (k, 2)."""
    assert first.surface is not None
    assert other.surface is not None
    at, zero = first.surface.currents, np.zeros((1, 2))
    shared = other.surface.inside(at)
    change = other.surface.psi(at) - other.surface.psi(zero) - first.surface.fluxes + first.surface.psi(zero)
    return np.argwhere(first.surface.known)[shared], change[shared]


def _rated_flux(first: RunSummary, rated_a: float) -> float:
    assert first.surface is not None
    flux = first.surface.psi(np.array([[0.0, rated_a], [0.0, 0.0]]))
    return max(float(np.linalg.norm(flux[0] - flux[1])), 1e-12)


def _slide_and_gain(first: RunSummary, at: Array, change: Array) -> tuple[float, float, float]:
    """Least squares of psi(i + s e_d) - psi(s e_d) and (1 + g) psi; s [A], g, and the rms residual [Wb]."""
    surface = first.surface
    assert surface is not None
    zero = np.zeros((1, 2))
    slide = surface.jacobian(at)[:, :, 0] - surface.jacobian(zero)[:, :, 0]
    gain = surface.psi(at) - surface.psi(zero)
    design = np.column_stack((slide.ravel(), gain.ravel()))
    solution = np.linalg.lstsq(design, change.ravel(), rcond=None)[0]
    residual = (change.ravel() - design @ solution).reshape(-1, 2)
    return float(solution[0]), float(solution[1]), float(np.sqrt(np.mean((residual**2).sum(axis=1))))


def _remarks(
    runs: Sequence[RunSummary],
    names: Sequence[str],
    quantities: Sequence[Quantity],
    effects: Sequence[Quantity],
    maps: Sequence[MapChange],
) -> list[Remark]:
    remarks = []
    motors = {(m.name, m.pole_pairs, m.rated_current_rms_a) for m in (run.manifest.motor for run in runs)}
    one_motor = len(motors) == 1
    if not one_motor:
        which = "; ".join(f"{name}: {run.manifest.motor.name}" for run, name in zip(runs, names, strict=True))
        text = "different motors ({motors}): differences are between motors, and no changes of one"
        remarks.append(Remark.of("other_motors", text, motors=which))
    for k, (run, name) in enumerate(zip(runs, names, strict=True)):
        if not run.estimates.usable:
            words = USABILITY_WORDS[run.estimates.usability]
            remarks.append(Remark.of("unusable", "the map of {run} is {words}", run=name, words=words))
        if not k:
            continue
        changes = [q.name for q in (*quantities, *effects) if q.changed[k]]
        map_ = maps[k - 1]
        if map_.changed is None:
            remarks.append(Remark.of("map_unsure", "it is undecided whether the map of {run} changed", run=name))
        remarks.append(_change(name, changes, map_, one_motor=one_motor))
        if quantities[0].changed[k] and one_motor:
            remarks.append(_warming(name, quantities[0].values[0], quantities[0].values[k]))
    return remarks


def _change(name: str, changes: Sequence[str], map_: MapChange, *, one_motor: bool) -> Remark:
    items = list(changes)
    if map_.changed:
        text = (
            "the map by {:.2g} % of the rated flux (noise {:.2g} %; a shift along i_d of {:+.3g} A and a gain of "
            "{:+.2g} % leave {:.2g} %)"
        )
        figures = (map_.rms_percent, map_.noise_percent, map_.slide_a, map_.gain_percent, map_.left_percent)
        items.insert(0, text.format(*figures))
    verb = "changed" if one_motor else "differs"
    if not items:
        return Remark.of("nothing_changed", f"{{run}}: nothing {verb} beyond noise", run=name)
    return Remark.of("changed", f"{{run}}: {verb} beyond noise: {{what}}", run=name, what="; ".join(items))


def _warming(name: str, first: Interval | None, other: Interval | None) -> Remark:
    assert first is not None
    assert other is not None
    percent = 100.0 * (other.value / first.value - 1.0)
    text = "{run}: R_s {percent:+.2g} %: a change of {kelvin:+.2g} K of a copper winding would explain it"
    return Remark.of("r_s_changed", text, run=name, percent=percent, kelvin=0.01 * percent / COPPER_PER_K)

"""fluxbench's own answer about a recording of the benchmark, by its public diagnosis."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from orchestrator.benchmark.definition import LOG, MAPPING, effect_sizes
from orchestrator.numerics.types import Array
from protocols import DiagnosisReport, Effect, FluxbenchError, FluxMap
from protocols.benchmark import BenchmarkAnswer, BenchmarkResistance, BenchmarkVerdict, NamedEffect

if TYPE_CHECKING:
    from orchestrator.diagnosis.reporting.delivery import Delivery
    from orchestrator.recording import Recording

EXPLAINED = ("explained", "explained_in_another_form", "mostly_explained")


def answer(folder: Path, entry: dict[str, Any], library: Sequence[Effect]) -> BenchmarkAnswer:
    """Diagnose one recording.

    Parameters
    ----------
    folder : Path
        A recording, or a log with its mapping.
    entry : dict
        Its entry of the set's manifest.
    """
    from orchestrator.diagnosis import diagnose_recording

    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="benchmark-") as place:
        try:
            recording = _opened(folder, Path(place))
            found = diagnose_recording(
                recording, library, model="saturated", without=entry["without"], out=Path(place) / "out"
            )
        except FluxbenchError:
            # What is refused is not explained.
            return BenchmarkAnswer(id=entry["id"], verdict="unknown", seconds=time.perf_counter() - start)
    return stated(found.report, found.delivery, entry, time.perf_counter() - start)


def stated(
    report: DiagnosisReport, delivery: Delivery | None, entry: dict[str, Any], seconds: float
) -> BenchmarkAnswer:
    """A diagnosis in the form of an answer."""
    plain = {"id": entry["id"], "verdict": _verdict(report), "names": _names(report), "seconds": round(seconds, 2)}
    if delivery is None:
        return BenchmarkAnswer.model_validate(plain)
    resistance = delivery.resistance
    flux, std = flux_at(delivery.map, entry["points_a"])
    return BenchmarkAnswer.model_validate(
        {
            **plain,
            "resistance_ohm": BenchmarkResistance(value=resistance.value_ohm, low=resistance.low, high=resistance.high),
            "flux_wb": flux,
            "flux_std_wb": std,
            "usable": not delivery.objections,
        }
    )


def flux_at(
    found: FluxMap, points_a: Sequence[Sequence[float]]
) -> tuple[list[tuple[float, float] | None], list[tuple[float, float] | None]]:
    """psi(i) - psi(0) and its standard deviation [Wb] at currents [A]; None where the map has no flux."""
    from scipy.interpolate import RegularGridInterpolator

    axes = np.asarray(found.i_d, dtype=float), np.asarray(found.i_q, dtype=float)
    at = np.array([[0.0, 0.0], *points_a])

    def values(grid: Array, method: Literal["linear", "cubic"]) -> Array:
        return np.asarray(RegularGridInterpolator(axes, grid, method=method, bounds_error=False)(at), dtype=float)

    smooth: Literal["linear", "cubic"] = "cubic" if min(found.psi_d.shape) > 3 else "linear"
    inside = values(np.asarray(found.psi_d, dtype=float), "linear")
    flux = np.stack([values(grid, smooth) for grid in _without_holes(found)], axis=1)
    flux[~np.isfinite(inside)] = np.nan
    grids = (np.asarray(grid, dtype=float) for grid in (found.psi_d_std, found.psi_q_std))
    std = np.stack([values(grid, "linear") for grid in grids], axis=1)
    moved = (flux - flux[0])[1:]
    return [_point(row) for row in moved], [_point(row) for row in std[1:]]


def _without_holes(found: FluxMap) -> tuple[Array, Array]:
    """psi_d and psi_q [Wb]; nodes without a flux continue that of the nearest one by its inductances."""
    psi_d, psi_q = (np.array(grid, dtype=float) for grid in (found.psi_d, found.psi_q))
    known = np.isfinite(psi_d)
    i_d, i_q = np.meshgrid(found.i_d, found.i_q, indexing="ij")
    for k, m in np.argwhere(~known):
        near = np.argmin((i_d[known] - i_d[k, m]) ** 2 + (i_q[known] - i_q[k, m]) ** 2)
        at = tuple(np.argwhere(known)[near])
        d, q = i_d[k, m] - i_d[at], i_q[k, m] - i_q[at]
        psi_d[k, m] = found.psi_d[at] + found.l_dd[at] * d + found.l_dq[at] * q
        psi_q[k, m] = found.psi_q[at] + found.l_dq[at] * d + found.l_qq[at] * q
    return psi_d, psi_q


def _point(row: Any) -> tuple[float, float] | None:
    return (float(f"{row[0]:.6g}"), float(f"{row[1]:.6g}")) if np.isfinite(row).all() else None


def _opened(folder: Path, place: Path) -> Recording:
    from orchestrator.importing import import_files
    from orchestrator.recording import open_recording

    if not (folder / LOG).exists():
        return open_recording(folder)
    import_files(folder / MAPPING, [folder / LOG], place / "imported")
    return open_recording(place / "imported")


def _verdict(report: DiagnosisReport) -> BenchmarkVerdict:
    if report.verdict in EXPLAINED:
        # A cause that is none of the set's names is something else.
        return "explained" if all(effect.name in effect_sizes() for effect in report.effects) else "unknown"
    return "clean" if report.verdict == "clean" else "unknown"


def _names(report: DiagnosisReport) -> list[NamedEffect]:
    named = []
    for effect in report.effects:
        if effect.name not in effect_sizes():
            continue  # newer than the set, or one of the user's own
        size = effect_sizes()[effect.name]
        value = effect.parameters.get(size.parameter)
        if value is None or value.value is None:
            named.append(NamedEffect(name=effect.name))
            continue
        known = value.low is not None and value.high is not None
        named.append(
            NamedEffect(
                name=effect.name, size=value.value, unit=size.unit, low=value.low if known else None,
                high=value.high if known else None,
            )
        )  # fmt: skip
    return named

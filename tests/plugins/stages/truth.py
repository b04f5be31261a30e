"""A run on the simulated drive, held against the plant behind it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orchestrator.estimation.flux_map_file import load_flux_map
from orchestrator.estimation.results import load_estimates
from orchestrator.runs import RunDirectory
from plugins.drives.simulated.options import SimulatedOptions
from plugins.drives.simulated.truth import TrueMagnetics, true_flux
from protocols import EstimationReport, FluxMap


def estimated(run: Path) -> EstimationReport:
    return load_estimates(run)


def flux_errors(run: Path, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a map's fluxes at its nodes, and the standard deviations that it states, shape (n, 2) each [Wb]."""
    found, truth = _found(run, method), _truth(run)
    at = np.stack(np.meshgrid(found.i_d, found.i_q, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float64)
    psi = np.stack([found.psi_d, found.psi_q], axis=-1).reshape(-1, 2)
    std = np.stack([found.psi_d_std, found.psi_q_std], axis=-1).reshape(-1, 2)
    there = np.isfinite(psi).all(axis=1)
    return psi[there] - truth.flux(at[there]), std[there]


def errors_percent(run: Path, method: str) -> float:
    """rms error of a map's flux, of the rated flux."""
    off, _ = flux_errors(run, method)
    truth, rated_a = _truth(run), RunDirectory.open(run).procedure().motor.rated_current_a
    assert rated_a is not None
    rated = truth.flux(np.array([[0.0, rated_a]])) - truth.flux(np.zeros((1, 2)))
    return 100.0 * float(np.sqrt((off**2).sum(axis=1).mean()) / np.linalg.norm(rated))


def _found(run: Path, method: str) -> FluxMap:
    recommended = load_estimates(run).method == method
    return load_flux_map(run / "results" / ("flux_map.nc" if recommended else f"flux_map_{method}.nc"))


def _truth(run: Path) -> TrueMagnetics:
    procedure = RunDirectory.open(run).procedure()
    return true_flux(SimulatedOptions(**procedure.drive.options), procedure.motor)

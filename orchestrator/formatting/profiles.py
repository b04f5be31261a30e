"""A flux map along a line of the current plane, and its flux at zero current, the origin of pictures."""

from __future__ import annotations

import numpy as np

from protocols import FluxMap, RealArray


def profile(flux_map: FluxMap, name: str, along: str, held: float) -> tuple[RealArray, RealArray, RealArray]:
    """Current, value and standard deviation along one axis, the other axis held (linear between grid lines)."""
    other = "q" if along == "d" else "d"
    grid = np.asarray(getattr(flux_map, f"i_{other}"))
    values, stds = (np.asarray(getattr(flux_map, key)) for key in (name, f"{name}_std"))
    if other == "d":
        values, stds = values.T, stds.T
    current = np.asarray(getattr(flux_map, f"i_{along}"))
    on_line = np.flatnonzero(np.isclose(grid, held, rtol=0.0, atol=1e-9))
    if len(on_line):
        return current, np.asarray(values[:, on_line[0]]), np.asarray(stds[:, on_line[0]])
    if not grid[0] < held < grid[-1]:
        return current, np.full(current.shape, np.nan), np.full(current.shape, np.nan)
    upper = int(np.searchsorted(grid, held))
    weight = (held - grid[upper - 1]) / (grid[upper] - grid[upper - 1])
    between = [(1.0 - weight) * x[:, upper - 1] + weight * x[:, upper] for x in (values, stds)]
    return current, np.asarray(between[0]), np.asarray(between[1])


def flux_at_zero(flux_map: FluxMap) -> dict[str, float]:
    """psi(0, 0) of each axis in the map; 0 where the map does not reach it."""
    zero = {"d": 0.0, "q": 0.0}
    for axis in zero:
        current, flux, _ = profile(flux_map, f"psi_{axis}", axis, 0.0)
        known = np.isfinite(flux)
        if known.any() and current[known][0] <= 0.0 <= current[known][-1]:
            zero[axis] = float(np.interp(0.0, current[known], flux[known]))
    return zero

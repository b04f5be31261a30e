"""The physically possible flux map nearest to a faulty one: the gradient of a convex energy, even about the magnet.

psi = grad W(i), W a tensor product of quintic splines on the current plane, even in i_q, as near to the points as least
squares come. Where W is not convex, its curvature along the worst direction there is bounded below, and the fit made
again, until no bound is missed: a quadratic programme whose constraints are found as they are needed (cutting planes,
J. E. Kelley, 1960, doi:10.1137/0108053), solved as a least-distance problem (Lawson and Hanson, "Solving Least Squares
Problems", 1974, chapter 23).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from orchestrator.flux_maps._checks import magnet_direction, swing_of, symmetry, symmetry_axis
from orchestrator.flux_maps._surface import WHERE, MapSurface
from orchestrator.numerics.surface import inside_hull
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import Basis, FluxMap, InputError, Strict


class RepairCriteria(Strict):
    """Limits of a repair."""

    least_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.05
    """Least incremental inductance over the median one; smaller ones are raised to it."""
    most_cells: Annotated[int, Field(ge=4, le=80)] = 32
    """Cells of the spline along d, and on each side along q: a finer table is smoothed."""
    rounds: Annotated[int, Field(ge=1)] = 60


@dataclass(frozen=True)
class Repair:
    """The repaired map, and its distance from the given one at their common points."""

    flux_map: FluxMap
    turned_rad: float
    """Angle by which currents and fluxes were turned to put the magnet on d."""
    rms_wb: float
    largest_wb: float


def repair_map(flux_map: FluxMap, criteria: RepairCriteria | None = None) -> Repair:
    """The nearest convex, symmetric map on the given one's axes; NaN outside the hull of its points.

    Raises
    ------
    InputError
        Where the map cannot be interpolated, or no convex energy was found.
    """
    criteria = criteria or RepairCriteria()
    surface = MapSurface(flux_map)
    turned = _turn(surface)
    i_dq, psi_dq = _turned(surface.currents, -turned), _turned(surface.fluxes, -turned)
    basis = _basis(i_dq, flux_map, criteria)
    coefficients = _fitted(basis, i_dq, psi_dq, criteria)
    axes = _axes(flux_map, turned)
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    mirrored = np.vstack((i_dq, i_dq * [1.0, -1.0])) if (i_dq[:, 1] < 0).any() and (i_dq[:, 1] > 0).any() else i_dq
    known = inside_hull(mirrored, places, WHERE)
    shape = (len(axes[0]), len(axes[1]))

    def table(along_d: int, along_q: int) -> Array:
        values = np.where(known, basis.rows(places, along_d, along_q) @ coefficients, np.nan)
        return np.asarray(values.reshape(shape), dtype=np.float64)

    tables = {"psi_d": table(1, 0), "psi_q": table(0, 1)}
    tables |= {"l_dd": table(2, 0), "l_dq": table(1, 1), "l_qq": table(0, 2)}
    tables |= {f"{name}_std": np.full(shape, np.nan) for name in list(tables)}
    gradient = np.column_stack([basis.rows(i_dq, *order) @ coefficients for order in ((1, 0), (0, 1))])
    apart = np.linalg.norm(gradient - psi_dq, axis=1)
    repaired = FluxMap(method=f"{flux_map.method} repaired", basis=Basis.ENERGY, i_d=axes[0], i_q=axes[1], **tables)
    return Repair(repaired, -turned, float(np.sqrt(np.mean(apart**2))), float(apart.max()))


def _turn(surface: MapSurface) -> float:
    """Angle of the axis of symmetry nearest to the magnet, or to d where no magnet is known."""
    _, _, near = magnet_direction(surface, swing_of(surface))
    best, plain = symmetry_axis(surface, near), symmetry(surface, near)
    return near if best is None or plain is None or best.rms_wb > 0.5 * plain.rms_wb else best.axis_rad


def _turned(vectors: Array, angle_rad: float) -> Array:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(vectors @ np.array([[c, s], [-s, c]]), dtype=np.float64)


def _axes(flux_map: FluxMap, turned_rad: float) -> tuple[Array, Array]:
    """The map's own axes, exchanged and reversed where it is turned by quarters."""
    d, q = np.asarray(flux_map.i_d, dtype=np.float64), np.asarray(flux_map.i_q, dtype=np.float64)
    for _ in range(round(turned_rad / (0.5 * math.pi)) % 4):
        d, q = q, -d[::-1]  # by -90 degrees: what lay on q lies on d, and what lay on d on -q
    return d, q


def _basis(i_dq: Array, flux_map: FluxMap, criteria: RepairCriteria) -> EvenSpline:
    low, high = float(i_dq[:, 0].min()), float(i_dq[:, 0].max())
    reach, most = float(np.abs(i_dq[:, 1]).max()), criteria.most_cells
    step = min(float(np.diff(axis).min()) for axis in (flux_map.i_d, flux_map.i_q))
    d, q = (max(math.ceil(span / step), 4) for span in (high - low, 2.0 * reach))
    return EvenSpline(low, high, reach, (min(d, most), min(q, 2 * most)))


def _fitted(basis: EvenSpline, i_dq: Array, psi_dq: Array, criteria: RepairCriteria) -> Array:
    """Least squares under the bounds on curvature that turn out to be needed."""
    from scipy.linalg import cho_solve

    rows = np.vstack([basis.rows(i_dq, 1, 0), basis.rows(i_dq, 0, 1)])
    right = psi_dq.T.ravel()
    normal = rows.T @ rows
    # Roughness decides where the points do not, with a millionth of their weight.
    smooth = basis.roughness
    normal += 1e-6 * np.trace(normal) / np.trace(smooth) * smooth
    normal += 1e-12 * np.trace(normal) / len(normal) * np.eye(len(normal))
    factor = np.asarray(np.linalg.cholesky(normal), dtype=np.float64)
    free = np.asarray(cho_solve((factor, True), rows.T @ right), dtype=np.float64)
    places = _convexity_points(i_dq)
    curvatures = [basis.rows(places, *order) for order in ((2, 0), (1, 1), (0, 2))]
    bound = criteria.least_share * float(np.median(_least(curvatures, free)[0]))
    if not bound > 0.0:
        raise InputError(WHERE, "psi_d, psi_q", "no convex energy is near: fluxes fall where currents rise")
    coefficients, cuts = free, np.empty((0, basis.size))
    for _ in range(criteria.rounds):
        least, direction = _least(curvatures, coefficients)
        missed = np.flatnonzero(least < bound * (1.0 - 1e-6))
        if not missed.size:
            return coefficients
        c, s = direction[missed].T
        dd, dq, qq = (curvature[missed] for curvature in curvatures)
        cuts = np.vstack((cuts, (c * c)[:, None] * dd + (2.0 * c * s)[:, None] * dq + (s * s)[:, None] * qq))
        coefficients = _constrained(factor, free, cuts, 1.01 * bound)
    raise InputError(WHERE, "psi_d, psi_q", f"no convex energy was found in {criteria.rounds} rounds")


def _convexity_points(i_dq: Array) -> Array:
    """Places where the energy has to be convex: the points, and midways between neighbours."""
    from scipy.spatial import Delaunay

    corners = i_dq[Delaunay(i_dq).simplices]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 2)
    return np.unique(np.vstack((i_dq, middles)), axis=0)


def _least(curvatures: list[Array], coefficients: Array) -> tuple[Array, Array]:
    """Smallest curvature at each place, and its direction as (cos, sin)."""
    dd, dq, qq = (curvature @ coefficients for curvature in curvatures)
    half = 0.5 * (dd - qq)
    angle = 0.5 * np.arctan2(-dq, -half)
    return 0.5 * (dd + qq) - np.hypot(half, dq), np.column_stack((np.cos(angle), np.sin(angle)))


def _constrained(factor: Array, free: Array, cuts: Array, bound: float) -> Array:
    """Nearest to the free solution, in the fit's own measure, with cuts @ x >= bound: a least-distance problem."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    scaled = solve_triangular(factor, cuts.T, lower=True)
    lacking = bound - cuts @ free
    sizes = np.linalg.norm(scaled, axis=0)
    scaled, lacking = scaled / sizes, lacking / sizes
    scale = float(np.abs(lacking).max())
    system = np.vstack((scaled, lacking / scale))
    target = np.zeros(len(system))
    target[-1] = 1.0
    weights, _ = nnls(system, target, maxiter=50 * system.shape[1])
    left = system @ weights - target
    step = scale * left[:-1] / -left[-1]
    return np.asarray(free + solve_triangular(factor, step, lower=True, trans="T"), dtype=np.float64)

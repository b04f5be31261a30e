"""Flux maps of real machines as energies: a table psi(i) becomes a spline H(psi) with grad H = i.

`orchestrator.flux_maps.load_map` reads the files; a user's map is rotated onto its magnet, if it includes zero current.
The spline is fitted to the currents, so that the model is free of curl and even in psi_q despite
measurement errors. A penalty on third differences smooths noise and extrapolates H quadratically (constant
inductances) where the table has no points.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from plugins.drives.simulated._energy import Array, Energy, Magnetics, current, hessian
from plugins.drives.simulated._inverse import flux_at
from protocols import InputError, Motor

OPTION_KEY = "drive.plant.magnetics"
SPLINE_CELLS = (24, 36)
SMOOTHING_FACTORS = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Factors on the weight of the third differences, tried in order until the energy is convex."""


@dataclass(frozen=True)
class FluxTable:
    """Points of a flux map, SI and peak values."""

    source: str
    i_dq: Array
    """Shape (n, 2) [A]."""
    psi_dq: Array
    """Shape (n, 2) [Wb]."""
    motor: Motor | None = None
    """The nameplate of a map of the package."""
    smoothing: float = 0.03
    """Smallest weight of the third differences."""
    turned_rad: float = 0.0
    """Angle by which the file's frame was rotated onto the magnet."""

    @property
    def reach_a(self) -> float:
        """Largest current that the table covers on both axes [A]."""
        return float(np.abs(self.i_dq).max(axis=0).min())

    @property
    def holds_zero(self) -> bool:
        """Whether zero current lies within the table's range on both axes."""
        return bool(((self.i_dq.min(axis=0) <= 0.0) & (self.i_dq.max(axis=0) >= 0.0)).all())


def map_names() -> tuple[str, ...]:
    """Names of the maps that come with the package."""
    folder = files("plugins.drives.simulated") / "maps"
    return tuple(sorted(f.name.removesuffix(".json") for f in folder.iterdir() if f.name.endswith(".json")))


def map_motor(name: str) -> Motor:
    """Nameplate of the machine behind a shipped map; raises `InputError` for an unknown name."""
    return Motor.model_validate(_about(name)["motor"])


def _about(name: str) -> dict[str, Any]:
    if name not in map_names():
        raise InputError(OPTION_KEY, "name", f"no map {name!r}; there are {', '.join(map_names())}")
    text = (files("plugins.drives.simulated") / "maps" / f"{name}.json").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def load_table(name: str | None, file: Path | None) -> FluxTable:
    """Table of a map of the package, by name, or of a user's file.

    Raises
    ------
    InputError
        Where there is no such map, or the file holds none.
    """
    if name is None:
        path = Path() if file is None else file
        return _rotate_to_magnet(_points(str(path), path))
    about = _about(name)
    with as_file(files("plugins.drives.simulated") / "maps" / f"{name}.csv") as path:
        table = _points(name, path)
    return replace(table, motor=Motor.model_validate(about["motor"]), smoothing=float(about["smoothing"]))


def _points(source: str, path: Path) -> FluxTable:
    """The grid points at which a map has values."""
    from orchestrator.flux_maps import load_map

    flux_map = load_map(path)
    known = np.isfinite(flux_map.psi_d) & np.isfinite(flux_map.psi_q)
    if known.sum() < 16:
        raise InputError(source, "", "expected 16 points or more, each with a current and a flux linkage")
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    i_dq = np.column_stack((i_d[known], i_q[known])).astype(np.float64)
    if not (np.ptp(i_dq, axis=0) > 0).all():
        raise InputError(source, "", "the points lie on one line")
    return FluxTable(source, i_dq, np.column_stack((flux_map.psi_d[known], flux_map.psi_q[known])).astype(np.float64))


def _rotate_to_magnet(table: FluxTable, near: float = 0.1, min_flux_share: float = 0.05) -> FluxTable:
    """The table, rotated so that its magnet lies on d.

    The plant is even about the d axis. The magnet's direction is that of the flux at the point nearest to zero current,
    extrapolated to zero. This needs a current below `near` of the largest and a flux above `min_flux_share` of the
    largest. A table that does not include zero stays as it is: saturation on the way would look like a rotation.
    """
    if not table.holds_zero:
        return table
    length = np.linalg.norm(table.i_dq, axis=1)
    at = int(np.argmin(length))
    flux = np.linalg.norm(table.psi_dq, axis=1)
    if length[at] > near * length.max() or flux[at] < min_flux_share * flux.max():
        return table
    rest_d, rest_q = table.psi_dq[at] - _inductance(table) @ table.i_dq[at]
    angle = math.atan2(rest_q, rest_d)
    if abs(angle) < 1e-6:
        return table
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])  # rows times this: by -angle
    return replace(table, i_dq=table.i_dq @ turn, psi_dq=table.psi_dq @ turn, turned_rad=angle)


def _inductance(table: FluxTable) -> Array:
    """Incremental inductance at the table's point nearest to zero current [H], shape (2, 2)."""
    distance = np.linalg.norm(table.i_dq, axis=1)
    near = np.argsort(distance, kind="stable")[:9]
    design = np.column_stack((np.ones(len(near)), table.i_dq[near]))
    return np.asarray(np.linalg.lstsq(design, table.psi_dq[near], rcond=None)[0][1:].T, dtype=np.float64)


def map_energy(table: FluxTable) -> Magnetics:
    """Spline energy of a flux map.

    It is convex at the table's points and on the d axis, where the table may have none.

    Raises
    ------
    InputError
        Where no convex energy fits the table.
    """
    i_dq, psi_dq = _symmetrised(table)
    box = _box(psi_dq, i_dq)
    on_axis = np.linspace(psi_dq[:, 0].min(), psi_dq[:, 0].max(), SPLINE_CELLS[0])  # without a q component
    flux_points = np.vstack((psi_dq, np.column_stack((on_axis, np.zeros(len(on_axis))))))
    for factor in SMOOTHING_FACTORS:
        spline = _fit(box, i_dq, psi_dq, factor * table.smoothing)
        points = np.array([hessian(box, spline, float(d), float(q)) for d, q in flux_points])
        if ((points[:, 0] > 0) & (points[:, 0] * points[:, 2] > points[:, 1] ** 2)).all():
            break
    else:
        raise InputError(table.source, "", "no convex magnetic energy goes through these points")
    outside_d, outside_q = float(points[:, 0].max()), float(points[:, 2].max())
    energy = box._replace(outside_d=outside_d, outside_q=outside_q)
    nearest = psi_dq[int(np.argmin(np.abs(i_dq).sum(axis=1)))]
    return Magnetics(energy._replace(psi_m=_zero_current_flux(Magnetics(energy, spline), float(nearest[0]))), spline)


def usable_reach(table: FluxTable, magnetics: Magnetics, *, positive_d: bool) -> float:
    """Radius of the circle (or of its half with i_d <= 0) in which the model is physical [A].

    Within the table's range on both axes, and where a one-sided table had to be extrapolated, as far
    as the eigenvalues of H stay within 0.3 and 3 times the extremes at the table's points.
    """
    energy = magnetics.energy

    def stiffness(psi_dq: Array) -> Array:
        clamped = np.clip(psi_dq, (energy.low_d, -energy.high_q), (energy.high_d, energy.high_q))
        h = np.array([hessian(*magnetics, float(d), float(q)) for d, q in clamped])
        mean, half = 0.5 * (h[:, 0] + h[:, 2]), np.hypot(0.5 * (h[:, 0] - h[:, 2]), h[:, 1])
        return np.column_stack((mean - half, mean + half))

    known = stiffness(table.psi_dq)
    low, high = 0.3 * float(known.min()), 3.0 * float(known.max())
    turn = np.linspace(0.0 if positive_d else 0.5 * np.pi, np.pi, 25)
    circle = np.column_stack((np.cos(turn), np.sin(turn)))
    reach = 0.0
    for radius in table.reach_a * np.linspace(0.05, 1.0, 20):
        try:
            eigenvalues = stiffness(flux_at(magnetics, radius * circle))
        except ValueError:
            break
        if eigenvalues.min() < low or eigenvalues.max() > high:
            break
        reach = float(radius)
    return reach


def fit_error(table: FluxTable, magnetics: Magnetics) -> float:
    """Rms of grad H(psi) - i over the table's points [A]."""
    model = np.array([current(*magnetics, float(d), float(q)) for d, q in table.psi_dq])
    return float(np.sqrt(((model - table.i_dq) ** 2).sum(axis=1).mean()))


def describe_misfit(table: FluxTable, magnetics: Magnetics) -> str:
    """One line on the smooth map's deviation from the file's points, and on its rotation."""
    share = 100.0 * fit_error(table, magnetics) / math.sqrt(float((table.i_dq**2).sum(axis=1).mean()))
    points = f"{len(table.i_dq)} points within {share:.2g} % of the current, rms"
    message = f"{table.source}: the motor's smooth map meets its {points}"
    if not table.holds_zero:
        message += "; they do not include zero current, so the magnet is taken to lie on d, as in the file"
    if abs(table.turned_rad) > math.radians(0.05):
        message += f"; turned by {-math.degrees(table.turned_rad):+.1f} degrees, so that the magnet lies on d"
    return message


def _symmetrised(table: FluxTable) -> tuple[Array, Array]:
    """The points and their mirror images in i_q, averaged where both were measured."""
    mirror = np.array([1.0, -1.0])
    distance = np.abs(table.i_dq[:, None, :] - (table.i_dq * mirror)[None, :, :]).sum(axis=2)
    mirrored = np.argmin(distance, axis=1)
    has_mirror = distance[np.arange(len(mirrored)), mirrored] < 1e-6 * table.reach_a
    psi = np.where(has_mirror[:, None], 0.5 * (table.psi_dq + (table.psi_dq * mirror)[mirrored]), table.psi_dq)
    return np.vstack((table.i_dq, table.i_dq * mirror)), np.vstack((psi, psi * mirror))


def _box(psi_dq: Array, i_dq: Array) -> Energy:
    """Spline box that contains all points, extended to the right for a map that ends at i_d = 0."""
    low, high, high_q = float(psi_dq[:, 0].min()), float(psi_dq[:, 0].max()), float(psi_dq[:, 1].max())
    if i_dq[:, 0].max() < 0.25 * -i_dq[:, 0].min():
        high += high - low
    margin_d, margin_q = 0.05 * (high - low), 0.05 * high_q
    low, high, high_q = low - margin_d, high + margin_d, high_q + margin_q
    return Energy(
        is_map=True,
        psi_m=0.0,
        rows=SPLINE_CELLS[0],
        columns=SPLINE_CELLS[1],
        cells_per_wb_d=SPLINE_CELLS[0] / (high - low),
        cells_per_wb_q=SPLINE_CELLS[1] / (2 * high_q),
        low_d=low,
        high_d=high,
        high_q=high_q,
    )


def _fit(box: Energy, i_dq: Array, psi_dq: Array, smoothing: float) -> Array:
    """Spline coefficients by penalised least squares."""
    from scipy.interpolate import BSpline

    shape, m, n = (box.rows + 3, box.columns + 3), box.cells_per_wb_d, box.cells_per_wb_q

    def basis(cells: int, t: Array) -> tuple[Array, Array]:
        knots, eye = np.arange(-3.0, cells + 4.0), np.eye(cells + 3)
        spline = BSpline(knots, eye, 3)
        return np.asarray(spline(t)), np.asarray(spline.derivative()(t))

    b, b1 = basis(SPLINE_CELLS[0], (psi_dq[:, 0] - box.low_d) * m)
    c, c1 = basis(SPLINE_CELLS[1], (psi_dq[:, 1] + box.high_q) * n)
    d_rows = m * np.einsum("pj,pk->pjk", b1, c).reshape(len(psi_dq), -1)
    q_rows = n * np.einsum("pj,pk->pjk", b, c1).reshape(len(psi_dq), -1)
    rows, right = np.vstack((d_rows, q_rows)), np.concatenate((i_dq[:, 0], i_dq[:, 1]))
    third = [np.diff(np.eye(size), 3, axis=0) for size in shape]
    second = [np.diff(np.eye(size), 2, axis=0) for size in shape]
    first = [np.diff(np.eye(size), 1, axis=0) for size in shape]
    smooth = np.vstack(
        [
            m * np.kron(third[0], np.eye(shape[1])),
            n * np.kron(np.eye(shape[0]), third[1]),
            m * np.kron(second[0], first[1]),
            n * np.kron(first[0], second[1]),
        ]
    )
    normal = rows.T @ rows + smoothing**2 * (smooth.T @ smooth)
    normal += 1e-10 * np.trace(normal) / len(normal) * np.eye(len(normal))  # H is known up to a constant
    solution: Any = np.linalg.solve(normal, rows.T @ right)
    coefficients = solution.reshape(shape)
    return np.ascontiguousarray(0.5 * (coefficients + coefficients[:, ::-1]))


def _zero_current_flux(magnetics: Magnetics, start_d: float) -> float:
    """psi_d at zero current by Newton's method [Wb]."""
    psi = start_d
    for _ in range(50):
        inside = min(max(psi, magnetics.energy.low_d), magnetics.energy.high_d)
        psi -= current(*magnetics, psi, 0.0)[0] / hessian(*magnetics, inside, 0.0)[0]
    return float(psi)

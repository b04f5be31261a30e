"""Flux maps of real machines as energies: a table psi(i) becomes a spline H(psi) with grad H = i.

Files are read as everywhere else (`orchestrator.flux_maps.load_map`); where the magnet does not lie on d, the map is
turned until it does.
The spline is fitted to the currents, so that the model is free of curl and even in psi_q whatever
the measurement's errors; third differences are held small, which smooths noise, and continues H
quadratically (constant inductances) where the table has no points. Fitting needs the table only:
a nameplate beside it is handed through.
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
"""Weights of the third differences over the least, tried in order until the energy is convex."""


@dataclass(frozen=True)
class FluxTable:
    """Points of a flux map, SI and peak values."""

    source: str
    i_dq: Array
    """Shape (n, 2) [A]."""
    psi_dq: Array
    """Shape (n, 2) [Wb]."""
    motor: Motor | None = None
    """The nameplate, for maps that come with the package."""
    smoothing: float = 0.03
    """Least weight of the third differences."""
    turned_rad: float = 0.0
    """By how much the file's frame was turned to lie on the magnet."""

    @property
    def reach_a(self) -> float:
        """Largest current that the table knows on both axes."""
        return float(np.abs(self.i_dq).max(axis=0).min())

    @property
    def holds_zero(self) -> bool:
        """Whether zero current lies within the table's range on both axes, or at its end."""
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
    """A shipped map by name, or the user's own: whatever `orchestrator.flux_maps.load_map` reads.

    Raises
    ------
    InputError
        Where there is no such map, or the file does not hold one.
    """
    if name is None:
        path = Path() if file is None else file
        return _on_the_magnet(_points(str(path), path))
    about = _about(name)
    with as_file(files("plugins.drives.simulated") / "maps" / f"{name}.csv") as path:
        table = _points(name, path)
    return replace(table, motor=Motor.model_validate(about["motor"]), smoothing=float(about["smoothing"]))


def _points(source: str, path: Path) -> FluxTable:
    """The grid points at which a map is known."""
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


def _on_the_magnet(table: FluxTable, near: float = 0.1, least_share: float = 0.05) -> FluxTable:
    """The table in the frame of its magnet.

    The plant is even about its d axis, on which the magnet lies. Where that is, the flux at the point nearest to zero
    current tells: a current `near` zero, relative to the largest, and a flux of `least_share` of the largest. A table
    that begins beside zero tells nothing: iron that saturates on the way there would pass for a turn.
    """
    if not table.holds_zero:
        return table
    length = np.linalg.norm(table.i_dq, axis=1)
    at = int(np.argmin(length))
    flux = np.linalg.norm(table.psi_dq, axis=1)
    if length[at] > near * length.max() or flux[at] < least_share * flux.max():
        return table
    rest_d, rest_q = table.psi_dq[at] - _inductance(table) @ table.i_dq[at]
    angle = math.atan2(rest_q, rest_d)
    if abs(angle) < 1e-6:
        return table
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])  # rows times this: by -angle
    return replace(table, i_dq=table.i_dq @ turn, psi_dq=table.psi_dq @ turn, turned_rad=angle)


def _inductance(table: FluxTable) -> Array:
    """Slope of the flux over the current about the table's point nearest to zero [H], shape (2, 2)."""
    apart = np.linalg.norm(table.i_dq, axis=1)
    near = np.argsort(apart, kind="stable")[:9]
    design = np.column_stack((np.ones(len(near)), table.i_dq[near]))
    return np.asarray(np.linalg.lstsq(design, table.psi_dq[near], rcond=None)[0][1:].T, dtype=np.float64)


def map_energy(table: FluxTable) -> Magnetics:
    """Spline energy of a flux map.

    It is convex at the table's points, and between them and their mirror images, where no point may be.

    Raises
    ------
    InputError
        Where the table cannot be a motor's: no convex energy goes through it.
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
    return Magnetics(energy._replace(psi_m=_rest(Magnetics(energy, spline), float(nearest[0]))), spline)


def usable_reach(table: FluxTable, magnetics: Magnetics, *, positive_d: bool) -> float:
    """Radius of the circle (or of its half with i_d <= 0) in which the model is a motor [A].

    Within the table's range on both axes, and where a one-sided table had to be continued, as far
    as the inductances stay within a third to three times what they are at the table's points.
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
            here = stiffness(flux_at(magnetics, radius * circle))
        except ValueError:
            break
        if here.min() < low or here.max() > high:
            break
        reach = float(radius)
    return reach


def fit_error(table: FluxTable, magnetics: Magnetics) -> float:
    """Rms of grad H(psi) - i over the table's points [A]."""
    model = np.array([current(*magnetics, float(d), float(q)) for d, q in table.psi_dq])
    return float(np.sqrt(((model - table.i_dq) ** 2).sum(axis=1).mean()))


def misfit_in_words(table: FluxTable, magnetics: Magnetics) -> str:
    """By how much the plant's smooth map differs from the file's points, and how it was turned; one line."""
    share = 100.0 * fit_error(table, magnetics) / math.sqrt(float((table.i_dq**2).sum(axis=1).mean()))
    points = f"{len(table.i_dq)} points within {share:.2g} % of the current, rms"
    message = f"{table.source}: the motor's smooth map meets its {points}"
    if not table.holds_zero:
        message += "; they begin beside zero current, which does not tell where the magnet lies: on d, as in the file"
    if abs(table.turned_rad) > math.radians(0.05):
        message += f"; turned by {-math.degrees(table.turned_rad):+.1f} degrees, so that the magnet lies on d"
    return message


def _symmetrised(table: FluxTable) -> tuple[Array, Array]:
    """The points and their mirror images in i_q; where both were measured, their mean."""
    mirror = np.array([1.0, -1.0])
    apart = np.abs(table.i_dq[:, None, :] - (table.i_dq * mirror)[None, :, :]).sum(axis=2)
    twin = np.argmin(apart, axis=1)
    has_twin = apart[np.arange(len(twin)), twin] < 1e-6 * table.reach_a
    psi = np.where(has_twin[:, None], 0.5 * (table.psi_dq + (table.psi_dq * mirror)[twin]), table.psi_dq)
    return np.vstack((table.i_dq, table.i_dq * mirror)), np.vstack((psi, psi * mirror))


def _box(psi_dq: Array, i_dq: Array) -> Energy:
    """A spline over a box that holds all points; to the right of a map that ends at i_d = 0, room to go on."""
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
    """Least squares for the coefficients."""
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


def _rest(magnetics: Magnetics, start_d: float) -> float:
    """psi_d at zero current, by Newton on the d axis."""
    psi = start_d
    for _ in range(50):
        inside = min(max(psi, magnetics.energy.low_d), magnetics.energy.high_d)
        psi -= current(*magnetics, psi, 0.0)[0] / hessian(*magnetics, inside, 0.0)[0]
    return float(psi)

"""Flux maps of real machines as energies: a table psi(i) becomes a spline H(psi) with grad H = i.

The spline is fitted to the currents, so that the model is free of curl and even in psi_q whatever
the measurement's errors; third differences are held small, which smooths noise, and continues H
quadratically (constant inductances) where the table has no points. Fitting needs the table only:
a nameplate beside it is handed through.
"""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from plugins.drives.simulated._energy import Array, Energy, Magnetics, current, hessian
from plugins.drives.simulated._inverse import flux_at
from protocols import InputError, Motor

WHERE = "drive.plant.magnetics"
COLUMNS = ("i_d_A", "i_q_A", "psi_d_Vs", "psi_q_Vs")
CELLS = (24, 36)
SMOOTHER = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Times the least weight of the third differences, until the energy is convex."""


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

    @property
    def reach_a(self) -> float:
        """Largest current that the table knows on both axes."""
        return float(np.abs(self.i_dq).max(axis=0).min())


def map_names() -> tuple[str, ...]:
    """Names of the maps that come with the package."""
    folder = files("plugins.drives.simulated") / "maps"
    return tuple(sorted(f.name.removesuffix(".json") for f in folder.iterdir() if f.name.endswith(".json")))


def map_motor(name: str) -> Motor:
    """Nameplate of the machine behind a shipped map; raises `InputError` for an unknown name."""
    return Motor.model_validate(_about(name)["motor"])


def _about(name: str) -> dict[str, Any]:
    if name not in map_names():
        raise InputError(WHERE, "name", f"no map {name!r}; there are {', '.join(map_names())}")
    text = (files("plugins.drives.simulated") / "maps" / f"{name}.json").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def load_table(name: str | None, file: Path | None) -> FluxTable:
    """A shipped map by name, or the user's own file.

    Raises
    ------
    InputError
        Where there is no such map, or the file does not hold one.
    """
    if name is not None:
        about = _about(name)
        text = (files("plugins.drives.simulated") / "maps" / f"{name}.csv").read_text(encoding="utf-8")
        table = _checked(name, *_parse_csv(name, text))
        return replace(table, motor=Motor.model_validate(about["motor"]), smoothing=float(about["smoothing"]))
    path = Path() if file is None else file
    try:
        if path.suffix == ".npz":
            return _checked(str(path), *_read_npz(path))
        return _checked(str(path), *_parse_csv(str(path), path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), "", f"cannot be read: {error}") from None


def _parse_csv(source: str, text: str) -> tuple[Array, Array]:
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    for column in COLUMNS:
        if column not in (rows.fieldnames or ()):
            raise InputError(source, column, f"no such column; expected {', '.join(COLUMNS)}")
    try:
        table = np.array([[float(row[c]) for c in COLUMNS] for row in rows])
    except (TypeError, ValueError):
        raise InputError(source, "", "a row holds something that is not a number") from None
    return table.reshape(-1, 4)[:, :2], table.reshape(-1, 4)[:, 2:]


def _read_npz(path: Path) -> tuple[Array, Array]:
    with path.open("rb") as stream:
        try:
            content = np.load(stream, allow_pickle=False)
            i, psi = np.asarray(content["i_s_dq"]).ravel(), np.asarray(content["psi_s_dq"]).ravel()
        except KeyError as error:
            raise InputError(str(path), "", f"{error.args[0]}; expected complex i_s_dq and psi_s_dq") from None
        except (ValueError, EOFError, TypeError) as error:
            raise InputError(str(path), "", f"not an .npz file: {error}") from None
    return np.column_stack((i.real, i.imag)).astype(np.float64), np.column_stack((psi.real, psi.imag)).astype(
        np.float64
    )


def _checked(source: str, i_dq: Array, psi_dq: Array) -> FluxTable:
    if i_dq.shape != psi_dq.shape or len(i_dq) < 16:
        raise InputError(source, "", "expected 16 points or more, each with a current and a flux linkage")
    if not (np.isfinite(i_dq).all() and np.isfinite(psi_dq).all()):
        raise InputError(source, "", "a value is not finite")
    if not (np.ptp(i_dq, axis=0) > 0).all():
        raise InputError(source, "", "the points lie on one line")
    return FluxTable(source, i_dq, psi_dq)


def map_energy(table: FluxTable) -> Magnetics:
    """Spline energy of a flux map.

    Raises
    ------
    InputError
        Where the table cannot be a motor's: no convex energy goes through it.
    """
    i_dq, psi_dq = _symmetrised(table)
    box = _box(psi_dq, i_dq)
    for factor in SMOOTHER:
        spline = _fit(box, i_dq, psi_dq, factor * table.smoothing)
        points = np.array([hessian(box, spline, float(d), float(q)) for d, q in psi_dq])
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


def _symmetrised(table: FluxTable) -> tuple[Array, Array]:
    """The points and their mirror images in i_q; where both were measured, their mean."""
    mirror = np.array([1.0, -1.0])
    apart = np.abs(table.i_dq[:, None, :] - (table.i_dq * mirror)[None, :, :]).sum(axis=2)
    twin = np.argmin(apart, axis=1)
    found = apart[np.arange(len(twin)), twin] < 1e-6 * table.reach_a
    psi = np.where(found[:, None], 0.5 * (table.psi_dq + (table.psi_dq * mirror)[twin]), table.psi_dq)
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
        inverse_l_d=1.0,
        inverse_l_q=1.0,
        a30=0.0,
        a12=0.0,
        a40=0.0,
        a22=0.0,
        a04=0.0,
        a60=0.0,
        a06=0.0,
        rows=CELLS[0],
        columns=CELLS[1],
        cells_per_wb_d=CELLS[0] / (high - low),
        cells_per_wb_q=CELLS[1] / (2 * high_q),
        low_d=low,
        high_d=high,
        high_q=high_q,
        outside_d=1.0,
        outside_q=1.0,
    )


def _fit(box: Energy, i_dq: Array, psi_dq: Array, smoothing: float) -> Array:
    """Least squares for the coefficients."""
    from scipy.interpolate import BSpline

    shape, m, n = (box.rows + 3, box.columns + 3), box.cells_per_wb_d, box.cells_per_wb_q

    def basis(cells: int, t: Array) -> tuple[Array, Array]:
        knots, eye = np.arange(-3.0, cells + 4.0), np.eye(cells + 3)
        spline = BSpline(knots, eye, 3)
        return np.asarray(spline(t)), np.asarray(spline.derivative()(t))

    b, b1 = basis(CELLS[0], (psi_dq[:, 0] - box.low_d) * m)
    c, c1 = basis(CELLS[1], (psi_dq[:, 1] + box.high_q) * n)
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

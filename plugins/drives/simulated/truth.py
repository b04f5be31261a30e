"""The sealed truth about the plant, for its private file and for tests, never for analysis."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plugins.drives.simulated._derive import Nameplate, TruePlant, bus_voltage, derive, read_nameplate
from plugins.drives.simulated._energy import Array, Magnetics, current, hessian
from plugins.drives.simulated._inverse import flux_at
from plugins.drives.simulated._map import fit_error
from plugins.drives.simulated.options import SimulatedOptions
from protocols import Motor, StorageError


@dataclass(frozen=True)
class TrueMagnetics:
    """The plant's reversible magnetics in its true frame."""

    magnetics: Magnetics

    @property
    def pm_flux_wb(self) -> float:
        """psi_d at zero current."""
        return self.magnetics.energy.psi_m

    def flux(self, i_dq: Array) -> Array:
        """psi(i) [Wb], shape (n, 2); raises `ValueError` where the energy has no flux for a current."""
        return flux_at(self.magnetics, np.atleast_2d(i_dq))

    def current(self, psi_dq: Array) -> Array:
        """i(psi) = grad H [A], shape (n, 2)."""
        return np.array([current(*self.magnetics, float(d), float(q)) for d, q in np.atleast_2d(psi_dq)])

    def inductance(self, i_dq: Array) -> Array:
        """dpsi/di [H], shape (n, 2, 2), symmetric."""
        points = [hessian(*self.magnetics, float(d), float(q)) for d, q in self.flux(i_dq)]
        return np.linalg.inv(np.array([[[dd, dq], [dq, qq]] for dd, dq, qq in points]))


def true_flux(options: SimulatedOptions, motor: Motor) -> TrueMagnetics:
    """The true magnetics of a simulated drive with these options on this motor.

    Raises
    ------
    InputError
        As on opening the drive.
    """
    nameplate = read_nameplate(motor)
    return TrueMagnetics(derive(options, nameplate, bus_voltage(options, nameplate)).magnetics)


def describe(nameplate: Nameplate, plant: TruePlant, seed: int) -> dict[str, Any]:
    """All of the plant's parameters and its flux map, as JSON."""
    magnetics = plant.magnetics
    rated = nameplate.rated_a
    axis = np.linspace(-1.25 * rated, 1.25 * rated, 11)
    grid = np.array([[d, q] for d in axis for q in axis])
    flux = flux_at(magnetics, grid)
    return {
        "format": "fluxbench-simulated-truth",
        "version": 1,
        "seed": seed,
        "plant": plant.options.model_dump(mode="json"),
        "derived": {
            "energy": {**_plain(magnetics.energy._asdict()), "spline": magnetics.spline.tolist()},
            "parameters": _plain(plant.parameters._asdict()),
            "sensors": _plain(plant.sensors._asdict()),
            "bench": None if plant.bench is None else _plain(plant.bench._asdict()),
            "map_fit_error_a": None if plant.table is None else fit_error(plant.table, magnetics),
        },
        "map": {"i_dq_a": grid.tolist(), "psi_dq_wb": flux.tolist()},
    }


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Arrays as lists, named tuples as objects, infinities as null."""

    def plain(value: Any) -> Any:
        if hasattr(value, "_asdict"):
            return _plain(value._asdict())
        if isinstance(value, np.ndarray):
            return value.tolist()
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {name: plain(value) for name, value in values.items()}


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Replace a file by rename, so that it is whole or absent; raises `StorageError` where it cannot be written."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise StorageError(f"{path}: cannot be written: {error.strerror}") from None

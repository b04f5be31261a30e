"""The quantities of all exports, computed once: torque, saliency, trajectories, inverse map. Writes no file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.flux_maps import (
    MapAudit,
    MapSurface,
    audit_map,
    has_no_rest_flux,
    in_ascii,
    magnet_basis,
    magnet_is_copied,
)
from orchestrator.flux_maps.exporting._inverse import InverseMap, invert
from orchestrator.flux_maps.exporting._torque import Trajectory, mtpa, mtpv, saliency, torque_nm
from orchestrator.formatting.names import code_identifier
from orchestrator.numerics.saliency import Saliency
from orchestrator.numerics.types import Array
from protocols import FluxMap, Motor


@dataclass(frozen=True)
class FileContent:
    """One file's content, and notes on it."""

    content: bytes
    measured_percent: float
    """Share of the table's nodes that were measured; the others are NaN, omitted or continued."""
    filled_nodes: int = 0
    """Nodes with a continued value."""
    notes: tuple[str, ...] = ()


class Products:
    """A flux map and all derived quantities, each computed on first use.

    Parameters
    ----------
    flux_map : FluxMap
    motor : Motor
        The motor, with the measured R_s if available.
    recording : str
        Name of the map's recording.
    caution : str
        Why the map is not to be relied on; the first of the notes, and empty where it is usable or nothing is known.
    resistance : str
        At which temperature R_s holds, for the notes; empty where R_s was not measured.
    """

    def __init__(
        self, flux_map: FluxMap, motor: Motor, recording: str = "", caution: str = "", resistance: str = ""
    ) -> None:
        self.flux_map, self.motor, self.recording, self.caution = flux_map, motor, recording, caution
        self.resistance = resistance

    @property
    def symbol(self) -> str:
        """The motor's name as a valid C and Modelica name: lower-case letters, digits, underscores."""
        return code_identifier(self.motor.name)

    @property
    def rest_wb(self) -> float | None:
        """psi_d at zero current; None where that was not measured."""
        rest = np.zeros((1, 2))
        return float(self.surface.psi(rest)[0, 0]) if self.surface.inside(rest)[0] else None

    @cached_property
    def surface(self) -> MapSurface:
        return MapSurface(self.flux_map)

    @cached_property
    def inverse(self) -> InverseMap:
        return invert(self.flux_map)

    @cached_property
    def audit(self) -> MapAudit:
        return audit_map(self.flux_map, self.motor)

    @cached_property
    def saliency(self) -> Saliency:
        return saliency(self.flux_map)

    @cached_property
    def torque_nm(self) -> Array:
        return torque_nm(self.flux_map, self.motor.pole_pairs)

    @cached_property
    def mtpa(self) -> Trajectory | None:
        """None where the map has no motoring half (i_q > 0)."""
        return mtpa(self.flux_map, self.motor.pole_pairs) if self.motors else None

    @cached_property
    def mtpv(self) -> Trajectory | None:
        return mtpv(self.flux_map, self.motor.pole_pairs) if self.motors else None

    @cached_property
    def measured_percent(self) -> float:
        """Share of the map's own grid that was measured."""
        return 100.0 * float(self.surface.known.mean())

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Notes for every format."""
        notes = [self.caution] if self.caution else []
        if self.resistance:
            notes.append(in_ascii(f"R_s: {self.resistance}"))
        if self.rest_wb is not None and magnet_is_copied(self.motor, self.rest_wb):
            notes.append(in_ascii(f"magnet's flux: {magnet_basis(self.rest_wb)}"))
        holes = int((~self.surface.known).sum())
        if holes:
            notes.append(f"{holes} of {self.surface.known.size} grid points were not measured")
        if self.lacks_magnet:
            notes.append(
                "pm_flux_wb is not known and a locked rotor does not show it: psi, torque, MTPA and MTPV leave out "
                "the magnet"
            )
        if self.mtpa is None:
            notes.append("no measured point with i_q > 0: no MTPA and no MTPV")
        elif self.mtpv is not None and not self.mtpv.interior.any():
            notes.append("MTPV lies beyond the measured region: its rows are the best at the edge (interior = 0)")
        return (*notes, *self.audit.notes)

    @property
    def lacks_magnet(self) -> bool:
        """Whether psi(0, 0) is zero only for want of a nameplate value."""
        return self.motor.pm_flux_wb is None and has_no_rest_flux(self.surface)

    @cached_property
    def motors(self) -> bool:
        """Whether a point with i_q > 0 was measured."""
        return bool((self.surface.currents[:, 1] > 0).any())


def lookup_error(
    rows: Array, columns: Array, tables: tuple[Array, Array], at: Array, truth: Array
) -> tuple[float, float]:
    """rms and largest length of the difference between bilinear lookups and the truth.

    Parameters
    ----------
    rows, columns : array, shapes (n,), (m,)
        Axes of the two tables, which have shape (n, m).
    at, truth : array, shape (k, 2)
        Points on the axes, and their true values.
    """
    from scipy.interpolate import RegularGridInterpolator

    lookup = RegularGridInterpolator((rows, columns), np.stack(tables, axis=-1), bounds_error=False, fill_value=None)
    apart = np.linalg.norm(np.asarray(lookup(at)) - truth, axis=1)
    return float(np.sqrt((apart**2).mean())), float(apart.max())

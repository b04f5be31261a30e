"""The audit of a flux map: figures, the faults that they show, and the uses that each fault spoils."""

from __future__ import annotations

import numpy as np

from orchestrator.flux_maps._checks import (
    enclosed,
    least_inductances,
    magnet_direction,
    reciprocity,
    roughness,
    swing_of,
    symmetry,
    symmetry_axis,
)
from orchestrator.flux_maps._faults import (
    AuditCriteria,
    Fault,
    Symmetries,
    audit_remarks,
    convexity_faults,
    curl_faults,
    hole_faults,
    rough_faults,
    symmetry_faults,
    torque_faults,
    uses_in_words,
)
from orchestrator.flux_maps._surface import MapSurface
from orchestrator.numerics.types import Array, Mask
from protocols import FluxMap, Motor, Number, Remark, Strict


class MapAudit(Strict):
    """The result of an audit; the JSON contract of `fluxbench audit --json`."""

    method: str
    points: int
    nodes: tuple[int, int]
    """Numbers of grid nodes along i_d and i_q."""
    swing_wb: float
    """Half the range of psi_d or psi_q, whichever is larger; percentages refer to it."""
    reciprocity_h: Number
    """rms of dpsi_d/di_q - dpsi_q/di_d over the cells."""
    reciprocity_percent: Number
    """rms of the flux' difference from the nearest gradient."""
    parity_d_percent: Number
    """Largest odd part of psi_d in i_q; on the magnet's axis where that lies on -q."""
    parity_q_percent: Number
    parity_turned_percent: Number
    """rms of the residual of both about the best axis."""
    axis_rad: Number
    """Angle from d to the axis about which the map is most nearly even."""
    magnet_rad: Number
    """Angle from d to the flux at zero current; null where that is unknown or zero."""
    magnet_wb: Number
    least_inductance_h: float
    """Smallest incremental inductance of all points and directions; negative where the energy is not convex."""
    non_convex: tuple[tuple[float, float], ...]
    """(i_d, i_q) of the points where the energy is not convex [A]."""
    holes: int
    """Unmeasured points that are surrounded by measured ones."""
    roughness_percent: Number
    """Typical error of a point against its neighbours."""
    torque_factor: Number
    """The file's torque over that of its fluxes; null where it has none, or the pole pairs are unknown."""
    torque_percent: Number
    """rms of the residual after this factor, of the largest torque."""
    faults: tuple[Fault, ...]
    remarks: tuple[Remark, ...]
    """Checks that were not possible, and further observations."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Each fault with the uses that it spoils, as a sentence for every export."""
        return tuple(f"{fault.remark.text}: spoils {uses_in_words(fault.spoils)}" for fault in self.faults)


def audit_map(
    flux_map: FluxMap,
    motor: Motor | None = None,
    torque_nm: Array | None = None,
    criteria: AuditCriteria | None = None,
) -> MapAudit:
    """Audit a flux map.

    Parameters
    ----------
    motor : Motor, optional
        The motor, for its pole pairs.
    torque_nm : array, shape (d, q), optional
        Torque that was measured, or not computed from the fluxes.

    Raises
    ------
    InputError
        Where the map cannot be interpolated.
    """
    criteria = criteria or AuditCriteria()
    surface = MapSurface(flux_map)
    swing = swing_of(surface)
    floor = max(0.01 * criteria.material_percent * swing, criteria.deviations * _own_error(flux_map, surface.known))
    gradient, (wb, rad, quarter) = reciprocity(surface), magnet_direction(surface, swing)
    symmetries = Symmetries(wb, rad, quarter, symmetry(surface, quarter), symmetry_axis(surface, quarter))
    least = least_inductances(surface)
    bad = least <= 0.0
    holes, rough = enclosed(surface.known), roughness(surface)
    typical = _typical(rough)
    torque = _torque(flux_map, motor, torque_nm)
    faults = (
        *curl_faults(gradient.distance_wb if gradient else None, floor, swing),
        *symmetry_faults(symmetries, floor, swing),
        *convexity_faults(surface.currents[bad], least),
        *hole_faults(holes, surface),
        *rough_faults(rough, typical, floor, surface, criteria),
        *torque_faults(torque, criteria),
    )
    best, about = symmetries.best, symmetries.about
    return MapAudit(
        method=flux_map.method,
        points=int(surface.known.sum()),
        nodes=surface.known.shape,
        swing_wb=swing,
        reciprocity_h=gradient.distance_h if gradient else None,
        reciprocity_percent=100.0 * gradient.distance_wb / swing if gradient else None,
        parity_d_percent=100.0 * about.d_wb / swing if about else None,
        parity_q_percent=100.0 * about.q_wb / swing if about else None,
        parity_turned_percent=100.0 * best.rms_wb / swing if best else None,
        axis_rad=best.axis_rad if best else None,
        magnet_rad=symmetries.magnet_rad,
        magnet_wb=symmetries.magnet_wb,
        least_inductance_h=float(least.min()),
        non_convex=tuple((float(d), float(q)) for d, q in surface.currents[bad]),
        holes=int(holes.sum()),
        roughness_percent=None if typical is None else 100.0 * typical / swing,
        torque_factor=torque[0] if torque else None,
        torque_percent=torque[1] if torque else None,
        faults=tuple(faults),
        remarks=tuple(audit_remarks(symmetries, swing, torque_nm is not None, motor is not None)),
    )


def _own_error(flux_map: FluxMap, known: Mask) -> float:
    """Median standard deviation of the map's points; zero where it has none."""
    stds = np.concatenate([table[known] for table in (flux_map.psi_d_std, flux_map.psi_q_std)])
    return float(np.median(stds[np.isfinite(stds)])) if np.isfinite(stds).any() else 0.0


def _typical(rough: tuple[Array, Array]) -> float | None:
    """Standard deviation of a point's own error, by the median, which outliers do not move."""
    values = np.concatenate([along[np.isfinite(along)] for along in rough])
    # Of normal values 0.6745 standard deviations are the median size.
    return float(np.median(np.abs(values))) / 0.6745 if values.size else None


def _torque(flux_map: FluxMap, motor: Motor | None, torque_nm: Array | None) -> tuple[float, float] | None:
    """The file's torque over that of its fluxes, and the rms residual in per cent of the largest torque."""
    if motor is None or torque_nm is None:
        return None
    i_d, i_q = (np.asarray(axis, dtype=np.float64) for axis in (flux_map.i_d, flux_map.i_q))
    computed = 1.5 * motor.pole_pairs * (flux_map.psi_d * i_q[None, :] - flux_map.psi_q * i_d[:, None])
    both = np.isfinite(computed) & np.isfinite(torque_nm)
    if not both.any() or not computed[both].any():
        return None
    factor = float(computed[both] @ torque_nm[both] / (computed[both] @ computed[both]))
    residual = torque_nm[both] - factor * computed[both]
    return factor, float(100.0 * np.sqrt(np.mean(residual**2)) / np.abs(torque_nm[both]).max())

"""The magnet's flux in a map: a locked rotor does not show it, so it comes from the nameplate or is lacking."""

from __future__ import annotations

import numpy as np

from orchestrator.flux_maps._surface import MapSurface
from protocols import FluxMap, Motor

REST_FLUX_RATIO = 1e-3
"""Flux without current over the largest difference of the map's fluxes, below which the map shows no magnet."""


def has_no_rest_flux(surface: MapSurface) -> bool:
    """Whether the map is known at zero current and has no flux there."""
    rest = np.zeros((1, 2))
    if not surface.inside(rest)[0]:
        return False
    return float(np.abs(surface.psi(rest)).max()) < REST_FLUX_RATIO * float(np.ptp(surface.fluxes, axis=0).max())


def with_magnet(flux_map: FluxMap, motor: Motor) -> FluxMap:
    """The map with the motor's `pm_flux_wb` where it has no flux without current; else as it is."""
    if not motor.pm_flux_wb or not has_no_rest_flux(MapSurface(flux_map)):
        return flux_map
    return flux_map.model_copy(update={"psi_d": np.asarray(flux_map.psi_d) + motor.pm_flux_wb})

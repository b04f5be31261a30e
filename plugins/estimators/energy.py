"""Flux map of one energy, fitted to inductances by injection and to flux by integration together.

psi = grad W(i) and L = Hess W(i) of one co-energy W that is even in i_q: reciprocal, and the same along every path.
What the measurements disagree with it is the check (Jebai, Combes, Malrait, Martin, Rouchon, "Energy-based modeling
of electric motors", CDC 2014, doi:10.1109/CDC.2014.7040330, for the energy and its symmetry).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis import EnergyFit, check_map, fit_energy, inside_hull, rated_flux_wb, require_area
from plugins.estimators._maps import InjectedFlux, SweptFlux, as_map, grid_of
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.injection import InjectionEstimator
from protocols import (
    EstimationContext,
    FluxMap,
    FluxMapEstimate,
    FluxPoints,
    MapChecks,
    NotMeasuredError,
    RecordingReader,
)

Array = NDArray[np.float64]

_CORRELATED = 0.5


class EnergyEstimator:
    """One co-energy for all derivatives and fluxes that were measured, its smoothness chosen by the data."""

    name: ClassVar[str] = "energy"
    summary: ClassVar[str] = "flux map of one energy, fitted to injection and integration together"
    produces: ClassVar[Literal["resistance", "flux_map"]] = "flux_map"

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> FluxMapEstimate:
        """Make the map; raises `NotMeasuredError` where neither injection nor sweeps span an area of currents."""
        injected, swept, problems = _measured(recording, context)
        sources = [source for source in (injected, swept) if source is not None]
        if not sources:
            raise NotMeasuredError(recording.manifest.name, "segments", "; ".join(problems))
        where = recording.manifest.name
        current = np.concatenate([source.points.i_dq.astype(np.float64) for source in sources])
        require_area(current, where)
        if not inside_hull(current, np.zeros((1, 2)), where)[0]:
            raise NotMeasuredError(where, "segments", "zero current lies outside the measured points")
        fit = fit_energy(injected.inductances if injected else None, swept.paths if swept else ())
        flux_map = _gridded(recording, fit, current)
        rated = rated_flux_wb(flux_map, recording.manifest.motor.rated_current_a)
        magnet = np.array([recording.manifest.motor.pm_flux_wb or 0.0, 0.0])
        return FluxMapEstimate(
            map=flux_map,
            points=FluxPoints(
                i_dq=current,
                psi_dq=fit.flux(current)[0] + magnet,
                segment=tuple(name for source in sources for name in source.points.segment),
            ),
            checks=_checked(flux_map, rated, fit, injected, swept),
            notes=tuple(_notes(fit, flux_map, rated, current)),
        )


def _measured(
    recording: RecordingReader, context: EstimationContext
) -> tuple[InjectedFlux | None, SweptFlux | None, list[str]]:
    """What the other two estimators found, made here where it was not made yet."""
    injected, swept = context.maps.get("injection"), context.maps.get("classical")
    problems = []
    if not isinstance(injected, InjectedFlux):
        try:
            injected = InjectionEstimator().estimate(recording, context)
        except NotMeasuredError as error:
            injected = None
            problems.append(str(error))
    if not isinstance(swept, SweptFlux):
        try:
            swept = ClassicalEstimator().estimate(recording, context)
        except NotMeasuredError as error:
            swept = None
            problems.append(str(error))
    return injected, swept, problems


def _gridded(recording: RecordingReader, fit: EnergyFit, current: Array) -> FluxMap:
    axes, nodes = grid_of(current)
    inside = inside_hull(current, nodes, recording.manifest.name)
    values, stds = np.full((len(nodes), 5), np.nan), np.full((len(nodes), 5), np.nan)
    flux, inductance = fit.flux(nodes[inside]), fit.inductance(nodes[inside])
    values[inside] = np.column_stack([flux[0], inductance[0]])
    stds[inside] = np.column_stack([flux[1], inductance[1]])
    return as_map("energy", recording.manifest.motor, axes, values, stds)


def _checked(
    flux_map: FluxMap, rated: float | None, fit: EnergyFit, injected: InjectedFlux | None, swept: SweptFlux | None
) -> MapChecks:
    """Parity and reciprocity, which the energy's form grants, and the crossings of what it was fitted to.

    Where injection's points are on no lines that cross, by how much the energy is off the sweeps' flux stands for it.
    """
    misfit = None
    if swept is not None:
        apart = [path.psi - fit.flux(path.current)[0] for path in swept.paths]
        misfit = np.concatenate([one - one.mean(axis=0) for one in apart])
    checks = check_map(flux_map, rated, misfit)
    if injected is None or injected.checks.crossings is None:
        return checks
    return checks.model_copy(update={"crossings": injected.checks.crossings})


def _notes(fit: EnergyFit, flux_map: FluxMap, rated: float | None, current: Array) -> list[str]:
    notes = []
    if rated:
        spread = np.sqrt(np.nanmean(flux_map.psi_d_std**2 + flux_map.psi_q_std**2))
        notes.append(
            f"the flux is known to +-{1.96 * 100 * spread / rated:.2f} % of the rated flux (95 %, over the map)"
        )
    if fit.angle_rad:
        notes.append(
            f"the map is symmetric about an axis {np.degrees(fit.angle_rad):+.2f} degrees (electrical) from the "
            "believed d axis: is the rotor angle right? The map stays in the believed frame"
        )
    inductance = fit.inductance(current)[0]
    if fit.stiffening_per_h:
        less = 50.0 * fit.stiffening_per_h * float((inductance[:, 0] + inductance[:, 2]).mean())
        notes.append(
            f"injection gives {less:.1f} % less flux than the sweeps: hysteresis, whose loops a small ripple does not "
            "pass; the map has the sweeps' flux, its inductances are those along the map"
        )
    if fit.scales[0] > 3.0 and fit.correlation > _CORRELATED:
        notes.append(
            f"what the energy leaves of the inductances is {fit.scales[0]:.0f} times their noise and alike at "
            f"neighbouring points (correlation {fit.correlation:.2f}): an effect that is no magnetics"
        )
    if (inductance[:, 0] * inductance[:, 2] <= inductance[:, 1] ** 2).any():
        notes.append("the energy is not convex everywhere: there the map cannot be inverted")
    return notes

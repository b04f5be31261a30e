"""Flux map of one energy, fitted to inductances by injection and to flux by integration together.

psi = grad W(i) and L = Hess W(i) of one co-energy W that is even in i_q: reciprocal, and the same along every path.
What the measurements disagree with it is the check (Jebai, Combes, Malrait, Martin, Rouchon, "Energy-based modeling
of electric motors", CDC 2014, doi:10.1109/CDC.2014.7040330, for the energy and its symmetry).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from orchestrator.analysis import EnergyFit, check_map, rated_flux_wb
from orchestrator.numerics.types import Array
from plugins.estimators._energies import EnergyFlux, Measurements, energy_measurements, gridded, pm_flux
from protocols import EstimationContext, FluxMap, FluxPoints, MapChecks, RecordingReader

_CORRELATED = 0.5


class EnergyEstimator:
    """One co-energy for all derivatives and fluxes that were measured, its smoothness chosen by the data."""

    name: ClassVar[str] = "energy"
    summary: ClassVar[str] = "flux map of one energy, fitted to injection and integration together"
    produces: ClassVar[Literal["resistance", "flux_map"]] = "flux_map"

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> EnergyFlux:
        """Make the map; raises `NotMeasuredError` where neither injection nor sweeps span an area of currents."""
        measured = energy_measurements(recording, context)
        fit = measured.fit()
        flux_map = gridded("energy", recording, fit, measured.current)
        rated = rated_flux_wb(flux_map, recording.manifest.motor.rated_current_a)
        return EnergyFlux(
            map=flux_map,
            points=FluxPoints(
                i_dq=measured.current,
                psi_dq=fit.flux(measured.current)[0] + pm_flux(recording),
                segment=measured.segments,
            ),
            checks=_checked(flux_map, rated, fit, measured),
            notes=tuple(_notes(fit, flux_map, rated, measured.current)),
            fit=fit,
        )


def _checked(flux_map: FluxMap, rated: float | None, fit: EnergyFit, measured: Measurements) -> MapChecks:
    """Parity and reciprocity, which the energy's form grants, and the crossings of what it was fitted to.

    Where injection's points are on no lines that cross, by how much the energy is off the sweeps' flux stands for it.
    """
    checks = check_map(flux_map, rated, measured.misfit(fit))
    injected = measured.injected
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
    if fit.dead_time:
        most = 100.0 * float(np.abs(fit.taken_out[:, [0, 2]] / inductance[: len(fit.taken_out), [0, 2]]).max())
        notes.append(
            f"where a phase current passes zero, dead time makes injection's inductances look up to {most:.1f} % "
            "wrong; taken out"
        )
    doubted = float(np.mean(fit.trust < 0.5)) if len(fit.trust) else 0.0
    if doubted > 0.0:
        notes.append(f"{100.0 * doubted:.0f} % of the injection's points are confirmed by no others and count for less")
    if (inductance[:, 0] * inductance[:, 2] <= inductance[:, 1] ** 2).any():
        notes.append("the energy is not convex everywhere: there the map cannot be inverted")
    return notes

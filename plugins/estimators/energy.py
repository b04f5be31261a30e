"""Flux map of one energy, fitted to inductances by injection and to flux by integration together.

psi = grad W(i) and L = Hess W(i) of one co-energy W that is even in i_q: reciprocal, and the same along every path.
The residual of the measurements is the check (Jebai, Combes, Malrait, Martin, Rouchon, "Energy-based modeling
of electric motors", CDC 2014, doi:10.1109/CDC.2014.7040330, for the energy and its symmetry).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orchestrator.analysis import EnergyFit, band_percent, check_map, reference_flux_wb
from orchestrator.numerics.types import Array
from plugins.estimators._energies import EnergyFlux, Measurements, energy_measurements, gridded
from plugins.estimators._maps import InjectedFlux, SteppedFlux, SweptFlux, axis_turned
from protocols import Estimate, EstimationContext, FluxMap, MapChecks, RecordingReader, Remark


@dataclass(frozen=True)
class EnergyEstimator:
    """One co-energy for all measured derivatives and fluxes; the data determine its smoothness.

    Attributes
    ----------
    misfit_sigmas, misfit_correlation : float
        A remark reports residual inductances that exceed the noise by this factor and correlate by this
        much at neighbouring points, as noise does not.
    significance_sigmas : float
        Significance of a dead-time share; the threshold allows for some hundred points.
    """

    misfit_sigmas: float = 3.0
    misfit_correlation: float = 0.5
    significance_sigmas: float = 4.0

    name: ClassVar[str] = "energy"
    summary: ClassVar[str] = "flux map of one energy, fitted to injection and integration together"
    requires: ClassVar[tuple[type[Estimate], ...]] = (SweptFlux, InjectedFlux, SteppedFlux)
    produces: ClassVar[type[Estimate]] = EnergyFlux
    rank: ClassVar[int] = 30

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> EnergyFlux:
        """Make the map; raises `NotMeasuredError` where neither injection nor sweeps span an area of currents."""
        measured = energy_measurements(recording, context)
        fit = measured.fit()
        flux_map = gridded("energy", recording, fit, measured.current)
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        return EnergyFlux(
            map=flux_map,
            points=measured.points(fit, recording),
            checks=_checked(flux_map, rated, fit, measured),
            remarks=tuple(self._remarks(fit, flux_map, rated, measured.current)),
            fit=fit,
        )

    def _remarks(self, fit: EnergyFit, flux_map: FluxMap, rated: float | None, current: Array) -> list[Remark]:
        remarks: list[Remark] = []

        def add(code: str, text: str, **values: float) -> None:
            remarks.append(Remark.of(code, text, **values))

        band = band_percent(flux_map, rated)
        if band is not None:
            text = (
                "the flux is known to +-{half_percent:.2g} % of the rated flux (95 %, of noise alone, rms over the map)"
            )
            add("flux_error", text, half_percent=band)
        if fit.angle_rad:
            remarks.append(axis_turned(fit.angle_rad))
        inductance = fit.inductance(current)[0]
        if fit.stiffening_per_h:
            loss_percent = 50.0 * fit.stiffening_per_h * float((inductance[:, 0] + inductance[:, 2]).mean())
            text = (
                "injection gives {less_percent:.1f} % less flux than the sweeps, which has several possible causes; "
                "a diagnosis can tell. The map has the sweeps' flux and its slopes as inductances"
            )
            add("hysteresis", text, less_percent=loss_percent)
        if fit.scales[0] > self.misfit_sigmas and fit.correlation > self.misfit_correlation:
            text = (
                "the inductances' residual is {noises:.0f} times their noise and similar at "
                "neighbouring points (correlation {correlation:.2f}): an effect that is not magnetic"
            )
            add("no_magnetics", text, noises=float(fit.scales[0]), correlation=fit.correlation)
        max_share_percent = 100.0 * self._dead_time_share(fit, inductance)
        if max_share_percent > 0.0:
            text = (
                "where a phase current crosses zero, dead time changes injection's inductances by up to "
                "{most_percent:.1f} %; corrected"
            )
            add("inverter_step", text, most_percent=max_share_percent)
        outlier_share = float(np.mean(fit.trust < 0.5)) if len(fit.trust) else 0.0
        if outlier_share > 0.0:
            text = "{points_percent:.0f} % of the injection's points agree with no others and get less weight"
            add("doubted_points", text, points_percent=100.0 * outlier_share)
        if (inductance[:, 0] * inductance[:, 2] <= inductance[:, 1] ** 2).any():
            add("not_convex", "the energy is not convex everywhere; where it is not, the map cannot be inverted")
        return remarks

    def _dead_time_share(self, fit: EnergyFit, inductance: Array) -> float:
        """Largest relative dead-time correction of L_dd or L_qq that is significant; zero where none is."""
        if not fit.inverter_step:
            return 0.0
        axes = [0, 2]
        share = np.abs(fit.correction[:, axes] / inductance[: len(fit.correction), axes])
        significant = np.abs(fit.correction[:, axes]) > self.significance_sigmas * fit.correction_std[:, axes]
        return float(share[significant].max(initial=0.0))


def _checked(flux_map: FluxMap, rated: float | None, fit: EnergyFit, measured: Measurements) -> MapChecks:
    """Parity and reciprocity, which the energy ensures, and the flux misfit at crossings of injection's lines."""
    # Where injection has no crossing lines, the residual of the sweeps' flux against the energy replaces the misfit.
    checks = check_map(flux_map, rated, measured.misfit(fit))
    injected = measured.injected
    if injected is None or injected.checks.crossings is None:
        return checks
    return checks.model_copy(update={"crossings": injected.checks.crossings})

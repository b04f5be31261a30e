"""Flux map of the paper's polynomial energy H(psi), with its coefficients, fitted to injection and integration.

A handful of numbers instead of a table; whether they are good enough is said beside them (A. K. Jebai, P. Combes,
F. Malrait, P. Martin, P. Rouchon, "Energy-based modeling of electric motors", CDC 2014,
doi:10.1109/CDC.2014.7040330).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from orchestrator.analysis import EnergyFit, PolynomialFit, check_map, fit_polynomial, rated_flux_wb
from orchestrator.numerics.types import Array
from plugins.estimators._energies import energy_measurements, gridded, pm_flux
from protocols import EstimationContext, FluxMapEstimate, FluxPoints, RecordingReader

_ENOUGH_PERCENT = 0.5  # of the rated flux, rms, off the flexible energy


class PolynomialEstimator:
    """H(psi) as a polynomial, its degree chosen by the data; psi(i) by Newton's method at every current."""

    name: ClassVar[str] = "polynomial"
    summary: ClassVar[str] = "flux map of the paper's polynomial energy, with its coefficients"
    produces: ClassVar[Literal["resistance", "flux_map"]] = "flux_map"

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> FluxMapEstimate:
        """Make the map.

        Raises
        ------
        NotMeasuredError
            Where neither injection nor sweeps span an area of currents, or no polynomial is convex there.
        """
        measured = energy_measurements(recording, context)
        energy = measured.fit()
        fit = fit_polynomial(measured.inductances, measured.paths, energy, recording.manifest.name)
        flux_map = gridded("polynomial", recording, fit, measured.current)
        rated = rated_flux_wb(flux_map, recording.manifest.motor.rated_current_a)
        return FluxMapEstimate(
            map=flux_map,
            points=FluxPoints(
                i_dq=measured.current,
                psi_dq=fit.flux(measured.current)[0] + pm_flux(recording),
                segment=measured.segments,
            ),
            checks=check_map(flux_map, rated, measured.misfit(fit)),
            notes=(_formula(fit), _goodness(fit, energy, measured.current, rated)),
        )


def _formula(fit: PolynomialFit) -> str:
    """The coefficients with their standard deviations and units."""
    values = dict(zip(fit.terms, zip(fit.coefficients, fit.std, strict=True), strict=True))
    words = []
    for name, term in (("L_d", (2, 0)), ("L_q", (0, 2))):
        value, std = values.pop(term)
        words.append(f"{name} = {500.0 / value:.5g} +- {500.0 * std / value**2:.2g} mH")
    for (m, n), (value, std) in values.items():
        words.append(f"alpha{m}{n} = {value:.4g} +- {std:.2g} A/Wb^{m + n - 1}")
    axis = f" about an axis {np.degrees(fit.angle_rad):+.2f} degrees from the believed d axis" if fit.angle_rad else ""
    return (
        "H = x^2/2L_d + y^2/2L_q + sum of alpha_mn x^m y^n, x = psi_d - psi_M, y = psi_q, i = grad H"
        f"{axis}: {', '.join(words)}"
    )


def _goodness(fit: PolynomialFit, energy: EnergyFit, current: Array, rated: float | None) -> str:
    tried = ", ".join(f"{degree}: {value - min(fit.criteria.values()):.0f}" for degree, value in fit.criteria.items())
    words = f"degree {fit.degree} of the tried ones (criterion above the best: {tried})"
    if np.isfinite(fit.misfit_percent):
        words += f"; it leaves {fit.misfit_percent:.2f} % of the inductances (rms)"
    if not rated:
        return words
    apart = fit.flux(current)[0] - energy.flux(current)[0]
    off = 100.0 / rated * float(np.sqrt((apart**2).sum(axis=1).mean()))
    verdict = (
        "good enough to stand for it" if off < _ENOUGH_PERCENT else "this motor saturates in another way: use the map"
    )
    return f"{words} and is {off:.2f} % of the rated flux off the flexible energy (rms): {verdict}"

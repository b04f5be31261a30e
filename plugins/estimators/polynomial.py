"""Flux map of the paper's polynomial energy H(psi), with its coefficients, fitted to injection and integration.

A few coefficients instead of a table; a remark states whether they suffice (A. K. Jebai, P. Combes,
F. Malrait, P. Martin, P. Rouchon, "Energy-based modeling of electric motors", CDC 2014,
doi:10.1109/CDC.2014.7040330).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orchestrator.analysis import EnergyFit, PolynomialFit, check_map, fit_polynomial, reference_flux_wb
from orchestrator.numerics.types import Array
from plugins.estimators._energies import EnergyFlux, energy_measurements, gridded
from plugins.estimators._maps import InjectedFlux, SteppedFlux, SweptFlux
from protocols import (
    ClosedForm,
    Coefficient,
    Estimate,
    EstimationContext,
    FluxMapEstimate,
    RecordingReader,
    Remark,
)


@dataclass(frozen=True)
class PolynomialEstimator:
    """H(psi) as a polynomial, its degree chosen by the data; psi(i) by Newton's method at every current.

    Attributes
    ----------
    max_error_percent : float
        Rms deviation from the flexible energy over the rated flux, up to which the polynomial can replace it: maps
        by different methods differ by as much on a good bench.
    """

    max_error_percent: float = 0.5

    name: ClassVar[str] = "polynomial"
    summary: ClassVar[str] = "flux map of the paper's polynomial energy, with its coefficients"
    requires: ClassVar[tuple[type[Estimate], ...]] = (SweptFlux, InjectedFlux, SteppedFlux, EnergyFlux)
    produces: ClassVar[type[Estimate]] = FluxMapEstimate
    rank: ClassVar[int] = 0

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
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        return FluxMapEstimate(
            map=flux_map,
            points=measured.points(fit, recording),
            checks=check_map(flux_map, rated, measured.misfit(fit)),
            form=_form(fit),
            remarks=_remarks(fit, energy, measured.current, rated, self.max_error_percent),
        )


def _form(fit: PolynomialFit) -> ClosedForm:
    """The coefficients with their standard deviations; L_d and L_q in place of those of x^2 and y^2."""
    values = dict(zip(fit.terms, zip(fit.coefficients.tolist(), fit.std.tolist(), strict=True), strict=True))
    coefficients = []
    for name, term in (("L_d", (2, 0)), ("L_q", (0, 2))):
        value, std = values.pop(term)
        coefficients.append(Coefficient(name=name, value=0.5 / value, std=0.5 * std / value**2, unit="H"))
    for (m, n), (value, std) in values.items():
        coefficients.append(Coefficient(name=f"alpha{m}{n}", value=value, std=std, unit=f"A/Wb^{m + n - 1}"))
    axis = f" about an axis {np.degrees(fit.angle_rad):+.2f} degrees from the believed d axis" if fit.angle_rad else ""
    formula = f"H = x^2/2L_d + y^2/2L_q + sum of alpha_mn x^m y^n, x = psi_d - psi_M, y = psi_q, i = grad H{axis}"
    return ClosedForm(formula=formula, coefficients=tuple(coefficients))


def _remarks(
    fit: PolynomialFit, energy: EnergyFit, current: Array, rated: float | None, max_error_percent: float
) -> tuple[Remark, ...]:
    """Remark on the chosen degree, and on whether the polynomial can replace the flexible energy."""
    best = min(fit.criteria.values())
    tried = ", ".join(f"{degree}: {value - best:.0f}" for degree, value in fit.criteria.items())
    text = "degree {degree} was chosen (criterion minus its minimum, by degree: {tried})"
    values: dict[str, float | str | None] = {"degree": fit.degree, "tried": tried}
    if np.isfinite(fit.misfit_percent):
        text += "; residual {left_percent:.2f} % of the inductances (rms)"
        values["left_percent"] = fit.misfit_percent
    if rated:
        flux_difference = fit.flux(current)[0] - energy.flux(current)[0]
        deviation_percent = 100.0 / rated * float(np.sqrt((flux_difference**2).sum(axis=1).mean()))
        good = deviation_percent < max_error_percent
        text += " and deviates from the flexible energy by {off_percent:.2f} % of the rated flux (rms): "
        text += "accurate enough to replace it" if good else "this motor saturates differently: use the map"
        values["off_percent"] = deviation_percent
    return (Remark.of("degree", text, **values),)

"""Shared by the energy estimators: the measurements that an energy is fitted to, and its flux map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from orchestrator.analysis import EnergyFit, FluxPath, Inductances, fit_energy
from orchestrator.numerics.surface import inside_hull, require_area
from orchestrator.numerics.types import Array
from plugins.estimators._maps import InjectedFlux, SteppedFlux, SweptFlux, as_map, grid_of, pm_flux
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.injection import InjectionEstimator
from protocols import Basis, EstimationContext, FluxMap, FluxMapEstimate, FluxPoints, NotMeasuredError, RecordingReader


class Energy(Protocol):
    """A fitted co-energy: flux and inductance with standard deviations at currents, shape (n, 2)."""

    def flux(self, at: Array) -> tuple[Array, Array]: ...

    def inductance(self, at: Array) -> tuple[Array, Array]: ...


class EnergyFlux(FluxMapEstimate):
    """A flux map with the energy fit that it comes from."""

    fit: EnergyFit


@dataclass(frozen=True)
class Measurements:
    """Inductances by injection, flux by integration and by voltage steps; None for each that was not measured.

    Attributes
    ----------
    current : array, shape (n, 2)
        All measured currents [A].
    segments : tuple of str
        The segment of each current.
    angles : array, shape (p,)
        Rotor angle of each inductance's segment.
    energy : EnergyFit or None
        The fit of an earlier estimator, if there is one.
    """

    injected: InjectedFlux | None
    swept: SweptFlux | None
    current: Array
    segments: tuple[str, ...]
    angles: Array
    energy: EnergyFit | None
    stepped: SteppedFlux | None = None

    @property
    def inductances(self) -> Inductances | None:
        return self.injected.inductances if self.injected else None

    @property
    def paths(self) -> tuple[FluxPath, ...]:
        swept = self.swept.paths if self.swept else ()
        return swept + self.stepped.fit.paths if self.stepped else swept

    def fit(self) -> EnergyFit:
        """The flexible energy: that of an earlier estimator, else fitted here."""
        if self.energy is not None:
            return self.energy
        return fit_energy(self.inductances, self.paths, rotor_angle_rad=self.angles)

    def points(self, energy: Energy, recording: RecordingReader) -> FluxPoints:
        """Flux of an energy at all measured currents."""
        psi = energy.flux(self.current)[0] + pm_flux(recording)
        return FluxPoints(i_dq=self.current, psi_dq=psi, segment=self.segments)

    def misfit(self, energy: Energy) -> Array | None:
        """Residual flux of the sweeps against an energy, each path's mean removed, shape (m, 2) [Wb]."""
        if not self.paths:
            return None
        residuals = [path.psi - energy.flux(path.current)[0] for path in self.paths]
        return np.concatenate([one - one.mean(axis=0) for one in residuals])


def energy_measurements(recording: RecordingReader, context: EstimationContext) -> Measurements:
    """Results of the other estimators, computed here where the context lacks them.

    Raises
    ------
    NotMeasuredError
        Where neither injection nor sweeps span an area of currents that contains zero.
    """
    injected, swept = context.latest(InjectedFlux), context.latest(SweptFlux)
    problems = []
    if swept is None:
        try:
            swept = ClassicalEstimator().estimate(recording, context)
            context = EstimationContext((*context.estimates, swept))
        except NotMeasuredError as error:
            problems.append(error.problem)
    if injected is None:
        try:
            injected = InjectionEstimator().estimate(recording, context)
        except NotMeasuredError as error:
            problems.append(error.problem)
    where = recording.manifest.name
    if injected is None and swept is None:
        raise NotMeasuredError(where, "segments", "; ".join(problems))
    stepped = context.latest(SteppedFlux)
    sources = [source for source in (injected, swept, stepped) if source is not None]
    current = np.concatenate([source.points.i_dq.astype(np.float64) for source in sources])
    require_area(current, where)
    if not inside_hull(current, np.zeros((1, 2)), where)[0]:
        raise NotMeasuredError(where, "segments", "zero current lies outside the measured points")
    angle = {segment.id: segment.rotor_angle_rad for segment in recording.manifest.segments}
    fitted = context.latest(EnergyFlux)
    return Measurements(
        injected=injected,
        swept=swept,
        current=current,
        segments=tuple(name for source in sources for name in source.points.segment),
        angles=np.array([angle[name] for name in injected.points.segment] if injected else []),
        energy=None if fitted is None else fitted.fit,
        stepped=stepped,
    )


def gridded(method: str, recording: RecordingReader, energy: Energy, current: Array) -> FluxMap:
    """The map of an energy over the convex hull of the measured currents."""
    axes, nodes = grid_of(current)
    inside = inside_hull(current, nodes, recording.manifest.name)
    values, stds = np.full((len(nodes), 5), np.nan), np.full((len(nodes), 5), np.nan)
    flux, inductance = energy.flux(nodes[inside]), energy.inductance(nodes[inside])
    values[inside] = np.column_stack([flux[0], inductance[0]])
    stds[inside] = np.column_stack([flux[1], inductance[1]])
    return as_map(method, Basis.ENERGY, recording.manifest.motor, axes, values, stds)

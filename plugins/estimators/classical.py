"""Flux map by the classical method: the voltage of swept currents integrated over time.

The sweeps also determine the voltage losses of inverter and copper. Rising and falling branches are
averaged, paths are aligned where they cross, and zero current has zero flux (Combes, Malrait, Martin, Rouchon,
"Obtaining the current-flux relations of the saturated PMSM by signal injection", section "Classical method").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from orchestrator.analysis import (
    KNOTS,
    NO_LOSS,
    Network,
    Sweep,
    VoltageLosses,
    check_map,
    close_loops,
    each_capture,
    flux_from_dwells,
    join_paths,
    reference_flux_wb,
    sweep_of,
    trace_sweep,
)
from orchestrator.numerics.surface import SmoothSurface, inside_hull, require_area
from orchestrator.numerics.types import Array
from plugins.estimators._maps import SweptFlux, as_map, grid_of, pm_flux, voltage_delay
from protocols import (
    Basis,
    Estimate,
    EstimationContext,
    FluxMap,
    FluxPoints,
    NotMeasuredError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    Segment,
    SegmentStage,
)


@dataclass(frozen=True)
class ClassicalEstimator:
    """psi = integral of (v - R_s i), averaged over periods and over both directions of the sweep.

    Attributes
    ----------
    smoothing : float
        Smoothing of the surface through the paths, whose flux differs slightly where they cross.
    thinning : int
        The surface is fitted to every n-th point of a path; neighbours are redundant.
    unseen_loss_ratio : float
        Share of an inverter's loss that opens no loop and is therefore unobservable.
    min_loss_ratio : float
        Inverter loss over R_s times the largest current, below which no remark reports it.
    draws : int
        Random draws of the flux errors, which give the derivatives' standard deviations to 1 / sqrt(2 draws).
    """

    smoothing: float = 1e-4
    thinning: int = 3
    hidden_loss_ratio: float = 0.003
    min_loss_ratio: float = 0.005
    draws: int = 24

    name: ClassVar[str] = "classical"
    summary: ClassVar[str] = "flux map by time integration of the voltage over swept currents"
    requires: ClassVar[tuple[type[Estimate], ...]] = (ResistanceEstimate,)
    produces: ClassVar[type[Estimate]] = SweptFlux
    rank: ClassVar[int] = 10

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> SweptFlux:
        """Make the map; raises `NotMeasuredError` where the sweeps do not span an area of currents."""
        segments = recording.segments(SegmentStage.CLASSICAL)
        if not segments:
            raise NotMeasuredError(recording.manifest.name, "segments", "no segment of stage classical")
        swept = self._sweep(recording, segments, context.resistance)
        sweeps = swept.sweeps
        network = join_paths([sweep.path for sweep in sweeps])
        current = np.concatenate([path.current for path in network.paths])
        require_area(current, recording.manifest.name)
        flux_map, origin = self._gridded(recording, network)
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        points = FluxPoints(
            i_dq=current,
            psi_dq=np.concatenate([path.psi for path in network.paths]) - origin + pm_flux(recording),
            segment=tuple(
                segments[member].id
                for member, path in zip(network.members, network.paths, strict=True)
                for _ in range(len(path.current))
            ),
        )
        return SweptFlux(
            map=flux_map,
            points=points,
            checks=check_map(flux_map, rated, network.misfit),
            remarks=_remarks(swept, network, rated),
            paths=network.paths,
            loss=swept.losses.phase if swept.has_loss else NO_LOSS,
        )

    def _sweep(
        self, recording: RecordingReader, segments: Sequence[Segment], resistance: ResistanceEstimate | None
    ) -> _Swept:
        delay = voltage_delay(recording)
        knots_a = KNOTS * float(np.linalg.norm(recording.load(segments[0]).i_ab, axis=1).max())
        traces = each_capture(
            recording,
            segments,
            lambda s, c: trace_sweep(c, s.rotor_angle_rad, delay=delay, knots_a=knots_a, where=s.id),
        )
        losses = close_loops(traces, knots_a)
        return _Swept(
            losses=losses,
            with_model=[sweep_of(trace, losses.flux(trace)) for trace in traces],
            resistive=[sweep_of(t, flux_from_dwells(t, _nearest_ohm(resistance, t.start_s))) for t in traces],
            hidden_loss_ratio=self.hidden_loss_ratio,
            min_loss_ratio=self.min_loss_ratio,
        )

    def _gridded(self, recording: RecordingReader, network: Network) -> tuple[FluxMap, Array]:
        """The map, and the flux of the paths at zero current, which is subtracted [Wb]."""
        where = recording.manifest.name
        current = np.concatenate([path.current[:: self.thinning] for path in network.paths])
        draws = self._error_draws(network)
        values = np.concatenate([np.concatenate([path.psi[:: self.thinning] for path in network.paths]), draws], axis=1)
        axes, nodes = grid_of(current)
        inside = inside_hull(current, np.concatenate([nodes, np.zeros((1, 2))]), where)
        if not inside[-1]:
            raise NotMeasuredError(
                where, "segments", "zero current lies outside the swept currents: no flux to start from"
            )
        surface = SmoothSurface(current, values, self.smoothing)
        inner_nodes = nodes[inside[:-1]]
        level = surface(np.zeros((1, 2)))
        psi, slopes = surface(inner_nodes) - level, surface.gradient(inner_nodes)
        columns = np.full((len(nodes), 5), np.nan)
        spreads = np.full((len(nodes), 5), np.nan)
        columns[inside[:-1]] = _quantities(psi[:, :2], slopes[:, :2])
        quantities = [_quantities(psi[:, k : k + 2], slopes[:, k : k + 2]) for k in range(2, values.shape[1], 2)]
        spreads[inside[:-1]] = np.sqrt(np.mean(np.square(quantities), axis=0))
        return as_map("classical", Basis.INTEGRATION, recording.manifest.motor, axes, columns, spreads), level[0, :2]

    def _error_draws(self, network: Network) -> Array:
        """Random errors of the paths' flux by their scatter and their misfit at crossings, columns (d, q) per draw."""
        random = np.random.default_rng(1)
        flux_changes = np.sqrt(0.5 * (network.misfit**2).mean(axis=0)) if network.misfit is not None else np.zeros(2)
        columns = []
        for path in network.paths:
            phase = np.linspace(0.0, np.pi, len(path.current))[:: self.thinning]
            # Scatter between branches is integrated drift and noise, hence smooth along the path.
            shapes = np.stack([np.cos(k * phase) for k in range(1, 5)], axis=1) / np.sqrt(2.0)
            smooth = np.einsum("mk,bkx->mbx", shapes, random.normal(size=(self.draws, 4, 2))) * path.std
            offset = random.normal(size=(1, self.draws, 2)) * flux_changes
            columns.append((smooth + offset).reshape(len(phase), 2 * self.draws))
        return np.concatenate(columns)


@dataclass(frozen=True)
class _Swept:
    """All sweeps: `with_model` less the fitted inverter model's voltage, `resistive` less the R_s i of the dwells."""

    losses: VoltageLosses
    with_model: list[Sweep]
    resistive: list[Sweep]
    hidden_loss_ratio: float
    min_loss_ratio: float

    @property
    def uses_model(self) -> bool:
        return _widest(self.with_model) <= _widest(self.resistive)

    @property
    def has_loss(self) -> bool:
        """Whether the inverter model reduces the loops significantly."""
        drop_v = self.losses.node_ohm.max() * self.losses.knots_a[-1] / KNOTS[-1]
        significant = float(np.abs(self.losses.error_v).max()) > self.min_loss_ratio * drop_v
        return significant and self.uses_model and _widest(self.with_model) < 0.5 * _widest(self.resistive)

    @property
    def sweeps(self) -> list[Sweep]:
        if not self.uses_model:
            return self.resistive
        return [_widened(*both, self.hidden_loss_ratio) for both in zip(self.with_model, self.resistive, strict=True)]


def _widened(sweep: Sweep, resistive: Sweep, hidden_loss_ratio: float) -> Sweep:
    """A sweep whose standard deviation includes a share of the inverter model's correction."""
    # A phase current that stalls near zero does so in both directions: an error of the inverter's shape there opens no
    # loop and remains in the mean.
    hidden_wb = hidden_loss_ratio * np.abs(resistive.loop_wb - sweep.loop_wb)
    return replace(sweep, path=replace(sweep.path, std=np.hypot(sweep.path.std, hidden_wb)))


def _widest(sweeps: list[Sweep]) -> float:
    return max(float(sweep.loop_wb.max()) for sweep in sweeps)


def _nearest_ohm(resistance: ResistanceEstimate | None, start_s: float) -> float | None:
    """Median of the four R_s readings nearest in time, since R_s drifts with temperature."""
    if resistance is None:
        return None
    nearest = sorted(resistance.readings, key=lambda reading: abs(reading.start_s - start_s))[:4]
    return float(np.median([reading.value_ohm for reading in nearest])) if nearest else resistance.value_ohm


def _quantities(psi: Array, slope: Array) -> Array:
    """psi_d, psi_q, l_dd, l_dq (mean of both mutual slopes), l_qq."""
    mutual = 0.5 * (slope[:, 0, 1] + slope[:, 1, 0])
    return np.column_stack([psi, slope[:, 0, 0], mutual, slope[:, 1, 1]])


def _remarks(swept: _Swept, network: Network, rated: float | None) -> tuple[Remark, ...]:
    remarks = []
    left_out = len(swept.sweeps) - len(network.paths)
    if left_out:
        text = "{left_out} of {sweeps} sweeps cross no other sweep and are left out"
        remarks.append(Remark.of("sweeps_left_out", text, left_out=left_out, sweeps=len(swept.sweeps)))
    if not rated:
        return tuple(remarks)
    modelled_percent, resistive = (100 * _widest(sweeps) / rated for sweeps in (swept.with_model, swept.resistive))
    error_v = float(np.abs(swept.losses.error_v).max())
    if swept.has_loss:
        flux_changes = [a.path.psi - b.path.psi for a, b in zip(swept.with_model, swept.resistive, strict=True)]
        moved = np.concatenate([one - one.mean(axis=0) for one in flux_changes])
        mean = 100 / rated * float(np.sqrt((moved**2).sum(axis=1).mean()))
        text = (
            "each phase loses up to {lost_v:.2f} V, estimated from the loops and corrected; without the correction "
            "rising and falling branches would differ by up to +-{apart_percent:.0f} % of the rated flux and their "
            "mean would change by {mean_percent:.1f} % (rms)"
        )
        remarks.append(Remark.of("inverter_loss", text, lost_v=error_v, apart_percent=resistive, mean_percent=mean))
    widest = modelled_percent if swept.uses_model else resistive
    if widest > 2.0:
        text = (
            "rising and falling branches still differ by up to +-{apart_percent:.1f} % of the rated flux: "
            "another voltage error, or hysteresis; their mean is used"
        )
        remarks.append(Remark.of("branches_differ", text, apart_percent=widest))
    return tuple(remarks)

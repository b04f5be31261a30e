"""Magnet flux and flux map of a turning rotor by its back-EMF, compared with the map at standstill.

Without current (bridge off, terminal voltage measured) the back-EMF gives the magnet flux, the true direction of the
d axis, and a check of phase order and pole pairs (`orchestrator.analysis.fit_spin`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orchestrator.analysis import (
    SpinFit,
    SpunPoints,
    check_map,
    each_capture,
    fit_spin,
    flux_at,
    flux_by_emf,
    magnet_axis,
    reference_flux_wb,
    require_emf_follows_angle,
    rotor_angles_rad,
    spun_points,
)
from orchestrator.numerics.surface import require_area
from plugins.estimators._energies import EnergyFlux, gridded
from plugins.estimators._maps import SteppedFlux, SweptFlux, pm_flux, voltage_delay
from plugins.estimators.resistance import ResistanceEstimator
from protocols import (
    Capture,
    Estimate,
    EstimationContext,
    FluxMap,
    FluxMapEstimate,
    FluxPoints,
    NotMeasuredError,
    RecordingReader,
    Remark,
    Segment,
    SegmentStage,
)


@dataclass(frozen=True)
class SpinEstimator:
    """psi_d = (v_q - R i_q) / w, psi_q = -(v_d - R i_d) / w, in means over whole turns, fitted by one energy.

    Attributes
    ----------
    zero_current_ratio : float
        Current over the rated one, below which the EMF is attributed to the magnet alone.
    resistance_std_ratio : float
        Relative standard deviation of R_s about the value measured or stated before: 2.5 K of copper.
    significance_sigmas : float
        Standard deviations from which on a remark reports a value.
    min_remark_rad : float
        Angle offset from which on a remark reports it.
    """

    zero_current_ratio: float = 0.02
    resistance_std_ratio: float = 0.01
    significance_sigmas: float = 4.0
    min_remark_rad: float = 0.005

    name: ClassVar[str] = "spin"
    summary: ClassVar[str] = "magnet flux and flux map by the back-EMF of a rotor that turns"
    requires: ClassVar[tuple[type[Estimate], ...]] = (EnergyFlux, SteppedFlux, SweptFlux)
    produces: ClassVar[type[Estimate]] = FluxMapEstimate
    reads: ClassVar[tuple[SegmentStage, ...]] = (SegmentStage.SPIN,)
    rank: ClassVar[int] = 5

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> FluxMapEstimate:
        """Make the map.

        Raises
        ------
        NotMeasuredError
            Where nothing turns, the angle is not known, or phase order or pole pairs are wrong.
        """
        where, segments = recording.manifest.name, recording.segments(SegmentStage.SPIN)
        if not segments:
            raise NotMeasuredError(where, "segments", "no segment of stage spin")
        rated_a, delay = recording.manifest.motor.rated_current_a, voltage_delay(recording)
        zero_current_a = self.zero_current_ratio * (rated_a or 0.0)
        largest_a = max(each_capture(recording, segments, lambda _, c: float(np.linalg.norm(c.i_ab, axis=1).max())))
        scale_a = max(largest_a, zero_current_a)

        def points_of(segment: Segment, capture: Capture) -> SpunPoints:
            theta = rotor_angles_rad(segment, capture)
            require_emf_follows_angle(segment, capture)
            bridge = segment.settings.get("bridge")
            held = bridge == "on" if bridge else float(np.abs(capture.i_ab).max()) > zero_current_a
            return spun_points(capture, theta, delay=delay if held else None, scale_a=scale_a or 1.0, where=segment.id)

        points_by_segment = each_capture(recording, segments, points_of)
        columns = ("i", "v", "speed", "loss", "time_s")
        points = SpunPoints(*(np.concatenate([getattr(p, name) for p in points_by_segment]) for name in columns))
        names = [s.id for s, p in zip(segments, points_by_segment, strict=True) for _ in range(len(p.i))]
        if float(np.linalg.norm(points.i, axis=1).max()) <= zero_current_a:
            return self._magnet(recording, points, names)
        require_area(points.i, where)
        known = ResistanceEstimator().estimate(recording, EstimationContext())
        std = float(np.hypot((known.high - known.low) / 3.92, self.resistance_std_ratio * known.value_ohm))
        fit = fit_spin(points, (known.value_ohm, std))
        flux_map = gridded("spin", recording, fit.energy, points.i)
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        return FluxMapEstimate(
            map=flux_map,
            points=FluxPoints(
                i_dq=points.i, psi_dq=fit.energy.flux(points.i)[0] + pm_flux(recording), segment=tuple(names)
            ),
            checks=check_map(flux_map, rated, fit.residual_wb),
            remarks=(
                *self._remarks(fit, recording.manifest.motor.pm_flux_wb),
                *_beside_standstill(flux_map, context, rated),
            ),
        )

    def _magnet(self, recording: RecordingReader, points: SpunPoints, names: Sequence[str]) -> FluxMapEstimate:
        """A map with one point, the magnet flux, where no current was measured."""
        psi = flux_by_emf(points, 0.0)
        angle = magnet_axis(points, 0.0)
        along = np.linalg.norm(psi, axis=1)
        flux, std = float(along.mean()), float(along.std() / max(len(along) - 1, 1) ** 0.5)
        nan = np.full((1, 1), np.nan)
        zero = np.zeros(1)
        flux_map = FluxMap(
            method="spin",
            i_d=zero,
            i_q=zero,
            psi_d=np.full((1, 1), flux),
            psi_q=np.zeros((1, 1)),
            psi_d_std=np.full((1, 1), std),
            psi_q_std=np.full((1, 1), std),
            **dict.fromkeys(("l_dd", "l_dq", "l_qq", "l_dd_std", "l_dq_std", "l_qq_std"), nan),
        )
        remarks = [_magnet_remark((flux, std), recording.manifest.motor.pm_flux_wb)]
        if abs(angle) > self.min_remark_rad:
            remarks.append(_offset_remark(angle))
        shown = FluxPoints(i_dq=points.i, psi_dq=psi, segment=tuple(names))
        checks = check_map(flux_map, None, None)
        return FluxMapEstimate(map=flux_map, points=shown, checks=checks, remarks=tuple(remarks))

    def _remarks(self, fit: SpinFit, stated: float | None) -> list[Remark]:
        remarks = [_magnet_remark(fit.magnet_wb, stated)]
        ohm, std = fit.resistance_ohm
        text = "R_s = {value_ohm:.4g} ohm (+-{std_ohm:.1g}) by the back-EMF's symmetry in i_q and its speeds"
        remarks.append(Remark.of("resistance_by_emf", text, value_ohm=ohm, std_ohm=std))
        angle, std = fit.angle_rad
        if abs(angle) > max(self.min_remark_rad, self.significance_sigmas * std):
            remarks.append(_offset_remark(angle))
        conductance, std = fit.conductance_s
        if conductance > self.significance_sigmas * std:
            text = "iron loss of {loss_ohm:.0f} ohm parallel to the magnetising inductance; corrected"
            remarks.append(Remark.of("iron_loss", text, loss_ohm=1.0 / conductance))
        volts, std = fit.loss_v
        if abs(volts) > self.significance_sigmas * std:
            text = "each phase loses {kept_v:.2f} V (+-{std_v:.1g}) in the inverter; corrected"
            remarks.append(Remark.of("inverter_loss", text, kept_v=volts, std_v=std))
        return remarks


def _magnet_remark(magnet: tuple[float, float], stated: float | None) -> Remark:
    text = "psi_M = {flux_wb:.4g} Wb (+-{std_wb:.1g}) by the back-EMF"
    values = {"flux_wb": magnet[0], "std_wb": magnet[1]}
    if stated:
        text += ", {ratio:.4g} times the nameplate's"
        values["ratio"] = magnet[0] / stated
    return Remark.of("magnet_flux", text, **values)


def _offset_remark(angle_rad: float) -> Remark:
    text = "the magnet lies {angle_deg:+.2f} degrees (electrical) from the believed d axis"
    if abs(angle_rad) > 0.5 * np.pi:
        text += ": the angle's zero or the polarity is wrong"
    return Remark.of("angle_offset", text, angle_deg=float(np.degrees(angle_rad)))


def _beside_standstill(spun: FluxMap, context: EstimationContext, rated: float | None) -> list[Remark]:
    """Remark on the difference from the map at standstill, where both are known."""
    standstill = next((one.map for kind in (EnergyFlux, SteppedFlux, SweptFlux) for one in context.of(kind)), None)
    if standstill is None or not rated:
        return []
    grid = np.stack(np.meshgrid(spun.i_d, spun.i_q, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float64)
    zero = np.zeros((1, 2))
    changes = [flux_at(one)(grid) - flux_at(one)(zero) for one in (spun, standstill)]
    distance_wb = np.linalg.norm(changes[0] - changes[1], axis=1)
    if not np.isfinite(distance_wb).any():
        return []
    text = "the flux differs from that at standstill by {apart_percent:.2f} % of the rated flux (rms)"
    rms_wb = float(np.sqrt(np.nanmean(distance_wb**2)))
    return [Remark.of("beside_standstill", text, apart_percent=100.0 * rms_wb / rated)]

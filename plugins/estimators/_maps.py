"""Shared by the map estimators: flux convention and grid of a map, and the measurements behind it."""

from __future__ import annotations

import numpy as np

from orchestrator.analysis import NO_LOSS, FluxPath, Inductances, PhaseLoss, StepsFit
from orchestrator.numerics.surface import current_axes
from orchestrator.numerics.types import Array
from protocols import Basis, FluxMap, FluxMapEstimate, Motor, RecordingReader, Remark

QUANTITIES = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")


class SweptFlux(FluxMapEstimate):
    """A map by integration, with its paths and the inverter's loss where that is identified."""

    paths: tuple[FluxPath, ...]
    loss: PhaseLoss = NO_LOSS


class SteppedFlux(FluxMapEstimate):
    """A map by voltage steps, with their joint fit and the start of the first step."""

    fit: StepsFit
    start_s: float


class InjectedFlux(FluxMapEstimate):
    """A map by injection, with its inductances."""

    inductances: Inductances


def grid_of(points: Array) -> tuple[tuple[Array, Array], Array]:
    """Axes over the points, and all their nodes, shape (n_d * n_q, 2)."""
    axes = current_axes(points)
    return axes, np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def as_map(method: str, basis: Basis, motor: Motor, axes: tuple[Array, Array], values: Array, stds: Array) -> FluxMap:
    """A map from columns psi_d, psi_q, l_dd, l_dq, l_qq at the nodes; psi without the magnet's flux."""
    shape = (len(axes[0]), len(axes[1]))
    fields = {name: values[:, k].reshape(shape) for k, name in enumerate(QUANTITIES)}
    fields["psi_d"] = fields["psi_d"] + (motor.pm_flux_wb or 0.0)
    spreads = {f"{name}_std": stds[:, k].reshape(shape) for k, name in enumerate(QUANTITIES)}
    return FluxMap(method=method, basis=basis, i_d=axes[0], i_q=axes[1], **fields, **spreads)


def voltage_delay(recording: RecordingReader) -> float:
    """Declared delay n in samples: v[k] acts from t_k + n Ts."""
    return recording.manifest.drive.voltage_delay_samples or 0.0


def pm_flux(recording: RecordingReader) -> Array:
    """Magnet flux (psi_M, 0) by the nameplate, zero where that lacks it, shape (2,) [Wb]."""
    return np.array([recording.manifest.motor.pm_flux_wb or 0.0, 0.0])


def axis_turned(angle_rad: float) -> Remark:
    """Remark on a map whose axis of symmetry is not the believed d axis."""
    text = (
        "the map is symmetric about an axis {angle_deg:+.2f} degrees (electrical) from the "
        "believed d axis: is the rotor angle right? The map stays in the believed frame"
    )
    return Remark.of("axis_turned", text, angle_deg=float(np.degrees(angle_rad)))

"""The picture of a tuning: torque over speed, references in the current plane, inverter's loss, injection's error,
and what the tuning changes."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.formatting.colours import BLUE, MODEL, Q_AXIS, VERMILION
from orchestrator.formatting.drawing import CURRENT_LABELS, STYLE, bare, empty_figure, name_axes
from orchestrator.tuning.benefits import ripple_of
from orchestrator.tuning.drive_tuning import DriveTuning

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def tuning_picture(tuning: DriveTuning) -> bytes:
    """The picture as SVG, the same bytes for the same tuning."""
    buffer = io.BytesIO()
    figure_of(tuning).savefig(buffer, format="svg", dpi=STYLE.dpi, metadata={"Date": None})
    return buffer.getvalue()


def figure_of(tuning: DriveTuning) -> Figure:
    """The figure, six axes."""
    figure = empty_figure(2.0 * STYLE.width_in, 3.0 * STYLE.height_in)
    axes = figure.subplots(3, 2)
    _torque(bare(axes[0, 0]), tuning)
    _references(bare(axes[0, 1]), tuning)
    _loss(bare(axes[1, 0]), tuning)
    _injection(figure, bare(axes[1, 1]), tuning)
    _torque_error(bare(axes[2, 0]), tuning)
    _ripple(bare(axes[2, 1]), tuning)
    figure.suptitle("\n".join(tuning.machine.basis), fontsize=STYLE.small_pt)
    return figure


def _torque(axes: Axes, tuning: DriveTuning) -> None:
    speeds, torques = tuning.whole_torque_curve
    limit = tuning.limits.speed_rad_s
    inside = speeds[speeds <= limit]
    at_limit = float(np.interp(limit, speeds, torques))
    axes.plot(
        [*map(tuning.rpm, inside), tuning.rpm(limit)], [*torques[: len(inside)], at_limit], color=MODEL, lw=1.6,
        label="up to the largest speed",
    )  # fmt: skip
    if limit < speeds[-1]:
        axes.plot(
            [tuning.rpm(limit), *map(tuning.rpm, speeds[len(inside) :])], [at_limit, *torques[len(inside) :]], ":",
            color=MODEL, lw=1.4, label="what voltage and current allow beyond",
        )  # fmt: skip
        axes.legend(fontsize=0.8 * STYLE.small_pt, loc="lower left")
    axes.set_title("largest torque", fontsize=STYLE.normal_pt)
    name_axes(axes, "speed [rpm]", "torque [Nm]")
    axes.set_ylim(bottom=0.0)


def _references(axes: Axes, tuning: DriveTuning) -> None:
    references = tuning.references
    for k in np.unique(np.linspace(0, len(references.psi_limit_wb) - 1, 5).astype(int)):
        last = k == len(references.psi_limit_wb) - 1
        i_d, i_q = references.i_dq_a[k].T
        label = "least current (MTPA)" if last else f"{1e3 * references.psi_limit_wb[k]:.0f} mWb"
        axes.plot(i_d, i_q, "-" if last else ":", color=Q_AXIS if last else MODEL, lw=1.6 if last else 1.2, label=label)
    angle = np.linspace(0.0, math.pi, 181)
    limit = tuning.limits.current_a
    axes.plot(limit * np.cos(angle), limit * np.sin(angle), color=VERMILION, lw=0.8, label="current limit")
    axes.set_aspect("equal")
    axes.set_title("current references by flux limit", fontsize=STYLE.normal_pt)
    name_axes(axes, CURRENT_LABELS["d"], CURRENT_LABELS["q"])
    axes.legend(fontsize=0.8 * STYLE.small_pt, loc="lower right")


def _loss(axes: Axes, tuning: DriveTuning) -> None:
    held = tuning.compensation
    axes.plot(held.current_a, held.lost_v + tuning.limits.bus_v * held.lost_per_bus_v, color=MODEL, lw=1.6)
    axes.set_title("compensation of a leg", fontsize=STYLE.normal_pt)
    name_axes(axes, "phase current [A]", "voltage to add [V]")
    _say_if_nothing(axes, tuning)


def _injection(figure: Figure, axes: Axes, tuning: DriveTuning) -> None:
    held = tuning.sensorless
    plane = np.stack(np.meshgrid(held.i_d_a, held.i_q_a, indexing="ij"), axis=-1)
    inside = tuning.machine.inside(plane.reshape(-1, 2)).reshape(plane.shape[:2])
    error = np.degrees(np.where(inside, held.injection_error_rad, np.nan))
    largest = float(np.nanmax(np.abs(error))) if np.isfinite(error).any() else 1.0
    mesh = axes.pcolormesh(
        held.i_d_a, held.i_q_a, error.T, cmap="RdBu_r", vmin=-largest, vmax=largest, shading="nearest", rasterized=True
    )
    bar = figure.colorbar(mesh, ax=axes)
    bar.ax.tick_params(labelsize=STYLE.small_pt)
    lost = inside & ~held.works
    if lost.any():
        rows, columns = np.nonzero(lost)
        axes.plot(held.i_d_a[rows], held.i_q_a[columns], "x", color=VERMILION, ms=4, label="does not work")
        axes.legend(fontsize=0.8 * STYLE.small_pt, loc="lower right")
    axes.set_title("position error of injection, not compensated [°]", fontsize=STYLE.normal_pt)
    name_axes(axes, CURRENT_LABELS["d"], CURRENT_LABELS["q"])


def _torque_error(axes: Axes, tuning: DriveTuning) -> None:
    held = tuning.benefits
    largest = held.wanted_nm[-1]
    by_constants, by_map = (100.0 * (x - held.wanted_nm) / largest for x in (held.by_constants_nm, held.by_map_nm))
    axes.plot(held.wanted_nm, by_constants, ":", color=BLUE, lw=1.4, label="constant inductances")
    axes.plot(held.wanted_nm, by_map, color=MODEL, lw=1.6, label="flux map")
    axes.set_title("error of the torque by its references", fontsize=STYLE.normal_pt)
    name_axes(axes, "wanted torque [Nm]", "error [% of the largest]")
    axes.legend(fontsize=0.8 * STYLE.small_pt, loc="best")


def _ripple(axes: Axes, tuning: DriveTuning) -> None:
    held = tuning.benefits
    turn, without, left = np.degrees(held.angle_rad), ripple_of(held.wave_without_a), ripple_of(held.wave_a)
    axes.plot(turn, 1e3 * without, ":", color=BLUE, lw=1.4, label="without compensation")
    axes.plot(turn, 1e3 * left, color=MODEL, lw=1.6, label="with compensation")
    speed = f"{tuning.rpm(held.speed_rad_s):.0f} rpm"
    axes.set_title(f"harmonics of the phase current at {speed}, simulated", fontsize=STYLE.normal_pt)
    name_axes(axes, "electrical angle [°]", "current less its fundamental [mA]")
    axes.legend(fontsize=0.8 * STYLE.small_pt, loc="upper left")
    _say_if_nothing(axes, tuning)


def _say_if_nothing(axes: Axes, tuning: DriveTuning) -> None:
    """Write into axes without a curve that there is nothing to compensate."""
    held = tuning.compensation
    if np.any(held.lost_v) or np.any(held.lost_per_bus_v):
        return
    axes.set_ylim(-1.0, 1.0)
    axes.text(
        0.5, 0.6, "no loss of the inverter is known", ha="center", transform=axes.transAxes, fontsize=STYLE.small_pt
    )

"""Data of the page: one run of the paper's procedure, estimated again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator.analysis import (
    KNOTS,
    SweepTrace,
    VoltageLosses,
    close_loops,
    difference_percent,
    flux_at,
    rated_flux_wb,
    sweep_of,
    trace_sweep,
)
from orchestrator.engine import UsedPlugins
from orchestrator.estimation import estimate_recording
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from orchestrator.recording import Recording, open_recording
from orchestrator.runs import RunDirectory
from orchestrator.stages import parse_stages
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions, TrueMagnetics, true_flux
from protocols import (
    Estimate,
    FluxMap,
    FluxMapEstimate,
    Motor,
    RecordingError,
    ResistanceEstimate,
    Segment,
    SegmentStage,
)

NEEDED = ("classical", "injection", "energy")


@dataclass(frozen=True)
class Loop:
    """Flux along one axis at zero current on the other, by three evaluations, each with zero initial flux.

    Attributes
    ----------
    axis : {"d", "q"}
    current : array, shape (n,)
    uncompensated, compensated : array, shape (n,)
        Integrated over all periods in succession [Wb].
    mean_current, mean : array, shape (m,)
        Average over points of equal current, zero at zero current.
    """

    axis: str
    current: Array
    uncompensated: Array
    compensated: Array
    mean_current: Array
    mean: Array


@dataclass(frozen=True)
class Material:
    """One run of the procedure, evaluated.

    Attributes
    ----------
    motor : Motor
    resistance_ohm : tuple of float
        R_s at the beginning and at the end of the classical sweep.
    estimates : dict of FluxMapEstimate
        Estimates by method.
    difference_percent : float or None
        Rms difference of the maps by the classical method and by injection.
    trajectories : tuple of array, shape (n, 3)
        Time and current (d, q) of one period: along q, along d, along both axes.
    sweeps : tuple of array, shape (n, 4)
        Current and flux (d, q) along each classical path, averaged.
    loops : tuple of Loop
    truth : TrueMagnetics
        The plant's magnetics, for the last table of the page only.
    samples : int
    """

    motor: Motor
    resistance_ohm: tuple[float, float]
    estimates: dict[str, FluxMapEstimate]
    difference_percent: float | None
    trajectories: tuple[Array, ...]
    sweeps: tuple[Array, ...]
    loops: tuple[Loop, ...]
    truth: TrueMagnetics
    samples: int

    @property
    def rated_wb(self) -> float:
        """The plant's |psi(rated i_q) - psi(0, 0)|, the reference of percentages [Wb]."""
        ends = self.truth.flux(np.array([[0.0, self.motor.rated_current_a or 1.0], [0.0, 0.0]]))
        return float(np.linalg.norm(ends[0] - ends[1]))

    def error_percent(self, method: str) -> tuple[float, float]:
        """Rms and largest distance of a map from the plant's, over its grid, in percent of the rated flux."""
        grid = self.estimates[method].map
        nodes = np.stack(np.meshgrid(grid.i_d, grid.i_q, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float64)
        psi = np.column_stack([grid.psi_d.ravel(), grid.psi_q.ravel()])
        inside = np.isfinite(psi).all(axis=1)
        zero = np.zeros((1, 2))
        estimated = psi[inside] - flux_at(grid)(zero)
        true = self.truth.flux(nodes[inside]) - self.truth.flux(zero)
        error_percent = 100.0 / self.rated_wb * np.linalg.norm(estimated - true, axis=1)
        return float(np.sqrt(np.mean(error_percent**2))), float(error_percent.max())


def collect(directory: Path) -> Material:
    """Evaluate a run of the paper's procedure.

    Raises
    ------
    RecordingError
        Where the run is not of the simulated drive, or lacks a sweep of the paper.
    """
    run = RunDirectory.open(directory)
    procedure = run.procedure()
    if procedure.drive.name != SimulatedDrive.name:
        raise RecordingError(str(directory / "run.json"), "procedure.drive", "a run on the simulated drive is expected")
    recording = open_recording(directory)
    estimates: list[Estimate] = []
    estimate_recording(
        recording, UsedPlugins(parse_stages(procedure)).of("estimators"), directory, on_estimate=estimates.append
    )
    maps = {e.map.method: e for e in estimates if isinstance(e, FluxMapEstimate)}
    resistances = [e for e in estimates if isinstance(e, ResistanceEstimate)]
    missing = [name for name in NEEDED if name not in maps]
    if missing or not resistances:
        lacking = ", ".join([*missing, *([] if resistances else ["resistance"])])
        raise RecordingError(str(directory), "segments", f"the paper's sweeps are expected; no estimate of {lacking}")
    motor = procedure.motor
    classical, injection = maps["classical"].map, maps["injection"].map
    segments = recording.segments(SegmentStage.CLASSICAL)
    traces, losses = _traces(recording, segments)
    start_s, end_s = segments[0].start_s, segments[-1].start_s
    during = [r.value_ohm for r in resistances[0].readings if start_s <= r.start_s <= end_s]
    during = during or [resistances[0].first_ohm, resistances[0].last_ohm]
    return Material(
        motor=motor,
        resistance_ohm=(during[0], during[-1]),
        estimates=maps,
        difference_percent=difference_percent(injection, classical, rated_flux_wb(injection, motor.rated_current_a)),
        trajectories=_trajectories(recording, segments),
        sweeps=_levelled(traces, losses, classical),
        loops=tuple(_loop(axis, _axis_trace(segments, traces, axis), losses) for axis in ("d", "q")),
        truth=true_flux(SimulatedOptions.model_validate(procedure.drive.options), motor),
        samples=sum(segment.samples for segment in recording.manifest.segments),
    )


def _traces(recording: Recording, segments: Sequence[Segment]) -> tuple[list[SweepTrace], VoltageLosses]:
    delay = recording.manifest.drive.voltage_delay_samples or 0.0
    captures = [recording.load(segment) for segment in segments]
    knots_a = KNOTS * max(float(np.linalg.norm(c.i_ab, axis=1).max()) for c in captures)
    traces = [
        trace_sweep(capture, segment.rotor_angle_rad, delay=delay, knots_a=knots_a, where=segment.id)
        for segment, capture in zip(segments, captures, strict=True)
    ]
    return traces, close_loops(traces, knots_a)


def _trajectories(recording: Recording, segments: Sequence[Segment]) -> tuple[Array, ...]:
    """The last period of one sweep of each kind."""
    out = []
    for axis in ("q", "d", "dq"):
        segment = next(s for s in segments if s.settings.get("swept_axis") == axis)
        capture = recording.load(segment)
        fs = capture.sampling_frequency_hz
        rows = round(float(segment.settings["period_s"]) * fs)
        current = to_dq(capture.i_ab[-rows:], segment.rotor_angle_rad)
        stride = max(1, rows // 800)
        out.append(np.column_stack([np.arange(0, rows, stride) / fs, current[::stride]]).astype(np.float64))
    return tuple(out)


def _axis_trace(segments: Sequence[Segment], traces: list[SweepTrace], axis: str) -> SweepTrace:
    """The sweep of one axis at zero current on the other."""
    on_axis = [
        (abs(float(segment.settings.get("held_a", 0.0))), n)
        for n, segment in enumerate(segments)
        if segment.settings.get("swept_axis") == axis
    ]
    return traces[min(on_axis)[1]]


def _levelled(traces: list[SweepTrace], losses: VoltageLosses, level: FluxMap) -> tuple[Array, ...]:
    """Current and mean flux along each path, with its constant from the map."""
    out = []
    for trace in traces:
        path = sweep_of(trace, losses.flux(trace)).path
        on_map = flux_at(level)(path.current) - flux_at(level)(np.zeros((1, 2)))
        out.append(np.column_stack([path.current, path.psi + np.nanmean(on_map - path.psi, axis=0)]))
    return tuple(out)


def _loop(axis: str, trace: SweepTrace, losses: VoltageLosses) -> Loop:
    column = "dq".index(axis)
    middle = trace.start_s + 0.5 * trace.time[-1]
    ohm = float(np.interp(middle, losses.node_s, losses.node_ohm))
    raw = trace.impulse - ohm * trace.charge
    compensated = losses.flux(trace)
    path = sweep_of(trace, compensated).path
    mean_current, mean = path.current[:, column], path.psi[:, column]
    order = np.argsort(mean_current)
    return Loop(
        axis=axis,
        current=trace.i[:, column],
        uncompensated=raw[:, column] - raw[0, column],
        compensated=compensated[:, column] - compensated[0, column],
        mean_current=mean_current,
        mean=mean - float(np.interp(0.0, mean_current[order], mean[order])),
    )

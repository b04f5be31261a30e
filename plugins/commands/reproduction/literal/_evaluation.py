"""Evaluation of the whole experiment as printed in the paper, and of its injection by fluxbench too.

Sweeps and operating points are processed one at a time; no waveforms are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis import FluxPath, Ripple, crossings_of, demodulate, integrate, invert
from orchestrator.numerics.types import Array
from plugins.commands.reproduction.literal._demodulation import VirtualMeasurement, hessian, virtual_measurement
from plugins.commands.reproduction.literal._integration import SweptPath, swept_path, tied
from plugins.commands.reproduction.literal._paths import Line, Rule, lines_of, summed
from protocols import Capture, NotMeasuredError, RecordingReader, Segment, SegmentStage

Measured = Sequence[tuple[Segment, Capture]]
"""A sweep, or all captures of one operating point."""
TrueFlux = Callable[[Array], Array]


@dataclass(frozen=True)
class Errors:
    """Inconsistencies and errors of flux paths.

    Attributes
    ----------
    crossings : array, shape (2,)
        Largest difference of psi_d and psi_q where two paths cross, in percent of the rated flux.
    relative : array, shape (2,)
        The same in percent of the flux at each crossing, except at small flux.
    rms, worst : float
        Distance from the true flux over all points, in percent of the rated flux.
    """

    crossings: Array
    relative: Array
    rms: float
    worst: float


@dataclass(frozen=True)
class Literal:
    """Evaluation of the experiment as printed.

    Attributes
    ----------
    sweeps : tuple of SweptPath
    closed : tuple of SweptPath
        The same with each sweep's drift removed.
    lines : tuple of Line
        Paths of the injection.
    current : array, shape (n, 2)
        Mean current of each operating point [A].
    hessian : array, shape (n, 2, 2)
        Hessians by the printed demodulator [A/Wb].
    ripples : tuple of Ripple or None
        The same points by fluxbench's regression; None for fixed vectors.
    signal : VirtualMeasurement
        Signal of the point with the largest residual of the Hessian's ripple.
    signal_hessian : array, shape (2, 2)
        Hessian of that point.
    """

    sweeps: tuple[SweptPath, ...]
    closed: tuple[SweptPath, ...]
    lines: tuple[Line, ...]
    current: Array
    hessian: Array
    ripples: tuple[Ripple, ...] | None
    signal: VirtualMeasurement
    signal_hessian: Array

    @property
    def inductance(self) -> Array:
        """L = H^-1 at each point, shape (n, 2, 2) [H]."""
        return np.asarray(np.linalg.inv(self.hessian), dtype=np.float64)

    @property
    def resistance_ohm(self) -> tuple[float, float]:
        """Smallest and largest v/i of the sweeps."""
        every = [sweep.resistance_ohm for sweep in self.sweeps]
        return min(every), max(every)

    def classical(self, *, closed: bool = False) -> list[FluxPath]:
        """Flux along each sweep by integration of the voltage, as printed or with its drift removed."""
        return tied(self.closed if closed else self.sweeps)

    def injection(self, rule: Rule = Rule.RECTANGLE) -> list[FluxPath]:
        """Flux along each path by sums of the printed demodulator's inductances."""
        return summed(self.lines, self.current, self.inductance, rule)

    def by_regression(self) -> list[FluxPath]:
        """Flux along each path by trapezoids over the inductances of the regression."""
        points = invert(list(self._regressed))
        return summed(self.lines, points.current, points.matrix, Rule.TRAPEZOID)

    def over_the_graph(self) -> FluxPath:
        """Flux of all points by least squares over neighbours with the inductances' slopes, as one path."""
        points = invert(list(self._regressed))
        return FluxPath(points.current, integrate(points, "injection").psi, np.zeros(2))

    @property
    def _regressed(self) -> tuple[Ripple, ...]:
        if self.ripples is None:
            raise NotMeasuredError("injection", "rotation_hz", "the regression needs a vector that turns")
        return self.ripples


def evaluate(measured: Iterable[Measured], *, regress: bool = True) -> Literal:
    """Evaluate an experiment incrementally.

    Parameters
    ----------
    measured : iterable
        Classical sweeps and operating points of the injection, in order.
    regress : bool
        Whether to apply the regression too; not possible with fixed vectors.

    Raises
    ------
    NotMeasuredError
        Where sweeps or paths are missing.
    """
    sweeps, closed, targets, current, hessians, ripples = [], [], [], [], [], []
    signal, worst = None, -1.0
    for parts in measured:
        segment, capture = parts[0]
        if segment.stage is SegmentStage.CLASSICAL:
            sweeps.append(swept_path(segment, capture))
            closed.append(swept_path(segment, capture, closed=True))
            continue
        angle = segment.rotor_angle_rad
        measurements = [virtual_measurement(*part, angle) for part in parts]
        targets.append([float(segment.settings[f"target_{axis}_a"]) for axis in "dq"])
        current.append(np.mean([one.mean.mean(axis=0) for one in measurements], axis=0))
        hessians.append(hessian(measurements))
        if regress:
            ripples.append(demodulate(capture, angle, where=segment.id))
        if (residual := _max_residual(measurements[0], hessians[-1])) > worst:
            signal, worst = (measurements[0], hessians[-1]), residual
    lines = lines_of(np.array(targets)) if len(targets) > 2 else []
    if signal is None or not lines or not sweeps:
        raise NotMeasuredError(
            "the paper's experiment", "segments", "classical sweeps and paths of injection are expected"
        )
    return Literal(
        sweeps=tuple(sweeps),
        closed=tuple(closed),
        lines=tuple(lines),
        current=np.array(current),
        hessian=np.array(hessians),
        ripples=tuple(ripples) if regress else None,
        signal=signal[0],
        signal_hessian=signal[1],
    )


def _max_residual(signal: VirtualMeasurement, matrix: Array) -> float:
    """Largest residual of the Hessian's ripple after the decay of the initial offset [A]."""
    settled = slice(len(signal.ripple) // 4, None)
    return float(np.abs(signal.ripple[settled] - signal.swing[settled] @ matrix).max())


def measured_in(recording: RecordingReader) -> Iterator[Measured]:
    """The sweeps and operating points of a recording, in order."""
    for segment in recording.segments(SegmentStage.CLASSICAL, SegmentStage.INJECTION):
        yield [(segment, recording.load(segment))]


def errors_of(paths: Sequence[FluxPath], true_flux: TrueFlux, rated_wb: float, *, small: float = 0.25) -> Errors:
    """Differences of paths at crossings, and from the truth.

    Parameters
    ----------
    paths : sequence of FluxPath
        Zero flux at zero current.
    true_flux : callable
        From currents to fluxes, shape (n, 2).
    rated_wb : float
    small : float
        Share of the rated flux below which crossings do not enter `relative`.
    """
    crossings = crossings_of(paths)
    difference, size = np.abs(crossings.difference), np.abs(crossings.psi)
    relative = np.where(size > small * rated_wb, difference / np.maximum(size, small * rated_wb), 0.0)
    current, psi = (np.concatenate([getattr(path, name) for path in paths]) for name in ("current", "psi"))
    error_wb = np.linalg.norm(psi - true_flux(current) + true_flux(np.zeros((1, 2))), axis=1)
    share = 100.0 / rated_wb
    return Errors(
        crossings=share * _largest(difference),
        relative=100.0 * _largest(relative),
        rms=share * float(np.sqrt(np.mean(error_wb**2))),
        worst=share * float(error_wb.max()),
    )


def _largest(x: Array) -> Array:
    """Largest value of each column; NaN without rows."""
    return np.asarray(x.max(axis=0)) if len(x) else np.full(2, np.nan)

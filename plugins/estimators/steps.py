"""Flux map and R_s by voltage steps: +-U on one axis or both, reversed at current limits, without a dwell.

One energy, R_s, the inverter's loss and the voltage's lag are fitted jointly to loops that have to close
(`orchestrator.analysis.fit_steps`). A prior on R_s, from holds or the nameplate, is weighted by its variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from orchestrator.analysis import (
    STEP_KNOTS,
    FluxPath,
    Priors,
    StepsFit,
    StepTrace,
    check_map,
    decay_weight,
    each_capture,
    exact_inductance,
    fit_steps,
    reference_flux_wb,
    trace_steps,
)
from orchestrator.config.time_constants import recording_notes
from orchestrator.numerics.surface import inside_hull, require_area
from orchestrator.numerics.types import Array
from plugins.estimators._energies import gridded
from plugins.estimators._maps import SteppedFlux, axis_turned, pm_flux, voltage_delay
from plugins.estimators.resistance import ResistanceEstimator
from protocols import (
    Capture,
    Estimate,
    EstimationContext,
    FluxMap,
    FluxPoints,
    NotMeasuredError,
    RecordingReader,
    Remark,
    ResistanceEstimate,
    ResistanceReading,
    Segment,
    SegmentStage,
)

MAX_FIT_ROWS, MAX_POINTS = 9000, 4000
"""Rows of all segments that enter the fit, and points that the result lists; both bound time and memory."""


@dataclass(frozen=True)
class StepsEstimator:
    """psi = integral of (v - R_s i - e), fitted by one energy along every loop.

    Attributes
    ----------
    resistance_std_ratio : float
        Relative standard deviation of R_s about the value measured or stated before: 2.5 K of copper.
    max_passes : int
        Passes over the captures until the fitted lag agrees with the assumed one.
    lag_tolerance_samples : float
        Difference of these lags below which no further pass is needed.
    inductance_tolerance : float
        Relative change of an inductance by the decay between rows, below which no further pass is needed.
    control_rows : float
        Rows per carrier period from which on rows count as control samples, between which the voltage is constant.
        Slower rows are means, or lack commands in between.
    decay_std_ratio : float
        Relative model error of the decay correction for control samples, since the iron saturates during the decay.
    mean_std_ratio : float
        As `decay_std_ratio`, for slower rows: means have the opposite error of instants, and commands
        within a row are unknown (simulated: up to twice the correction).
    min_remark_samples : float
        Lag from which on a remark reports it: iron's hysteresis opens a loop by less.
    min_interval_ratio : float
        Smallest relative standard deviation of R_s (from simulated plants, 20 samples per swing).
    """

    resistance_std_ratio: float = 0.01
    max_passes: int = 4
    lag_tolerance_samples: float = 0.05
    inductance_tolerance: float = 2e-4
    control_rows: float = 0.9
    decay_std_ratio: float = 0.1
    mean_std_ratio: float = 2.0
    min_remark_samples: float = 0.3
    min_interval_ratio: float = 0.005

    name: ClassVar[str] = "steps"
    summary: ClassVar[str] = "flux map of one energy by voltage steps between current limits"
    requires: ClassVar[tuple[type[Estimate], ...]] = ()
    produces: ClassVar[type[Estimate]] = SteppedFlux
    reads: ClassVar[tuple[SegmentStage, ...]] = (SegmentStage.STEPS,)
    rank: ClassVar[int] = 25

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> SteppedFlux:
        """Make the map; raises `NotMeasuredError` where the steps span no area of currents, or R_s has no prior."""
        where, segments = recording.manifest.name, recording.segments(SegmentStage.STEPS)
        if not segments:
            raise NotMeasuredError(where, "segments", "no segment of stage steps")
        known = ResistanceEstimator().estimate(recording, context)
        std_ohm = float(np.hypot((known.high - known.low) / 3.92, self.resistance_std_ratio * known.value_ohm))
        prior = Priors(known.value_ohm, std_ohm)
        drive = recording.manifest.drive
        fs, carrier_hz = drive.sampling_frequency_hz, drive.pwm_frequency_hz or 0.0
        rows = _Rows(1.0 / fs, exact=fs >= self.control_rows * carrier_hz)
        traces, fit, lag_samples = self._fit(recording, segments, prior, rows)
        current = np.concatenate([trace.i for trace in traces])
        if not inside_hull(current, np.zeros((1, 2)), where)[0]:
            raise NotMeasuredError(where, "segments", "zero current lies outside the currents of the steps")
        error_h = self._decay_error_h(fit, rows)
        flux_map = _with_error(gridded("steps", recording, fit.energy, current), error_h)
        fit = replace(fit, paths=tuple(_path_with_error(path, error_h) for path in fit.paths))
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        thin = slice(None, None, max(1, len(current) // MAX_POINTS))
        names = [trace.where for trace in traces for _ in range(len(trace.i))]
        points = FluxPoints(
            i_dq=current[thin],
            psi_dq=fit.energy.flux(current[thin])[0] + pm_flux(recording),
            segment=tuple(names[thin]),
        )
        return SteppedFlux(
            map=flux_map,
            points=points,
            checks=check_map(flux_map, rated, fit.misfit),
            remarks=(
                *_prior_conflict(fit, prior),
                *self._remarks(fit, lag_samples, rated, max(t.volts for t in traces)),
                *(Remark(code="time_constant", text=one) for one in recording_notes(recording.manifest)),
            ),
            fit=fit,
            start_s=segments[0].start_s,
        )

    def _fit(
        self, recording: RecordingReader, segments: Sequence[Segment], prior: Priors, rows: _Rows
    ) -> tuple[list[StepTrace], StepsFit, float]:
        """Traces, their fit, and the voltage's lag after the delay that the manifest declares, in samples."""
        declared, lag_samples, later_s = voltage_delay(recording), 0.0, np.zeros(2)
        reach = each_capture(recording, segments, lambda _, c: float(np.linalg.norm(c.i_ab, axis=1).max()))
        knots_a = STEP_KNOTS * max(reach)
        max_blocks = max(1, MAX_FIT_ROWS // len(segments))

        def traced(segment: Segment, capture: Capture) -> StepTrace:
            delay = declared + lag_samples
            angle = segment.rotor_angle_rad
            trace = trace_steps(capture, angle, delay=delay, knots_a=knots_a, where=segment.id, max_blocks=max_blocks)
            return replace(trace, charge=trace.charge + later_s * trace.i)

        for passes_left in reversed(range(self.max_passes)):
            traces = each_capture(recording, segments, traced)
            require_area(np.concatenate([trace.i for trace in traces]), recording.manifest.name)
            fit = fit_steps(traces, prior)
            before, later_s = later_s, rows.decay_s(fit, later_s)
            moved_h = fit.resistance_ohm * np.abs(later_s - before)
            is_same_map = bool((moved_h < self.inductance_tolerance * _unsaturated(fit)).all())
            settled = is_same_map and abs(fit.lag_samples) < self.lag_tolerance_samples
            if not passes_left or settled:
                break
            lag_samples = max(lag_samples + fit.lag_samples, -declared)
        return traces, fit, lag_samples + fit.lag_samples

    def _decay_error_h(self, fit: StepsFit, rows: _Rows) -> Array:
        """Standard deviation of the inductances by the current's decay between rows, shape (2,) [H]."""
        drop_h = fit.resistance_ohm * rows.step_s
        size = np.maximum(_unsaturated(fit), 1e-9 * drop_h)
        share = self.decay_std_ratio if rows.exact else self.mean_std_ratio
        return share * np.array([drop_h * decay_weight(drop_h / h) for h in size])

    def _remarks(self, fit: StepsFit, lag_samples: float, rated: float | None, volts: float) -> list[Remark]:
        remarks = []
        spread = None if not rated else 100.0 * fit.misfit.std(axis=0).max() / rated
        if abs(lag_samples) > max(self.min_remark_samples, 3.0 * fit.lag_std_samples):
            text = (
                "the voltage acts {late:+.2f} samples later than the manifest declares, as the loops show; corrected; "
                "is voltage_delay_samples right?"
            )
            remarks.append(Remark.of("steps_lag", text, late=lag_samples))
        if not fit.determines_resistance:
            text = (
                "the steps cannot separate R_s from the inverter's voltage loss: both stay near their priors, R_s "
                "+-{std_ohm:.2g} ohm and {std_v:.2g} V per phase (one standard deviation); step to two currents "
                "of both signs, or hold direct currents"
            )
            figures = {"std_ohm": fit.resistance_std_ohm, "std_v": float(fit.loss_std_v[-1])}
            remarks.append(Remark.of("resistance_undetermined", text, **figures))
        loss_v = float(fit.loss_v[-1])
        if abs(loss_v) > max(4.0 * float(fit.loss_std_v[-1]), 0.002 * volts):
            text = "each phase loses {lost_v:.2f} V, estimated from the loops; corrected"
            remarks.append(Remark.of("inverter_loss", text, lost_v=loss_v))
        if fit.energy.angle_rad:
            remarks.append(axis_turned(fit.energy.angle_rad))
        if spread is not None and spread > 1.0:
            text = (
                "loops differ from one energy by {spread_percent:.1f} % of the rated flux (rms): no map explains that"
            )
            remarks.append(Remark.of("loops_differ", text, spread_percent=spread))
        return remarks


@dataclass(frozen=True)
class _Rows:
    """Time between rows [s], and whether the voltage is constant between them."""

    step_s: float
    exact: bool

    def decay_s(self, fit: StepsFit, taken_s: Array) -> Array:
        """Delay of the current's mean against a straight line between rows, shape (2,); `taken_s` is included."""
        if not self.exact or fit.resistance_ohm <= 0.0:
            return np.zeros(2)
        straight = _unsaturated(fit) + fit.resistance_ohm * taken_s
        exact = [exact_inductance(float(h), fit.resistance_ohm, self.step_s) for h in straight]
        drop_h = fit.resistance_ohm * self.step_s
        return np.array([self.step_s * decay_weight(drop_h / max(h, 1e-9 * drop_h)) for h in exact])


def _unsaturated(fit: StepsFit) -> Array:
    """L_dd and L_qq at zero current, shape (2,) [H]."""
    return np.asarray(fit.energy.inductance(np.zeros((1, 2)))[0][0, [0, 2]])


def _with_error(flux_map: FluxMap, error_h: Array) -> FluxMap:
    """The map with a common inductance error along each axis added to its standard deviations."""
    d_h, q_h = error_h
    stds = {
        "psi_d_std": np.hypot(flux_map.psi_d_std, d_h * np.abs(flux_map.i_d[:, None])),
        "psi_q_std": np.hypot(flux_map.psi_q_std, q_h * np.abs(flux_map.i_q[None, :])),
        "l_dd_std": np.hypot(flux_map.l_dd_std, d_h),
        "l_qq_std": np.hypot(flux_map.l_qq_std, q_h),
    }
    return flux_map.model_copy(update=stds)


def _path_with_error(path: FluxPath, error_h: Array) -> FluxPath:
    deviation = path.current - path.current.mean(axis=0)
    return replace(path, std=np.hypot(path.std, error_h * np.sqrt((deviation**2).mean(axis=0))))


def _prior_conflict(fit: StepsFit, prior: Priors, max_sigmas: float = 3.0) -> list[Remark]:
    """Remark where R_s by the loops alone contradicts its prior, although the estimate combines both."""
    alone = fit.resistance_std_ohm**-2 - prior.resistance_std_ohm**-2
    moved = fit.resistance_ohm - prior.resistance_ohm
    if alone <= 0.0:
        return []
    deviation = abs(moved) / (prior.resistance_std_ohm**2 - fit.resistance_std_ohm**2) ** 0.5
    if deviation < max_sigmas:
        return []
    text = (
        "R_s by the loops differs by {apart:.0f} standard deviations from the prior {known_ohm:.4g} ohm: a sensor's "
        "or the voltage's gain, or a warm winding?"
    )
    return [Remark.of("off_the_known", text, apart=deviation, known_ohm=prior.resistance_ohm)]


@dataclass(frozen=True)
class StepResistanceEstimator:
    """R_s with which the loops of voltage steps close best, including its prior."""

    name: ClassVar[str] = "step_resistance"
    summary: ClassVar[str] = "R_s by which the loops of voltage steps close"
    requires: ClassVar[tuple[type[Estimate], ...]] = (SteppedFlux,)
    produces: ClassVar[type[Estimate]] = ResistanceEstimate
    reads: ClassVar[tuple[SegmentStage, ...]] = (SegmentStage.STEPS,)
    rank: ClassVar[int] = 0

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> ResistanceEstimate:
        """Take it from the map's fit; raises `NotMeasuredError` where there is none."""
        stepped = context.latest(SteppedFlux) or StepsEstimator().estimate(recording, context)
        value = stepped.fit.resistance_ohm
        std = float(np.hypot(stepped.fit.resistance_std_ohm, StepsEstimator.min_interval_ratio * value))
        reading = ResistanceReading(start_s=stepped.start_s, value_ohm=value, std_ohm=std)
        return ResistanceEstimate(
            value_ohm=value,
            low=value - 1.96 * std,
            high=value + 1.96 * std,
            first_ohm=value,
            last_ohm=value,
            readings=(reading,),
            remarks=(Remark.of("by_loops", "no constant current: R_s is that with which the loops close"),),
        )

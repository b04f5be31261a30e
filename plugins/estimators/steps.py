"""Flux map and R_s by voltage steps: +-U on one axis or both, turned round at current limits, nothing resting.

One energy, R_s, the inverter and the voltage's lag are fitted jointly to loops that have to close
(`orchestrator.analysis.fit_steps`). What is known of R_s beforehand, from holds or the nameplate, counts as far as it
is sure.
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


@dataclass(frozen=True)
class StepsEstimator:
    """psi = integral of (v - R_s i - e), held against one energy along every loop.

    Attributes
    ----------
    resistance_std_ratio : float
        Relative standard deviation of R_s about the value measured or stated before: 2.5 K of copper.
    max_passes : int
        Passes over the captures until the fitted lag agrees with the assumed one.
    lag_tolerance_samples : float
        Difference of these lags that needs no further pass.
    inductance_tolerance : float
        Relative change of an inductance, by how the current decays between rows, that needs no further pass.
    control_rows : float
        Rows for each period of the carrier, from which on they are the control's own: the voltage is constant between
        them. Slower rows are means, or leave out what was commanded in between.
    decay_std_ratio : float
        Of what the decay between the control's own rows changes in an inductance: iron saturates meanwhile.
    mean_std_ratio : float
        Of the same, where rows are slower than the control: means err in the other direction than instants, and what
        was commanded within a row is not known (simulated: up to twice of it).
    min_remark_samples : float
        Lag from which on a remark reports it: iron's hysteresis opens a loop by less.
    min_interval_ratio : float
        Smallest relative standard deviation of R_s (simulated: 20 samples a swing, on blind plants).
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
        """Make the map; raises `NotMeasuredError` without steps that span an area of currents, or any idea of R_s."""
        where, segments = recording.manifest.name, recording.segments(SegmentStage.STEPS)
        if not segments:
            raise NotMeasuredError(where, "segments", "no segment of stage steps")
        known = ResistanceEstimator().estimate(recording, context)
        std_ohm = float(np.hypot((known.high - known.low) / 3.92, self.resistance_std_ratio * known.value_ohm))
        beliefs = Priors(known.value_ohm, std_ohm)
        drive = recording.manifest.drive
        fs, carrier_hz = drive.sampling_frequency_hz, drive.pwm_frequency_hz or 0.0
        rows = _Rows(1.0 / fs, exact=fs >= self.control_rows * carrier_hz)
        traces, fit, late = self._fitted(recording, segments, beliefs, rows)
        current = np.concatenate([trace.i for trace in traces])
        if not inside_hull(current, np.zeros((1, 2)), where)[0]:
            raise NotMeasuredError(where, "segments", "zero current lies outside what the steps pass")
        doubt_h = self._decay_doubt_h(fit, rows)
        flux_map = _doubted(gridded("steps", recording, fit.energy, current), doubt_h)
        fit = replace(fit, paths=tuple(_doubted_path(path, doubt_h) for path in fit.paths))
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        thin = slice(None, None, max(1, len(current) // 4000))
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
                *_off_the_known(fit, beliefs),
                *self._remarks(fit, late, rated, max(t.volts for t in traces)),
                *(Remark(code="time_constant", text=one) for one in recording_notes(recording.manifest)),
            ),
            fit=fit,
            start_s=segments[0].start_s,
        )

    def _fitted(
        self, recording: RecordingReader, segments: Sequence[Segment], beliefs: Priors, rows: _Rows
    ) -> tuple[list[StepTrace], StepsFit, float]:
        """Traces, what they say, and by how many samples the voltage acts later than the manifest says."""
        declared, late, later_s = voltage_delay(recording), 0.0, np.zeros(2)
        reach = each_capture(recording, segments, lambda _, c: float(np.linalg.norm(c.i_ab, axis=1).max()))
        knots_a = STEP_KNOTS * max(reach)
        max_blocks = max(1, 9000 // len(segments))

        def traced(segment: Segment, capture: Capture) -> StepTrace:
            delay = declared + late
            angle = segment.rotor_angle_rad
            trace = trace_steps(capture, angle, delay=delay, knots_a=knots_a, where=segment.id, max_blocks=max_blocks)
            return replace(trace, charge=trace.charge + later_s * trace.i)

        for left in reversed(range(self.max_passes)):
            traces = each_capture(recording, segments, traced)
            require_area(np.concatenate([trace.i for trace in traces]), recording.manifest.name)
            fit = fit_steps(traces, beliefs)
            before, later_s = later_s, rows.decay_s(fit, later_s)
            moved_h = fit.resistance_ohm * np.abs(later_s - before)
            is_same_map = bool((moved_h < self.inductance_tolerance * _at_rest(fit)).all())
            settled = is_same_map and abs(fit.lag_samples) < self.lag_tolerance_samples
            if not left or settled:
                break
            late = max(late + fit.lag_samples, -declared)
        return traces, fit, late + fit.lag_samples

    def _decay_doubt_h(self, fit: StepsFit, rows: _Rows) -> Array:
        """Standard deviation of the inductances by what the current does between rows, shape (2,) [H]."""
        drop_h = fit.resistance_ohm * rows.step_s
        size = np.maximum(_at_rest(fit), 1e-9 * drop_h)
        share = self.decay_std_ratio if rows.exact else self.mean_std_ratio
        return share * np.array([drop_h * decay_weight(drop_h / h) for h in size])

    def _remarks(self, fit: StepsFit, late: float, rated: float | None, volts: float) -> list[Remark]:
        remarks = []
        spread = None if not rated else 100.0 * fit.misfit.std(axis=0).max() / rated
        if abs(late) > max(self.min_remark_samples, 3.0 * fit.lag_std_samples):
            text = (
                "the loops open as if the voltage acted {late:+.2f} samples later than the manifest says: taken out; "
                "is voltage_delay_samples right?"
            )
            remarks.append(Remark.of("steps_lag", text, late=late))
        if not fit.determines_resistance:
            text = (
                "the steps do not tell R_s from what the inverter keeps: both are near what was believed before, R_s "
                "+-{std_ohm:.2g} ohm and {std_v:.2g} V a phase (one standard deviation); step to two sizes of current "
                "with both signs, or hold direct currents"
            )
            figures = {"std_ohm": fit.resistance_std_ohm, "std_v": float(fit.loss_std_v[-1])}
            remarks.append(Remark.of("resistance_undetermined", text, **figures))
        kept = float(fit.loss_v[-1])
        if abs(kept) > max(4.0 * float(fit.loss_std_v[-1]), 0.002 * volts):
            text = "each phase loses {lost_v:.2f} V, estimated from the loops; corrected"
            remarks.append(Remark.of("inverter_loss", text, lost_v=kept))
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
        """By how much later than a straight line's the current between rows counts, shape (2,), `taken_s` being in."""
        if not self.exact or fit.resistance_ohm <= 0.0:
            return np.zeros(2)
        straight = _at_rest(fit) + fit.resistance_ohm * taken_s
        exact = [exact_inductance(float(h), fit.resistance_ohm, self.step_s) for h in straight]
        drop_h = fit.resistance_ohm * self.step_s
        return np.array([self.step_s * decay_weight(drop_h / max(h, 1e-9 * drop_h)) for h in exact])


def _at_rest(fit: StepsFit) -> Array:
    """L_dd and L_qq without current, shape (2,) [H]."""
    return np.asarray(fit.energy.inductance(np.zeros((1, 2)))[0][0, [0, 2]])


def _doubted(flux_map: FluxMap, doubt_h: Array) -> FluxMap:
    """The same with inductances that may all be off by so much along each axis."""
    d_h, q_h = doubt_h
    stds = {
        "psi_d_std": np.hypot(flux_map.psi_d_std, d_h * np.abs(flux_map.i_d[:, None])),
        "psi_q_std": np.hypot(flux_map.psi_q_std, q_h * np.abs(flux_map.i_q[None, :])),
        "l_dd_std": np.hypot(flux_map.l_dd_std, d_h),
        "l_qq_std": np.hypot(flux_map.l_qq_std, q_h),
    }
    return flux_map.model_copy(update=stds)


def _doubted_path(path: FluxPath, doubt_h: Array) -> FluxPath:
    apart = path.current - path.current.mean(axis=0)
    return replace(path, std=np.hypot(path.std, doubt_h * np.sqrt((apart**2).mean(axis=0))))


def _off_the_known(fit: StepsFit, beliefs: Priors, doubtful: float = 3.0) -> list[Remark]:
    """By how much the loops alone are off what was believed: they and it make the estimate together."""
    alone = fit.resistance_std_ohm**-2 - beliefs.resistance_std_ohm**-2
    moved = fit.resistance_ohm - beliefs.resistance_ohm
    if alone <= 0.0:
        return []
    apart = abs(moved) / (beliefs.resistance_std_ohm**2 - fit.resistance_std_ohm**2) ** 0.5
    if apart < doubtful:
        return []
    text = (
        "R_s by the loops is {apart:.0f} standard deviations off the {known_ohm:.4g} ohm that were known: a sensor's "
        "or the voltage's gain, or a warm winding?"
    )
    return [Remark.of("off_the_known", text, apart=apart, known_ohm=beliefs.resistance_ohm)]


@dataclass(frozen=True)
class StepResistanceEstimator:
    """R_s by which the loops of voltage steps close best, what was known before it counted in."""

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
            remarks=(Remark.of("by_loops", "no current rests: R_s is the one by which the loops of steps close"),),
        )

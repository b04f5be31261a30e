"""Flux map by signal injection: the ripple's Hessian at many currents, inverted and integrated.

Neither R_s nor the base voltage enters (Combes, Malrait, Martin, Rouchon, "Obtaining the current-flux relations of
the saturated PMSM by signal injection", section "Proposed method"), except where the voltage rotates at its own
frequency: that needs a known R_s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from orchestrator.analysis import (
    DEFAULT_RESISTANCE_STD_RATIO,
    NO_LOSS,
    ONE_AXIS_ERROR,
    FluxPath,
    Inductances,
    IntegratedFlux,
    PhaseLoss,
    Ripple,
    check_map,
    demodulate,
    each_capture,
    fixed_axis_rad,
    flux_steps,
    injection_frequency,
    integrate,
    invert,
    join_paths,
    known_resistance,
    reference_flux_wb,
)
from orchestrator.config.time_constants import recording_notes
from orchestrator.numerics.surface import TaylorSurface
from orchestrator.numerics.types import Array
from plugins.estimators._lines import straight_lines
from plugins.estimators._maps import InjectedFlux, SweptFlux, as_map, grid_of, pm_flux, voltage_delay
from plugins.estimators._one_way import OneWay, group_by_point, shows_both_axes
from protocols import (
    Basis,
    Capture,
    Estimate,
    EstimationContext,
    FluxMap,
    FluxPoints,
    IncrementalInductances,
    NotMeasuredError,
    RecordingReader,
    Remark,
    Segment,
    SegmentStage,
)


@dataclass(frozen=True)
class _Group:
    """Points injected with one frequency and one amplitude of flux ripple."""

    segments: list[str]
    ripples: list[Ripple]

    @property
    def size(self) -> float:
        return float(np.median([r.flux_rms_wb for r in self.ripples]))

    @property
    def frequency_hz(self) -> float:
        return self.ripples[0].frequency_hz

    def __str__(self) -> str:
        first = self.ripples[0]
        return f"{first.amplitude_v:.3g} V rms at {first.frequency_hz:.4g} Hz"


@dataclass(frozen=True)
class InjectionEstimator:
    """H at each point reached, L = H^-1, psi by least squares over the graph of neighbouring points.

    Amplitudes and frequencies are evaluated separately: the map uses the smallest ripple among those that cover
    nearly all points; the others are compared with it.

    Attributes
    ----------
    frequency_tolerance, ripple_tolerance : float
        Relative differences within which injections count as equal, for clock error and changing inductance.
    min_coverage : float
        Points over those of the largest group, below which a group makes no map.
    transient_points : int
        Points whose transients are measured; the slowest is used.
    max_inductance_ratio : float
        Ratio of an inductance at two successive points beyond which a remark calls them too far apart.
        Ratio 1.6: error up to 0.2 % of the rated flux, rms; ratio 2.6: 1.8 %.
    """

    frequency_tolerance: float = 0.03
    ripple_tolerance: float = 0.2
    min_coverage: float = 0.8
    transient_points: int = 3
    max_inductance_ratio: float = 2.0

    name: ClassVar[str] = "injection"
    summary: ClassVar[str] = (
        "flux map by demodulated signal injection; a voltage that rotates at its own frequency needs R_s"
    )
    requires: ClassVar[tuple[type[Estimate], ...]] = (SweptFlux,)
    produces: ClassVar[type[Estimate]] = InjectedFlux
    rank: ClassVar[int] = 20

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> InjectedFlux:
        """Make the map; raises `NotMeasuredError` where the points do not span an area of currents."""
        swept = context.latest(SweptFlux)
        loss = NO_LOSS if swept is None else swept.loss
        groups, skipped = self._groups(recording, loss, _resistance_ohm(recording, context))
        if not groups:
            problem = skipped[0] if skipped else "no segment of stage injection"
            raise NotMeasuredError(recording.manifest.name, "segments", problem)
        max_points = max(len(group.ripples) for group in groups)
        chosen = min((g for g in groups if len(g.ripples) >= self.min_coverage * max_points), key=lambda g: g.size)
        points = invert(chosen.ripples)
        flux = integrate(points, recording.manifest.name)
        flux_map = _gridded(recording, points, flux)
        rated = reference_flux_wb(flux_map, recording.manifest.motor)
        psi = flux.psi + pm_flux(recording)
        return InjectedFlux(
            map=flux_map,
            points=FluxPoints(i_dq=points.current, psi_dq=psi, segment=tuple(chosen.segments)),
            checks=check_map(flux_map, rated, _misfit(points)),
            remarks=(
                *_too_far_apart(points, self.max_inductance_ratio),
                *_remarks(groups, chosen, points, flux),
                *(Remark(code="time_constant", text=one) for one in recording_notes(recording.manifest)),
                *(Remark(code="skipped", text=one) for one in skipped),
            ),
            inductances=points,
            incremental=tuple(_incremental(group) for group in sorted(groups, key=lambda g: (g.frequency_hz, g.size))),
        )

    def _groups(
        self, recording: RecordingReader, loss: PhaseLoss, resistance_ohm: float | None
    ) -> tuple[list[_Group], list[str]]:
        """Demodulate every point; group by frequency and ripple, largest group first."""
        segments = recording.segments(SegmentStage.INJECTION)
        time_constant_s = self._time_constant(recording, segments, resistance_ohm)
        known = {"time_constant_s": time_constant_s, "resistance_ohm": resistance_ohm}
        groups: list[_Group] = []
        skipped = []

        def ripple_of(segment: Segment, capture: Capture, *other_captures: Capture) -> Ripple | str:
            return _ripple(recording, segment, capture, *other_captures, **known, loss=loss)

        results = each_capture(recording, segments, lambda s, c: _one_way(s, c) or ripple_of(s, c))
        ripples: list[tuple[Segment, Ripple | OneWay | str]] = list(zip(segments, results, strict=True))
        for point in group_by_point([one for _, one in ripples if isinstance(one, OneWay)], self.frequency_tolerance):
            first = point[0].segment
            if shows_both_axes(point):
                ripples.append((first, ripple_of(first, *(recording.load(one.segment) for one in point))))
            else:
                ripples.append((first, f"{first.id}: v_alpha, v_beta: {ONE_AXIS_ERROR}"))
        for segment, ripple in ripples:
            if isinstance(ripple, OneWay):
                continue
            if isinstance(ripple, str):
                skipped.append(ripple)
                continue
            group = next((g for g in groups if self._same_injection(g.ripples[0], ripple)), None)
            if group is None:
                groups.append(group := _Group([], []))
            group.segments.append(segment.id)
            group.ripples.append(ripple)
        return sorted(groups, key=lambda g: -len(g.ripples)), skipped

    def _time_constant(
        self, recording: RecordingReader, segments: Sequence[Segment], resistance_ohm: float | None
    ) -> float | None:
        """Slowest decay of a transient at a few points [s]; None where it cannot be measured."""
        probes = segments[:: max(1, math.ceil(len(segments) / self.transient_points))]
        ripples = each_capture(
            recording, probes, lambda s, c: _ripple(recording, s, c, discard_s=0.0, resistance_ohm=resistance_ohm)
        )
        return max((1.0 / one.decay_per_s for one in ripples if not isinstance(one, str)), default=None)

    def _same_injection(self, one: Ripple, other: Ripple) -> bool:
        """Whether two ripples have equal frequency and amplitude, within the tolerances."""
        same_frequency = math.isclose(other.frequency_hz, one.frequency_hz, rel_tol=self.frequency_tolerance)
        return same_frequency and math.isclose(other.flux_rms_wb, one.flux_rms_wb, rel_tol=self.ripple_tolerance)


def _incremental(group: _Group) -> IncrementalInductances:
    inverse = invert(group.ripples)
    return IncrementalInductances(
        frequency_hz=group.frequency_hz,
        amplitude_v=float(np.median([r.amplitude_v for r in group.ripples])),
        i_dq=inverse.current,
        inductance=np.stack([inverse.matrix[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1))], axis=1),
    )


def _resistance_ohm(recording: RecordingReader, context: EstimationContext) -> float | None:
    """R_s as measured before, if that is more precise than an uncertain nameplate, else the nameplate's."""
    measured = context.resistance
    if measured is not None and measured.high - measured.low < 4.0 * DEFAULT_RESISTANCE_STD_RATIO * measured.value_ohm:
        return measured.value_ohm
    known = known_resistance(recording.manifest.motor)
    return None if known is None else known.value_ohm


def _one_way(segment: Segment, capture: Capture) -> OneWay | None:
    """The segment if its injection keeps to one axis; None where it rotates or is absent."""
    axis_rad = fixed_axis_rad(capture.v_ab)
    if axis_rad is None:
        return None
    try:
        frequency_hz = injection_frequency(capture.v_ab, capture.sampling_frequency_hz, segment.id)
    except NotMeasuredError:
        return None
    mean = np.asarray(capture.i_ab[len(capture) // 2 :], dtype=np.float64).mean(axis=0)
    return OneWay(segment, frequency_hz, mean, axis_rad)


def _ripple(
    recording: RecordingReader,
    segment: Segment,
    capture: Capture,
    *other_captures: Capture,
    discard_s: float | None = None,
    time_constant_s: float | None = None,
    resistance_ohm: float | None = None,
    loss: PhaseLoss = NO_LOSS,
) -> Ripple | str:
    """The ripple of one point, or the reason why it cannot be demodulated."""
    try:
        return demodulate(
            capture,
            segment.rotor_angle_rad,
            voltage_delay_samples=voltage_delay(recording),
            discard_s=discard_s,
            time_constant_s=time_constant_s,
            loss=loss if _same_pwm(recording, segment) else NO_LOSS,
            more_captures=other_captures,
            resistance_ohm=resistance_ohm,
            where=segment.id,
        )
    except NotMeasuredError as error:
        return str(error)


def _same_pwm(recording: RecordingReader, segment: Segment) -> bool:
    """Whether the PWM frequency equals that of the sweeps, since dead-time voltage is proportional to it."""
    default_hz = recording.manifest.drive.pwm_frequency_hz
    compared = (segment, *recording.segments(SegmentStage.CLASSICAL))
    return len({s.settings.get("pwm_frequency_hz") or default_hz for s in compared}) == 1


def _gridded(recording: RecordingReader, points: Inductances, flux: IntegratedFlux) -> FluxMap:
    axes, nodes = grid_of(points.current)
    surface = TaylorSurface(points.current, nodes, recording.manifest.name)
    psi = [surface(flux.psi[:, k], points.matrix[:, k], points.slope[:, k]) for k in range(2)]
    psi_std = [surface(flux.std[:, k]) for k in range(2)]
    inductance, interpolation_error = _inductance(points, flux, nodes, surface)
    spread = np.sqrt(np.einsum("nii->ni", points.covariance))
    if points.misfit is not None:
        spread = np.hypot(spread, points.misfit)
    l_std = [np.hypot(surface(spread[:, k]), interpolation_error[:, k]) for k in range(3)]
    values, stds = np.column_stack([*psi, inductance]), np.stack([*psi_std, *l_std], axis=1)
    return as_map("injection", Basis.INJECTION, recording.manifest.motor, axes, values, stds)


def _inductance(points: Inductances, flux: IntegratedFlux, nodes: Array, surface: TaylorSurface) -> tuple[Array, Array]:
    """L_dd, L_dq, L_qq at the nodes, and their interpolation error."""
    # Between distant points, interpolated inductances and slopes of the interpolated flux have errors of similar size
    # and different origin. The result is their mean, and half their difference estimates its error.
    step = 1e-3 * float(np.ptp(points.current, axis=0).max())
    slopes = np.empty((len(nodes), 2, 2))
    slender = surface.is_sliver
    for axis, e in enumerate(step * np.eye(2)):
        ahead, behind = (TaylorSurface(points.current, nodes + side, "injection") for side in (e, -e))
        slender = slender | ahead.is_sliver | behind.is_sliver
        for k in range(2):
            known = (flux.psi[:, k], points.matrix[:, k], points.slope[:, k])
            slopes[:, k, axis] = (ahead(*known) - behind(*known)) / (2.0 * step)
    pairs = ((0, 0), (0, 1), (1, 1))
    direct = np.stack([surface(points.matrix[:, i, j], points.slope[:, i, j]) for i, j in pairs], axis=1)
    by_flux = np.stack([0.5 * (slopes[:, i, j] + slopes[:, j, i]) for i, j in pairs], axis=1)
    by_flux = np.where(np.isnan(by_flux) | slender[:, None], direct, by_flux)
    difference = direct - by_flux
    # They agree by chance at some nodes, so the rms difference over all nodes is added.
    return 0.5 * (direct + by_flux), 0.5 * np.sqrt(difference**2 + np.nanmean(difference**2, axis=0))


def _misfit(points: Inductances) -> Array | None:
    """Flux differences at crossings of lines of measured points, each line integrated separately."""
    paths = []
    for line in straight_lines(points.current):
        start, end = line[:-1], line[1:]
        step = points.current[end] - points.current[start]
        rise = flux_steps(step, (points.matrix[start], points.slope[start]), (points.matrix[end], points.slope[end]))
        psi = np.concatenate([np.zeros((1, 2)), np.cumsum(rise, axis=0)])
        paths.append(FluxPath(points.current[line], psi, np.zeros(2)))
    return join_paths(paths).misfit if len(paths) > 1 else None


def _too_far_apart(points: Inductances, max_ratio: float) -> list[Remark]:
    """Remark on an inductance that changes too much between two points of a line for integration to be accurate."""
    steps = []
    for line in straight_lines(points.current):
        diagonal = np.einsum("nii->ni", points.matrix[line])
        ratio = np.maximum(diagonal[1:] / diagonal[:-1], diagonal[:-1] / diagonal[1:])
        step, axis = divmod(int(np.argmax(ratio)), 2)
        steps.append((float(ratio[step, axis]), axis, points.current[line[step]], points.current[line[step + 1]]))
    if not steps or (worst := max(steps, key=lambda one: one[0]))[0] <= max_ratio:
        return []
    largest_ratio, axis, start, end = worst
    text = (
        "{inductance} at ({from_d_a:+.3g}, {from_q_a:+.3g}) A and at the next point, ({to_d_a:+.3g}, {to_q_a:+.3g}) A, "
        "differ {ratio:.2g} times: the flux between them is uncertain; measure points closer together there"
    )
    places = {"from_d_a": start[0], "from_q_a": start[1], "to_d_a": end[0], "to_q_a": end[1]}
    figures = {name: float(value) for name, value in places.items()}
    return [Remark.of("too_far_apart", text, inductance=("L_dd", "L_qq")[axis], ratio=largest_ratio, **figures)]


def _remarks(groups: list[_Group], chosen: _Group, points: Inductances, flux: IntegratedFlux) -> list[Remark]:
    remarks = []
    if not flux.anchored:
        text = "zero current lies outside the measured points: the flux there was extrapolated"
        remarks.append(Remark.of("zero_outside", text))
    if len(groups) > 1:
        text = "several injections: the map uses {injection} ({points} points)"
        remarks.append(Remark.of("several_injections", text, injection=str(chosen), points=len(chosen.ripples)))
    for group in groups:
        if group is chosen:
            continue
        other = invert(group.ripples)
        surface = TaylorSurface(points.current, other.current, "injection")
        ratios = [other.matrix[:, k, k] / surface(points.matrix[:, k, k], points.slope[:, k, k]) for k in range(2)]
        if np.isfinite(ratios).any():
            d, q = (100.0 * (float(np.nanmean(ratio)) - 1.0) for ratio in ratios)
            text = "with {by} L_dd is {d_percent:+.1f} % and L_qq {q_percent:+.1f} % of the map's ({points} points)"
            figures = {"d_percent": d, "q_percent": q, "points": len(group.ripples)}
            remarks.append(Remark.of("other_injection", text, by=str(group), **figures))
    return remarks

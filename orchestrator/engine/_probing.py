"""Scales a stage's injection: a weak probe at the outermost points measures the ripple before the stage runs.

The nameplate's inductance gives the ripple of an unsaturated motor, U / (4 f L) for a square wave. Saturation raises it
severalfold, and only at the largest currents, close to the limit. So where 2.9 times that ripple would exceed 1.1
limits.current_a, the outermost points of the stage get a short injection first; the peak current, scaled to the
stage's voltage, gives the factor by which all points are weakened. One factor serves them all, since the points of a
map need one amplitude. Probes are not recorded, and their heat is not accounted for; a stage that fits is not probed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.config import PlannedPoint, nominal_ripple_a
from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._power import PowerStage
from protocols import DriveRefused, Injection, Limits, Motor, Segment


@dataclass(frozen=True)
class _Rules:
    """Settings of the probe, and limits of the ripple."""

    max_growth_ratio: float = 2.9
    """Peak over the nameplate's ripple that needs no probe: a factor of two as the wave begins, and saturation."""
    max_current_ratio: float = 1.1
    """Largest peak of the first half wave over the limit; drives trip above that."""
    directions: int = 8
    """Directions of the plane; the probe takes the outermost point in each."""
    probe_periods: int = 20
    """Injection periods in one probe, which makes one turn."""
    probe_amplitude_ratio: float = 0.25
    """Largest amplitude of a probe over the stage's."""
    saturation_margin_ratio: float = 1.25
    """Safety factor: in saturation the ripple grows faster than the voltage."""
    peak_current_ratio: float = 0.98
    """Peak of the weakened stage over the limit."""
    min_amplitude_ratio: float = 0.02
    """Smallest amplitude of a probe or stage over the planned one."""


_RULES = _Rules()


class RippleProbe:
    """Finds the factor by which the injection of a stage has to be weaker than planned.

    Parameters
    ----------
    power : PowerStage
        Armed before `factor` is called.
    limits : Limits
    motor : Motor
        For the nameplate's ripple.
    interrupts : Interrupts
    """

    def __init__(self, power: PowerStage, limits: Limits, motor: Motor, interrupts: Interrupts) -> None:
        self._power, self._limits, self._motor, self._interrupts = power, limits, motor, interrupts

    def factor(self, points: Sequence[PlannedPoint]) -> float:
        """Scale of the planned injection: 1 where it fits, otherwise less (two digits, at least a fiftieth).

        Raises
        ------
        DriveFault
            The drive tripped during a probe.
        RunInterrupted
            A stop was requested.
        """
        injections = [p.excitation for p in points if isinstance(p.excitation, Injection)]
        if not injections:
            return 1.0
        strongest = max(injections, key=lambda e: e.amplitude_v)
        nominal = nominal_ripple_a(strongest, self._motor)
        outermost = max(_length(e) for e in injections)
        if (
            nominal > 0.0
            and outermost + _RULES.max_growth_ratio * nominal <= _RULES.max_current_ratio * self._limits.current_a
        ):
            return 1.0
        try:
            update = {"amplitude_v": strongest.amplitude_v}
            return min(self._scale(e.model_copy(update=update)) for e in _outermost(injections))
        except DriveRefused:  # a drive that cannot probe gets the plan unchanged
            return 1.0

    def _scale(self, planned: Injection) -> float:
        """The scale for one point."""
        nominal = nominal_ripple_a(planned, self._motor)
        room = max(_RULES.peak_current_ratio * self._limits.current_a - _length(planned), 0.0)
        small = (
            _RULES.probe_amplitude_ratio
            if nominal <= 0.0
            else min(_RULES.probe_amplitude_ratio, 2.0 * _RULES.probe_amplitude_ratio * room / nominal)
        )
        small = max(small, _RULES.min_amplitude_ratio)
        peak = self._peak(planned, small)
        growth = max(peak - _length(planned), 1e-9) / small
        if _length(planned) + growth <= _RULES.max_current_ratio * self._limits.current_a:
            return 1.0
        return max(
            _RULES.min_amplitude_ratio, float(f"{min(1.0, room / (_RULES.saturation_margin_ratio * growth)):.2g}")
        )

    def _peak(self, planned: Injection, small: float) -> float:
        """Longest current vector while a weaker injection makes one turn at the point [A]."""
        probe = planned.model_copy(
            update={
                "amplitude_v": small * planned.amplitude_v,
                "rotation_hz": planned.frequency_hz / _RULES.probe_periods,
                "duration_s": _RULES.probe_periods / planned.frequency_hz,
                "discard_s": 0.0,
            }
        )
        peak = 0.0
        with closing(self._power.execute(probe, quiet_s=probe.settling_s + probe.captured_s)) as blocks:
            for capture in blocks:
                self._interrupts.check()
                if len(capture):
                    peak = max(peak, float(np.sqrt(np.max(np.einsum("na,na->n", capture.i_ab, capture.i_ab)))))
        return peak


def weakened(point: PlannedPoint, factor: float) -> PlannedPoint:
    """The point with its injection weaker by a factor; its settings hold the weaker amplitude."""
    if factor == 1.0 or not isinstance(point.excitation, Injection):
        return point
    amplitude = float(f"{factor * point.excitation.amplitude_v:.3g}")
    excitation = point.excitation.model_copy(update={"amplitude_v": amplitude})
    return replace(point, excitation=excitation, settings={**point.settings, "amplitude_v": amplitude})


def measured_scale(point: PlannedPoint, measured: Segment) -> float | None:
    """Measured injection amplitude over the planned one; None where it was no injection."""
    amplitude = measured.settings.get("amplitude_v")
    if not isinstance(point.excitation, Injection) or not isinstance(amplitude, int | float):
        return None
    return float(amplitude) / point.excitation.amplitude_v


def _length(excitation: Injection) -> float:
    return math.hypot(excitation.target_d_a, excitation.target_q_a)


def _outermost(injections: Sequence[Injection]) -> list[Injection]:
    """The outermost points in eight directions, each once."""
    outer: dict[tuple[float, float], Injection] = {}
    for k in range(_RULES.directions):
        d, q = math.cos(2 * math.pi * k / _RULES.directions), math.sin(2 * math.pi * k / _RULES.directions)
        outermost = max(injections, key=lambda e: d * e.target_d_a + q * e.target_q_a)
        outer[(outermost.target_d_a, outermost.target_q_a)] = outermost
    return list(outer.values())

"""Check waveforms against the nameplate: units, scaling, zero sequence, polarity and lag.

Each check detects a mistake of the mapping or the logger, with wide margins. Effects of drive and motor are left to
the diagnosis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.importing._findings import Finding, Findings
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._rotation import beyond_resistance_v, turning
from orchestrator.importing._signals import Scaling
from orchestrator.importing._source import Numbers
from orchestrator.importing._units import unit_that_fits
from orchestrator.importing._vectors import TO_PEAK
from orchestrator.numerics.alignment import Alignment, alignment_of
from orchestrator.numerics.frames import from_phases
from orchestrator.validation.plausibility import (
    MAX_VOLTAGE_RATIO,
    MIN_OHMIC_RATIO,
    MIN_SLOW_VOLTAGE_RATIO,
    PLAUSIBLE_BOUNDS,
    is_reversed,
    rms,
    slow_part,
    suspicious_phase_rad,
    within,
)
from protocols import SegmentStage

_LOCKED = (SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION)
"""Stages whose currents do not rotate by design; steps on both axes may go round a square."""


@dataclass(frozen=True)
class Waveforms:
    """A segment's waveforms, and the file's data that the checks need."""

    file: str
    mapping: ImportMapping
    """Mapping of the segment's file."""
    rows: str
    """The place of the first row, for messages."""
    stage: SegmentStage
    rate_hz: float
    i_ab: Numbers
    v_ab: Numbers
    v_dc: Numbers
    injected_hz: float | None
    """Injection frequency of the mapping's settings [Hz]; its ripple may rotate."""
    i_abc: Numbers | None
    """The phase currents, where the file has all three."""
    raw_currents: Mapping[str, Numbers]


class WaveformChecks:
    """Checks each segment, and at the end the recording as a whole."""

    def __init__(self, mapping: ImportMapping, findings: Findings) -> None:
        self._mapping, self._findings = mapping, findings
        self._current_names = self._voltage_names = ""
        self._largest_current_a = self._largest_rms_a = self._largest_modulation = 0.0
        self._power_w = self._square_a2 = 0.0
        self._with_the_current = False
        self._lags: list[Alignment] = []
        self._back_emfs: list[tuple[str, str, str]] = []

    def judge(self, w: Waveforms) -> None:
        """Check one segment; raises `InputError` for a finding that the mapping does not accept."""
        self._mapping = w.mapping
        self._current_names = ", ".join(w.mapping.current.columns.values())
        self._voltage_names = ", ".join(w.mapping.voltage.columns.values())
        self._bus(w)
        self._current_size(w)
        self._voltage_size(w)
        if w.stage is SegmentStage.GATES_OFF:
            return
        self._constants(w)
        self._enabled(w)
        if w.stage in _LOCKED:
            self._turning(w)
        if w.i_abc is not None:
            self._zero_sequence(w, w.i_abc)
            if self._mapping.phase_currents is not None:
                self._scaling(w, from_phases(w.i_abc))
        if w.stage is not SegmentStage.SPIN:  # a rotating machine may generate
            self._polarity(w)
        if w.stage is SegmentStage.INJECTION:
            found = alignment_of(w.i_ab, w.v_ab, ohm=self._mapping.motor.stator_resistance_ohm)
            self._lags += [] if found is None else [found]

    def conclude(self, file: str) -> None:
        """Check the recording as a whole; findings name `file`."""
        self._current_too_small(file)
        self._voltage_too_small(file)
        self._resistance(file)
        # A current in a wrong unit explains no voltage either, so units come first.
        for where, names, problem in self._back_emfs:
            self._findings.doubt(Finding.TURNING_ROTOR, where, names, problem)
        self._lag()

    def _bus(self, w: Waveforms) -> None:
        bus, nominal = self._mapping.bus, self._mapping.drive.dc_bus_voltage_v
        if bus is None:
            return
        low, high = (limit * nominal for limit in PLAUSIBLE_BOUNDS.bus)
        median = float(np.median(w.v_dc))
        if not low <= median <= high:
            self._findings.doubt(
                Finding.BUS_UNIT,
                w.file,
                bus.column,
                f"{median:.4g} V (median from {w.rows} on) against a nominal bus of {nominal:g} V"
                f"{_unit_hint(bus.unit, abs(median), low, high)}",
            )

    def _current_size(self, w: Waveforms) -> None:
        length = np.hypot(*w.i_ab.T)
        peak = float(np.max(length))
        if w.stage is not SegmentStage.GATES_OFF:
            self._largest_current_a = max(self._largest_current_a, peak)
            self._largest_rms_a = max(self._largest_rms_a, rms(w.i_ab))
        rated = self._mapping.motor.rated_current_a
        if rated is not None and peak > PLAUSIBLE_BOUNDS.rated_currents[1] * rated:
            self._findings.doubt(
                Finding.CURRENT_UNIT,
                w.file,
                self._current_names,
                f"{peak:.4g} A at sample {int(np.argmax(length)) + 1} from {w.rows} on is {peak / rated:.3g} times the "
                f"rated current ({rated:.3g} A peak)"
                f"{_unit_hint(self._mapping.current.unit, peak, 0.02 * rated, 5.0 * rated)}",
            )

    def _voltage_size(self, w: Waveforms) -> None:
        length = np.hypot(*w.v_ab.T)
        modulation = length / np.maximum(np.abs(w.v_dc), 1e-9)
        worst = int(np.argmax(modulation))
        largest = float(modulation[worst])
        if w.stage is not SegmentStage.GATES_OFF:
            self._largest_modulation = max(self._largest_modulation, largest)
        if largest <= 1.05 * MAX_VOLTAGE_RATIO:
            return
        bus = abs(float(w.v_dc[worst]))
        excess = (
            f"{length[worst]:.4g} V at sample {worst + 1} from {w.rows} on is more than a bridge makes of {bus:.4g} V "
            f"({MAX_VOLTAGE_RATIO * bus:.4g} V)"
        )
        if largest > PLAUSIBLE_BOUNDS.bus_voltages[1]:
            hint = _unit_hint(self._mapping.voltage.unit, float(length[worst]), 1e-3 * bus, MAX_VOLTAGE_RATIO * bus)
            self._findings.doubt(Finding.VOLTAGE_UNIT, w.file, self._voltage_names, excess + hint)
        else:
            # Controllers with late saturation command such voltages.
            self._findings.note("modulation", f"{w.file}: {self._voltage_names}: {excess}; is the scaling right?")

    def _constants(self, w: Waveforms) -> None:
        still = [name for name, values in w.raw_currents.items() if np.ptp(values) == 0.0]
        if still:
            problem = f"constant at {float(w.raw_currents[still[0]][0]):g} from {w.rows} to the segment's end"
            if len(still) == len(w.raw_currents):
                self._findings.doubt(Finding.CONSTANT_CURRENT, w.file, ", ".join(still), problem)
            else:
                self._findings.note("constant", f"{w.file}: {', '.join(still)}: {problem}; is it connected?")
        # Duties of a half give zero volts except for rounding.
        if float(np.max(np.abs(w.v_ab))) < 1e-9 * self._mapping.drive.dc_bus_voltage_v:
            self._findings.doubt(
                Finding.CONSTANT_VOLTAGE, w.file, self._voltage_names, f"zero from {w.rows} to the segment's end"
            )

    def _turning(self, w: Waveforms) -> None:
        where = f"{w.stage.value} is for a locked rotor; one that turns is of stage spin, with its angle"
        if self._is_significant(rms(w.i_ab)) and w.injected_hz is None:
            found = turning(w.i_ab, w.rate_hz)
            if found is not None:
                problem = f"the current turns {found[0]:.0f} times at {found[1]:.4g} Hz from {w.rows} on: {where}"
                self._findings.doubt(Finding.TURNING_ROTOR, w.file, self._current_names, problem)
        ohm, bus = self._mapping.motor.stator_resistance_ohm, self._mapping.drive.dc_bus_voltage_v
        if self._mapping.voltage.frame != "dq" or ohm is None:
            return
        left = beyond_resistance_v(w.i_ab, w.v_ab, ohm)
        # Dead time and drops are far below a twentieth of the bus.
        if left is not None and left > 0.05 * bus:
            problem = f"{left:.3g} V (mean from {w.rows} on) exceed the drop at the nameplate's {ohm:g} ohm: back-EMF?"
            self._back_emfs.append((w.file, self._voltage_names, f"{problem} {where}"))

    def _zero_sequence(self, w: Waveforms, i_abc: Numbers) -> None:
        total = i_abc.sum(axis=1)
        share = rms(total / 3.0) / max(rms(i_abc), 1e-30)
        if share <= 0.05 or not self._is_significant(rms(i_abc)):
            return
        names = self._mapping.phase_currents or self._mapping.current
        text = f"the three currents do not add up to zero (from {w.rows} on): zero sequence {100 * share:.2g} % of them"
        without = {phase: rms(total - 2.0 * x) / rms(total) for phase, x in zip("abc", i_abc.T, strict=True)}
        phase = min(without, key=without.__getitem__)
        if share <= 0.2:
            hint = f"phase {phase} may be reversed" if without[phase] < 0.2 else "offsets or gains of the sensors"
            self._findings.note("zero_sequence", f"{w.file}: {text}; {hint}")
            return
        hint = f"phase {phase} looks reversed" if without[phase] < 0.2 else "one is reversed or wrongly scaled"
        self._findings.doubt(Finding.ZERO_SEQUENCE, w.file, ", ".join(names.columns.values()), f"{text}; {hint}")

    def _scaling(self, w: Waveforms, from_phases: Numbers) -> None:
        if not self._is_significant(max(rms(from_phases), rms(w.i_ab))):
            return
        likeness, gain, angle = _compared(from_phases, w.i_ab)
        if likeness > 0.9 and abs(gain * np.exp(1j * angle) - 1.0) < 0.05:
            return
        mirrored, _, _ = _compared(from_phases * [1.0, -1.0], w.i_ab)
        if likeness < 0.9:
            problem = "have the reversed phase order of" if mirrored > 0.9 else "do not go together with"
            hint = ""
        elif abs(angle) > math.radians(10.0):
            problem = f"are turned by {math.degrees(angle):.0f} degrees against"
            hint = "; wrong angle, or phases exchanged"
        else:
            problem, hint = f"are {gain:.4g} times", _scaling_hint(self._mapping.current.scaling, gain)
        self._findings.doubt(
            Finding.SCALING,
            w.file,
            self._current_names,
            f"the phase currents {problem} what these columns give (from {w.rows} on){hint}",
        )

    def _enabled(self, w: Waveforms) -> None:
        """Note a constant voltage at the start without current: the bridge was off."""
        ohm, window_s = self._mapping.motor.stator_resistance_ohm, 0.02
        i, v = (np.hypot(*slow_part(x, w.rate_hz, window_s).T) for x in (w.i_ab, w.v_ab))
        if ohm is None or not len(i):
            return
        answered = (i > 0.02 * i.max()) | (v < 0.1 * ohm * i.max())
        silent = int(np.argmax(answered)) if answered.any() else 0
        if silent < 3:
            return
        self._findings.note(
            "not_enabled",
            f"{w.file}: from {w.rows} on {np.median(v[:silent]):.3g} V stand for {silent * window_s:.2g} s and no "
            "current flows: was the bridge off? A segment has to begin where it is on (from_s)",
        )

    def _polarity(self, w: Waveforms) -> None:
        i, v = (slow_part(x, w.rate_hz) for x in (w.i_ab, w.v_ab))
        if (
            rms(i) < 0.2 * rms(w.i_ab)
            or rms(v) < MIN_SLOW_VOLTAGE_RATIO * rms(w.v_ab)
            or not self._is_significant(rms(i))
        ):
            return
        self._power_w += float(np.sum(v * i))
        self._square_a2 += float(np.sum(i * i))
        i_c, v_c = i[:, 0] + 1j * i[:, 1], v[:, 0] + 1j * v[:, 1]
        least_ohm = MIN_OHMIC_RATIO * (self._mapping.motor.stator_resistance_ohm or 0.0)
        power = complex(np.vdot(i_c, v_c))
        angle = suspicious_phase_rad(power, float(np.sum(v * v)), float(np.sum(i * i)), min_ohm=least_ohm)
        if angle is not None:
            hint = "one of both is reversed (factor: -1)" if is_reversed(angle) else "phases are exchanged"
            if is_reversed(angle) and self._with_the_current:
                # Exchanged phases have no effect along one axis, and a full effect across it.
                hint = "other segments are right: two phases of one of both may be exchanged"
            self._findings.doubt(
                Finding.POLARITY,
                w.file,
                f"{self._voltage_names} against {self._current_names}",
                f"voltage and current are {abs(math.degrees(angle)):.0f} degrees apart from {w.rows} on, but a winding "
                f"takes power: {hint}, or their frames differ",
            )
        self._with_the_current |= power.real > 0.5 * rms(i) * rms(v) * len(i)

    def _is_significant(self, rms_a: float) -> bool:
        """Whether a current is large enough to evaluate: a twentieth of the rated or largest measured current."""
        return rms_a > 0.05 * (self._mapping.motor.rated_current_a or self._largest_rms_a)

    def _current_too_small(self, file: str) -> None:
        rated, largest = self._mapping.motor.rated_current_a, self._largest_current_a
        if rated is not None and 0.0 < largest < PLAUSIBLE_BOUNDS.rated_currents[0] * rated:
            self._findings.doubt(
                Finding.CURRENT_UNIT,
                file,
                self._current_names,
                f"nowhere more than {largest:.3g} A, {100 * largest / rated:.2g} % of the rated current"
                f"{_unit_hint(self._mapping.current.unit, largest, 0.02 * rated, 5.0 * rated)}",
            )

    def _voltage_too_small(self, file: str) -> None:
        largest = self._largest_modulation
        if 0.0 < largest < PLAUSIBLE_BOUNDS.bus_voltages[0]:
            self._findings.doubt(
                Finding.VOLTAGE_UNIT,
                file,
                self._voltage_names,
                f"nowhere more than {100 * largest:.2g} % of the bus voltage"
                f"{_unit_hint(self._mapping.voltage.unit, largest, 1e-3, MAX_VOLTAGE_RATIO)}",
            )

    def _resistance(self, file: str) -> None:
        nameplate = self._mapping.motor.stator_resistance_ohm
        if nameplate is None or self._square_a2 == 0.0:
            return
        seen = self._power_w / self._square_a2
        if not within(seen, PLAUSIBLE_BOUNDS.resistance, nameplate):
            self._findings.doubt(
                Finding.VOLTAGE_UNIT,
                file,
                f"{self._voltage_names} over {self._current_names}",
                f"{seen:.3g} ohm, the nameplate says {nameplate:g} ohm: a unit of one of both is wrong",
            )

    def _lag(self) -> None:
        if not self._lags:
            return
        lag, given = (
            float(np.median([x.lag_rows for x in self._lags])),
            self._mapping.drive.voltage_delay_samples or 0.0,
        )
        by_edges = any(x.by_edges for x in self._lags)
        # The ripple's shape may act as a quarter of a sample; iron loss shifts a sine's phase by half a sample.
        if abs(lag - given) > (0.25 if by_edges else 0.6):
            how = "" if by_edges else f", by the phase of a sine at {self._mapping.motor.stator_resistance_ohm:g} ohm"
            self._findings.note(
                "lag",
                f"the current follows the commanded voltage by {lag:.1f} samples (median of {len(self._lags)} "
                f"injection segments{how}), drive.voltage_delay_samples is {given:g}: {lag:.1f} would fit",
            )


def _compared(x: Numbers, y: Numbers) -> tuple[float, float, float]:
    """Coherence of two vector series (1: equal up to gain and rotation), and the gain and angle from y to x."""
    x_c, y_c = x[:, 0] + 1j * x[:, 1], y[:, 0] + 1j * y[:, 1]
    product, x_power, y_power = np.vdot(y_c, x_c), np.vdot(x_c, x_c).real, np.vdot(y_c, y_c).real
    if x_power == 0.0 or y_power == 0.0:
        return 0.0, 0.0, 0.0
    return float(abs(product) / math.sqrt(x_power * y_power)), float(abs(product) / y_power), float(np.angle(product))


def _unit_hint(labelled: str, value: float, low: float, high: float) -> str:
    fits = unit_that_fits(labelled, value, low, high)
    return "" if fits is None else f"; read in {labelled}, {fits} would fit"


def _scaling_hint(labelled: Scaling | None, gain: float) -> str:
    """A hint at the scaling that would fit; empty for quantities without a scaling."""
    if labelled is None:
        return ""
    for scaling, to_peak in TO_PEAK.items():
        if scaling != labelled and abs(gain * TO_PEAK[labelled] / to_peak - 1.0) < 0.02:
            return f"; labelled {labelled}, {scaling} would fit"
    return ""

"""Effect checks valid for any effect: scaling with the machine, response to its size, no state between calls."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, ClassVar

import numpy as np

from orchestrator.formatting.quantities import percent
from orchestrator.formatting.sentences import listed
from orchestrator.testing._signals import SIGNAL_ARRAYS, exciting_signals, largest_change
from protocols import (
    LAYER_CHANGES,
    Correction,
    Effect,
    EffectLayer,
    EffectParameter,
    ParameterRole,
    Signals,
    unit_powers,
)

MAX_EVALUATION_S = 0.25
"""For a second of samples: a diagnosis evaluates an effect some thousand times."""
CURRENT_SCALE = 4.0
"""Currents of another machine over the first one's; times stay."""
VOLTAGE_SCALE = 0.5
OTHER_UNITS = (
    *("A", "V", "ohm", "1", "W", "1/A", "1/V", "1/ohm", "1/W", "A^2", "V^2", "1/A^2", "1/V^2"),
    *("ohm/A", "ohm/A^2", "ohm/V", "ohm/W", "V/A^2", "A/V^2"),
)
"""Units by which a parameter may scale; of those that scale alike, such as V and Wb, the most frequent one."""
UNIT_RESPONSE_LIMITS = (0.01, 100.0)
"""Change of voltage or current by a parameter of 1 V or 1 A, in its own unit."""
MIN_SLOPE_RATIO = 0.01
"""Smallest slope over the mean slope."""
UNSEEN_CHANGE = 1e-9
"""Change over an array's largest value that is rounding."""
SIZE_FRACTIONS = (0.0, 0.13, 0.37, 0.61, 0.89)
SIZE_STEP = 2e-3


class EffectPhysicsChecks(ABC):
    """Units, layer, slope, speed, memory."""

    look_ahead_samples: ClassVar[float] = 1
    """Number of later samples that a correction may depend on, ``math.inf`` for the whole segment.

    One is usual: the voltage of row k acts from t_k to t_k+1, so the current of row k + 1 belongs to it.
    """

    @abstractmethod
    def make_effect(self) -> Effect: ...

    @abstractmethod
    def signals(self) -> Signals: ...

    def _values(self, which: str) -> dict[str, float]:
        """Every parameter at its ``neutral`` or ``typical`` value."""
        return {parameter.name: getattr(parameter, which) for parameter in self.make_effect().Parameters.declared()}

    def _amplitudes(self) -> list[EffectParameter]:
        return [p for p in self.make_effect().Parameters.declared() if p.role is ParameterRole.AMPLITUDE]

    def _correction(self, signals: Signals, values: Mapping[str, float]) -> Correction:
        effect = self.make_effect()
        return effect.correct(signals, effect.Parameters(**values))

    def test_changes_only_what_its_layer_is_about(self) -> None:
        layer = self.make_effect().layer
        others = sorted(set(self._correction(self.signals(), self._values("typical")).arrays) - LAYER_CHANGES[layer])
        assert not others, (
            f"layer is {layer.name}, whose effects change {listed(sorted(LAYER_CHANGES[layer]))} alone, but this one "
            f"changes {listed(others)}: choose another layer, or leave these signals"
        )

    def test_no_voltage_appears_while_the_bridge_is_off(self) -> None:
        effect = self.make_effect()
        if effect.layer is not EffectLayer.CURRENT_SENSORS:
            return  # nothing to check
        off = replace(self.signals(), v_ab=np.zeros_like(self.signals().v_ab), bridge_on=False)
        changed = sorted(set(self._correction(off, self._values("typical")).arrays) - {"i_ab"})
        assert not changed, (
            f"with all gates off (signals.bridge_on is False) it changes {listed(changed)}, but there only an "
            "effect of CURRENT_SENSORS can show: return Correction() there"
        )

    def test_a_machine_of_another_size_behaves_alike(self) -> None:
        """Parameters in A, V, ohm etc. have to scale with the machine: else a unit is wrong or a constant hidden."""
        signals = self.signals()
        here = signals.corrected(self._correction(signals, self._values("typical")))
        size, units = largest_change(signals, here), self._units()
        allowed = 1e-6 * max(size, 1e-3)
        apart = self._difference_of_scaled(here, units)
        off = percent(100.0 * apart / max(size, 1e-12))
        assert apart <= allowed, (
            f"on a motor of {CURRENT_SCALE:g} times the current and {VOLTAGE_SCALE:g} times the voltage, with the "
            "parameters scaled by their units, the effect should scale alike, but differs by "
            f"{off} of its size. {self._cause_of_difference(here, units, allowed)}"
        )

    def _units(self) -> dict[str, str]:
        return {p.name: p.unit for p in self.make_effect().Parameters.declared()}

    def _difference_of_scaled(self, here: Signals, units: Mapping[str, str]) -> float:
        """Largest difference on the scaled machine between the scaled effect and the effect of scaled parameters."""
        there = _scaled(self.signals())
        values = {name: value * _factor(units[name]) for name, value in self._values("typical").items()}
        return largest_change(_scaled(here), there.corrected(self._correction(there, values)))

    def _cause_of_difference(self, here: Signals, units: Mapping[str, str], allowed: float) -> str:
        """A parameter that fits in another unit than its own; without one, a constant in the code."""
        for name, declared in units.items():
            others = [unit for unit in OTHER_UNITS if _factor(unit) != _factor(declared)]
            fit = next((x for x in others if self._difference_of_scaled(here, {**units, name: x}) <= allowed), None)
            if fit is not None:
                return f"{name} is declared in {declared}, but scales like a quantity in {fit}: correct its unit"
        return (
            "Either the code has a constant in A, V or ohm: make it a parameter, or take it from signals.motor. Or "
            f"more than one unit is wrong (declared: {', '.join(f'{name} in {unit}' for name, unit in units.items())})"
        )

    def test_a_volt_is_a_volt(self) -> None:
        """A parameter in V that changes a voltage, or in A a current, does so by about its own size."""
        signals = self.signals()
        for p in self._amplitudes():
            array = {"V": "v_ab", "A": "i_ab"}.get(p.unit)
            changed = self._correction(signals, self._values("neutral") | self._shapes() | {p.name: p.typical}).arrays
            if array is None or array not in changed:
                continue
            by = float(np.abs(changed[array] - getattr(signals, array)).max()) / abs(p.typical)
            assert UNIT_RESPONSE_LIMITS[0] <= by <= UNIT_RESPONSE_LIMITS[1], (
                f"{p.name}: 1 {p.unit} changes {array} by {by:.2g} {p.unit}; is it meant in m{p.unit}? "
                "Values are in SI, without prefixes"
            )

    def test_every_size_of_an_amplitude_has_a_slope(self) -> None:
        """A fit needs derivatives: it cannot move where they are zero, as on the treads of a staircase."""
        for p in self._amplitudes():
            whole = self._moved(p, 0.0, 1.0)
            assert whole > 0.0, f"{p.name} changes nothing between its neutral and its typical value"
            for size in SIZE_FRACTIONS:
                slope = self._moved(p, size, size + SIZE_STEP) / SIZE_STEP
                assert slope >= MIN_SLOPE_RATIO * whole, (
                    f"{p.name}: around {size:g} of its typical value the signals hardly change with it (slope "
                    f"{slope / whole:.2g} of the mean one), so a fit would stop there: no steps, rounding or clipping"
                )

    def _moved(self, p: EffectParameter, one: float, other: float) -> float:
        """Length of the way between what two sizes of an amplitude make of the signals, the others typical."""
        signals = self.signals()
        a, b = (
            signals.corrected(self._correction(signals, self._values("typical") | {p.name: _at(p, x)}))
            for x in (one, other)
        )
        ways = [np.linalg.norm(getattr(b, n) - getattr(a, n)) / _size(getattr(signals, n)) for n in SIGNAL_ARRAYS]
        return float(np.linalg.norm(ways))

    def test_time_shows_only_where_a_parameter_has_to_do_with_it(self) -> None:
        if any("s" in unit_powers(p.unit) for p in self.make_effect().Parameters.declared()):
            return
        signals = self.signals()
        now, then = (s.corrected(self._correction(s, self._values("typical"))) for s in (signals, _later(signals)))
        change = largest_change(now, then)
        assert change <= 1e-9, (
            f"the same signals 1000 s later (start_s) get another correction, by {change:.2g} of a signal, but no "
            "parameter's unit has an s: do not use the time, or declare the parameter that goes with it per second"
        )

    def test_no_earlier_segment_is_remembered(self) -> None:
        """Segments come in any order, and from several threads."""
        signals, used = _later(self.signals(), 1.0), self.make_effect()
        parameters = used.Parameters(**self._values("typical"))
        for earlier in (self.signals(), exciting_signals(seed=7)):
            used.correct(earlier, parameters)
        fresh = signals.corrected(self._correction(signals, self._values("typical")))
        assert largest_change(fresh, signals.corrected(used.correct(signals, parameters))) == 0.0, (
            "an earlier segment changes the correction of this one: keep no state, use the arguments of correct() alone"
        )

    def test_a_later_sample_changes_nothing_earlier(self) -> None:
        """Such as a filter that runs both ways, or a sum over a whole segment, which is another in a longer one."""
        signals = self.signals()
        half = len(signals.v_dc) // 2
        values = self._values("typical")
        one, other = (self._correction(s, values).arrays for s in (signals, _changed_from(signals, half)))
        assert one.keys() == other.keys(), "samples after the middle of a segment change which signals it corrects"
        moved = {n: _moved_rows(x[:half], other[n][:half]) / _largest(x) for n, x in one.items()}
        ahead = {
            n: half - int(np.argmax(rows > UNSEEN_CHANGE)) for n, rows in moved.items() if rows.max() > UNSEEN_CHANGE
        }
        most = max(ahead.values(), default=0)
        late = sorted(n for n, samples in ahead.items() if samples > self.look_ahead_samples)
        assert not late, (
            f"correct() looks {most} samples ({1e3 * most / signals.sampling_frequency_hz:g} ms) ahead: "
            f"{listed(late)} at a sample depend on that many later ones, {self.look_ahead_samples:g} allowed. "
            f"{_why_ahead(most, half)} Where it is meant, write look_ahead_samples = "
            f"{'math.inf' if most == half else most} in the test class"
        )

    def test_answers_quickly(self) -> None:
        signals = self.signals()
        took: list[float] = []
        while not took or (
            len(took) < 4 and min(took) > MAX_EVALUATION_S and sum(took) < 8.0
        ):  # the first one may compile
            begun = time.perf_counter()
            self._correction(signals, self._values("typical"))
            took.append(time.perf_counter() - begun)
        assert min(took) <= MAX_EVALUATION_S, (
            f"correct() takes {min(took):.2f} s for a second of samples, {MAX_EVALUATION_S} s at most: use array "
            "operations instead of a loop over samples"
        )

    def _shapes(self) -> dict[str, float]:
        declared = self.make_effect().Parameters.declared()
        return {p.name: p.typical for p in declared if p.role is not ParameterRole.AMPLITUDE}


def _factor(unit: str) -> float:
    """Scale of a quantity of this unit from this machine to the other."""
    volts, amperes = VOLTAGE_SCALE, CURRENT_SCALE
    sizes = {"A": amperes, "V": volts, "ohm": volts / amperes, "Wb": volts, "H": volts / amperes}
    sizes |= {"W": volts * amperes, "Nm": volts * amperes}
    return float(np.prod([sizes.get(symbol, 1.0) ** power for symbol, power in unit_powers(unit).items()]))


def _scaled(signals: Signals) -> Signals:
    """The same on the other machine."""
    units = {
        **dict.fromkeys(("i_ab", "i_m_ab", "i_abc", "i_smooth_ab", "i_quiet_ab", "came_from_ab"), "A"),
        **dict.fromkeys(("v_ab", "v_late_ab", "v_dc"), "V"),
        **dict.fromkeys(("psi_ab", "psi_smooth_ab"), "Wb"),
        "inductance_ab": "H",
        "resistance_ohm": "ohm",
        "heat_j": "W",
    }
    arrays = {name: getattr(signals, name) for name in units}
    update: dict[str, Any] = {name: x * _factor(units[name]) for name, x in arrays.items() if x is not None}
    if signals.losses is not None:
        update["losses"] = replace(signals.losses, power_w=signals.losses.power_w * _factor("W"))
    if signals.motor is not None:
        update["motor"] = signals.motor.model_copy(update=_nameplate(signals.motor.model_dump()))
    if signals.drive is not None:
        bus_v = signals.drive.dc_bus_voltage_v * _factor("V")
        update["drive"] = signals.drive.model_copy(update={"dc_bus_voltage_v": bus_v})
    return replace(signals, **update)


def _nameplate(values: Mapping[str, float | str | None]) -> dict[str, float]:
    suffixes = {"_a": "A", "_v": "V", "_w": "W", "_ohm": "ohm", "_h": "H", "_wb": "Wb", "_nm": "Nm"}
    return {
        name: value * _factor(unit)
        for name, value in values.items()
        for suffix, unit in suffixes.items()
        if isinstance(value, float) and name.endswith(suffix)
    }


def _later(signals: Signals, by_s: float = 1000.0) -> Signals:
    update: dict[str, Any] = {"start_s": signals.start_s + by_s}
    if signals.losses is not None:
        update["losses"] = replace(signals.losses, time_s=signals.losses.time_s + by_s)
    return replace(signals, **update)


def _changed_from(signals: Signals, start: int) -> Signals:
    """The same up to a sample; from there on every array of samples is half as large again."""
    samples = len(signals.v_dc)
    arrays = {field.name: getattr(signals, field.name) for field in fields(signals)}
    update: dict[str, Any] = {
        name: np.concatenate([x[:start], 1.5 * x[start:]])
        for name, x in arrays.items()
        if isinstance(x, np.ndarray) and len(x) == samples
    }
    return replace(signals, **update)


def _moved_rows(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest difference of each row, shape (n,)."""
    rows: np.ndarray = np.abs(other - one).reshape(len(one), -1).max(axis=1)
    return rows


def _why_ahead(samples: int, half: int) -> str:
    """What in the code makes a correction look ahead by so many samples, of those up to the change."""
    if samples == half:
        return (
            "From the first sample on: does a sum or mean run over time instead of the two axes (axis=1), or does "
            "np.roll bring the segment's end to its start?"
        )
    return "Is a shift's sign wrong, or does a filter or a smoothing run both ways (filtfilt, a centred window)?"


def _largest(x: np.ndarray) -> float:
    return max(float(np.abs(x).max()), 1e-12)


def _at(p: EffectParameter, size: float) -> float:
    """The value of an amplitude at a part of its typical size."""
    if p.strong_when_small:
        return p.neutral if size == 0.0 else p.typical / size
    return p.neutral + size * (p.typical - p.neutral)


def _size(x: np.ndarray) -> float:
    return max(float(np.linalg.norm(x)), 1e-12)

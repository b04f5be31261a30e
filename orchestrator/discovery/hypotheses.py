"""Hypotheses about what is missing: a place, a quantity, the phases concerned and a flexible law, as effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, cast

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.discovery import places as at
from orchestrator.discovery import quantities as of
from orchestrator.discovery.bases import KNEE, Basis, CurveBasis, HarmonicBasis, LineBasis, MemoryBasis, Parity
from orchestrator.discovery.places import Place
from orchestrator.discovery.proposals import gradient_over, line_frequencies
from orchestrator.discovery.quantities import Quantity
from orchestrator.numerics.types import Array
from protocols import Correction, Effect, EffectParameters, SignalBatch, Signals, amplitude

CELLS: int = 9
"""Intervals of a curve in the ranking."""
LAGS: int = 8
"""Time constants of a spectrum of lags."""
COOLING: tuple[float, float] = (0.03, 1.0)
"""Shortest and longest time constant of cooling, relative to the experiment's length."""
MAX_HARMONICS: int = 6
RADII: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Radii of plays, in units of the quantity's range."""

ALL, A, B, C = (1.0, 1.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
Phases = tuple[float, float, float]
PHASE_NAMES: Mapping[Phases, str] = {ALL: "", A: "a", B: "b", C: "c"}


@dataclass(frozen=True)
class Hypothesis:
    """What may be missing.

    Attributes
    ----------
    place : Place
    quantity : Quantity
    phases : (float, float, float)
        1 for the phases concerned.
    basis : Basis
    size : float
        Small size of the law's values, in the unit of the place.
    """

    place: Place
    quantity: Quantity
    phases: Phases
    basis: Basis
    size: float

    @property
    def key(self) -> str:
        """Name of its own."""
        parity = getattr(self.basis, "parity", "")
        words = [self.place.name, PHASE_NAMES[self.phases], self.basis.kind, parity.replace("none", "")]
        return "-".join(word for word in [*words, self.quantity.name] if word)

    def candidate(self, shared: SharedColumns | None = None) -> CandidateEffect:
        """The flexible law as a candidate effect of this machine, one amplitude for each coefficient."""
        effect = FlexibleEffect(self, shared or SharedColumns())
        return CandidateEffect(cast(Effect, effect), effect.Parameters.declared())

    def values(self, columns: Array, coefficients: Array) -> Array:
        """The law's values from its columns, (n, 3) or (n,) as the place takes them."""
        # The ranking asks for one coefficient at a time.
        there = np.flatnonzero(coefficients)
        y: Array = coefficients[there[0]] * columns[there[0]] if len(there) == 1 else coefficients @ columns
        if not self.place.of_phases:
            return y
        y = y.reshape(-1, 3) if self.quantity.of_phases or self.basis.kind == "line" else y[:, None]
        return np.asarray(y * np.array(self.phases), dtype=np.float64)

    def columns(self, batch: SignalBatch) -> Array:
        """Columns of the basis at the quantity's values in a batch, shape (size, n) or (size, 3 n)."""
        x = self.quantity.of(batch)
        return self.basis.columns(x if x.ndim == 2 else x[:, None], batch, self.place.over_interval)


@dataclass
class SharedColumns:
    """Columns that hypotheses have in common, as those of each phase and of all, for the batch that is evaluated."""

    _seen: dict[object, tuple[SignalBatch, Array]] = field(default_factory=dict)

    def of(self, hypothesis: Hypothesis, batch: SignalBatch) -> Array:
        """A hypothesis' columns, computed where the last batch was another."""
        place = hypothesis.place
        # Places of one layer see the same signals.
        key = hypothesis.quantity.name, hypothesis.basis, place.over_interval, place.layer
        seen = self._seen.get(key)
        # Other threads may ask of other batches.
        if seen is None or seen[0] is not batch:
            self._seen[key] = seen = batch, hypothesis.columns(batch)
        return seen[1]


def in_words(hypothesis: Hypothesis) -> str:
    """Place, quantity and phase of a law: ``a voltage that each leg loses, over its phase current``."""
    phase = PHASE_NAMES[hypothesis.phases]
    return f"{hypothesis.place.text}, over {hypothesis.quantity.text}{f', in phase {phase} alone' if phase else ''}"


class FlexibleEffect:
    """A hypothesis as an effect, for the diagnosis' fitter."""

    summary = "A flexible law."
    signature = ""
    needs = ()
    gauge = ""

    def __init__(self, hypothesis: Hypothesis, shared: SharedColumns) -> None:
        self.hypothesis, self.shared = hypothesis, shared
        self.name = hypothesis.key
        self.layer = hypothesis.place.layer
        self.Parameters = _parameters(hypothesis)

    def correct_batch(self, batch: SignalBatch, p: Any) -> Correction:
        """The signals without the law's values."""
        coefficients = np.array([getattr(p, name) for name in names(self.hypothesis)])
        columns = self.shared.of(self.hypothesis, batch)
        return self.hypothesis.place.apply(batch, self.hypothesis.values(columns, coefficients))

    def correct(self, signals: Signals, p: Any) -> Correction:
        """`correct_batch` of one segment."""
        return self.correct_batch(SignalBatch.of([signals]), p)


def names(hypothesis: Hypothesis) -> tuple[str, ...]:
    """Names of a flexible law's coefficients."""
    return tuple(f"c{j}" for j in range(hypothesis.basis.size))


def _parameters(hypothesis: Hypothesis) -> type[EffectParameters]:
    size, far = hypothesis.size, 1e4 * hypothesis.size
    fields: dict[str, Any] = {
        name: amplitude("1", typical=size, prior_width=size, low=-far, high=far) for name in names(hypothesis)
    }
    return type("Parameters", (EffectParameters,), {"__annotations__": dict.fromkeys(fields, float), **fields})


@dataclass(frozen=True)
class Ranges:
    """Range of each quantity in a recording, and the sizes that make a law small.

    Attributes
    ----------
    of : dict
        Lowest and highest value of each quantity, by name.
    interval_s, longest_s : float
        Shortest sampling interval and longest segment.
    sizes : dict
        By the unit of a place.
    pulse_rates : int
        Number of PWM frequencies.
    positions : int
        Number of rotor angles.
    whole_s : float
        Length of the experiment.
    """

    of: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    interval_s: float = 1e-4
    longest_s: float = 1.0
    sizes: Mapping[str, float] = field(default_factory=dict)
    pulse_rates: int = 1
    positions: int = 1
    whole_s: float = 1.0

    @classmethod
    def in_fit(cls, fit: Fit) -> Ranges:
        """Of the segments of a fit whose bridge is on."""
        batches = [b.base for b in fit.linearisation.batches if b.base.segments[0].bridge_on]
        found = {}
        for quantity in QUANTITIES:
            values = [quantity.of(batch) for batch in batches]
            found[quantity.name] = (min(float(v.min()) for v in values), max(float(v.max()) for v in values))
        rates = [r for b in batches for r in b.sampling_frequency_hz]
        lengths = [
            float(n / r) for b in batches for n, r in zip(np.diff(b.starts), b.sampling_frequency_hz, strict=True)
        ]
        amps, ohms = found[of.CURRENT.name][1], abs(fit.model.r_s)
        sizes = {"V": amps * ohms, "A": amps, "ohm": ohms, "1": 1.0, "rad": 1.0}
        pulse_rates = {float(f) for b in batches for f in b.pwm_frequency_hz}
        angles = {round(float(b.segments[k].turned_rad), 3) for b in batches for k in range(len(b.segments))}
        whole_s = found[of.TIME.name][1]
        return cls(found, 1.0 / max(rates), max(lengths), sizes, len(pulse_rates), len(angles), whole_s)

    def size_at(self, place: Place) -> float:
        """A small size of a law there."""
        if place.factor is None:
            return place.typical * self.sizes[place.unit]
        far = max(map(abs, self.of[place.factor.name]))
        return place.typical * self.sizes[place.unit.split("/")[0]] / max(far, 1e-300)

    def curve(self, quantity: Quantity, parity: Parity, cells: int = CELLS) -> CurveBasis | None:
        """A curve over a quantity's range; None where the quantity does not vary."""
        low, high = self.of[quantity.name]
        if parity == "periodic":
            # As many positions as twice the harmonics: higher ones look like lower ones.
            harmonics = min(MAX_HARMONICS, self.positions // 2)
            return HarmonicBasis(-np.pi, np.pi, harmonics, parity) if harmonics > 0 else None
        if parity != "none":
            low, high = 0.0, max(abs(low), abs(high))
        if not high - low > 1e-6 * max(abs(low), abs(high)):
            return None
        knee = KNEE * high if parity != "none" else np.inf
        return CurveBasis(low, high, cells, parity, knee)

    def memory(self, quantity: Quantity, kind: str) -> MemoryBasis | None:
        """A spectrum of lags, or a sum of plays."""
        top = max(map(abs, self.of[quantity.name]))
        if top == 0.0:
            return None
        if kind == "cooling":
            shortest, longest = (part * self.whole_s for part in COOLING)
            return MemoryBasis("cooling", tuple(float(t) for t in np.geomspace(shortest, longest, LAGS)))
        if kind == "play":
            return MemoryBasis("play", tuple(r * top for r in RADII))
        return MemoryBasis(kind, tuple(float(t) for t in np.geomspace(self.interval_s, 0.5 * self.longest_s, LAGS)))


QUANTITIES = (
    of.PHASE_CURRENT, of.SMOOTH_CURRENT, of.NEXT_CURRENT, of.PREVIOUS_CURRENT, of.CURRENT_SLOPE, of.PHASE_VOLTAGE,
    of.VOLTAGE_BEFORE, of.PHASE_FLUX, of.CURRENT, of.CURRENT_D, of.CURRENT_Q, of.TORQUE, of.VOLTAGE, of.POWER,
    of.LINK_VOLTAGE, of.TIME, of.HEAT, of.ROTOR_ANGLE,
)  # fmt: skip
EACH = (ALL, A, B, C)
SENSORS = (ALL, A, B)
Part = Parity | Literal["lag", "play", "cooling", "late"]
KINDS: tuple[tuple[Place, Quantity, tuple[Part, ...], tuple[Phases, ...]], ...] = (
    (at.LEG_VOLTAGE, of.PHASE_CURRENT, ("odd",), EACH),
    (at.LEG_VOLTAGE, of.PHASE_CURRENT, ("even",), EACH),
    (at.PULSE_VOLTAGE, of.PHASE_CURRENT, ("odd",), EACH),
    (at.LEG_VOLTAGE_BY_TIME, of.PHASE_CURRENT, ("odd",), EACH),
    (at.PULSE_VOLTAGE_BY_TIME, of.PHASE_CURRENT, ("odd",), (ALL,)),
    (at.LEG_VOLTAGE_BY_HEAT, of.PHASE_CURRENT, ("odd",), EACH),
    (at.LEG_VOLTAGE, of.SMOOTH_CURRENT, ("lag", "play"), (ALL,)),
    (at.LEG_VOLTAGE, of.PHASE_VOLTAGE, ("odd",), (ALL,)),
    (at.LEG_VOLTAGE, of.TIME, ("none",), (A, B, C)),
    (at.VOLTAGE_GAIN, of.TIME, ("none",), (ALL,)),
    (at.VOLTAGE_GAIN, of.POWER, ("none",), (ALL,)),
    (at.VOLTAGE_GAIN, of.CURRENT, ("none",), (ALL,)),
    (at.VOLTAGE_GAIN, of.LINK_VOLTAGE, ("none",), (ALL,)),
    (at.VOLTAGE_GAIN, of.VOLTAGE, ("none",), (ALL,)),
    (at.VOLTAGE_GAIN, of.HEAT, ("none",), (ALL,)),
    (at.READING, of.PHASE_CURRENT, ("odd",), SENSORS),
    (at.READING, of.PHASE_CURRENT, ("even",), SENSORS),
    (at.READING, of.SMOOTH_CURRENT, ("lag", "play"), (ALL,)),
    (at.READING, of.NEXT_CURRENT, ("odd",), SENSORS),
    (at.READING, of.PREVIOUS_CURRENT, ("odd",), SENSORS),
    (at.READING, of.VOLTAGE_BEFORE, ("odd",), SENSORS),
    (at.READING_BY_TIME, of.PHASE_CURRENT, ("odd",), SENSORS),
    (at.READING, of.CURRENT_SLOPE, ("odd",), SENSORS),
    (at.READING, of.CURRENT, ("none",), SENSORS),
    (at.READING, of.TIME, ("none",), SENSORS),
    (at.READING_GAIN, of.TIME, ("none",), SENSORS),
    (at.READING_GAIN, of.HEAT, ("none",), SENSORS),
    (at.READING_GAIN, of.CURRENT, ("none",), (ALL,)),
    (at.RESISTANCE, of.TIME, ("none",), (ALL,)),
    (at.RESISTANCE, of.HEAT, ("none", "cooling"), (ALL,)),
    (at.RESISTANCE, of.CURRENT, ("none",), (ALL,)),
    (at.LEG_RESISTANCE, of.TIME, ("none",), (A, B, C)),
    (at.LEG_RESISTANCE, of.HEAT, ("none", "cooling"), (A, B, C)),
    (at.ANGLE, of.TIME, ("none",), (ALL,)),
    (at.ANGLE, of.HEAT, ("none",), (ALL,)),
    (at.ANGLE, of.ROTOR_ANGLE, ("periodic",), (ALL,)),
    (at.ANGLE, of.CURRENT_Q, ("odd", "even"), (ALL,)),
    (at.ANGLE, of.TORQUE, ("odd", "even", "late"), (ALL,)),
    (at.ANGLE, of.CURRENT_D, ("none",), (ALL,)),
    (at.MAGNETISING, of.PHASE_FLUX, ("lag", "play"), EACH),
    (at.MAGNETISING_D, of.TIME, ("none",), (ALL,)),
    (at.MAGNETISING_D, of.HEAT, ("none", "cooling"), (ALL,)),
)
"""The single laws: place, quantity, parts of a curve or kinds of memory, phases."""


LINES = (at.READING, at.LEG_VOLTAGE, at.VOLTAGE_GAIN)
"""Where a line over time may enter."""
MAX_LINES: int = 8
"""Lines that are compared at each of these places: a sum over windows has some at other frequencies, too."""


def hypotheses(ranges: Ranges) -> Iterator[Hypothesis]:
    """All single laws over quantities that vary in the recording."""
    for place, quantity, parts, which in KINDS:
        if place.name.startswith(at.PULSE_VOLTAGE.name) and ranges.pulse_rates < 2:
            continue
        for part in parts:
            size = ranges.size_at(place)
            basis: Basis | None
            if part == "lag" or part == "play" or part == "cooling" or part == "late":
                basis = ranges.memory(quantity, part)
            else:
                basis = ranges.curve(quantity, part)
            if basis is None:
                continue
            if isinstance(basis, MemoryBasis):
                # Coefficients multiply the quantity itself.
                size /= max(map(abs, ranges.of[quantity.name]))
            for phases in which:
                yield Hypothesis(place, quantity, phases, basis, size)


def line_hypotheses(fit: Fit, ranges: Ranges) -> Iterator[Hypothesis]:
    """The highest lines of a leftover over time, at each place where one may enter."""
    for place in LINES:
        gradients = [gradient_over(fit, place, phases, of.TIME) for phases in ((A, B) if place.of_phases else (ALL,))]
        both = gradients[0][1] + 1j * gradients[-1][1] if place.of_phases else gradients[0][1]
        for frequency_hz in line_frequencies(gradients[0][0], both, ranges.interval_s, MAX_LINES):
            basis = LineBasis(frequency_hz, 1.0 / ranges.whole_s, place.of_phases)
            yield Hypothesis(place, of.TIME, ALL, basis, ranges.size_at(place))


def term_of(hypothesis: Hypothesis, coefficients: Array, free: bool = True) -> EffectTerm:
    """The flexible law as a term of a model."""
    candidate = hypothesis.candidate()
    values = dict(zip(names(hypothesis), map(float, coefficients), strict=True))
    return EffectTerm(candidate, values, tuple(values) if free else ())

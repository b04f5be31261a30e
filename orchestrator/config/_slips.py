"""Nameplate values written in another unit or convention than their fields', ranked by their probability.

A slip is a hypothesis that competes with the numbers as written. With the mismatch X (twice the negative logarithm of
the likelihood) and its prior probability P, it is more likely than "as written" where
X_written - X_slip > 2 ln 1/P (Bayes' theorem; D. MacKay, Information Theory, Inference, and Learning Algorithms,
Cambridge 2003, ch. 28).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from orchestrator.config._nameplate import (
    Values,
    broken_relations,
    completed,
    contradictions,
    is_judged,
    largest_torque_nm,
    mismatch,
    stated_values,
)
from protocols import Motor

POLES, HABIT, COMMON, RARE = 0.06, 0.04, 0.01, 0.001
"""Prior probability of a slip per nameplate: poles, which most data sheets count; another convention of data sheets; a
wrong unit or decimal point; rare slips. With correct values of up to 25 % error, one nameplate in thirty is then
questioned."""
MAX_EXCESS_MISMATCH = 2.0 * math.log(100.0)
"""A named slip is within odds of 1 to 100 of the best: its mismatch plus prior exceeds the best's by at most this."""
MAX_NAMED = 2
MAX_COINCIDENCE = 0.02
"""Relative difference of two numbers of a data sheet that agree, rounded as they are."""
USUAL_BUSES_V = (12.0, 36.0, 48.0, 60.0, 72.0, 96.0)
"""DC buses that stand on a low-voltage motor's label as its voltage [V]; 24 V is a usual rms value, too."""
BUS_TO_LINE_RMS = math.sqrt(0.5)
"""Largest rms voltage from line to line over the DC bus: the phase's peak is bus / sqrt 3."""


@dataclass(frozen=True)
class Slip:
    """Values written in another unit or convention than their fields'.

    Attributes
    ----------
    fields : tuple of str
        Fields concerned.
    words : str
        End of the question "is the stated value ...?"
    corrected : callable
        Corrected values of these fields, from all values.
    probability : float
        Prior probability per nameplate.
    needed : tuple of str
        Other fields without which the slip cannot be judged.
    """

    fields: tuple[str, ...]
    words: str
    corrected: Callable[[Values], Mapping[str, float]]
    probability: float = COMMON
    needed: tuple[str, ...] = ()

    def repeats(self, other: Slip) -> bool:
        """Whether it asks the question of another one again, about some of the same fields."""
        return self.words.endswith(other.words.removeprefix("in ")) and bool(set(self.fields) & set(other.fields))

    def question(self, values: Values) -> str:
        """The question, with the corrected values and without its mark."""
        right = ", ".join(f"{value:.4g}" for value in self.corrected(values).values())
        fields = " and ".join(f"motor.{name}" for name in self.fields)
        return f"{fields}: {right} would fit: is the stated value {self.words}"

    def applied(self, values: Values) -> dict[str, float]:
        """All values, corrected."""
        return {**values, **self.corrected(values)}


def _times(fields: tuple[str, ...], factor: float, words: str, probability: float = COMMON) -> Slip:
    return Slip(fields, words, lambda values: {name: factor * values[name] for name in fields}, probability)


_R, _L_D, _L_Q, _PSI = "stator_resistance_ohm", "d_inductance_h", "q_inductance_h", "pm_flux_wb"
_V, _I, _P, _T = "rated_voltage_rms_v", "rated_current_rms_a", "rated_power_w", "rated_torque_nm"
_F, _N, _PAIRS = "rated_frequency_hz", "rated_speed_rpm", "pole_pairs"
_BETWEEN_LINES = "from line to line, not of a phase"

SLIPS = (
    *(_times(fields, 1e-3, "in mH") for fields in ((_L_D, _L_Q), (_L_D,), (_L_Q,))),
    *(_times(fields, 1e-6, "in uH") for fields in ((_L_D, _L_Q), (_L_D,), (_L_Q,))),
    *(_times(fields, 0.5, _BETWEEN_LINES, HABIT) for fields in ((_R, _L_D, _L_Q), (_R,))),
    _times((_L_D, _L_Q), 0.5, _BETWEEN_LINES, HABIT),
    *(_times(fields, 0.1, "a decimal point off") for fields in ((_L_D, _L_Q), (_R,), (_PSI,))),
    *(_times(fields, 10.0, "a decimal point off") for fields in ((_L_D, _L_Q), (_R,), (_PSI,))),
    Slip((_L_D, _L_Q), "d and q exchanged", lambda v: {_L_D: v[_L_Q], _L_Q: v[_L_D]}, HABIT, needed=(_PSI,)),
    _times((_R,), 1e-3, "in milliohm"),
    _times((_R, _L_D, _L_Q), 1e-3, "in milliohm and mH"),
    _times((_PSI,), 1e-3, "in mWb"),
    _times((_PSI,), math.sqrt(2.0), "the rms, not the peak value", HABIT),
    _times((_PSI,), 1.0 / math.sqrt(3.0), _BETWEEN_LINES, HABIT),
    _times((_PSI,), 2.0, "half of the peak value", HABIT),
    _times((_PSI,), 0.5, "from peak to peak", HABIT),
    _times((_I,), math.sqrt(0.5), "the peak, not the rms value", HABIT),
    _times((_I,), 1e-3, "in mA"),
    _times((_V,), math.sqrt(3.0), "from phase to star point, not from line to line", HABIT),
    _times((_V,), math.sqrt(0.5), "the peak between lines, or the bus, not the rms value", HABIT),
    _times((_V,), 1e3, "in kV"),
    _times((_P,), 1e3, "in kW"),
    _times((_P,), 745.7, "in horsepower", RARE),
    _times((_T,), 1e-3, "in mNm"),
    _times((_T,), 1e-2, "in Ncm", RARE),
    _times((_N,), 30.0 / math.pi, "in rad/s"),
    Slip((_N,), "the electrical, not the mechanical speed", lambda v: {_N: v[_N] / v.get(_PAIRS, 1.0)}, RARE),
    Slip((_F,), "the mechanical, not the electrical frequency", lambda v: {_F: v[_F] * v.get(_PAIRS, 1.0)}),
    _times((_PAIRS,), 0.5, "the number of poles", POLES),
)

ROOT_TWO_SLIPS = (
    _times((_I,), math.sqrt(0.5), "the peak, not the rms value", HABIT),
    _times((_PSI,), math.sqrt(0.5), "of a torque constant in Nm per ampere rms, not peak"),
)
"""Slips that make the torque a root of two too large."""


def nameplate_doubts(motor: Motor) -> Iterator[str]:
    """Contradictions of a nameplate and likely slips, a sentence each; none where it is consistent or too incomplete.

    Parameters
    ----------
    motor : Motor

    Yields
    ------
    str
        Both numbers of each violated relation, then the slips that would correct all of them, the likeliest first.
        Where all relations hold, a slip that is more likely than none.
    """
    yield from contradictions(motor)
    yield from nameplate_questions(motor)


def nameplate_questions(motor: Motor) -> Iterator[str]:
    """The slips alone of `nameplate_doubts`, each with the corrected values; a usual DC bus as the rated voltage."""
    values = stated_values(motor)
    for slip in likely_slips(values):
        yield f"{slip.question(values)}?"
    voltage_v = values.get(_V)
    if voltage_v in USUAL_BUSES_V and not is_judged(values, _V):
        text = (
            f"{voltage_v:g} V is a usual DC bus, of which {BUS_TO_LINE_RMS * voltage_v:.4g} V line to line rms are left"
        )
        yield f"motor.{_V}: {text}: is the stated value the bus?"


def root_two_question(motor: Motor) -> Iterator[str]:
    """Which value is a root of two too large, where flux, current and torque differ by just that factor.

    Only where no likelier slip is named. A torque sqrt 2 times the rated one is not unusual by itself, but a nameplate
    whose numbers agree after the division is rarely a coincidence. The torque alone does not tell current and flux
    apart: both are questioned, first the one with which voltage and power agree better.
    """
    values = completed(stated_values(motor))
    if not all(name in values for name in (_PAIRS, _PSI, _I, _T)) or likely_slips(stated_values(motor)):
        return
    fitting = [
        slip
        for slip in ROOT_TWO_SLIPS
        if abs(largest_torque_nm(slip.applied(values)) / values[_T] - 1.0) <= MAX_COINCIDENCE
    ]
    if not fitting:
        return
    fitting.sort(key=lambda slip: mismatch(slip.applied(values)) - 2.0 * math.log(slip.probability))
    torque_nm = largest_torque_nm(values)
    questions = ", or ".join(slip.question(values) for slip in fitting)
    made = f"{values[_PAIRS]:g} pole pairs, {values[_PSI]:.4g} Wb and {values[_I]:.4g} A rms make {torque_nm:.3g} Nm"
    yield f"{questions}? As it is written, {made}, {torque_nm / values[_T]:.3g} times rated_torque_nm"


def likely_slips(values: Values) -> list[Slip]:
    """The slips that are more likely than the values as written, the likeliest first; at most two.

    Only those that violate no relation, or fewer than are violated without them.
    """
    written, broken = mismatch(values), len(broken_relations(values))
    scores: list[tuple[float, Slip]] = []
    for slip in SLIPS:
        if not all(name in values for name in (*slip.fields, *slip.needed)):
            continue
        corrected = slip.applied(values)
        if corrected == values or (_PAIRS in slip.fields and corrected[_PAIRS] % 1.0):
            continue
        if len(broken_relations(corrected)) > max(broken - 1, 0):
            continue
        score = mismatch(corrected) + 2.0 * math.log(1.0 / slip.probability)
        if score < written:
            scores.append((score, slip))
    scores.sort(key=lambda pair: pair[0])
    named: list[Slip] = []
    for score, slip in scores:
        if score <= scores[0][0] + MAX_EXCESS_MISMATCH and not any(slip.repeats(other) for other in named):
            named.append(slip)
    return named[:MAX_NAMED]

"""How each contrast is recognised in a recording, and which effects a recording can separate.

Installed effects declare what separates them. A file of one's own may declare nothing, so that its effects are compared
by their signals. With x the standardised amplitudes of an effect and M the normal matrix of their columns, the columns
of R_s, the map and all other parameters eliminated, its signal has chi2 = x'Mx. An effect resembles it where that falls
to a small part once its columns are eliminated too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from protocols import Contrast, Effect, SegmentStage

SAME_CURRENT: float = 0.02
"""Difference of two currents, relative to the largest, below which they are one operating point."""
MIN_AMPLITUDE_RATIO: float = 1.3
"""Ratio of two injected amplitudes from which they count as different."""
LONG_HOLD_S: float = 30.0
"""Length of a hold that warms the winding noticeably [s]."""
SMALL_CURRENTS: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Currents of both signs, relative to the largest, at which the behaviour about zero current is measured."""
DIRECTIONS: int = 12
"""Number of directions of held currents in a full turn: twice the axes of a three-phase winding."""


class Recognition(NamedTuple):
    """The measurement that provides a contrast, in words, and whether a recording contains it."""

    text: str
    holds: Callable[[PreparedRecording], bool]


def holds(prepared: PreparedRecording, contrast: Contrast) -> bool:
    """Whether a recording holds a contrast."""
    return CONTRASTS[contrast].holds(prepared)


def _of(prepared: PreparedRecording, stage: SegmentStage) -> list[SegmentData]:
    return [p for p in prepared.pieces if p.stage is stage]


def _currents(prepared: PreparedRecording, stage: SegmentStage) -> Array:
    """Mean currents of a stage's segments in dq, in parts of the largest current; shape (segments, 2)."""
    means = [to_dq(p.signals.i_ab, p.segment.rotor_angle_rad).mean(axis=0) for p in _of(prepared, stage)]
    low, high, q = prepared.current_range
    return np.reshape(means, (-1, 2)) / max(-low, high, q)


def _gates_off(prepared: PreparedRecording) -> bool:
    return bool(_of(prepared, SegmentStage.GATES_OFF))


def _small_currents(prepared: PreparedRecording) -> bool:
    shares = SMALL_CURRENTS
    sizes = np.hypot(*_currents(prepared, SegmentStage.RESISTANCE).T)
    return int(np.sum(sizes < 1.5 * max(shares))) >= len(shares)


def _two_pwm_frequencies(prepared: PreparedRecording) -> bool:
    return len({p.signals.pwm_frequency_hz for p in _of(prepared, SegmentStage.RESISTANCE)}) > 1


def _all_around(prepared: PreparedRecording) -> bool:
    d, q = _currents(prepared, SegmentStage.RESISTANCE).T
    step = 2.0 * math.pi / DIRECTIONS
    held = {round(float(angle / step)) for angle in np.arctan2(q, d)[np.hypot(d, q) > 0.5]}
    return len(held) > DIRECTIONS / 2


def _seconds(piece: SegmentData) -> float:
    return len(piece.signals.v_dc) / piece.signals.sampling_frequency_hz


def _measured_again(prepared: PreparedRecording) -> bool:
    end = prepared.pieces[-1].signals.start_s
    for stage in (SegmentStage.RESISTANCE, SegmentStage.INJECTION):
        pieces, currents = _of(prepared, stage), _currents(prepared, stage)
        for k, piece in enumerate(pieces):
            later = [p.signals.start_s - piece.signals.start_s > 0.5 * end for p in pieces]
            if np.any(np.hypot(*(currents - currents[k]).T)[later] < SAME_CURRENT):
                return True
    return False


def _long_hold(prepared: PreparedRecording) -> bool:
    pieces, currents = _of(prepared, SegmentStage.RESISTANCE), _currents(prepared, SegmentStage.RESISTANCE)
    longest = LONG_HOLD_S
    return any(_seconds(p) > 0.5 * longest and np.hypot(*i) > 0.5 for p, i in zip(pieces, currents, strict=True))


def _two_amplitudes(prepared: PreparedRecording) -> bool:
    swings = [float(np.linalg.norm(np.std(p.signals.v_ab, axis=0))) for p in _of(prepared, SegmentStage.INJECTION)]
    return bool(swings) and max(swings) > MIN_AMPLITUDE_RATIO * min(swings)


def _two_ripple_frequencies(prepared: PreparedRecording) -> bool:
    ripples = _of(prepared, SegmentStage.INJECTION)
    return len({round(p.windows.period / p.signals.sampling_frequency_hz, 6) for p in ripples}) > 1


def _along_both_axes(prepared: PreparedRecording) -> bool:
    currents = _currents(prepared, SegmentStage.INJECTION)
    return len(currents) > 0 and bool((np.ptp(currents, axis=0) > 0.5).all())


def _two_angles(prepared: PreparedRecording) -> bool:
    return len({round(p.segment.rotor_angle_rad, 3) for p in prepared.pieces}) > 1


CONTRASTS: Mapping[Contrast, Recognition] = {
    Contrast.GATES_OFF: Recognition("a reading with all gates off", _gates_off),
    Contrast.SMALL_CURRENTS: Recognition("direct currents close to zero", _small_currents),
    Contrast.SECOND_PWM_FREQUENCY: Recognition("direct currents at a second PWM frequency", _two_pwm_frequencies),
    Contrast.DIRECTIONS: Recognition("direct currents all around", _all_around),
    Contrast.ANCHOR: Recognition("one point once more at the end", _measured_again),
    Contrast.LONG_HOLD: Recognition("a direct current for long", _long_hold),
    Contrast.SECOND_INJECTION_AMPLITUDE: Recognition("ripple of a second amplitude", _two_amplitudes),
    Contrast.SECOND_INJECTION_FREQUENCY: Recognition("ripple of a second frequency", _two_ripple_frequencies),
    Contrast.OPERATING_POINTS: Recognition("ripple along both axes", _along_both_axes),
    Contrast.SECOND_ANGLE: Recognition("the rotor locked at a second angle", _two_angles),
}


def separating_contrasts(first: Effect, second: Effect) -> tuple[Contrast, ...]:
    """The contrasts that separate two effects: those in the `needs` of both.

    Effects that need the same contrast act alike without it. Others, even if each has needs, act differently in the
    ordinary stages: the result is empty, and any recording separates them.
    """
    return tuple(contrast for contrast in first.needs if contrast in second.needs)


def needed_contrasts(first: Effect, second: Effect) -> tuple[Contrast, ...]:
    """The contrasts in the `needs` of both, or else those in the `needs` of own effects among them.

    The author of an own effect knows what separates it, and cannot change what the installed ones declare.
    """
    own = (contrast for effect in (first, second) if is_own(effect) for contrast in effect.needs)
    return separating_contrasts(first, second) or tuple(dict.fromkeys(own))


def separable(prepared: PreparedRecording, first: Effect, second: Effect) -> bool:
    """Whether the recording holds every contrast that separates the two effects."""
    return all(holds(prepared, contrast) for contrast in separating_contrasts(first, second))


def inseparable_from(
    fitter: Fitter, fit: Fit, present: EffectTerm, candidates: Sequence[CandidateEffect]
) -> frozenset[str]:
    """Names of the absent candidates that the recording does not separate from an effect of the fit.

    Parameters
    ----------
    present : EffectTerm
        An effect of the fit's model.
    candidates : sequence of CandidateEffect
        Those that the model has already are passed over.
    """
    effect = present.candidate.effect
    absent = [c for c in candidates if c.name not in fit.model.names]
    tied = {c.name for c in absent if not separable(fit.prepared, c.effect, effect)}
    undeclared = [c for c in absent if (is_own(c.effect) or is_own(effect)) and c.name not in tied]
    if undeclared:
        tied |= {c.name for c in undeclared} & set(resembling(fitter, fit, present.name, undeclared))
    return frozenset(tied)


MIN_IMITATED_SHARE: float = 0.8
"""Part of an effect's signal that another one imitates, from which they resemble each other."""


def imitated_shares(fitter: Fitter, fit: Fit, name: str, candidates: Sequence[CandidateEffect]) -> dict[str, float]:
    """The part of an effect's signal that each other effect imitates, the largest first.

    Parameters
    ----------
    name : str
        An effect of the fit's model.
    candidates : sequence of CandidateEffect
        Compared with it, besides the other effects of the model.
    """
    columns = [*fit.model.free, *absent_columns([c for c in candidates if c.name not in fit.model.names])]
    normal, _ = fitter.evaluate(fit.model, fit.linearisation, columns[len(fit.model.free) :], known=fit).projected()
    of = [active.name for active, _ in columns]
    own = [k for k, (active, n) in enumerate(columns) if of[k] == name and n in active.candidate.amplitudes]
    x = np.array([columns[k][0].standardised_value(columns[k][1]) for k in own])
    shares = {}
    for other in dict.fromkeys(of):
        beside = [k for k in range(len(fit.model.free)) if of[k] not in (name, other)]
        alone = _signal(normal, own, beside, x)
        if other != name and alone > 0.0:
            imitating = [k for k, effect in enumerate(of) if effect == other]
            shares[other] = 1.0 - _signal(normal, own, [*beside, *imitating], x) / alone
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def own_signal(fitter: Fitter, fit: Fit, name: str, beside_others: bool) -> float:
    """chi2 of the signal of one effect of the model; of what the map and the other effects do not imitate of it.

    Parameters
    ----------
    beside_others : bool
        Whether the other effects of the model adapt; otherwise the map and R_s alone do.
    """
    columns = fit.model.free
    normal, _ = fitter.evaluate(fit.model, fit.linearisation, known=fit).projected()
    own = [k for k, (term, n) in enumerate(columns) if term.name == name and n in term.candidate.amplitudes]
    others = [k for k, (term, _) in enumerate(columns) if term.name != name] if beside_others else []
    return _signal(normal, own, others, np.array([columns[k][0].standardised_value(columns[k][1]) for k in own]))


def resembling(fitter: Fitter, fit: Fit, name: str, candidates: Sequence[CandidateEffect]) -> list[str]:
    """The effects of the model and candidates that resemble an effect of the model, the most similar first."""
    shares = imitated_shares(fitter, fit, name, candidates)
    return [other for other, share in shares.items() if share > MIN_IMITATED_SHARE]


def _signal(normal: Array, own: Sequence[int], others: Sequence[int], x: Array) -> float:
    """chi2 of an effect's signal that the other columns, under their unit priors, do not imitate."""
    block = normal[np.ix_(own, own)]
    if others:
        across = normal[np.ix_(others, own)]
        inner = normal[np.ix_(others, others)] + np.eye(len(others))
        block = block - across.T @ np.linalg.solve(inner, across)
    return float(x @ block @ x)

"""Pattern of the residual: each pattern is a set of signals with free amounts, fitted like an effect.

Patterns are attributed greedily, the one that explains most of the remaining residual first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.numerics.frames import from_phases, to_ab, to_dq, to_phases
from orchestrator.numerics.types import Array
from protocols import Correction, EffectLayer, EffectParameters, ShapeGroup, Signals, amplitude

MIN_PATTERN_SHARE: float = 0.02
"""Part of the residual below which a pattern is not reported."""
LEAST_PATTERN_CHI2: float = 20.0
"""Fall of chi2 required of a pattern; chance reaches it once in 1e3."""

Field = Callable[[Signals, float], Array]
"""Function of the signals and the typical current [A] that returns a signal of unit size, shape (n, 2)."""


@dataclass(frozen=True)
class _Addition:
    """A signal of `size` added to one quantity in a free amount: an effect without metadata."""

    quantity: str
    field: Field
    current_a: float
    size: float
    layer: EffectLayer

    class Parameters(EffectParameters):
        amount: float = amplitude("1", typical=1.0, prior_width=100.0, low=-1e9, high=1e9)

    @property
    def name(self) -> str:
        return f"addition to {self.quantity}"

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Add the signal."""
        added = p.amount * self.size * self.field(signals, self.current_a)
        return Correction(**{self.quantity: getattr(signals, self.quantity) + added})


Columns = list[tuple[EffectTerm, str]]
"""Amounts of a pattern's signals, for `Fitter.evaluate`'s `extra`."""


def _added(
    quantity: str, size: float, current_a: float, *fields: Field, layer: EffectLayer = EffectLayer.INVERTER
) -> Columns:
    """The amounts of signals that are added to one quantity."""
    additions = [_Addition(quantity, field, current_a, size, layer) for field in fields]
    parameters = _Addition.Parameters.declared()
    # The fit reads no more of an effect than an addition has.
    return absent_columns([CandidateEffect(addition, parameters) for addition in additions])  # type: ignore[arg-type]


def residual_pattern(fitter: Fitter, fit: Fit, current_a: float) -> list[tuple[ShapeGroup, float]]:
    """Shares of the excess chi2 by pattern, largest first; they add up to one.

    Parameters
    ----------
    current_a : float
        A typical current, which scales the patterns [A].
    """
    excess = fit.chi2 - fit.dof
    if excess <= 0.0:
        return []
    wanted: Columns = []
    remaining: dict[ShapeGroup, list[int]] = {}
    fitted = len(fit.model.free)
    for group, columns in _patterns(current_a, max(fit.model.r_s, 1e-3)).items():
        remaining[group] = list(range(fitted + len(wanted), fitted + len(wanted) + len(columns)))
        wanted += columns
    normal, right = fitter.evaluate(fit.model, fit.linearisation, wanted, known=fit).projected()
    chosen = list(range(fitted))
    shares: list[tuple[ShapeGroup, float]] = []
    explained = _explained(normal, right, chosen)
    while remaining:
        gains = {group: _explained(normal, right, chosen + columns) - explained for group, columns in remaining.items()}
        group = max(gains, key=lambda n: gains[n])
        if gains[group] < max(MIN_PATTERN_SHARE * excess, LEAST_PATTERN_CHI2):
            break
        chosen += remaining.pop(group)
        explained += gains[group]
        shares.append((group, min(gains[group] / excess, 1.0)))
    rest = 1.0 - sum(share for _, share in shares)
    if rest > MIN_PATTERN_SHARE:
        shares.append(("other", rest))
    total = sum(share for _, share in shares)
    return [(group, share / total) for group, share in sorted(shares, key=lambda item: -item[1])]


def _explained(normal: Array, right: Array, which: Sequence[int]) -> float:
    if not which:
        return 0.0
    block = normal[np.ix_(which, which)]
    scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
    scaled = block / np.outer(scale, scale) + 1e-9 * np.eye(len(which))
    b = right[list(which)] / scale
    return float(b @ np.linalg.solve(scaled, b))


def _patterns(current_a: float, r_s: float) -> dict[ShapeGroup, Columns]:
    volts, amps = 0.01 * r_s * current_a, 0.01 * current_a
    voltage = partial(_added, "v_ab", volts, current_a)
    current = partial(_added, "i_m_ab", amps, current_a, layer=EffectLayer.IRON)
    return {
        "odd_phase_current": voltage(
            *(_of_phases(_step(w)) for w in (0.01, 0.05, 0.3)), _of_phases(lambda i, a: (i / a) ** 3)
        ),
        "even_phase_current": voltage(
            _of_phases(lambda i, a: np.abs(i) / a), _of_phases(lambda i, a: np.asarray((i / a) ** 2))
        ),
        "constant": voltage(*(_constant(k, t) for t in (0, 1) for k in (0, 1))),
        "anisotropic_resistance": voltage(_stretched, _sheared),
        "time_resistance": voltage(*(_in_time(p) for p in (1, 2, 3))),
        "power_voltage": voltage(_power_voltage),
        "sweep_direction": current(*(_direction(w) for w in (0.02, 0.2))),
        "ripple_in_phase": voltage(_ripple),
        "ripple_edges": _added("v_ab", 1e-3, current_a, _edges),
        "map_not_even": current(_mixed(1.0), _mixed_cubic),
        "reciprocity_broken": current(_mixed(-1.0)),
        "map_detail": current(*(_wave(k) for k in (3, 5, 8))),
        "periodic": voltage(*(_hum(f, k) for f in (50.0, 60.0) for k in (0, 1))),
    }


def _of_phases(function: Callable[[Array, float], Array]) -> Field:
    return lambda s, a: from_phases(function(to_phases(s.i_ab), a))


def _step(width: float) -> Callable[[Array, float], Array]:
    return lambda i, a: np.asarray(np.tanh(i / (width * a)))


def _part_of_run(s: Signals) -> Array:
    end = float(s.losses.time_s[-1]) if s.losses is not None else 1.0
    return np.asarray(s.time_s / max(end, 1e-9), dtype=np.float64)


def _constant(axis: int, power: int) -> Field:
    def field(s: Signals, a: float) -> Array:
        out = np.zeros((len(s.v_dc), 2))
        out[:, axis] = _part_of_run(s) ** power
        return out

    return field


def _stretched(s: Signals, a: float) -> Array:
    return np.asarray(s.i_ab * np.array([1.0, -1.0]) / a)


def _sheared(s: Signals, a: float) -> Array:
    return np.asarray(s.i_ab[:, ::-1] / a)


def _in_time(power: int) -> Field:
    return lambda s, a: np.asarray(s.i_ab * (_part_of_run(s) ** power / a)[:, None])


def _power_voltage(s: Signals, a: float) -> Array:
    power = np.einsum("ij,ij->i", s.v_ab, s.i_ab)
    return np.asarray(s.v_ab * (power / (a * a * float(s.resistance_ohm[0]) * a * float(s.resistance_ohm[0])))[:, None])


def _direction(width: float) -> Field:
    def field(s: Signals, a: float) -> Array:
        psi = s.psi_smooth_ab if s.psi_smooth_ab is not None else s.i_ab
        step = max(1, round(0.001 * s.sampling_frequency_hz))
        ahead = np.concatenate([psi[step:], np.repeat(psi[-1:], step, axis=0)]) - psi
        scale = width * float(np.abs(ahead).max()) + 1e-12
        return np.asarray(ahead / np.sqrt(np.einsum("ij,ij->i", ahead, ahead) + scale**2)[:, None])

    return field


def _ripple(s: Signals, a: float) -> Array:
    width = max(2, round(0.004 * s.sampling_frequency_hz))
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(s.i_ab, axis=0)])
    index = np.arange(len(s.v_dc))
    first, last = np.maximum(index - width, 0), np.minimum(index + width, len(index) - 1) + 1
    mean = (total[last] - total[first]) / (last - first)[:, None]
    return np.asarray((s.i_ab - mean) / a)


def _edges(s: Signals, a: float) -> Array:
    return np.asarray(np.concatenate([np.zeros((1, 2)), np.diff(s.v_ab, axis=0)]))


def _mixed(sign: float) -> Field:
    def field(s: Signals, a: float) -> Array:
        i_dq = to_dq(s.i_m_ab, s.theta_rad)
        return to_ab(i_dq[:, ::-1] * (np.array([1.0, sign]) / a), s.theta_rad)

    return field


def _mixed_cubic(s: Signals, a: float) -> Array:
    d, q = to_dq(s.i_m_ab, s.theta_rad).T / a
    return to_ab(np.stack([q**3, 3.0 * q**2 * d], axis=1), s.theta_rad)


def _wave(count: int) -> Field:
    return lambda s, a: to_ab(np.sin(count / a * to_dq(s.i_m_ab, s.theta_rad)), s.theta_rad)


def _hum(frequency: float, axis: int) -> Field:
    def field(s: Signals, a: float) -> Array:
        out = np.zeros((len(s.v_dc), 2))
        out[:, axis] = np.sin(2 * np.pi * frequency * s.time_s)
        out[:, 1 - axis] = np.cos(2 * np.pi * frequency * s.time_s)
        return out

    return field


def map_asymmetry(fitter: Fitter, fit: Fit, current_a: float) -> tuple[tuple[float, float], float]:
    """Violation of the map's symmetries that the residual suggests.

    Returns
    -------
    parity : (float, float)
        Flux at the typical current by which psi_d would be odd, and psi_q even, in i_q [Wb].
    reciprocity : float
        dpsi_d/di_q - dpsi_q/di_d over the mean inductance.
    """
    size = 0.01 * current_a
    columns = _added("i_m_ab", size, current_a, _mixed(1.0), _mixed(-1.0), layer=EffectLayer.IRON)
    normal, right = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
    regular = normal + 1e-12 * np.diag(np.diag(normal) + 1e-300)
    fitted = len(fit.model.free)
    regular[:fitted, :fitted] += np.eye(fitted)
    x = -np.linalg.solve(regular, right)[fitted:] * _Addition.Parameters.declared()[0].prior_width * size
    inductance = fit.model.magnetics.flux_and_inductance(np.zeros((1, 2)))[1][0]
    even, odd = abs(float(x[0])), abs(float(x[1])) / current_a
    return (inductance[0] * even, inductance[2] * even), 2.0 * odd

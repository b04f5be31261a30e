"""Pattern of the residual: each pattern is a set of signals with free amounts, fitted like an effect.

Patterns are attributed greedily, the one that explains most of the remaining residual first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import get_args

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

    name: str
    quantity: str
    field: Field
    current_a: float
    size: float
    layer: EffectLayer

    class Parameters(EffectParameters):
        amount: float = amplitude("1", typical=1.0, prior_width=100.0, low=-1e9, high=1e9)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Add the signal."""
        added = p.amount * self.size * self.field(signals, self.current_a)
        return Correction(**{self.quantity: getattr(signals, self.quantity) + added})


@dataclass(frozen=True)
class _Shape:
    """A pattern: signals added to one quantity in free amounts."""

    name: str
    quantity: str
    fields: tuple[Field, ...]
    current_a: float
    size: float
    layer: EffectLayer = EffectLayer.INVERTER

    @property
    def columns(self) -> list[tuple[EffectTerm, str]]:
        """Each signal's amount, for `Fitter.evaluate`'s `extra`."""
        parameters = _Addition.Parameters.declared()
        additions = [
            _Addition(self.name, self.quantity, field, self.current_a, self.size, self.layer) for field in self.fields
        ]
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
    shapes = _shapes(current_a, max(fit.model.r_s, 1e-3))
    wanted: list[tuple[EffectTerm, str]] = []
    index: dict[str, list[int]] = {}
    for shape in shapes:
        index[shape.name] = list(range(len(wanted), len(wanted) + len(shape.fields)))
        wanted += shape.columns
    normal, right = fitter.evaluate(fit.model, fit.linearisation, wanted, known=fit).projected()
    fitted = len(fit.model.free)
    chosen = list(range(fitted))
    shares: list[tuple[ShapeGroup, float]] = []
    remaining = dict(index)
    explained = _explained(normal, right, chosen)
    while remaining:
        gains = {
            name: _explained(normal, right, chosen + [fitted + k for k in columns]) - explained
            for name, columns in remaining.items()
        }
        name = max(gains, key=lambda n: gains[n])
        if gains[name] < max(MIN_PATTERN_SHARE * excess, LEAST_PATTERN_CHI2):
            break
        chosen += [fitted + k for k in remaining.pop(name)]
        explained += gains[name]
        group: ShapeGroup = name  # type: ignore[assignment]  # `_shapes` has no other names
        shares.append((group, min(gains[name] / excess, 1.0)))
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


def _shapes(current_a: float, r_s: float) -> list[_Shape]:
    volts = 0.01 * r_s * current_a
    amps = 0.01 * current_a
    layer = EffectLayer.IRON

    def of_phases(function: Callable[[Array, float], Array]) -> Field:
        def field(s: Signals, a: float) -> Array:
            return from_phases(function(to_phases(s.i_ab), a))

        return field

    shapes = [
        _Shape(
            "odd_phase_current",
            "v_ab",
            (*(of_phases(_step(w)) for w in (0.01, 0.05, 0.3)), of_phases(lambda i, a: (i / a) ** 3)),
            current_a,
            volts,
        ),
        _Shape(
            "even_phase_current",
            "v_ab",
            (of_phases(lambda i, a: np.abs(i) / a), of_phases(lambda i, a: (i / a) ** 2)),
            current_a,
            volts,
        ),
        _Shape("constant", "v_ab", tuple(_constant(k, t) for t in (0, 1) for k in (0, 1)), current_a, volts),
        _Shape("anisotropic_resistance", "v_ab", (_stretched, _sheared), current_a, volts),
        _Shape("time_resistance", "v_ab", tuple(_in_time(p) for p in (1, 2, 3)), current_a, volts),
        _Shape("power_voltage", "v_ab", (_power_voltage,), current_a, volts),
        _Shape("sweep_direction", "i_m_ab", tuple(_direction(w) for w in (0.02, 0.2)), current_a, amps, layer=layer),
        _Shape("ripple_in_phase", "v_ab", (_ripple,), current_a, volts),
        _Shape("ripple_edges", "v_ab", (_edges,), current_a, 1e-3),
        _Shape("map_not_even", "i_m_ab", (_mixed(1.0), _mixed_cubic), current_a, amps, layer=layer),
        _Shape("reciprocity_broken", "i_m_ab", (_mixed(-1.0),), current_a, amps, layer=layer),
        _Shape("map_detail", "i_m_ab", tuple(_wave(k) for k in (3, 5, 8)), current_a, amps, layer=layer),
        _Shape("periodic", "v_ab", tuple(_hum(f, k) for f in (50.0, 60.0) for k in (0, 1)), current_a, volts),
    ]
    known = set(get_args(ShapeGroup))
    return [shape for shape in shapes if shape.name in known]


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
    layer = EffectLayer.IRON
    shape = _Shape("breaks", "i_m_ab", (_mixed(1.0), _mixed(-1.0)), current_a, 0.01 * current_a, layer=layer)
    normal, right = fitter.evaluate(fit.model, fit.linearisation, shape.columns, known=fit).projected()
    regular = normal + 1e-12 * np.diag(np.diag(normal) + 1e-300)
    fitted = len(fit.model.free)
    regular[:fitted, :fitted] += np.eye(fitted)
    x = -np.linalg.solve(regular, right)[fitted:] * _Addition.Parameters.declared()[0].prior_width * shape.size
    inductance = fit.model.magnetics.flux_and_inductance(np.zeros((1, 2)))[1][0]
    mean = 0.5 * (inductance[0] + inductance[2])
    even, odd = abs(float(x[0])), abs(float(x[1])) / current_a
    return (inductance[0] * even, inductance[2] * even), 2.0 * odd * mean / mean

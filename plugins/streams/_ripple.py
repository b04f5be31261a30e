"""The ripple of one operating point and a straight line through it, quick and provisional: the estimators know better.

While the rotor is locked and the ripple is small, i~ = L^-1 psi~ with psi~ the zero-mean primitive of v - R_s i
(Combes, Malrait, Martin, Rouchon, "Obtaining the current-flux relations of the saturated PMSM by signal
injection"). Inductances at neighbouring points, integrated by the trapezoid rule from each point to the nearest
one known before, give a flux that grows point by point while the sweep goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from orchestrator.numerics.frames import to_dq
from protocols import Capture, RealArray

DELAY_SAMPLES = (0, 1, 2)
"""Samples by which a drive's voltage may act late; the best fit says which."""


@dataclass(frozen=True)
class RippleFit:
    """A point's ripple, measured and fitted, and what the fit says.

    Attributes
    ----------
    time_s : array, shape (n,)
        From the start of the stretch.
    measured_a, fitted_a : arrays, shape (2, n)
        Current less its mean and drift, believed dq frame.
    inductance_h : array, shape (2, 2)
        Symmetric.
    mean_a : array, shape (2,)
    """

    time_s: RealArray
    measured_a: RealArray
    fitted_a: RealArray
    inductance_h: RealArray
    mean_a: RealArray


def fit_ripple(
    capture: Capture, angle_rad: float, resistance_ohm: float, rows: int = 3000, least_rows: int = 64
) -> RippleFit | None:
    """Fit the last samples of an injection capture; None where they hold no ripple that spans the plane."""
    n = min(rows, len(capture))
    if n < least_rows:
        return None
    step_s = 1.0 / capture.sampling_frequency_hz
    current = to_dq(capture.i_ab[-n:], angle_rad).T
    voltage = to_dq(capture.v_ab[-n:], angle_rad).T
    flux = np.zeros_like(current)
    drop = voltage[:, :-1] - 0.5 * resistance_ohm * (current[:, :-1] + current[:, 1:])
    np.cumsum(drop * step_s, axis=1, out=flux[:, 1:])
    best: tuple[float, RealArray, RealArray, RealArray] | None = None
    for delay in DELAY_SAMPLES:
        psi, i = _without_drift(flux[:, : n - delay]), _without_drift(current[:, delay:])
        gram = psi @ psi.T
        if not np.isfinite(gram).all() or np.linalg.cond(gram) > 1e8:
            return None
        inverse_h = np.linalg.solve(gram, psi @ i.T).T
        fitted = inverse_h @ psi
        left = float(np.square(i - fitted).mean())
        if best is None or left < best[0]:
            best = (left, i, fitted, inverse_h)
    if best is None or abs(np.linalg.det(best[3])) < 1e-12:
        return None
    inductance = np.linalg.inv(0.5 * (best[3] + best[3].T))
    if not (np.linalg.eigvalsh(inductance) > 0.0).all():
        return None
    return RippleFit(step_s * np.arange(best[1].shape[1]), best[1], best[2], inductance, current.mean(axis=1))


def _without_drift(rows: RealArray) -> RealArray:
    """Rows (2, n) less a parabola in time, by least squares."""
    basis = _parabolas(rows.shape[1])
    out: RealArray = rows - (rows @ basis) @ basis.T
    return out


@lru_cache(maxsize=16)
def _parabolas(samples: int) -> RealArray:
    """Orthonormal parabolas over so many samples, shape (samples, 3)."""
    t = np.linspace(-1.0, 1.0, samples)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(t), t, t * t], axis=1))
    basis.flags.writeable = False
    return basis


class FluxTree:
    """Flux at the points reached so far, each from the nearest one known before; zero at zero current."""

    def __init__(self) -> None:
        self._i: list[RealArray] = []
        self._psi: list[RealArray] = []
        self._l: list[RealArray] = []

    def __len__(self) -> int:
        return len(self._i)

    def add(self, i_dq: RealArray, inductance_h: RealArray) -> None:
        """One more point: its mean current (2,), and its inductances (2, 2)."""
        if not self._i:
            psi = inductance_h @ i_dq
        else:
            near = int(np.square(np.asarray(self._i) - i_dq).sum(axis=1).argmin())
            psi = self._psi[near] + 0.5 * (self._l[near] + inductance_h) @ (i_dq - self._i[near])
        self._i.append(i_dq)
        self._psi.append(psi)
        self._l.append(inductance_h)

    def points(self) -> tuple[RealArray, RealArray]:
        """Currents and fluxes, each of shape (n, 2)."""
        i, psi = np.asarray(self._i), np.asarray(self._psi)
        middle = int(np.square(i).sum(axis=1).argmin())
        return i, psi - (psi[middle] - self._l[middle] @ i[middle])

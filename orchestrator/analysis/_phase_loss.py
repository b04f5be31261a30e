"""Inverter voltage error per phase as a function of its current: odd, and linear between knots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class PhaseLoss:
    """The error over the phase current: zero at zero, constant beyond the last knot.

    Attributes
    ----------
    knots_a, error_v : array, shape (k,)
        Voltage error of a phase [V] at these phase currents, increasing and positive.
    """

    knots_a: Array
    error_v: Array

    @property
    def areas(self) -> Array:
        """Integral of the error from zero to each knot [VA], shape (k,)."""
        ends, volts = np.append(0.0, self.knots_a), np.append(0.0, self.error_v)
        return np.asarray(np.cumsum(0.5 * (volts[1:] + volts[:-1]) * np.diff(ends)))


NO_LOSS = PhaseLoss(np.zeros(0), np.zeros(0))

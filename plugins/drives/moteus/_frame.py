"""Electrical angles as the positions that a moteus is commanded by, and vectors in the stator frame.

With a fixed current commanded, the firmware takes its electrical angle from the commanded position alone (firmware,
`ISR_CalculateDerivedQuantities`): ``theta = zero + sign * position / ratio * poles / 2 * 2 pi``. Its Clarke and Park
transforms are amplitude-invariant (`fw/foc.h`), its q axis is turned by the sign of the output. The zero depends on
where the output's origin was put, and is read from the board.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Frame:
    """How the board is configured (`motor.poles`, `motor_position`), and the angle at position zero [rad]."""

    poles: int
    sign: int
    ratio: float
    zero_rad: float = 0.0

    def position(self, theta_rad: float) -> float:
        """Position [revolutions of the output] at this electrical angle: the one nearest to zero."""
        from_zero = math.remainder(theta_rad - self.zero_rad, 2.0 * math.pi)
        return self.sign * self.ratio * from_zero / (math.pi * self.poles)

    def stator(self, d: float, q: float, theta_rad: float) -> complex:
        """Stator-frame vector alpha + j beta of what the board calls d and q at this electrical angle."""
        return complex(d, self.sign * q) * cmath.exp(1j * theta_rad)

"""The maps i -> a i + b conj(i) by which wrong conventions distort vectors, and the catalogue of known ones."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.survey import Vectors

PHASES = "abc"
AXES = np.exp(2j * np.pi / 3.0 * np.arange(3))
"""The phases' magnetic axes."""


@dataclass(frozen=True)
class VectorMap:
    """The recorded vector of a true one z: a z + b conj(z).

    Attributes
    ----------
    kind : str
        ``scaled``, ``swapped``, ``inverted``, ``dead``, ``reversed`` or ``turned``.
    a, b : complex
    what : str
        Description of the distortion, to follow "the currents look ...".
    """

    kind: str
    a: complex
    b: complex
    what: str

    def __call__(self, z: Vectors) -> Vectors:
        return self.a * z + self.b * np.conj(z)

    @property
    def matrix(self) -> Array:
        """The map as a matrix of (alpha, beta), shape (2, 2)."""
        a, b = self.a, self.b
        return np.array([[a.real + b.real, b.imag - a.imag], [a.imag + b.imag, a.real - b.real]])

    @property
    def factor(self) -> float | None:
        """The gain; None where the map is more than a gain."""
        return self.a.real if self.b == 0.0 and self.a.imag == 0.0 else None

    @property
    def inverse(self) -> VectorMap | None:
        """The inverse map; None where there is none."""
        size = abs(self.a) ** 2 - abs(self.b) ** 2
        if abs(size) < 1e-9:
            return None
        return VectorMap(self.kind, self.a.conjugate() / size, -self.b / size, self.what)


IDENTITY = VectorMap("same", 1.0, 0.0, "right")


def _scaled(factor: float, why: str) -> VectorMap:
    return VectorMap("scaled", factor, 0.0, f"scaled by {factor:.4g} ({why})")


_CURRENT_OR_VOLTAGE = (
    _scaled(2.0 / 3.0, "a Clarke convention, 2/3"),
    _scaled(1.5, "a Clarke convention, 3/2"),
    _scaled(math.sqrt(2.0 / 3.0), "a power-invariant Clarke transform"),
    _scaled(math.sqrt(1.5), "a power-invariant Clarke transform"),
    _scaled(1.0 / math.sqrt(2.0), "rms for peak"),
    _scaled(math.sqrt(2.0), "peak for rms"),
    _scaled(0.1, "a decimal point"),
    _scaled(10.0, "a decimal point"),
)
CURRENT_SCALES = (
    *_CURRENT_OR_VOLTAGE,
    _scaled(math.sqrt(3.0), "line for phase"),
    _scaled(1.0 / math.sqrt(3.0), "phase for line"),
    _scaled(0.5, "a half"),
    _scaled(2.0, "a double"),
    _scaled(1e3, "milliamperes"),
    _scaled(1e-3, "kiloamperes"),
)
VOLTAGE_SCALES = (
    *_CURRENT_OR_VOLTAGE,
    _scaled(math.sqrt(3.0), "line to line for phase"),
    _scaled(1.0 / math.sqrt(3.0), "phase for line to line"),
    _scaled(0.5, "half of the bus"),
    _scaled(2.0, "the bus for half of it"),
    _scaled(1e3, "millivolts"),
    _scaled(1e-3, "kilovolts"),
)


def _exchanges() -> Iterator[VectorMap]:
    yield VectorMap("reversed", -1.0, 0.0, "reversed")
    for first, second in itertools.combinations(range(3), 2):
        third = 3 - first - second
        # A reflection at the third phase's axis.
        yield VectorMap(
            "swapped", 0.0, complex(AXES[third] ** 2), f"swapped in phases {PHASES[first]} and {PHASES[second]}"
        )
    for turn in (1, 2):
        yield VectorMap("swapped", complex(AXES[turn]), 0.0, f"moved on by {turn} phase{'s' if turn > 1 else ''}")


def _of_one_phase(kind: str, gain: float, what: str) -> Iterator[VectorMap]:
    """Maps where one sensor reads `gain` times its current, for a Clarke transform of any two sensors or of three."""
    for phase in range(3):
        z = complex(gain - 1.0) / 3.0 * AXES[phase] ** 2
        yield VectorMap(kind, 1.0 + (gain - 1.0) / 3.0, complex(z), what.format(phase=PHASES[phase]))
        for other in (n for n in range(3) if n != phase):
            hidden = 3 - phase - other
            # The third current is computed as minus the other two, so that it has the same error reversed.
            difference = (AXES[phase] - AXES[hidden]) * (gain - 1.0) * 2.0 / 3.0
            a, b = difference * np.conj(AXES[phase]) / 2.0, difference * AXES[phase] / 2.0
            yield VectorMap(kind, complex(1.0 + a), complex(b), what.format(phase=PHASES[phase]))


EXCHANGES = tuple(_exchanges())
# A conjugate of beta is an exchange of phases b and c, which EXCHANGES contains.
INVERTED = (
    VectorMap("inverted", 0.0, -1.0, "inverted in alpha"),
    *_of_one_phase("inverted", -1.0, "inverted in phase {phase}"),
)
DEAD = (
    VectorMap("dead", 0.5, -0.5, "zero in alpha"),
    VectorMap("dead", 0.5, 0.5, "zero in beta"),
    *_of_one_phase("dead", 0.0, "zero in phase {phase}"),
)

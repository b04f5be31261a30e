"""A law with its constants: what a written effect declares, with units and priors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.discovery.forms import FormFit
from orchestrator.discovery.hypotheses import Hypothesis
from orchestrator.numerics.types import Array
from protocols import unit_powers

NAME_OF_SIZE = "size"
WIDTH_OF_SIZE: float = 1.0
"""Prior width of a size, relative to its typical value."""
WIDTH_OF_SHAPE: float = 0.7
"""Prior width of a shape, in its logarithm."""
WIDTH_OF_UNIT: float = 1e-3
"""Prior width of a shape that only states at which value of the quantity the size is meant."""
POWER_BOUNDS: Mapping[str, tuple[float, float, float]] = {
    "exponent": (0.5, 0.05, 12.0),
    "sharpness": (WIDTH_OF_UNIT, 1.0, 1e6),
}
"""Prior width of a power's logit, and its bounds."""
WIDTH_OF_FREQUENCY: float = 0.3
"""Prior width of a frequency, in what the experiment's length resolves."""
WIDTH_OF_EDGE: float = 3.0
"""Prior width of the place of a step, in its edges: a fit finds it in the sample that the search has found."""
REACH: float = 100.0
"""Bounds of a size, relative to its typical value, and of a shape."""


@dataclass(frozen=True)
class Table:
    """A curve between points.

    Attributes
    ----------
    x, y : array, shape (m,)
        In units of the largest; odd and even curves for x >= 0 alone.
    top : float
        Largest value of the quantity.
    size : float
        Largest value of the law.
    parity : str
    """

    x: Array
    y: Array
    top: float
    size: float
    parity: str


@dataclass(frozen=True)
class Line:
    """A wave over time of one frequency.

    Attributes
    ----------
    sizes : tuple of float
        Of sin and cos; of phase a, then of phase b, where each has its own.
    frequency_hz, spacing_hz : float
        As of its `LineBasis`.
    """

    sizes: tuple[float, ...]
    frequency_hz: float
    spacing_hz: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the sizes."""
        waves = ("sine", "cosine")
        return waves if len(self.sizes) == 2 else tuple(f"{wave}_of_{phase}" for phase in "ab" for wave in waves)


@dataclass(frozen=True)
class Law:
    """A law with its constants.

    Attributes
    ----------
    hypothesis : Hypothesis
        Place, quantity and phases.
    form : FormFit, Table or Line
    """

    hypothesis: Hypothesis
    form: FormFit | Table | Line

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its constants, the size first."""
        y, x, form = self.hypothesis.place.unit, self.hypothesis.quantity.unit, self.form
        if isinstance(form, Table):
            return (_size(y, form.size), _shape("range", x, form.top, WIDTH_OF_UNIT))
        if isinstance(form, Line):
            largest = max(map(abs, form.sizes))
            sizes = (_size(y, size, name, largest) for name, size in zip(form.names, form.sizes, strict=True))
            width = WIDTH_OF_FREQUENCY * form.spacing_hz / form.frequency_hz
            return (*sizes, _shape("frequency", "Hz", form.frequency_hz, width))
        if form.form is None:
            kind = self.hypothesis.basis.kind
            shape = _shape("radius", x, form.scale) if kind == "play" else _shape(kind, "s", form.scale)
            return (_size(quotient(y, x), form.size), shape)
        found = [_size(quotient(y, x, form.form.power_of_x), form.size)]
        if form.form.has_scale:
            # A power's scale and size are one number: the scale only says where the size is meant.
            is_unit = form.form.has_power and form.form.power_name == "exponent"
            is_step = form.form.has_power and not is_unit
            width = WIDTH_OF_UNIT if is_unit else WIDTH_OF_EDGE / form.power if is_step else WIDTH_OF_SHAPE
            found.append(_shape(form.form.scale_name, x, form.scale, width))
        if form.form.has_power:
            found.append(
                Parameter(form.form.power_name, "1", form.power, *POWER_BOUNDS[form.form.power_name], is_size=False)
            )
        return tuple(found)

    def values(self, x: Array) -> Array:
        """At values of its quantity; of a law without memory."""
        form = self.form
        assert not isinstance(form, Line)
        if isinstance(form, FormFit):
            assert form.form is not None
            return np.asarray(form.size * form.form.of(x, form.scale, form.power), dtype=np.float64)
        u = np.abs(x) if form.parity != "none" else x
        y = form.size * np.interp(u / form.top, form.x, form.y)
        return np.asarray(np.sign(x) * y if form.parity == "odd" else y, dtype=np.float64)

    @property
    def formula(self) -> str:
        """As a person reads it."""
        hypothesis, form = self.hypothesis, self.form
        x = hypothesis.quantity.symbol
        if isinstance(form, Table):
            return f"a table over {x}"
        if isinstance(form, Line):
            return "a sin(2 pi f t) + b cos(2 pi f t)" + (", in each phase" if len(form.sizes) > 2 else "")
        if form.form is None:
            if hypothesis.basis.kind == "cooling":
                return f"a {x}, {x}' = P - {x} / b"
            if hypothesis.basis.kind == "late":
                return f"a ({x} lagging by b)"
            return f"a ({x} - {x} {'lagging by' if hypothesis.basis.kind == 'lag' else 'with a play of'} b)"
        return (
            re.sub(r"\bx\b", x.replace("|", ""), form.form.formula)
            if "|" in x
            else re.sub(r"\bx\b", x, form.form.formula)
        )

    @property
    def label(self) -> str:
        """Short name of its form."""
        if isinstance(self.form, Table):
            return "table"
        if isinstance(self.form, Line):
            return "line"
        return self.form.form.name if self.form.form is not None else self.hypothesis.basis.kind


@dataclass(frozen=True)
class Parameter:
    """A constant of a written law."""

    name: str
    unit: str
    value: float
    width: float
    low: float
    high: float
    is_size: bool

    def declared(self, factor: float) -> str:
        """Its line in the class, with values of the reference machine; `factor` is this machine's over that one's."""
        role = "amplitude" if self.is_size else "shape"
        # A narrow shape is known to more digits.
        digits = 4 if self.is_size else max(4, 2 - math.floor(math.log10(self.width)))
        value, low, high = (_rounded(v / factor, digits) for v in (self.value, self.low, self.high))
        width = _rounded(self.width / factor) if self.is_size else _rounded(self.width)
        return (
            f"        {self.name}: float = {role}("
            f'"{self.unit}", typical={value!r}, prior_width={width!r}, low={low!r}, high={high!r})'
        )


def _size(unit: str, value: float, name: str = NAME_OF_SIZE, typical: float | None = None) -> Parameter:
    """Of a typical size by default its own."""
    name = "_".join([name, *([_suffix(unit)] if unit != "1" else [])])
    far = abs(value) if typical is None else typical
    return Parameter(name, unit, value, WIDTH_OF_SIZE * far, -REACH * far, REACH * far, is_size=True)


def _shape(name: str, unit: str, value: float, width: float = WIDTH_OF_SHAPE) -> Parameter:
    return Parameter(f"{name}_{_suffix(unit)}", unit, value, width, value / REACH, value * REACH, is_size=False)


def _suffix(unit: str) -> str:
    return unit.lower().replace("1/", "per_").replace("/", "_per_").replace(" ", "_").replace("^", "")


def quotient(unit: str, by: str, power: int = 1) -> str:
    """The unit of one unit over a power of another."""
    powers = dict(unit_powers(unit)) if unit != "1" else {}
    for symbol, exponent in unit_powers(by).items():
        powers[symbol] = powers.get(symbol, 0) - power * exponent
    above, below = (
        " ".join(f"{s}^{sign * k}" if sign * k > 1 else s for s, k in powers.items() if sign * k > 0 and s != "1")
        for sign in (1, -1)
    )
    return f"{above or '1'}/{below}" if below else above or "1"


def _rounded(value: float, digits: int = 4) -> float:
    return 0.0 if value == 0.0 or not math.isfinite(value) else float(f"{value:.{digits}g}")

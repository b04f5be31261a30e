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
    "sharpness": (2.0, 1.0, 1e4),
}
"""Prior width of a power's logit, and its bounds."""
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
class Law:
    """A law with its constants.

    Attributes
    ----------
    hypothesis : Hypothesis
        Place, quantity and phases.
    form : FormFit or Table
    """

    hypothesis: Hypothesis
    form: FormFit | Table

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its constants, the size first."""
        y, x, form = self.hypothesis.place.unit, self.hypothesis.quantity.unit, self.form
        if isinstance(form, Table):
            return (_size(y, form.size), _shape("range", x, form.top, WIDTH_OF_UNIT))
        if form.form is None:
            kind = self.hypothesis.basis.kind
            shape = _shape("radius", x, form.scale) if kind == "play" else _shape(kind, "s", form.scale)
            return (_size(quotient(y, x), form.size), shape)
        found = [_size(quotient(y, x, form.form.power_of_x), form.size)]
        if form.form.has_scale:
            # A power's scale and size are one number: the scale only says where the size is meant.
            is_unit = form.form.has_power and form.form.power_name == "exponent"
            found.append(_shape(form.form.scale_name, x, form.scale, WIDTH_OF_UNIT if is_unit else WIDTH_OF_SHAPE))
        if form.form.has_power:
            found.append(
                Parameter(form.form.power_name, "1", form.power, *POWER_BOUNDS[form.form.power_name], is_size=False)
            )
        return tuple(found)

    def values(self, x: Array) -> Array:
        """At values of its quantity; of a law without memory."""
        form = self.form
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
        value, low, high = (_rounded(v / factor) for v in (self.value, self.low, self.high))
        width = _rounded(self.width / factor) if self.is_size else _rounded(self.width)
        return (
            f"        {self.name}: float = {role}("
            f'"{self.unit}", typical={value!r}, prior_width={width!r}, low={low!r}, high={high!r})'
        )


def _size(unit: str, value: float) -> Parameter:
    name = "_".join([NAME_OF_SIZE, *([_suffix(unit)] if unit != "1" else [])])
    far = REACH * abs(value)
    return Parameter(name, unit, value, WIDTH_OF_SIZE * abs(value), -far, far, is_size=True)


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


def _rounded(value: float) -> float:
    return 0.0 if value == 0.0 or not math.isfinite(value) else float(f"{value:.4g}")

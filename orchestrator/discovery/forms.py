"""Short forms of a law: what a curve may be in a formula, dimension-checked, with one size and at most two shapes.

A form is fitted to a flexible law's coefficients with their covariance, which costs next to nothing: its shapes are
scanned, its size and, where the equations leave it open, a straight line follow by generalised least squares. What
fits best is refitted by the diagnosis' own fitter (`orchestrator.discovery.laws`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from orchestrator.discovery.bases import CurveBasis, MemoryBasis, Parity
from orchestrator.discovery.hypotheses import Hypothesis
from orchestrator.discovery.ranking import Score
from orchestrator.numerics.types import Array

SCAN: int = 40
"""Values of a shape that are scanned."""
DISCREPANCY: float = 0.01
"""Difference between a law and a form, relative to the law's largest value, that is not held against the form."""

HARMONICS: tuple[int, ...] = (1, 2, 3, 4, 6)
"""Of an angle: its own, the offsets, gains and slots of its sensor."""


@dataclass(frozen=True)
class Form:
    """A formula y = size * g(x / scale), or size * g(x) where it has no scale.

    Attributes
    ----------
    name : str
    formula : str
        As a person reads it; ``x`` is the quantity, ``b`` its scale, ``p`` an exponent.
    code : str
        g as an expression of ``x``, ``b`` and ``p``.
    of : callable
        The same as a function of (x, b, p).
    parity : {"odd", "even", "none", "periodic"}
        Of the curves that it may be.
    has_scale, has_power : bool
    """

    name: str
    formula: str
    code: str
    of: Callable[[Array, float, float], Array]
    parity: Parity
    has_scale: bool = True
    has_power: bool = False
    scale_name: str = "scale"
    power_of_x: int = 0
    """Power of the quantity in g, where it has no scale."""
    power_name: str = "exponent"
    powers: tuple[float, ...] = (0.3, 0.5, 0.75, 1.5, 2.0, 3.0, 5.0, 7.0)
    """Values of p that are scanned."""

    @property
    def constants(self) -> int:
        """Number of its constants."""
        return 1 + self.has_scale + self.has_power


def _harmonic(k: int) -> Form:
    def of(x: Array, b: float, p: float) -> Array:
        return np.asarray(np.sin(k * x + b), dtype=np.float64)

    code = f"np.sin({k} * x + b)" if k > 1 else "np.sin(x + b)"
    return Form(f"harmonic {k}", f"a {code.removeprefix('np.')}", code, of, "periodic", scale_name="phase")


CURVES: tuple[Form, ...] = (
    Form("proportional", "a x", "x", lambda x, b, p: x, "odd", has_scale=False, power_of_x=1),
    Form("cubic", "a x^3", "x**3", lambda x, b, p: x**3, "odd", has_scale=False, power_of_x=3),
    Form("tanh", "a tanh(x / b)", "np.tanh(x / b)", lambda x, b, p: np.tanh(x / b), "odd"),
    Form("root", "a x / sqrt(b^2 + x^2)", "x / np.hypot(b, x)", lambda x, b, p: x / np.hypot(b, x), "odd"),
    Form("fraction", "a x / (b + |x|)", "x / (b + np.abs(x))", lambda x, b, p: x / (b + np.abs(x)), "odd"),
    Form(
        "logarithm", "a sgn(x) log(1 + |x| / b)", "np.sign(x) * np.log1p(np.abs(x) / b)",
        lambda x, b, p: np.sign(x) * np.log1p(np.abs(x) / b), "odd",
    ),
    Form(
        "bump", "a (x / b) / (1 + (x / b)^2)", "(x / b) / (1.0 + (x / b) ** 2)",
        lambda x, b, p: (x / b) / (1.0 + (x / b) ** 2), "odd",
    ),
    Form(
        "fading", "a (x / b) exp(-|x| / b)", "(x / b) * np.exp(-np.abs(x) / b)",
        lambda x, b, p: (x / b) * np.exp(-np.abs(x) / b), "odd",
    ),
    Form(
        "hinge", "a sgn(x) max(|x| / b - 1, 0)", "np.sign(x) * np.maximum(np.abs(x) / b - 1.0, 0.0)",
        lambda x, b, p: np.sign(x) * np.maximum(np.abs(x) / b - 1.0, 0.0), "odd",
    ),
    Form(
        "power", "a sgn(x) (|x| / b)^p", "np.sign(x) * (np.abs(x) / b) ** p",
        lambda x, b, p: np.sign(x) * (np.abs(x) / b) ** p, "odd", has_power=True,
    ),
    Form("constant", "a", "np.ones_like(x)", lambda x, b, p: np.ones_like(x), "even", has_scale=False),
    Form("square", "a x^2", "x**2", lambda x, b, p: x**2, "even", has_scale=False, power_of_x=2),
    Form("size", "a |x|", "np.abs(x)", lambda x, b, p: np.abs(x), "even", has_scale=False, power_of_x=1),
    Form(
        "peak", "a / (1 + (x / b)^2)", "1.0 / (1.0 + (x / b) ** 2)", lambda x, b, p: 1.0 / (1.0 + (x / b) ** 2), "even",
    ),
    Form(
        "even hinge", "a max(|x| / b - 1, 0)", "np.maximum(np.abs(x) / b - 1.0, 0.0)",
        lambda x, b, p: np.maximum(np.abs(x) / b - 1.0, 0.0), "even",
    ),
    Form(
        "even power", "a (|x| / b)^p", "(np.abs(x) / b) ** p", lambda x, b, p: (np.abs(x) / b) ** p, "even",
        has_power=True,
    ),
    Form("straight", "a x", "x", lambda x, b, p: x, "none", has_scale=False, power_of_x=1),
    Form("parabola", "a x^2", "x**2", lambda x, b, p: x**2, "none", has_scale=False, power_of_x=2),
    Form("steady", "a", "np.ones_like(x)", lambda x, b, p: np.ones_like(x), "none", has_scale=False),
    Form(
        "settling", "a (1 - exp(-x / b))", "1.0 - np.exp(-x / b)", lambda x, b, p: 1.0 - np.exp(-x / b), "none",
    ),
    Form(
        "saturating", "a x / (b + |x|)", "x / (b + np.abs(x))", lambda x, b, p: x / (b + np.abs(x)), "none",
    ),
    Form("log", "a log(1 + |x| / b)", "np.log1p(np.abs(x) / b)", lambda x, b, p: np.log1p(np.abs(x) / b), "none"),
    Form(
        "step", "a from x = b on", "0.5 + 0.5 * np.tanh(p * (x / b - 1.0))",
        lambda x, b, p: 0.5 + 0.5 * np.tanh(p * (x / b - 1.0)), "none",
        has_power=True, power_name="sharpness", powers=(50.0,),
    ),
    Form(
        "ramp", "a max(x / b - 1, 0)", "np.maximum(x / b - 1.0, 0.0)", lambda x, b, p: np.maximum(x / b - 1.0, 0.0),
        "none",
    ),
    Form(
        "fractional power", "a (|x| / b)^p", "(np.abs(x) / b) ** p", lambda x, b, p: (np.abs(x) / b) ** p, "none",
        has_power=True,
    ),
    *map(_harmonic, HARMONICS),
)  # fmt: skip


@dataclass(frozen=True)
class FormFit:
    """A form with its constants, as it fits a flexible law.

    Attributes
    ----------
    form : Form or None
        None: memory with one time constant or radius, `scale`.
    size, scale, power : float
    misfit : float
        Generalised sum of squares.
    """

    form: Form | None
    size: float
    scale: float
    power: float
    misfit: float


def fitting_forms(score: Score) -> list[FormFit]:
    """All forms fitted to a law, the best first: misfit, plus two for each constant."""
    basis = score.hypothesis.basis
    if isinstance(basis, MemoryBasis):
        return _memories(score, basis)
    if not isinstance(basis, CurveBasis):
        return []
    grid = basis.grid(12 * basis.cells)[1 if basis.parity == "odd" else 0 :]
    design = basis.design(grid)
    values = design @ score.coefficients
    floor = DISCREPANCY * float(np.abs(values).max())
    weigh = np.linalg.cholesky(np.linalg.inv(score.covariance + floor**2 * np.eye(basis.size))).T
    project = np.linalg.pinv(design)
    target = weigh @ score.coefficients
    taken_up = _gauges(score.hypothesis, grid)
    gauges = [weigh @ project @ g for g in taken_up]
    fits = []
    for form in CURVES:
        # A power is a line for one exponent alone.
        is_taken_up = not form.has_power and any(np.allclose(form.of(grid, 1.0, 1.0), g) for g in taken_up)
        if form.parity != basis.parity or is_taken_up:
            continue
        if form.name == "steady" and score.hypothesis.place.name == "reading_gain":
            continue  # an error of the reading in proportion to the current, which is simpler
        best = None
        for scale, power in _shapes(form, basis):
            column = weigh @ (project @ form.of(grid, scale, power))
            if not np.isfinite(column).all():
                continue
            solution, misfit = _least_squares([column, *gauges], target)
            if best is None or misfit < best.misfit:
                best = FormFit(form, solution[0], scale, power, misfit)
        if best is not None and _is_something(best):
            fits.append(best)
    return sorted(fits, key=lambda fit: fit.misfit + 2.0 * (fit.form.constants if fit.form else 2))


def without_gauge(hypothesis: Hypothesis, x: Array, y: Array) -> Array:
    """A curve without what R_s or the map take up: zero where its quantity is, or of no slope at its median.

    A gain that all sensors have in common shows nowhere, but moves the map.
    """
    for gauge in _gauges(hypothesis, x):
        if np.ptp(gauge) == 0.0:
            return np.asarray(y - y[np.argmin(np.abs(x))])
        at = np.flatnonzero(x)
        slope = y[at] / x[at]
        order = np.argsort(slope)
        weight = np.cumsum(np.abs(x[at][order]))
        # The slope that leaves the least sum of absolute values: of a corner, that before it.
        return np.asarray(y - x * slope[order][np.searchsorted(weight, 0.5 * weight[-1])])
    return y


def _gauges(hypothesis: Hypothesis, grid: Array) -> list[Array]:
    """Functions that R_s or the map take up, whatever the law is."""
    name, everywhere = hypothesis.place.name, all(hypothesis.phases)
    if name in ("resistance", "voltage_gain") or (name == "reading_gain" and everywhere):
        return [np.ones_like(grid)]
    if name in ("leg_voltage", "reading") and everywhere and hypothesis.quantity.name == "phase_currents":
        return [grid]
    return []


def _shapes(form: Form, basis: CurveBasis) -> Iterator[tuple[float, float]]:
    top = max(abs(basis.low), abs(basis.high))
    if form.parity == "periodic":
        # The scale is a phase; the size has the sign.
        yield from ((float(b), 1.0) for b in np.linspace(0.1, 0.1 + math.pi, 2 * SCAN))
        return
    scales: Sequence[float] = [top]
    if form.has_scale and (not form.has_power or form.power_name == "sharpness"):
        near = 0.2 if form.name in ("step", "ramp", "hinge", "even hinge") else 0.003
        far = 1.0 if near == 0.2 else 10.0
        scales = [float(s) for s in np.geomspace(near * top, far * top, SCAN)]
        if near == 0.2:
            scales = [float(s) for s in np.linspace(0.03 * top, top, 2 * SCAN)]
    yield from product(scales, form.powers if form.has_power else (1.0,))


def _least_squares(columns: list[Array], target: Array) -> tuple[list[float], float]:
    design = np.stack(columns, axis=1)
    size = np.linalg.norm(design, axis=0)
    scaled = design / np.where(size > 0.0, size, 1.0)
    solution, *_ = np.linalg.lstsq(scaled, target, rcond=1e-10)
    rest = target - scaled @ solution
    return [float(s / n) if n > 0.0 else 0.0 for s, n in zip(solution, size, strict=True)], float(rest @ rest)


def _memories(score: Score, basis: MemoryBasis) -> list[FormFit]:
    """One time constant or radius: each of the basis', and the size that follows."""
    precision = np.linalg.pinv(score.covariance)
    pull = precision @ score.coefficients
    whole = float(score.coefficients @ pull)
    fits = [
        FormFit(None, float(pull[j] / precision[j, j]), value, 1.0, whole - float(pull[j] ** 2 / precision[j, j]))
        for j, value in enumerate(basis.values)
        if precision[j, j] > 0.0
    ]
    return sorted(filter(_is_something, fits), key=lambda fit: fit.misfit)[:2]


def _is_something(fit: FormFit) -> bool:
    return fit.size != 0.0 and math.isfinite(fit.size) and math.isfinite(fit.misfit)

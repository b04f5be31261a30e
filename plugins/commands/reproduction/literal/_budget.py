"""The paper's error budget: single sources of error, switched on one after another on the simulated plant.

Each is a complete experiment, evaluated as printed in the paper and by fluxbench.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestrator.analysis import FluxPath, PolynomialFit
from orchestrator.numerics.types import Array
from plugins.commands.reproduction.literal._bench import measured_by, plant_of, truth_of, with_plant
from plugins.commands.reproduction.literal._energy import fitted_to_flux, fitted_to_second_derivatives
from plugins.commands.reproduction.literal._evaluation import Errors, Literal, errors_of, evaluate
from plugins.commands.reproduction.literal._paths import Rule
from protocols import Procedure

RULE, NOISE, ALL, IRON, IRON_ALL = "rule", "noise", "all", "hysteresis", "all and hysteresis"


@dataclass(frozen=True)
class Sources:
    """Sources of error beside those of the procedure's plant.

    Attributes
    ----------
    compensated_v : float
        Residual dead-time voltage after compensation, in each phase.
    hysteresis : mapping
        The iron's options, in the form of `plant.effects.hysteresis`.
    """

    compensated_v: float = 0.8
    hysteresis: Mapping[str, float] = field(default_factory=lambda: {"half_width_a": 0.03, "reversible_ratio": 0.98})


@dataclass(frozen=True)
class Row:
    """Errors of one bench.

    Attributes
    ----------
    name : str
        The source that is switched on.
    resistance_ohm : (float, float)
        Smallest and largest v/i of the classical sweeps.
    classical, closed : Errors
        Integration as printed, and with each sweep's drift removed.
    literal, trapezoids : Errors
        The printed demodulator, its inductances summed by rectangles and by trapezoids.
    regression : Errors
        fluxbench's regression on the ripple, by trapezoids.
    graph : Errors
        As `regression`, over the graph of all points (fluxbench's map by injection).
    second_derivatives, first_derivatives : Errors
        The paper's polynomial energy fitted to the Hessians, and to the rectangles' flux.
    gap_percent : mapping of str to array, shape (2,)
        Difference of injection's flux from that of the classical sweeps on the d and q axis, by evaluation; only for
        benches without inverter loss, with which the printed integration diverges.
    """

    name: str
    resistance_ohm: tuple[float, float]
    classical: Errors
    closed: Errors
    literal: Errors
    trapezoids: Errors
    regression: Errors
    graph: Errors
    second_derivatives: Errors
    first_derivatives: Errors
    gap_percent: Mapping[str, Array]


@dataclass(frozen=True)
class Budget:
    """The errors of all benches.

    Attributes
    ----------
    rows : tuple of Row
        In the order of the page.
    standing : tuple of Errors
        The procedure's bench with two fixed injection directions: by rectangles, by trapezoids.
    still : Literal
        The bench without any source of error.
    iron : Literal
        The bench with hysteresis alone.
    sources : Sources
    rated_wb : float
    """

    rows: tuple[Row, ...]
    standing: tuple[Errors, Errors]
    still: Literal
    iron: Literal
    sources: Sources
    rated_wb: float

    def row(self, name: str) -> Row:
        """The row of a bench."""
        return next(row for row in self.rows if row.name == name)


def budget(procedure: Procedure, measured: Literal, sources: Sources | None = None) -> Budget:
    """Run all benches and add the measured one.

    Parameters
    ----------
    procedure : Procedure
        Procedure of the run.
    measured : Literal
        Evaluation of the run, with all effects of its plant.
    sources : Sources, optional
    """
    sources = sources or Sources()
    errors, rated_wb = errors_against(procedure)
    rows, kept = [row_of(ALL, measured, errors)], {}
    for name, plant in plants(procedure, sources).items():
        literal = evaluate(measured_by(with_plant(procedure, plant)))
        rows.append(row_of(name, literal, errors))
        if name in (RULE, IRON):
            kept[name] = literal
    stood = evaluate(measured_by(with_plant(procedure, plant_of(procedure)), standing=True), regress=False)
    by_rule = [errors(stood.injection(rule)) for rule in (Rule.RECTANGLE, Rule.TRAPEZOID)]
    return Budget(
        rows=(*rows[1:-2], rows[0], *rows[-2:]),
        standing=(by_rule[0], by_rule[1]),
        still=kept[RULE],
        iron=kept[IRON],
        sources=sources,
        rated_wb=rated_wb,
    )


def plants(procedure: Procedure, sources: Sources) -> dict[str, dict[str, Any]]:
    """Plants by bench: the procedure's with no, one and all sources switched on."""
    own = plant_of(procedure)
    effects = dict(own.get("effects") or {})
    quiet = {**own, "effects": {}, "sensors": {"noise_a": 0.0, "quantum_a": 0.0}}
    out = {RULE: quiet, NOISE: {**own, "effects": {}}}
    out |= {name: {**quiet, "effects": {name: options}} for name, options in effects.items()}
    out["dead_time, compensated"] = {**quiet, "effects": {"dead_time": {"voltage_v": sources.compensated_v}}}
    out[IRON] = {**quiet, "effects": {"hysteresis": dict(sources.hysteresis)}}
    out[IRON_ALL] = {**own, "effects": {**effects, "hysteresis": dict(sources.hysteresis)}}
    return out


def errors_against(procedure: Procedure) -> tuple[Callable[[Sequence[FluxPath]], Errors], float]:
    """Function that gives the errors of paths on this procedure's motor, and the rated flux [Wb]."""
    truth = truth_of(procedure)
    ends = truth.flux(np.array([[0.0, procedure.motor.rated_current_a or 1.0], [0.0, 0.0]]))
    rated_wb = float(np.linalg.norm(ends[0] - ends[1]))
    return lambda paths: errors_of(paths, truth.flux, rated_wb), rated_wb


def row_of(name: str, evaluation: Literal, errors: Callable[[Sequence[FluxPath]], Errors]) -> Row:
    """Errors of all evaluations of one bench."""
    literal, classical = evaluation.injection(), evaluation.classical()
    regression = evaluation.by_regression()
    current, psi = (np.concatenate([getattr(path, part) for path in literal]) for part in ("current", "psi"))
    by_hessian = fitted_to_second_derivatives(evaluation.current, evaluation.hessian)
    by_flux = fitted_to_flux(current, psi, by_hessian)
    return Row(
        name=name,
        resistance_ohm=evaluation.resistance_ohm,
        classical=errors(classical),
        closed=errors(evaluation.classical(closed=True)),
        literal=errors(literal),
        trapezoids=errors(evaluation.injection(Rule.TRAPEZOID)),
        regression=errors(regression),
        graph=errors([evaluation.over_the_graph()]),
        second_derivatives=errors([_on(by_hessian, evaluation.current)]),
        first_derivatives=errors([_on(by_flux, evaluation.current)]),
        gap_percent={"literal": gap_percent(literal, classical), "regression": gap_percent(regression, classical)},
    )


def _on(energy: PolynomialFit, current: Array) -> FluxPath:
    return FluxPath(current, energy.flux(current)[0], np.zeros(2))


def gap_percent(injection: Sequence[FluxPath], classical: Sequence[FluxPath]) -> Array:
    """Relative excess of injection's flux along d and q by least squares through zero, shape (2,) [percent]."""
    larger = []
    for column in range(2):
        _, own, theirs = side_by_side(along(injection, column), along(classical, column), column)
        larger.append(100.0 * (float(own @ theirs / (theirs @ theirs)) - 1.0))
    return np.array(larger)


def along(paths: Sequence[FluxPath], column: int) -> FluxPath:
    """The path along the d axis (0) or the q axis (1)."""
    return min(paths, key=lambda path: float(np.abs(path.current[:, 1 - column]).max()))


def side_by_side(one: FluxPath, other: FluxPath, column: int) -> tuple[Array, Array, Array]:
    """Currents of the first path that the other one covers, and the flux of each there, shape (n,)."""
    order = np.argsort(other.current[:, column])
    at = other.current[order, column]
    inside = (one.current[:, column] >= at[0]) & (one.current[:, column] <= at[-1])
    current = one.current[inside, column]
    return current, one.psi[inside, column], np.interp(current, at, other.psi[order, column])

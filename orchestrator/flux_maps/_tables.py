"""Tables over axes (current or flux, and rotor angle) as points; lengths or inductances identify the dimensions.

Of a convex energy the inductances obey |L_dq| <= sqrt(L_dd L_qq) <= (L_dd + L_qq) / 2: their trace exceeds the sum of
their cross terms. A table that is read with d and q exchanged has the two the other way round.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import permutations

import numpy as np

from orchestrator.numerics.types import Array
from protocols import InputError, Remark

Vectors = Callable[[Mapping[str, Array]], tuple[Array, Array]]
"""From columns to currents [A] and flux linkages [Wb], each of shape (n, 2)."""

ANGLE = "theta"
"""The dimension of a rotor angle."""
_MAX_SECOND_EVIDENCE_RATIO = 0.5
"""Evidence for the second best order of dimensions over that for the best, below which the best is taken."""
_MIN_EVIDENCE = 0.5
"""Least evidence of a motor; a round machine has sqrt 2."""
_MIN_FLUX_SHARE = 1e-6
"""Share of the largest flux that the currents have to make: less is the rounding of a constant."""


def as_points(
    where: str,
    found: Mapping[str, Array],
    axes: Mapping[str, str],
    tables: Sequence[str],
    vectors: Vectors,
    order: Sequence[str] | None = None,
) -> tuple[dict[str, Array], Remark | None]:
    """Every array with one value per point, shape (n,), and a remark where values decided the order of dimensions.

    Parameters
    ----------
    where : str
        Name for errors.
    found : mapping
        Arrays by column: all of one shape, or those of `axes` one-dimensional and the others over them.
    axes : mapping
        The column of each dimension, by its name: d and q, or amplitude and angle, and perhaps `ANGLE`.
    tables : sequence of str
        The columns over the axes.
    vectors : callable
        Converts columns of points, for the choice among axes of one length.
    order : sequence of str, optional
        The tables' dimensions, the first along the rows.

    Raises
    ------
    InputError
        Where shapes do not match, or the order of the dimensions is ambiguous.
    """
    shapes = {found[name].shape for name in (*axes.values(), *tables)}
    if len(shapes) == 1:
        return {name: found[name].ravel() for name in (*axes.values(), *tables)}, None
    names = ", ".join(axes.values())
    lines = {name: found[column].ravel() for name, column in axes.items()}
    of_tables = {found[name].shape for name in tables}
    shape = next(iter(of_tables))
    if len(of_tables) > 1 or any(max(found[c].shape, default=0) != found[c].size for c in axes.values()):
        raise InputError(where, names, f"arrays of shapes {_listed(shapes)} do not match")
    if order is not None and sorted(order) != sorted(axes):
        raise InputError(where, "axes", f"expected each of {', '.join(axes)} once, got {', '.join(order)}")
    lengths = {name: line.size for name, line in lines.items()}
    fitting = [one for one in permutations(axes) if shape == tuple(lengths[name] for name in one)]
    if order is not None:
        if tuple(order) not in fitting:
            problem = f"tables of shape {shape}, but {', '.join(f'{n} has {lengths[n]}' for n in order)}"
            raise InputError(where, "axes", problem)
        fitting = [tuple(order)]
    if not fitting:
        raise InputError(where, names, f"currents and fluxes of shapes {_listed(shapes)} do not match")
    by_length = len(fitting) == 1
    if ANGLE in axes and not by_length:
        fitting = _with_least_variation(where, fitting, [found[name] for name in tables])
    candidates = [_expanded(found, axes, tables, lines, one) for one in fitting]
    best = 0 if len(candidates) == 1 else _most_like_a_motor(where, fitting, [vectors(one) for one in candidates])
    if by_length:
        return candidates[best], None
    text = "the dimensions of the tables are [{axes}], by their values (axes: [{axes}] sets them)"
    return candidates[best], Remark.of("axes_by_values", text, axes=", ".join(fitting[best]))


def _most_like_a_motor(where: str, orders: Sequence[Sequence[str]], candidates: Sequence[tuple[Array, Array]]) -> int:
    """Index of the candidate with the inductances of a motor; raises `InputError` where that is not clear."""
    evidence = [motor_evidence(currents, fluxes) for currents, fluxes in candidates]
    best = int(np.argmax(evidence))
    second = max(e for k, e in enumerate(evidence) if k != best)
    if evidence[best] < _MIN_EVIDENCE or second > _MAX_SECOND_EVIDENCE_RATIO * evidence[best]:
        raise _undecided(where, orders)
    return best


def motor_evidence(currents: Array, fluxes: Array) -> float:
    """The trace of the inductances, over their size: near sqrt 2 of a motor, near 0 with d and q exchanged."""
    known = np.isfinite(currents).all(axis=1) & np.isfinite(fluxes).all(axis=1)
    i, psi = (x[known] - x[known].mean(axis=0) for x in (currents, fluxes))
    slopes: Array = np.linalg.lstsq(i, psi, rcond=None)[0].T  # of the plane nearest the points
    size = float(np.linalg.norm(slopes))
    reach_wb = size * float(np.nanmax(np.abs(currents)))
    if not reach_wb > _MIN_FLUX_SHARE * float(np.nanmax(np.abs(fluxes))):
        return 0.0
    return float(np.trace(slopes)) / size


def _with_least_variation(where: str, orders: list[tuple[str, ...]], tables: Sequence[Array]) -> list[tuple[str, ...]]:
    """The orders whose rotor angle is the dimension along which the flux changes least: slots against saturation."""
    variation = {}
    for k in {order.index(ANGLE) for order in orders}:
        variation[k] = sum(float(np.ma.filled(np.ma.masked_invalid(t).var(axis=k).mean(), 0.0)) ** 0.5 for t in tables)
    least = min(variation, key=lambda k: variation[k])
    if any(variation[least] > _MAX_SECOND_EVIDENCE_RATIO * other for k, other in variation.items() if k != least):
        raise _undecided(where, orders)
    return [order for order in orders if order.index(ANGLE) == least]


def _undecided(where: str, orders: Sequence[Sequence[str]]) -> InputError:
    choices = " or ".join(f"[{', '.join(order)}]" for order in orders)
    return InputError(where, "axes", f"neither lengths nor values identify the tables' dimensions: set axes: {choices}")


def _expanded(
    found: Mapping[str, Array],
    axes: Mapping[str, str],
    tables: Sequence[str],
    lines: Mapping[str, Array],
    order: Sequence[str],
) -> dict[str, Array]:
    meshes = np.meshgrid(*(lines[name] for name in order), indexing="ij")
    points = {axes[name]: mesh.ravel() for name, mesh in zip(order, meshes, strict=True)}
    return points | {name: found[name].ravel() for name in tables}


def _listed(shapes: set[tuple[int, ...]]) -> str:
    return ", ".join(map(str, sorted(shapes)))

"""A plant from a `model.json`: its map as a table of points, its R_s, its effects under the plant's names.

Only the file's format (docs/model.md) is shared with the diagnosis; the spline's evaluation is separate code.
Parameters that the plant's effects lack (a fit's refinements) are ignored.
"""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
from pydantic import ValidationError

from orchestrator.recording import read_model
from plugins.drives.simulated._energy import Array
from plugins.drives.simulated._map import FluxTable
from plugins.drives.simulated.effects import Effects
from plugins.drives.simulated.options import Plant
from protocols import CoEnergySpline, InputError, MotorModel

OPTION_KEY = "drive.plant.model"
SPLINE_DEGREE = 5


def apply_model(plant: Plant) -> tuple[Plant, FluxTable | None]:
    """The plant with R_s and effects of its `model`, and that model's map; unchanged without one.

    Raises
    ------
    RecordingError
        Where the file is no model.
    InputError
        Where the model has an effect, or a parameter's value, that the plant does not support.
    """
    if plant.model is None:
        return plant, None
    model = read_model(plant.model)
    update = {"resistance_ohm": model.r_s_ohm, "effects": _effects(model)}
    return plant.model_copy(update=update), flux_table(model, plant.model)


def _effects(model: MotorModel) -> Effects:
    effects = {}
    for effect in model.effects:
        field = Effects.model_fields.get(effect.name)
        if field is None:
            raise InputError(OPTION_KEY, effect.name, "the simulated plant has no effect of that name")
        known = get_args(field.annotation)[0].model_fields
        effects[effect.name] = {name: p.value for name, p in effect.parameters.items() if name in known}
    try:
        return Effects.model_validate(effects)
    except ValidationError as error:
        first_error = error.errors()[0]
        message = f"{first_error['msg'][:1].lower()}{first_error['msg'][1:]}; the model has {first_error['input']!r}"
        raise InputError(OPTION_KEY, ".".join(map(str, first_error["loc"])), message) from None


def flux_table(model: MotorModel, source: Path, nodes: int = 25) -> FluxTable:
    """The model's map at `nodes` x `nodes` currents over its rectangle, within the measured hull.

    A usual spline has at most ten intervals per axis, each with two nodes or more; those with up to 40 are smoothed.
    """
    from scipy.spatial import Delaunay

    spline, corners = model.magnetics, np.array(model.magnetics.measured_hull_a)
    i_d = np.linspace(spline.d_low_a, spline.d_high_a, nodes)
    i_q = np.linspace(-spline.q_high_a, spline.q_high_a, nodes)
    i_dq = np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1).reshape(-1, 2)
    zero = np.zeros(1)
    psi_dq = (
        _flux(spline, i_d, i_q).reshape(-1, 2) - _flux(spline, zero, zero)[0, 0] + np.array([model.pm_flux_wb, 0.0])
    )
    measured = Delaunay(corners).find_simplex(i_dq) >= 0 if len(corners) else np.ones(len(i_dq), dtype=bool)
    return FluxTable(str(source), i_dq[measured], psi_dq[measured], model.motor, smoothing=1e-3)


def _flux(spline: CoEnergySpline, i_d: Array, i_q: Array) -> Array:
    """grad W on a grid of currents [Wb], shape (d, q, 2)."""
    from scipy.interpolate import BSpline

    cells = np.array([spline.d_intervals, spline.q_intervals])
    along_q = int(cells[1]) + SPLINE_DEGREE
    mirrored = np.minimum(np.arange(along_q), along_q - 1 - np.arange(along_q))
    coefficients = np.array(spline.coefficients_j).reshape(int(cells[0]) + SPLINE_DEGREE, -1)[:, mirrored]
    low = np.array([spline.d_low_a, -spline.q_high_a])
    step = (np.array([spline.d_high_a, spline.q_high_a]) - low) / cells
    knots_d, knots_q = (low[k] + step[k] * np.arange(-SPLINE_DEGREE, cells[k] + SPLINE_DEGREE + 1) for k in range(2))
    in_d = BSpline(knots_d, coefficients, SPLINE_DEGREE)
    psi_d = BSpline(knots_q, in_d.derivative()(i_d).T, SPLINE_DEGREE)(i_q).T
    psi_q = BSpline(knots_q, in_d(i_d).T, SPLINE_DEGREE).derivative()(i_q).T
    if spline.kink_j:
        kink, (value, slope) = BSpline(knots_d, np.array(spline.kink_j), SPLINE_DEGREE), _kink(i_q / step[1])
        psi_d += np.outer(kink.derivative()(i_d), value)
        psi_q += np.outer(kink(i_d), slope / step[1])
    return np.stack([psi_d, psi_q], axis=-1)


def _kink(u: Array) -> tuple[Array, Array]:
    """((2 - |u|)_+^5 - 16 (1 - |u|)_+^5) / 120 and its derivative."""
    two, one = np.maximum(2.0 - np.abs(u), 0.0), np.maximum(1.0 - np.abs(u), 0.0)
    return (two**5 - 16.0 * one**5) / 120.0, -np.sign(u) * (two**4 - 16.0 * one**4) / 24.0

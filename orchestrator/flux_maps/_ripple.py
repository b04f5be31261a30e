"""Flux over the rotor angle as its mean and harmonics; a flux map keeps the mean.

In the rotor's frame a balanced three-phase winding repeats itself after 60 electrical degrees (120, where a winding has
even harmonics), so that a mean over a multiple of 60 degrees holds no ripple.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from orchestrator.flux_maps._scattered import distinct_values
from orchestrator.numerics.types import Array
from protocols import InputError, Remark

_PERIOD_RAD = math.pi / 3.0
_MAX_CLOSURE_SHARE = 0.02
"""Share of the ripple's range by which the flux at the first and last angle of a closed turn may differ."""
_MAX_SPACING_ERROR = 1e-3
"""Part of a step by which the spacing of angles may vary."""


def mean_over_angle(where: str, columns: Mapping[str, Array], angle_rad: Array) -> tuple[dict[str, Array], Remark]:
    """The mean over the rotor angle at each current, and a remark with the harmonics around it.

    Parameters
    ----------
    where : str
        Name for errors.
    columns : mapping
        Arrays of shape (n,): `i_d`, `i_q` [A], `psi_d`, `psi_q` [Wb], and any further quantity.
    angle_rad : array, shape (n,)
        Electrical angle of the rotor at each point.

    Raises
    ------
    InputError
        Where a current lacks an angle, or the angles are not evenly spaced.
    """
    angles, which = distinct_values(angle_rad)
    (_, rows), (i_q, places) = (distinct_values(columns[axis]) for axis in ("i_d", "i_q"))
    currents, point = np.unique(rows * i_q.size + places, return_inverse=True)
    cell, shape = point * angles.size + which, (currents.size, angles.size)
    count = np.bincount(cell, minlength=currents.size * angles.size).reshape(shape)
    if angles.size < 2:
        raise InputError(where, "rotor_angle", "fewer than two rotor angles")
    if not count.all():
        lacking = int(np.count_nonzero((count == 0).any(axis=1)))
        problem = f"{lacking} of {currents.size} currents lack some of the {angles.size} rotor angles"
        raise InputError(where, "rotor_angle", problem)
    steps = np.diff(angles)
    if np.ptp(steps) > _MAX_SPACING_ERROR * steps.mean():
        raise InputError(where, "rotor_angle", "angles are not evenly spaced")
    sums = {name: np.bincount(cell, weights=values, minlength=count.size) for name, values in columns.items()}
    table = {name: total.reshape(shape) / count for name, total in sums.items()}
    step_rad = float(steps.mean())
    complete = np.isfinite(table["psi_d"] + table["psi_q"]).all(axis=1)
    if not complete.any():
        raise InputError(where, "rotor_angle", "no current has a flux linkage at each rotor angle")
    fluxes = [table["psi_d"][complete], table["psi_q"][complete]]
    used = angles.size - int(_is_closed(step_rad * (angles.size - 1), step_rad, fluxes))
    means = {name: values[:, :used].mean(axis=1) for name, values in table.items()}
    return means, _described(step_rad * used, [flux[:, :used] for flux in fluxes])


def _is_closed(reach_rad: float, step_rad: float, fluxes: Sequence[Array]) -> bool:
    """Whether the last angle is the first again, a whole number of periods later."""
    if _is_whole(reach_rad):
        return True
    if _is_whole(reach_rad + step_rad):
        return False
    apart = sum(float(np.mean((flux[:, -1] - flux[:, 0]) ** 2)) for flux in fluxes)
    ranges = sum(float(np.mean(np.ptp(flux, axis=1) ** 2)) for flux in fluxes)
    return apart < _MAX_CLOSURE_SHARE**2 * ranges


def _is_whole(span_rad: float) -> bool:
    periods = span_rad / _PERIOD_RAD
    return round(periods) >= 1 and abs(periods - round(periods)) < _MAX_SPACING_ERROR


def _described(span_rad: float, fluxes: Sequence[Array]) -> Remark:
    """The span and the harmonics, largest over all currents, as a remark."""
    count = fluxes[0].shape[1]
    amplitudes = [np.abs(np.fft.rfft(flux, axis=1)).max(axis=0)[1:] * 2.0 / count for flux in fluxes]
    if count % 2 == 0:  # the last line has no mirror image
        for each in amplitudes:
            each[-1] *= 0.5
    orders = np.arange(1, amplitudes[0].size + 1) * 2.0 * math.pi / span_rad
    strongest = int(np.argmax(np.hypot(*amplitudes)))
    values = {
        "angles": count,
        "span_deg": math.degrees(span_rad),
        "order": float(orders[strongest]),
        "d_mwb": 1e3 * float(amplitudes[0][strongest]),
        "q_mwb": 1e3 * float(amplitudes[1][strongest]),
        "whole": ""
        if _is_whole(span_rad)
        else ", which is no multiple of 60: is the angle the shaft's (mechanical: true)?",
    }
    text = "mean over {angles} rotor angles that span {span_deg:.4g} electrical degrees{whole}"
    if float(np.hypot(*amplitudes)[strongest]) > 0.0:
        text += "; the largest harmonic, of order {order:.4g}, is {d_mwb:.3g} mWb on d and {q_mwb:.3g} mWb on q at most"
    remark = Remark.of("rotor_angles", text, **values)
    every = {
        f"{axis}_{order:.4g}_mwb": 1e3 * float(amplitude)
        for axis, each in zip("dq", amplitudes, strict=True)
        for order, amplitude in zip(orders, each, strict=True)
    }
    return remark.model_copy(update={"values": remark.values | every})

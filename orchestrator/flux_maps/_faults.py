"""The faults of a flux map, and the uses that each of them spoils: from figures to sentences.

A fault counts from a part of the flux on, or from the map's own error where that is larger. Checks that are not
possible are reported, not skipped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from orchestrator.flux_maps._checks import Symmetry
from orchestrator.flux_maps._surface import MapSurface
from orchestrator.formatting.quantities import plural, quantity, vector
from orchestrator.numerics.types import Array, Mask
from protocols import Remark, Strict

Use = Literal["mtpa", "observer", "sensorless", "simulation", "inverse"]
USES: dict[Use, str] = {
    "mtpa": "MTPA and torque tables",
    "observer": "flux observers and feed-forward",
    "sensorless": "sensorless control by injection",
    "simulation": "simulation over stored energy",
    "inverse": "the inverse map i(psi)",
}


class AuditCriteria(Strict):
    """Limits from which a fault counts."""

    material_percent: Annotated[float, Field(gt=0.0, le=100.0)] = 0.2
    """Percent of the flux' swing, the diagnosis' limit of materiality in a map."""
    torque_percent: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    """Percent of the largest torque, rms: the accuracy of a good torque sensor."""
    outlier: Annotated[float, Field(ge=1.0)] = 10.0
    """Multiple of the typical roughness of a point: one in 10**10 independent normal errors exceeds it."""
    deviations: Annotated[float, Field(ge=0.0)] = 2.0
    """Standard deviations of the map that a fault has to exceed."""


class Fault(Strict):
    """A property that no motor's map can have."""

    remark: Remark
    spoils: tuple[Use, ...]


@dataclass(frozen=True)
class Symmetries:
    """Parity about d, or about the axis a quarter turn away on which the magnet lies; and about the best axis."""

    magnet_wb: float | None
    magnet_rad: float | None
    quarter: float
    about: Symmetry | None
    best: Symmetry | None


def uses_in_words(uses: tuple[Use, ...]) -> str:
    return ", ".join(USES[use] for use in uses)


def curl_faults(apart: float | None, floor: float, swing: float) -> Iterator[Fault]:
    if apart is not None and apart > floor:
        text = "no energy has this flux: its nearest gradient is {apart_percent:.2g} % of the swing away, rms"
        yield _fault("not_reciprocal", text, ("simulation", "sensorless"), apart_percent=100.0 * apart / swing)


def symmetry_faults(symmetries: Symmetries, floor: float, swing: float) -> Iterator[Fault]:
    if symmetries.quarter:
        text = "the magnet lies at {degrees:.0f} degrees: the axes of a reluctance machine (magnet_axis in a mapping)"
        yield _fault("other_axes", text, tuple(USES), degrees=math.degrees(symmetries.quarter))
    about, best = symmetries.about, symmetries.best
    if about is None or best is None or about.rms_wb <= floor:
        return
    off = math.degrees(best.axis_rad - symmetries.quarter)
    # Squares add up: what a turn explains is most of it where half of the rms is left.
    if best.rms_wb < 0.5 * about.rms_wb:
        text = "the axis of symmetry is {degrees:+.2f} degrees off: an angle error, or offsets that look like one"
        yield _fault("turned", text, ("mtpa", "observer", "sensorless"), degrees=off)
    if best.rms_wb > floor:
        text = "not even in i_q: {apart_percent:.2g} % of the swing, rms, however it is turned: voltage or current errs"
        yield _fault("not_even", text, ("mtpa", "observer"), apart_percent=100.0 * best.rms_wb / swing)


def convexity_faults(places: Array, least: Array) -> Iterator[Fault]:
    if len(places):
        text = "the energy is not convex at {points} (least inductance {least} at {worst}): there one flux belongs to \
several currents"
        at = int(np.argmin(least[least <= 0.0]))
        values = {"points": plural(len(places), "point"), "least": quantity(float(least.min()), "H")}
        yield _fault("not_convex", text, ("inverse", "observer", "simulation"), worst=vector(*places[at]), **values)


def hole_faults(holes: Mask, surface: MapSurface) -> Iterator[Fault]:
    if holes.any():
        d, q = (int(index[0]) for index in np.nonzero(holes))
        text = "{points} inside the measured region missing, the first at {worst}"
        first = vector(float(surface.i_d[d]), float(surface.i_q[q]))
        yield _fault("holes", text, ("inverse", "simulation"), points=plural(int(holes.sum()), "point"), worst=first)


def rough_faults(
    rough: tuple[Array, Array], typical: float | None, floor: float, surface: MapSurface, criteria: AuditCriteria
) -> Iterator[Fault]:
    if typical is None:
        return
    swing = 0.5 * float(np.ptp(surface.fluxes, axis=0).max())
    if typical > floor:
        text = "points scatter by {apart_percent:.2g} % of the swing against their neighbours"
        yield _fault("noisy", text, ("sensorless", "observer"), apart_percent=100.0 * typical / swing)
    own = _own_errors(rough)
    d, q, _ = np.unravel_index(int(np.argmax(own)), own.shape)
    worst = float(own.max())
    if worst > max(criteria.outlier * typical, floor):
        text = "the flux at {worst} is out of line with its neighbours by {apart_percent:.2g} % of the swing"
        where = vector(float(surface.i_d[d]), float(surface.i_q[q]))
        uses: tuple[Use, ...] = ("sensorless", "inverse", "mtpa")
        yield _fault("out_of_line", text, uses, worst=where, apart_percent=100.0 * worst / swing)


def _own_errors(rough: tuple[Array, Array]) -> Array:
    """Smaller deviation of a point along both axes; zero where the signs differ."""
    along_d, along_q = (np.nan_to_num(along) for along in rough)
    least: Array = np.where(along_d * along_q > 0.0, np.minimum(np.abs(along_d), np.abs(along_q)), 0.0)
    return least


def torque_faults(torque: tuple[float, float] | None, criteria: AuditCriteria) -> Iterator[Fault]:
    if torque is None:
        return
    factor, left = torque
    if abs(factor - 1.0) > 0.01 * criteria.torque_percent:
        text = "the file's torque is {factor:.4g} times that of its fluxes{likely}"
        yield _fault("torque_scale", text, ("mtpa",), factor=factor, likely=_likely_causes(factor))
    if left > criteria.torque_percent:
        text = (
            "beside a factor, the file's torque and that of its fluxes are {apart_percent:.2g} % of the largest apart"
        )
        yield _fault("torque_differs", text, ("mtpa",), apart_percent=left)


def _likely_causes(factor: float) -> str:
    """Usual causes of such a factor."""
    known = {2 / 3: "power-invariant vectors, or the 3/2 left out", 0.5: "rms currents or fluxes, or pole pairs \
halved", 2.0: "poles taken for pole pairs"}  # fmt: skip
    causes = ["the opposite sign"] if factor < 0.0 else []
    causes += [text for value, text in known.items() if abs(abs(factor) / value - 1.0) < 0.02]
    return f" ({', '.join(causes)})" if causes else ""


def audit_remarks(symmetries: Symmetries, swing: float, torque: bool, known: bool) -> Iterator[Remark]:
    """Remarks on impossible checks and on symmetries; `known` is whether the pole pairs are known."""
    if symmetries.about is None:
        text = "no point has its mirror image in i_q: parity and the magnet's axis are unknown"
        yield Remark.of("parity_unasked", text)
    elif symmetries.about.rms_wb < 1e-9 * swing:
        text = "even to the last digit, by construction or symmetrised: parity is no evidence on the measurement"
        yield Remark.of("symmetrised", text)
    if symmetries.magnet_wb is None:
        yield Remark.of("rest_unknown", "zero current lies outside the map: the magnet's flux is an extrapolation")
    elif symmetries.magnet_rad is None:
        yield Remark.of(
            "no_magnet", "no flux at zero current: a reluctance machine, or a map without the magnet's part"
        )
    if torque and not known:
        text = "the file has a torque, but the pole pairs are unknown: give --motor"
        yield Remark.of("pole_pairs_unknown", text)
    if not torque:
        text = "the file has no torque: a wrong scale common to both axes cannot be detected"
        yield Remark.of("torque_unasked", text)


def _fault(code: str, text: str, spoils: tuple[Use, ...], **values: float | str | None) -> Fault:
    return Fault(remark=Remark.of(code, text, **values), spoils=spoils)

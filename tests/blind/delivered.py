"""The map that a diagnosis delivers, held against the plant's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocols import FluxMap, ResistanceEstimate
from tests.blind.hidden import Case


@dataclass(frozen=True)
class Delivered:
    """How good a delivered map is where currents were.

    Attributes
    ----------
    map_percent : float
        rms error of the flux over the map and both axes, of the rated flux.
    inside : float
        Part of the map's fluxes whose 95 % interval holds the truth.
    resistance_percent : float
        Error of R_s.
    usable : bool
        Whether nothing was stated against it.
    """

    map_percent: float
    inside: float
    resistance_percent: float
    usable: bool


def held_against(case: Case, found: FluxMap, resistance: ResistanceEstimate, usable: bool) -> Delivered:
    """The figures of one answer.

    The truth is the part of the plant's map that is even in i_q: what is not belongs to the slots, an effect.
    """
    table, machine = case.bench.table, case.bench.machine
    error, spread = [], []
    rest_d, _ = table.flux(0.0, 0.0)
    for k, i_d in enumerate(found.i_d):
        for m, i_q in enumerate(found.i_q):
            if not np.isfinite(found.psi_d[k, m]):
                continue
            ahead, behind = table.flux(float(i_d), float(i_q)), table.flux(float(i_d), -float(i_q))
            psi_d, psi_q = 0.5 * (ahead[0] + behind[0]) - rest_d, 0.5 * (ahead[1] - behind[1])
            error.append((found.psi_d[k, m] - machine.pm_flux_wb - psi_d, found.psi_q[k, m] - psi_q))
            spread.append((found.psi_d_std[k, m], found.psi_q_std[k, m]))
    off, std = np.array(error), np.array(spread)
    bridge = case.bench.bridge
    # What a bridge loses in proportion to the current nobody can tell from R_s; each device conducts half the time.
    true_ohm = float(case.bench.plant.resistance + 0.5 * (bridge.switch_ohm + bridge.diode_ohm))
    return Delivered(
        map_percent=100.0 * float(np.sqrt(np.mean(off**2))) / machine.rated_flux_wb,
        inside=float(np.mean(np.abs(off) <= 1.96 * std)),
        resistance_percent=100.0 * abs(resistance.value_ohm / true_ohm - 1.0),
        usable=usable,
    )

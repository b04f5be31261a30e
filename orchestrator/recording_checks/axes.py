"""A d axis that is a quarter turn from the magnet's, by which way the iron saturates unevenly.

A magnet makes the inductances of +i_d others than those of -i_d; of +i_q and -i_q they are the same. A machine that was
described as a synchronous reluctance motor is, with d along its largest inductance and the magnet on -q, is uneven
across its own q axis instead. Set-points and readings agree then: nothing else says it.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.survey import Sighting, parts
from protocols import Convention, ManifestCorrection

EVEN = ((0, 0), (2, 0), (0, 2), (1, 1))
ODD_IN_D = ((1, 0), (3, 0), (1, 2))
ODD_IN_Q = ((0, 1), (0, 3), (2, 1))
"""Powers of i_d and i_q, in the largest current, of which what an inductance does is made."""
LEAST_POINTS = 16


def quarter_turn(seen: Responses) -> Convention | None:
    """The d axis along which the iron is even, while across it is not: the magnet lies there."""
    survey, limits = seen.survey, seen.survey.criteria
    declared = math.floor(survey.manifest.drive.voltage_delay_samples or 0.0)
    told = [(s, found) for s in survey.injections if (found := _per_volt(s, declared)) is not None]
    if len(told) < LEAST_POINTS:
        return None
    at = np.array([s.mean_i * np.exp(-1j * s.theta_rad) for s, _ in told])
    at = at / max(float(np.abs(at).max()), 1e-300)
    powers = np.stack([at.real**m * at.imag**n for m, n in (*EVEN, *ODD_IN_D, *ODD_IN_Q)], axis=1)
    size = np.linalg.norm(powers, axis=0)
    if not size.all() or np.linalg.cond(powers / size) ** 2 > limits.told_apart:
        return None
    inverse_inductance = np.log(np.array([found for _, found in told]))
    numbers = np.linalg.lstsq(powers, inverse_inductance, rcond=None)[0]
    d, q = slice(len(EVEN), len(EVEN) + len(ODD_IN_D)), slice(len(EVEN) + len(ODD_IN_D), None)
    along, across = _rms(powers[:, d] @ numbers[d]), _rms(powers[:, q] @ numbers[q])
    if across < limits.least_uneven or across < limits.uneven * along:
        return None
    # Where the magnet's flux and the current's add up, iron saturates, and 1/L is larger.
    more = float(np.sum(powers[:, q] @ numbers[q] * at.imag[:, None]))
    return _named(math.copysign(0.5 * math.pi, more), along, across)


def _named(turn: float, along: float, across: float) -> Convention:
    side = "+q" if turn > 0.0 else "-q"
    text = (
        f"add {turn:.4g} rad to rotor_angle_rad, turn the set-points back by as much, and let L_d be the magnet's "
        "axis' on the nameplate"
    )
    return Convention(
        kind="quarter_turn",
        what=f"the magnet looks to lie on {side}, as with a reluctance motor's d axis or an angle a quarter turn off",
        evidence=(
            f"inductances at +i_q and -i_q differ by {100.0 * 2.0 * across:.2g} % (rms), at +i_d and -i_d by "
            f"{100.0 * 2.0 * along:.2g} %"
        ),
        correction=ManifestCorrection(text=text, field="axes", add=turn),
    )


def _per_volt(seen: Sighting, declared: int) -> Array | None:
    """How far the current moves in a sample by a volt along d, and along q [A/V], shape (2,); None where untold."""
    turn = np.exp(-1j * seen.theta_rad)
    u, steps = parts(seen.ripple_v * turn)[: len(seen.i) - 1 - declared], parts(np.diff(seen.i * turn))[declared:]
    moments = u.T @ u
    if not np.linalg.det(moments) > 1e-4 * np.trace(moments) ** 2:
        # It ripples along one axis.
        return None
    found = np.diag(np.linalg.solve(moments, u.T @ steps))
    return found if (found > 0.0).all() else None


def _rms(x: Array) -> float:
    return math.sqrt(float(np.mean(x**2)))

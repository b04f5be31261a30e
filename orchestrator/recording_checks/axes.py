"""A d axis that is a quarter turn from the magnet's, detected by the asymmetry of saturation.

A magnet makes the inductances at +i_d differ from those at -i_d; at +i_q and -i_q they are equal. A machine described
like a synchronous reluctance motor, with d along its largest inductance and the magnet on -q, is asymmetric along its
own q axis instead. Set-points and readings agree then, so that no other check detects it.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.survey import MAX_CONDITION_NUMBER, SegmentReadings, parts
from protocols import Convention, ManifestCorrection

EVEN = ((0, 0), (2, 0), (0, 2), (1, 1))
ODD_IN_D = ((1, 0), (3, 0), (1, 2))
ODD_IN_Q = ((0, 1), (0, 3), (2, 1))
"""Powers of i_d and i_q, relative to the largest current, of the polynomial that models an inductance."""
MIN_INJECTION_POINTS = 16
"""Injections below which the polynomial is not fitted."""
MIN_ASYMMETRY_RATIO = 3.0
"""Asymmetry in i_q over that in i_d where the magnet lies across. Of 33 recordings of six plants with right axes the
largest ratio is a third."""
MIN_ASYMMETRY = 0.04
"""Part of an inductance, rms and odd in i_q, that counts as asymmetry; those recordings had 0.03 at most."""


def quarter_turn(responses: Responses) -> Convention | None:
    """A quarter turn where the iron is symmetric along d and asymmetric along q: the magnet lies on q."""
    survey = responses.survey
    declared = math.floor(survey.manifest.drive.voltage_delay_samples or 0.0)
    slopes = [(s, slope) for s in survey.injections if (slope := _current_per_volt(s, declared)) is not None]
    if len(slopes) < MIN_INJECTION_POINTS:
        return None
    at = np.array([s.mean_i * np.exp(-1j * s.theta_rad) for s, _ in slopes])
    at = at / max(float(np.abs(at).max()), 1e-300)
    powers = np.stack([at.real**m * at.imag**n for m, n in (*EVEN, *ODD_IN_D, *ODD_IN_Q)], axis=1)
    size = np.linalg.norm(powers, axis=0)
    if not size.all() or np.linalg.cond(powers / size) ** 2 > MAX_CONDITION_NUMBER:
        return None
    inverse_inductance = np.log(np.array([slope for _, slope in slopes]))
    coefficients = np.linalg.lstsq(powers, inverse_inductance, rcond=None)[0]
    d, q = slice(len(EVEN), len(EVEN) + len(ODD_IN_D)), slice(len(EVEN) + len(ODD_IN_D), None)
    along, across = _rms(powers[:, d] @ coefficients[d]), _rms(powers[:, q] @ coefficients[q])
    if across < MIN_ASYMMETRY or across < MIN_ASYMMETRY_RATIO * along:
        return None
    # Where the magnet's flux and the current's add up, iron saturates, and 1/L is larger.
    more = float(np.sum(powers[:, q] @ coefficients[q] * at.imag[:, None]))
    return _quarter_turn_convention(math.copysign(0.5 * math.pi, more), along, across)


def _quarter_turn_convention(turn: float, along: float, across: float) -> Convention:
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


def _current_per_volt(readings: SegmentReadings, declared: int) -> Array | None:
    """Change of current per sample and volt along d and along q [A/V], shape (2,); None where not identifiable."""
    turn = np.exp(-1j * readings.theta_rad)
    u, steps = (
        parts(readings.ripple_v * turn)[: len(readings.i) - 1 - declared],
        parts(np.diff(readings.i * turn))[declared:],
    )
    moments = u.T @ u
    if not np.linalg.det(moments) > 1e-4 * np.trace(moments) ** 2:
        # The voltage ripples along one axis only.
        return None
    slopes = np.diag(np.linalg.solve(moments, u.T @ steps))
    return slopes if (slopes > 0.0).all() else None


def _rms(x: Array) -> float:
    return math.sqrt(float(np.mean(x**2)))

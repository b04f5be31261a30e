"""What a gain common to all current sensors may do to a map, where the sensors were found unequal.

No reading of a locked rotor shows a gain that all sensors share: it scales R_s and the flux. That of two sensors with
independent errors is as uncertain as half their difference is large. A model that corrects the currents by a matrix M
therefore knows the currents' scale to no better than M stretches one axis more than the other:

    i_corrected = M i,    s = |sym M - 1/2 tr(M) 1| / sqrt(2),    d psi = s L(i) i

with the Frobenius norm and the incremental inductances L. Sensors that the model has as equal are taken as right.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.fitting.corrections import apply_effects
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS
from orchestrator.numerics.types import Array
from protocols import EffectLayer


def common_gain_wb(fit: Fit, i_dq: Array) -> float:
    """Half width of the flux's 95 % band by a gain common to all sensors, rms over currents (n, 2) and both axes [Wb].

    Zero where the model has no unequal sensors.
    """
    inductance = fit.model.magnetics.flux_and_inductance(i_dq)[1]
    l_dd, l_dq, l_qq = inductance.T
    i_d, i_q = i_dq.T
    moved = np.stack([l_dd * i_d + l_dq * i_q, l_dq * i_d + l_qq * i_q], axis=1)
    moved -= moved.mean(axis=0)
    return INTERVAL_SIGMAS * unequal_gains(fit) * math.sqrt(float(np.mean(moved**2)))


def unequal_gains(fit: Fit) -> float:
    """By how much more a model's sensors stretch one axis of the current than both on average."""
    sensors = [a for a in fit.model.active if a.candidate.effect.layer is EffectLayer.CURRENT_SENSORS]
    if not sensors:
        return 0.0
    powers, products = np.zeros((2, 2)), np.zeros((2, 2))
    for linearisation in fit.linearisation.batches:
        read = np.asarray(linearisation.base.i_ab, dtype=np.float64)
        corrected = np.asarray(apply_effects(linearisation.base, sensors).signals.i_ab, dtype=np.float64)
        read, corrected = read - read.mean(axis=0), corrected - corrected.mean(axis=0)
        powers += read.T @ read
        products += read.T @ corrected
    matrix = np.linalg.solve(powers, products).T
    stretch = 0.5 * (matrix + matrix.T) - 0.5 * np.trace(matrix) * np.eye(2)
    return float(np.linalg.norm(stretch)) / math.sqrt(2.0)

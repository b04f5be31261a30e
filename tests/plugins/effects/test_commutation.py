"""What the kernel of a switching leg's edges says, beside three legs switched in steps of ten nanoseconds."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.frames import from_phases, to_phases
from orchestrator.numerics.types import Array
from plugins.effects._commutation import Swing, lost_at_edges, swing_course, swing_lines
from tests.support.cases import few

BUS, PERIOD, STEP = 540.0, 1e-4, 1e-8
DEAD = 193
"""Dead time in steps."""
L_D, L_Q = 0.043, 0.069
TWO, CARRIER = np.array([0, 2]), (np.array([PERIOD]), np.array([1]))
"""Bounds of a segment of two samples; a period in each of its intervals."""
VOLT = 2.0 * BUS * STEP / PERIOD
"""The voltage that shifts each edge by a step, so that all of them are on the grid."""


def _swing(grading: float) -> tuple[Array, Array]:
    """Charge that has flown, of a whole swing's, and the node's voltage then, of the bus: C ~ u^-m + (1 - u)^-m."""
    # The rail, where the capacitance has no end, is left in ever larger steps.
    low = 0.5 * np.linspace(0.0, 1.0, 2_001) ** 6
    middle = 0.5 * (low[1:] + low[:-1])
    charge = np.append(0.0, np.cumsum((middle**-grading + (1.0 - middle) ** -grading) * np.diff(low)))
    x = 0.5 * charge / charge[-1]
    return np.append(x, 1.0 - x[-2::-1]), np.append(low, 1.0 - low[-2::-1])


def _switched(i_abc: Array, steps: Array, capacitance_f: float, grading: float) -> tuple[Array, Array]:
    """Currents after a period that begins in the valley, and the mean phase voltages in it; each shape (3,).

    A node follows its switch, or what the current makes of its capacitance while neither conducts; the d axis of the
    motor is along phase a.
    """
    swing = _swing(grading)
    n = round(PERIOD / STEP)
    rise, fall = n // 4 - steps, 3 * n // 4 + steps
    node, mean, i = np.zeros(3), np.zeros(3), i_abc.copy()
    admittance = np.array([[2.0, -1.0, -1.0], [-1.0, 0.5, 0.5], [-1.0, 0.5, 0.5]]) / (3.0 * L_D)
    admittance += np.array([[0.0, 0.0, 0.0], [0.0, 0.5, -0.5], [0.0, -0.5, 0.5]]) / L_Q
    for k in range(n):
        charge = np.interp(node / BUS, swing[1], swing[0]) - i * (STEP / (capacitance_f * BUS))
        floating = BUS * np.interp(charge, *swing)
        driven = np.where((k >= rise + DEAD) & (k < fall), BUS, 0.0)
        node = np.where((k < rise) | ((k >= rise + DEAD) & (k < fall)) | (k >= fall + DEAD), driven, floating)
        i += STEP * (admittance @ node)
        mean += node / n
    return i, mean - mean.mean()


@few("capacitance_f, grading", [(128e-12, 0.5), (64e-12, 0.0), (128e-12, 0.0), (128e-12, 0.7)])
@few(
    "i_a, i_b, steps",
    [
        (0.0003, 2.6, (-3, 206, -203)),
        (0.0002, 0.2165, (-1, 106, -105)),
        (-0.002, 0.2, (0, 106, -106)),
        (0.02, -0.01, (74, -37, -37)),
        (0.25, -0.125, (138, -69, -69)),
        (0.02, 0.5, (-278, 370, -92)),
    ],
    fast=3,
)
def test_the_kernel_agrees_with_legs_switched_step_by_step(
    i_a: float, i_b: float, steps: tuple[int, int, int], capacitance_f: float, grading: float
) -> None:
    i_abc = np.array([i_a, i_b, -i_a - i_b])
    after, mean = _switched(i_abc, np.array(steps), capacitance_f, grading)
    commanded = VOLT * np.array(steps, dtype=np.float64)
    volts = DEAD * STEP / PERIOD * BUS
    knee = capacitance_f * BUS / (DEAD * STEP)
    motor = np.array([[L_D, 0.0, L_Q]])
    i_ab, v_ab = from_phases(np.array([i_abc, after])), from_phases(np.array([commanded, commanded]))
    swing = Swing(swing_lines(grading), yielding=1.0)
    lost_ab = lost_at_edges(v_ab, i_ab, np.full(2, volts), TWO, np.ones(3), 1.0 / knee, motor, *CARRIER, swing)
    lost = to_phases(lost_ab)[0]
    np.testing.assert_allclose(lost, commanded - mean, atol=0.006 * volts)


@pytest.mark.parametrize("grading", [0.0, 1.0 / 3.0, 0.5, 0.75])
def test_a_node_follows_the_charge_of_its_capacitance(grading: float) -> None:
    (node, mean), (x, u) = swing_course(grading), _swing(grading)
    place = np.linspace(0.0, 1.0, len(node))
    np.testing.assert_allclose(node, np.interp(place, x, u), atol=2e-3)
    np.testing.assert_allclose(node + node[::-1], 1.0, atol=1e-6)
    area = np.append(0.0, np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(x)))
    np.testing.assert_allclose(mean[10:], np.interp(place[10:], x, area) / place[10:], atol=2e-3)


@pytest.mark.parametrize("yielding", [0.0, 1.0])
def test_a_knee_s_current_swings_the_node_in_just_the_dead_time(yielding: float) -> None:
    """Half of the dead time is lost then at either edge, by a motor that yields nothing to the edges."""
    stiff, volts = np.array([[1e9, 0.0, 1e9]]), np.full(2, 5.0)
    i_ab, v_ab = from_phases(np.tile([0.0, 1.0, -1.0], (2, 1))), np.zeros((2, 2))
    swing = Swing(swing_lines(0.5), yielding=yielding)
    lost = to_phases(lost_at_edges(v_ab, i_ab, volts, TWO, np.ones(3), 1.0, stiff, *CARRIER, swing))[0]
    np.testing.assert_allclose(lost, 5.0 * np.array([0.0, 0.5, -0.5]), atol=2e-2)

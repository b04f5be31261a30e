"""What a resistance takes of the ripple: against a machine that is taken through its pulses step by step."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.carrier_ripple import MIN_INDUCTANCE_RATIO, CarrierRipple
from orchestrator.diagnosis.weak_form.magnetics import Magnetics, linear_magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import to_dq, to_phases
from orchestrator.numerics.tensor_spline import EvenSpline
from protocols import SegmentStage, Signals
from tests.orchestrator.diagnosis.pieces import FS, GRID, L_D, TRUE_MAP, Array, Plan, hold, piece
from tests.support.cases import few

BUS_V, OHM = 540.0, 40.0
"""A resistance that makes R T / L a tenth, as a small servo's is."""
SATURATED = Magnetics(GRID, TRUE_MAP.coefficients + np.random.default_rng(1).normal(0.0, 1e-3, GRID.size))


def flux(magnetics: Magnetics, i_dq: Array) -> Array:
    psi: Array = magnetics.flux_and_inductance(i_dq[None])[0][0]
    return psi


def current(magnetics: Magnetics, psi: Array, near: Array) -> Array:
    """The current of a flux, by Newton's method."""
    i = near.copy()
    for _ in range(20):
        at, (dd, dq, qq) = (x[0] for x in magnetics.flux_and_inductance(i[None]))
        step = np.linalg.solve(np.array([[dd, dq], [dq, qq]]), psi - at)
        i = i + step
        if np.abs(step).max() < 1e-9:  # the next one would be its square
            break
    return i


def pulses(v_dq: Array) -> list[tuple[float, Array]]:
    """Durations of a carrier period's parts, and the voltage in each."""
    phases = to_phases(v_dq[None])[0]
    duty = 0.5 + (phases - 0.5 * (phases.max() + phases.min())) / BUS_V
    edges = np.unique(np.concatenate([[0.0, 1.0], 0.5 * (1.0 - duty), 0.5 * (1.0 + duty)]))
    parts = []
    for start, stop in pairwise(edges):
        a, b, c = BUS_V * (np.abs(0.5 * (start + stop) - 0.5) < 0.5 * duty)
        parts.append(((stop - start) / FS, np.array([(2.0 * a - b - c) / 3.0, (b - c) / np.sqrt(3.0)])))
    return parts


def missed(magnetics: Magnetics, v_dq: Array, start: Array, steps: int = 24) -> tuple[Array, Array]:
    """v T - R T (mean of both ends' currents) - change of flux over one period, and the current at its end."""
    psi, i = flux(magnetics, start), start

    def rise(at: Array, volts: Array) -> Array:
        return volts - OHM * current(magnetics, at, i)

    for duration, volts in pulses(v_dq):
        h = duration / steps
        for _ in range(steps):
            k1 = rise(psi, volts)
            k2 = rise(psi + 0.5 * h * k1, volts)
            k3 = rise(psi + 0.5 * h * k2, volts)
            psi = psi + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rise(psi + h * k3, volts))
            i = current(magnetics, psi, i)
    return v_dq / FS - 0.5 * OHM / FS * (start + i) - (psi - flux(magnetics, start)), i


def ripple(one: SegmentData, signals: Signals, magnetics: Magnetics) -> CarrierRipple:
    found = CarrierRipple.of(one, signals, magnetics)
    assert found is not None
    return found


def bend(of: CarrierRipple, one: SegmentData, magnetics: Magnetics) -> Array:
    """The mean voltage of a hold by the map's curvature, in the rotor frame."""
    rows = of.columns(of.bent(), one.windows, magnetics.grid) @ magnetics.coefficients
    volts = (rows * FS / one.windows.absolute_weight).reshape(-1, 2)
    mean: Array = volts.mean(axis=0)
    return mean


@pytest.mark.parametrize("magnetics", [TRUE_MAP, SATURATED])
@few("i_dq", [(-1.5, 1.0), (2.0, 0.0), (0.3, -2.2)])
def test_it_is_what_the_line_between_readings_misses(magnetics: Magnetics, i_dq: tuple[float, float]) -> None:
    v_dq, i = OHM * np.array(i_dq), np.array(i_dq)
    for _ in range(3):  # to where the current returns after a period
        off, end = missed(magnetics, v_dq, i)
        i = end
    off, end = missed(magnetics, v_dq, i)
    one = piece(Plan(SegmentStage.RESISTANCE, hold(*i_dq)))
    n = len(one.signals.v_dc)
    arrays = {"v_ab": np.tile(v_dq, (n, 1)), "i_ab": np.tile(i, (n, 1)), "v_dc": np.full(n, BUS_V)}
    signals = one.signals.replaced({**arrays, "resistance_ohm": np.full(n, OHM)})
    found = ripple(one, signals, magnetics)
    taken = found.damped()[0] + bend(found, one, magnetics)
    assert np.linalg.norm(off + taken / FS) < 0.02 * np.linalg.norm(off)


def test_its_direction_is_the_stators_whatever_the_rotors_angle() -> None:
    plain, turned = (piece(Plan(SegmentStage.RESISTANCE, hold(2.0, 0.0)), angle=x) for x in (0.0, 2.0 * np.pi / 3.0))
    # A third of a turn is another phase, to which the pulses do alike.
    a, b = (ripple(one, one.signals, SATURATED) for one in (plain, turned))
    # A third of a turn is another phase, to which the pulses do alike.
    there = to_dq(b.damped(), 2.0 * np.pi / 3.0)
    np.testing.assert_allclose(there, a.damped(), rtol=1e-6, atol=1e-12 * np.abs(a.damped()).max())
    x, y = bend(a, plain, SATURATED), bend(b, turned, SATURATED)
    np.testing.assert_allclose(y, x, rtol=1e-6, atol=1e-12 * np.abs(x).max())


def test_with_the_bridge_off_there_is_none() -> None:
    one = piece(Plan(SegmentStage.GATES_OFF, np.zeros((600, 2))))
    assert CarrierRipple.of(one, one.signals, TRUE_MAP) is None


def test_the_bend_is_none_where_the_map_does_not_saturate() -> None:
    one = piece(Plan(SegmentStage.RESISTANCE, hold(2.0, -1.0)))
    linear = linear_magnetics(GRID, L_D, 1.4 * L_D)
    found = ripple(one, one.signals, linear)
    assert np.abs(bend(found, one, linear)).max() < 1e-9 * np.abs(found.damped()).max()


def test_columns_of_the_bend_are_the_second_difference_of_the_flux_along_the_ripple() -> None:
    """Also with the kink of iron that saturates from zero flux on, beside which the third derivative jumps."""
    grid = EvenSpline(-4.0, 4.0, 4.0, (4, 6), kink=True)
    rough = np.random.default_rng(4).normal(0.0, 1e-3, grid.size)
    one = piece(Plan(SegmentStage.RESISTANCE, hold(1.1, 0.9)))
    found = ripple(one, one.signals, Magnetics(grid, linear_magnetics(grid, L_D, L_D).coefficients))
    i, (dd, dq, qq) = found.i_dq[0], found.square[0]
    values, vectors = np.linalg.eigh(np.array([[dd, dq], [dq, qq]]))
    x = 1e-3
    second = sum(
        0.5 * value * (flux(m, i + x * along) + flux(m, i - x * along) - 2.0 * flux(m, i)) / x**2
        for m in [Magnetics(grid, rough)]
        for value, along in zip(values, vectors.T, strict=True)
    )
    l_dd, l_dq, l_qq = found.inductance[0]
    expected = found.ohm[0] * np.linalg.solve(np.array([[l_dd, l_dq], [l_dq, l_qq]]), second)
    np.testing.assert_allclose(bend(found, one, Magnetics(grid, rough)), expected, rtol=1e-4)


@pytest.mark.parametrize("scale", [0.0, -0.5, 1e-3])
def test_a_map_that_is_none_yet_makes_no_voltage_without_bounds(scale: float) -> None:
    """On its way to where it fits a map may have any inductance; its ripple must not lead it further away."""
    one = piece(Plan(SegmentStage.RESISTANCE, hold(2.0, -1.0)))
    signals = one.signals.replaced({"resistance_ohm": np.full(len(one.signals.v_dc), OHM)})
    rough = np.random.default_rng(2).normal(0.0, 1.0, GRID.size)
    right = ripple(one, signals, TRUE_MAP).damped()
    flat = ripple(one, signals, Magnetics(GRID, scale * TRUE_MAP.coefficients)).damped()
    wrong = ripple(one, signals, Magnetics(GRID, scale * TRUE_MAP.coefficients + rough)).damped()
    np.testing.assert_allclose(flat, right, rtol=1e-9, atol=1e-12 * np.abs(right).max())
    # Not more than what a ripple at the least inductance drops across the resistance.
    assert np.abs(wrong).max() < OHM * BUS_V / FS / (MIN_INDUCTANCE_RATIO * L_D)

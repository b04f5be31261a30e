"""The weak form's equations: they hold for an exact machine, and do not depend on what must not matter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import (
    basis,
    change_of_rows,
    flux_terms,
    local_map,
    voltage_and_resistance,
)
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.windows import plain_windows
from orchestrator.numerics.frames import to_ab
from protocols import SegmentStage, SignalBatch, Signals
from tests.orchestrator.diagnosis.pieces import FS, GRID, PM_WB, R_S, TRUE_MAP, Array, Plan, piece, ripple, sweep

SWEEP = Plan(SegmentStage.CLASSICAL, sweep(1, 2.5, 1.0))
RIPPLE = Plan(
    SegmentStage.INJECTION, ripple(1.0, 1.0, 40.0), settings={"frequency_hz": FS / 20, "rotation_hz": FS / 2500}
)


def _rows(one: SegmentData, signals: Signals, magnetics: Magnetics = TRUE_MAP) -> Array:
    batch, there = SegmentBatch.of([one]), SignalBatch.of([signals])
    at = local_map(batch, there, magnetics)
    known, resistance = voltage_and_resistance(batch, there, at, PM_WB)
    return known + R_S * resistance + flux_terms(batch, at)


def _voltage(one: SegmentData) -> Array:
    """What the rows consist of, to say how small what is left is."""
    batch = SegmentBatch.of([one])
    return voltage_and_resistance(batch, batch.signals, local_map(batch, batch.signals, TRUE_MAP), PM_WB)[0]


def _saturated() -> Magnetics:
    rng = np.random.default_rng(1)
    return Magnetics(GRID, TRUE_MAP.coefficients + rng.normal(0.0, 1e-3, GRID.size))


@pytest.mark.parametrize("plan", [SWEEP, RIPPLE])
def test_nothing_is_left_where_the_model_is_the_machine(plan: Plan) -> None:
    one = piece(plan)
    assert np.abs(_rows(one, one.signals)).max() < 1e-9 * np.abs(_voltage(one)).max()


@pytest.mark.parametrize("plan", [SWEEP, RIPPLE])
def test_columns_of_the_coefficients_are_the_flux(plan: Plan) -> None:
    batch, magnetics = SegmentBatch.of([piece(plan)]), _saturated()
    at = local_map(batch, batch.signals, magnetics)
    terms = flux_terms(batch, at)
    # Polynomials are used a little beyond their cells, where they part by some 3e-6.
    (columns,) = basis(batch, at, magnetics)
    columns = columns @ magnetics.coefficients
    np.testing.assert_allclose(columns, terms, atol=1e-4 * np.abs(terms).max())


@pytest.mark.parametrize("plan", [SWEEP, RIPPLE])
def test_rows_do_not_depend_on_the_angle_of_the_stator_frame(plan: Plan) -> None:
    magnetics = _saturated()
    plain, turned = piece(plan), piece(plan, angle=1.1)
    expected = _rows(plain, plain.signals, magnetics)
    np.testing.assert_allclose(_rows(turned, turned.signals, magnetics), expected, atol=1e-9 * np.abs(expected).max())


def test_rows_do_not_depend_on_when_a_segment_began() -> None:
    early, late = piece(SWEEP), piece(SWEEP, start_s=1234.5)
    np.testing.assert_array_equal(_rows(early, early.signals, _saturated()), _rows(late, late.signals, _saturated()))


def test_a_part_of_a_segment_has_the_rows_of_the_whole() -> None:
    whole, magnetics = piece(SWEEP), _saturated()
    n = 1501
    cut = {name: getattr(whole.signals, name)[:n] for name in ("i_ab", "v_ab", "v_dc", "theta_rad", "resistance_ohm")}
    signals = replace(whole.signals, **{**cut, "i_m_ab": cut["i_ab"], "heat_j": np.zeros(n)})
    windows = plain_windows(n - 1, whole.windows.step)
    assert windows is not None
    part = replace(whole, signals=signals, windows=windows)
    rows = _rows(part, signals, magnetics)
    np.testing.assert_allclose(rows, _rows(whole, whole.signals, magnetics)[: len(rows)], rtol=1e-12, atol=1e-15)


def test_an_unknown_turn_of_the_frame_is_found_in_the_angle() -> None:
    one = piece(SWEEP)
    turn = 0.2
    # The motor stands 0.2 rad off: what it felt is what is measured, seen from its own frame.
    i_ab, v_ab = to_ab(one.signals.i_ab, turn), to_ab(one.signals.v_ab, turn)
    seen = replace(one.signals, i_ab=i_ab, i_m_ab=i_ab, v_ab=v_ab)
    right = replace(seen, theta_rad=seen.theta_rad + turn)
    assert np.abs(_rows(one, right)).max() < 1e-6 * np.abs(_voltage(one)).max()
    assert np.abs(_rows(one, seen)).max() > 1e-2 * np.abs(_voltage(one)).max()


@pytest.mark.parametrize("quantity", ["v_ab", "i_ab", "i_m_ab", "resistance_ohm", "theta_rad"])
@pytest.mark.parametrize("turn", [0.0, 0.05])
def test_change_of_rows_is_the_derivative_by_each_quantity(quantity: str, turn: float) -> None:
    one, magnetics, h = piece(SWEEP), _saturated(), 1e-5
    batch = SegmentBatch.of([one])
    base = replace(one.signals, theta_rad=one.signals.theta_rad + turn) if turn else one.signals
    base = replace(base, resistance_ohm=R_S * base.resistance_ohm)
    t = np.arange(len(base.v_dc)) / FS
    wave = np.sin(40.0 * t)
    shape = wave if quantity in ("resistance_ohm", "theta_rad") else np.stack([wave, np.cos(25.0 * t)], axis=1)

    def moved(x: float) -> Signals:
        changed: dict[str, Any] = {quantity: getattr(base, quantity) + x * shape}
        return replace(base, **changed)

    def rows(x: float) -> Array:
        signals = SignalBatch.of([moved(x)])
        at = local_map(batch, signals, magnetics)
        known, resistance = voltage_and_resistance(batch, signals, at, PM_WB)
        return known + resistance + flux_terms(batch, at)

    slope = (rows(h) - rows(-h)) / (2.0 * h)
    there = SignalBatch.of([base])
    at = local_map(batch, there, magnetics)
    derivative = change_of_rows(batch, there, {quantity: h * shape}, at, PM_WB) / h
    # What it leaves out is the small correction of the trapezoidal rule.
    np.testing.assert_allclose(derivative, slope, atol=1e-3 * np.abs(slope).max())


def test_a_trial_map_that_is_nearly_flat_at_a_current_does_not_change_what_the_resistance_takes() -> None:
    """Between two readings the current leaves its chord by no more than slopes that differ by twice the chord's."""
    one = piece(RIPPLE)
    batch, there = SegmentBatch.of([one]), SignalBatch.of([one.signals])
    local = local_map(batch, there, TRUE_MAP)
    is_flat = np.arange(len(local.inductance)) % 97 == 5
    flat = replace(local, inductance=np.where(is_flat[:, None], 1e-9, 1.0) * local.inductance)
    taken, beside = (voltage_and_resistance(batch, there, one_map, PM_WB)[1] for one_map in (local, flat))
    assert np.abs(beside - taken).max() < 0.01 * np.abs(taken).max()

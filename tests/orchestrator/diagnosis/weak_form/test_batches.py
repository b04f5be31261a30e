"""Segments laid end to end have the equations that each has alone, and every segment is dealt out once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.batches import SegmentBatch, in_batches
from orchestrator.diagnosis.weak_form.equations import (
    LocalMap,
    basis,
    change_of_rows,
    flux_terms,
    local_map,
    voltage_and_resistance,
)
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.observer import smooth_flux
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.kernels import unit_vectors
from protocols import SegmentStage, SignalBatch
from tests.orchestrator.diagnosis.pieces import (
    FS,
    GRID,
    PM_WB,
    R_S,
    TRUE_MAP,
    Array,
    Plan,
    hold,
    piece,
    plan,
    prepared,
    ripple,
    sweep,
)

RNG_SEED = 4
CHANGES = ("v_ab", "i_ab", "i_m_ab", "resistance_ohm", "theta_rad")


def _ripple(samples: int, period: int) -> Plan:
    settings = {"frequency_hz": FS / period, "rotation_hz": FS / samples}
    return Plan(SegmentStage.INJECTION, ripple(1.0, 0.5, 40.0, samples, period), settings=settings)


def _pieces() -> list[SegmentData]:
    """A hold, two sweeps and two injections, of different lengths, sampling rates and angles; one axis not logged."""
    rng = np.random.default_rng(RNG_SEED)
    plans = [
        Plan(SegmentStage.RESISTANCE, hold(1.0, -0.5, 431)),
        Plan(SegmentStage.CLASSICAL, sweep(1, 2.0, 0.5, 1500)),
        _ripple(2500, 20),
        Plan(SegmentStage.CLASSICAL, sweep(0, 1.5, 0.0, 903)),
        _ripple(1500, 12),
    ]
    rates, angles = (1.0, 2.0, 1.0, 0.5, 1.6), (0.0, 0.7, -1.2, 0.0, 2.9)
    made = []
    for k, (requested, rate, angle) in enumerate(zip(plans, rates, angles, strict=True)):
        noise = rng.normal(0.0, 0.004, requested.v_dq.shape)
        one = piece(requested, start_s=10.0 * k, angle=angle, noise=noise)
        resistance = R_S * (1.0 + 0.01 * rng.normal(size=len(requested.v_dq)))
        signals = replace(one.signals, sampling_frequency_hz=rate * FS, resistance_ohm=resistance)
        made.append(replace(one, signals=signals))
    made[3] = replace(made[3], windows=replace(made[3].windows, unread=1))
    return made


PIECES = _pieces()
BATCH = SegmentBatch.of(PIECES)
MAGNETICS = Magnetics(
    GRID, TRUE_MAP.coefficients + np.random.default_rng(RNG_SEED).normal(0.0, 1e-3, len(TRUE_MAP.coefficients))
)


def _turned(batch: SignalBatch, segments: Sequence[int]) -> SignalBatch:
    """The same where the rotor of some segments lies elsewhere than it is believed to."""
    theta = batch.theta_rad.copy()
    for k in segments:
        theta[batch.slice_of(k)] += 0.05
    return batch.replaced({"theta_rad": theta})


def _moved(batch: SignalBatch, name: str) -> Array:
    """By how much an array changes at every sample."""
    wave = np.sin(40.0 * np.arange(batch.samples) / FS)
    return wave if name in ("resistance_ohm", "theta_rad") else np.stack([wave, np.cos(3.0 * wave)], axis=1)


# No segment, one of them, and all of them lie elsewhere.
TURNED = pytest.mark.parametrize("turned", [(), (2,), range(len(PIECES))], ids=["none", "one", "all"])
OfBatch = Callable[[SegmentBatch, SignalBatch, LocalMap], Array]


def _assert_as_alone(rows: OfBatch, turned: Sequence[int]) -> None:
    """What a function makes of a batch is, end to end, what it makes of each segment alone."""
    signals = _turned(BATCH.signals, turned) if turned else BATCH.signals
    together = rows(BATCH, signals, local_map(BATCH, signals, MAGNETICS))
    assert len(together) == sum(p.windows.rows for p in PIECES)
    for j, one in enumerate(PIECES):
        batch = SegmentBatch.of([one])
        alone = _turned(batch.signals, [0]) if j in turned else batch.signals
        expected = rows(batch, alone, local_map(batch, alone, MAGNETICS))
        found = together[BATCH.rows_of(j)]
        assert np.abs(expected).max() > 0.0
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@TURNED
@pytest.mark.parametrize("part", [0, 1], ids=["voltage", "resistance"])
def test_voltage_and_resistance_are_those_of_each_segment_alone(part: int, turned: Sequence[int]) -> None:
    _assert_as_alone(lambda batch, signals, at: voltage_and_resistance(batch, signals, at, PM_WB)[part], turned)


@TURNED
def test_flux_terms_are_those_of_each_segment_alone(turned: Sequence[int]) -> None:
    _assert_as_alone(lambda batch, _, at: flux_terms(batch, at), turned)


@TURNED
def test_columns_of_the_map_are_those_of_each_segment_alone(turned: Sequence[int]) -> None:
    _assert_as_alone(lambda batch, _, at: np.concatenate(basis(batch, at, MAGNETICS)), turned)


@TURNED
@pytest.mark.parametrize("name", CHANGES)
def test_a_change_of_any_array_changes_each_segment_as_it_does_alone(name: str, turned: Sequence[int]) -> None:
    whole = _moved(BATCH.signals, name)

    def rows(batch: SegmentBatch, signals: SignalBatch, at: LocalMap) -> Array:
        same = [one for one in range(len(PIECES)) if batch.pieces[0] is PIECES[one]]
        own = whole if len(batch.pieces) > 1 else whole[BATCH.signals.slice_of(same[0])]
        return change_of_rows(batch, signals, {name: own}, at, PM_WB)

    _assert_as_alone(rows, turned)


def test_changes_of_all_arrays_together_are_the_sum_of_each() -> None:
    signals = _turned(BATCH.signals, [1])
    local = local_map(BATCH, signals, MAGNETICS)
    changes = {name: _moved(signals, name) for name in CHANGES}
    # A change of current and one of resistance are both first order: their product is in neither.
    each = [change_of_rows(BATCH, signals, {name: change}, local, PM_WB) for name, change in changes.items()]
    together = change_of_rows(BATCH, signals, changes, local, PM_WB)
    np.testing.assert_allclose(together, sum(each), rtol=0.0, atol=1e-12 * np.abs(together).max())


def test_rows_are_written_where_they_are_wanted() -> None:
    local = local_map(BATCH, BATCH.signals, MAGNETICS)
    room = np.full((int(BATCH.layout.rows[-1]), 2), np.nan, order="F")
    change = {"v_ab": _moved(BATCH.signals, "v_ab")}
    made = change_of_rows(BATCH, BATCH.signals, change, local, PM_WB, room[:, 1])
    np.testing.assert_array_equal(room[:, 1], change_of_rows(BATCH, BATCH.signals, change, local, PM_WB))
    assert np.shares_memory(made, room)
    assert np.isnan(room[:, 0]).all()


def test_an_axis_that_was_not_logged_says_nothing_in_a_batch_either() -> None:
    rows = flux_terms(BATCH, local_map(BATCH, BATCH.signals, MAGNETICS))
    for j, one in enumerate(PIECES):
        d, q = rows[BATCH.rows_of(j)].reshape(-1, 2).T
        assert d.any()
        assert q.any() == (one.windows.unread is None)


@TURNED
def test_flux_without_noise_begins_anew_with_each_segment(turned: Sequence[int]) -> None:
    signals = _turned(BATCH.signals, turned) if turned else BATCH.signals

    def observed(batch: SegmentBatch, at: SignalBatch) -> tuple[Array, ...]:
        local, layout = local_map(batch, at, MAGNETICS), batch.layout
        turn = (
            unit_vectors(np.asarray(at.theta_rad, dtype=np.float64))
            if turned
            else np.column_stack([layout.cos, layout.sin])
        )
        v_ab, i_ab, ohm = (np.asarray(x, dtype=np.float64) for x in (at.v_ab, at.i_ab, at.resistance_ohm))
        times = (layout.starts, layout.interval_s, 0.005)
        return smooth_flux(local.psi, local.inductance, v_ab, i_ab, ohm, turn, PM_WB, *times)

    together = observed(BATCH, signals)
    for j, one in enumerate(PIECES):
        batch = SegmentBatch.of([one])
        alone = observed(batch, _turned(batch.signals, [0]) if j in turned else batch.signals)
        for found, expected in zip(together, alone, strict=True):
            scale = np.abs(expected).max()
            np.testing.assert_allclose(found[signals.slice_of(j)], expected, rtol=0.0, atol=1e-12 * scale)


def test_the_angle_is_that_of_each_segment_and_one_where_all_lie_alike() -> None:
    angles = [float(p.segment.rotor_angle_rad) for p in PIECES]
    np.testing.assert_array_equal(BATCH.believed_rad, np.repeat(angles, np.diff(BATCH.signals.starts)))
    np.testing.assert_array_equal(SegmentBatch.of([PIECES[0], PIECES[3]]).believed_rad, [0.0])


def test_a_batch_knows_its_places_and_each_segment_alone() -> None:
    batch = SegmentBatch.of(PIECES, [1, 3])
    assert batch.places == (1, 3)
    assert batch.pieces == (PIECES[1], PIECES[3])
    assert [one.pieces for one in batch.singles] == [(PIECES[1],), (PIECES[3],)]
    assert batch.rows_of(1) == slice(PIECES[1].windows.rows, PIECES[1].windows.rows + PIECES[3].windows.rows)


MADE = prepared([*plan(), *(Plan(SegmentStage.RESISTANCE, hold(0.2 * k, 0.0, 450 + 50 * k)) for k in range(9))]).pieces


@pytest.mark.parametrize("samples", [1, 1000, 4000, 10**9])
def test_every_segment_is_dealt_out_exactly_once(samples: int) -> None:
    first = [1, 4, 9]
    batches = in_batches(MADE, first, samples)
    ahead, others = batches.probes, batches.others
    assert sorted(k for batch in ahead for k in batch.places) == first
    assert sorted(k for batch in (*ahead, *others) for k in batch.places) == list(range(len(MADE)))
    for batch in (*ahead, *others):
        assert batch.pieces == tuple(MADE[k] for k in batch.places)
        assert list(batch.places) == sorted(batch.places)


def test_what_is_held_out_and_what_was_read_with_the_bridge_off_is_by_itself() -> None:
    batches = in_batches(MADE, [], 10**9).all
    kinds = [{(p.held_out, p.signals.bridge_on) for p in batch.pieces} for batch in batches]
    assert all(len(kind) == 1 for kind in kinds)
    assert sorted(kind.pop() for kind in kinds) == [(False, False), (False, True), (True, True)]


@pytest.mark.parametrize("samples", [3000, 6000, 20_000])
def test_a_batch_is_of_about_the_size_that_was_requested(samples: int) -> None:
    others = in_batches(MADE, [], samples).others
    lengths = [len(p.signals.v_dc) for p in MADE]
    kinds: dict[tuple[bool, bool], list[int]] = {}
    for batch in others:
        kinds.setdefault((batch.pieces[0].held_out, batch.pieces[0].signals.bridge_on), []).append(
            batch.signals.samples
        )
    for (held_out, bridge_on), sizes in kinds.items():
        own = [
            n for n, p in zip(lengths, MADE, strict=True) if (p.held_out, p.signals.bridge_on) == (held_out, bridge_on)
        ]
        # As few as there can be; dealt out evenly, none is larger than its part by more than one segment.
        assert len(sizes) == min(math.ceil(sum(own) / samples), len(own))
        assert max(sizes) <= sum(own) / len(sizes) + max(own)
        assert sum(sizes) == sum(own)


def test_a_segment_longer_than_a_batch_is_one_by_itself() -> None:
    batches = in_batches(MADE, [], 100).all
    assert [len(batch.pieces) for batch in batches] == [1] * len(MADE)


def test_a_batch_of_other_voltages_shares_all_other_arrays() -> None:
    first, second = (replace(p, signals=replace(p.signals, v_ab=2.0 * p.signals.v_ab)) for p in PIECES[:2])
    other = BATCH.with_voltages_of((first, second, *PIECES[2:]))
    expected = SegmentBatch.of(other.pieces)
    np.testing.assert_array_equal(other.signals.v_ab, expected.signals.v_ab)
    assert other.signals.segments == expected.signals.segments
    assert other.layout is BATCH.layout
    assert other.signals.i_ab is BATCH.signals.i_ab
    assert BATCH.with_voltages_of(PIECES) is BATCH

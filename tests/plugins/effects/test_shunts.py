"""Three low-side shunts of which one is reconstructed: what is read, written anew, is undone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from plugins.effects.sensors import CurrentGainMismatch, ShuntReconstruction
from protocols import DriveRecord, RealArray, Signals
from tests.plugins.effects.readings import FS, corrected, readings, reads
from tests.support.close import assert_close

CLARKE = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3.0), -np.sqrt(3.0)]]) / 3.0
GAINS = np.array([1.01, 0.985, 1.005])
TWO, THIRD = 0.025, 0.0075
"""g_a - g_b and g_c - (g_a + g_b) / 2 of these, whose mean is 1."""
EFFECT = ShuntReconstruction()


def of_two_shunts(i_ab: RealArray, commands_ab: RealArray, gains: RealArray, offset: float = 0.0) -> Array:
    """What is read where each reading follows the command in its row: the largest leg is minus the other two."""
    read = 1.5 * i_ab @ CLARKE * gains + offset
    missing = np.argmax(commands_ab @ CLARKE, axis=1)
    rows = np.arange(len(read))
    read[rows, missing] = 0.0
    read[rows, missing] = -read.sum(axis=1)
    return np.asarray(read @ CLARKE.T)


def through_all_sectors(rows: int = 400) -> Signals:
    """Readings under a square wave on top of a turning voltage."""
    turn = 2.0 * np.pi * 3.0 * np.arange(rows) / rows
    turning = 45.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return replace(readings(rows), v_ab=readings(rows).v_ab + turning)


def before(commands_ab: RealArray) -> RealArray:
    """The last command before each reading; the first one's is not known."""
    return np.concatenate([commands_ab[:1], commands_ab[:-1]])


def test_readings_of_two_shunts_each_are_undone() -> None:
    signals = through_all_sectors()
    seen = set(np.argmax(signals.v_ab @ CLARKE, axis=1))
    assert seen == {0, 1, 2}
    read = reads(signals, of_two_shunts(signals.i_ab, before(signals.v_ab), GAINS, 0.03))
    out = corrected(EFFECT, read, gain_a_minus_b=TWO, gain_c_minus_ab=THIRD, common_offset_a=0.03)
    assert_close(out.i_ab, signals.i_ab, 1e-14)
    assert_close(out.i_m_ab, signals.i_ab, 1e-14)


@pytest.mark.parametrize("delay", [1.0, 0.25, 1.5])
def test_the_command_that_counts_is_the_last_one_whenever_it_acts(delay: float) -> None:
    signals = through_all_sectors()
    late, part = int(delay), delay % 1.0
    rows = np.arange(len(signals.v_ab))
    whole, older = (signals.v_ab[np.maximum(rows - late - more, 0)] for more in (0, 1))
    acting = replace(
        reads(signals, of_two_shunts(signals.i_ab, before(signals.v_ab), GAINS)),
        v_ab=(1.0 - part) * whole + part * older,
        v_late_ab=part * (whole - older),
        drive=DriveRecord(name="d", sampling_frequency_hz=FS, dc_bus_voltage_v=540.0, voltage_delay_samples=delay),
    )
    out = corrected(EFFECT, acting, gain_a_minus_b=TWO, gain_c_minus_ab=THIRD)
    assert_close(out.i_ab, signals.i_ab, 1e-14)


def test_means_of_many_readings_are_undone_by_the_part_that_each_leg_was_missing() -> None:
    signals, width = through_all_sectors(), 8
    held = np.repeat(signals.i_ab[::width], width, axis=0)
    commands = before(signals.v_ab)
    read = of_two_shunts(held, commands, GAINS, 0.03)
    blocks = (len(held) // width, width, -1)
    legs = np.eye(3)[np.argmax(commands @ CLARKE, axis=1)]
    n = blocks[0]
    means = replace(
        reads(readings(n), read.reshape(blocks).mean(axis=1)),
        largest_command_abc=legs.reshape(blocks).mean(axis=1),
    )
    out = corrected(EFFECT, means, gain_a_minus_b=TWO, gain_c_minus_ab=THIRD, common_offset_a=0.03)
    assert_close(out.i_ab, held[::width], 1e-14)


def test_a_gain_that_all_shunts_have_in_common_stays_in_the_current() -> None:
    signals = through_all_sectors()
    read = reads(signals, of_two_shunts(signals.i_ab, before(signals.v_ab), 1.07 * GAINS))
    out = corrected(EFFECT, read, gain_a_minus_b=TWO, gain_c_minus_ab=THIRD)
    assert_close(out.i_ab, 1.07 * signals.i_ab, 1e-14)


def test_while_phase_c_is_the_largest_it_is_a_mismatch_of_two_sensors() -> None:
    signals = replace(readings(), v_ab=np.tile([-5.0, -20.0], (400, 1)))
    two = corrected(CurrentGainMismatch(), signals, gain_a_minus_b=0.03)
    assert_close(corrected(EFFECT, signals, gain_a_minus_b=0.03).i_ab, two.i_ab, 1e-14)


def test_without_gates_nothing_is_reconstructed() -> None:
    off = replace(readings(), v_ab=np.zeros((400, 2)), bridge_on=False)
    assert_close(corrected(EFFECT, off, gain_a_minus_b=0.03, common_offset_a=0.1).i_ab, off.i_ab, 1e-15)
    assert not EFFECT.shows_in(off)


def test_three_readings_with_a_sum_of_their_own_show_that_none_is_reconstructed() -> None:
    signals = through_all_sectors()
    phases = 1.5 * signals.i_ab @ CLARKE
    assert EFFECT.shows_in(signals)
    assert EFFECT.shows_in(replace(signals, i_abc=phases, clarke_of_three=False))
    apart = phases + np.random.default_rng(1).normal(0.0, 0.02, phases.shape)
    assert not EFFECT.shows_in(replace(signals, i_abc=apart, clarke_of_three=False))
    assert not EFFECT.shows_in(replace(signals, i_abc=apart, clarke_of_three=True))
    # Raw readings beside a vector that is none of theirs: the drive may have put one together.
    assert EFFECT.shows_in(replace(signals, i_abc=apart, clarke_of_three=None))

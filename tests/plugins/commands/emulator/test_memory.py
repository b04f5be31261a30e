"""Ripple rows made piece by piece are those of the whole capture at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plugins.commands.emulator._memory import CHANNELS, Capture, RippleMemory
from plugins.drives.simulated.rig import Step, Stretch
from plugins.wire import RIPPLE_FLAG, CaptureFormat, Channel, ReadBlock, RippleGrid, RowFormat, Scales, demodulate
from plugins.wire import serial_blocks as blocks
from tests.support.close import assert_close

SCALES = Scales.spanning(10.0, 200.0, 400.0, 5.0)


def pieces(samples: np.ndarray[Any, Any], cuts: list[int]) -> list[np.ndarray[Any, Any]]:
    return np.split(samples, sorted({c for c in cuts if 0 < c < len(samples)}))


@given(
    frequency=st.sampled_from([500.0, 333.0, 312.5, 997.3]),
    periods=st.integers(1, 4),
    discarded=st.integers(0, 50),
    cuts=st.lists(st.integers(1, 1999), max_size=12),
    seed=st.integers(0, 2**32 - 1),
)
def test_pieces_make_the_same_rows(frequency: float, periods: int, discarded: int, cuts: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    i, v = rng.normal(size=(2000, 2)).astype(np.float32), 50 * rng.normal(size=(2000, 2)).astype(np.float32)
    grid = RippleGrid(10_000.0, frequency, "square", periods, discarded, 1.5)
    memory = RippleMemory(1, grid, 2000, 0.3, SCALES)
    memory.base_v = (3.0, -4.0)
    live = 0
    parts = list(zip(pieces(i, cuts), pieces(v, cuts), strict=True))
    for k, (i_part, v_part) in enumerate(parts):
        live += len(memory.take(i_part, v_part, k == len(parts) - 1))
    turn = np.exp(-0.3j)
    i_dq, v_dq = (((x[:, 0].astype(float) + 1j * x[:, 1]) * turn) for x in (i, v))
    whole = demodulate(
        np.column_stack((i_dq.real, i_dq.imag)), np.column_stack((v_dq.real, v_dq.imag)), memory.base_v, grid
    ).counts(SCALES)
    assert live == 2 * len(whole)
    answer = memory.source.answer(ReadBlock(0, 0, 4000, 1 + RIPPLE_FLAG), blocks(60))
    assert not isinstance(answer, int)
    data = b"".join(payload[4:] for payload in answer.payloads)[: 12 * len(whole)]
    assert data == whole.tobytes()


def test_the_third_phase_closes_the_star() -> None:
    form = RowFormat(CHANNELS, CaptureFormat.F32, SCALES)
    capture = Capture(1, 4, form, None)
    i = np.array([[1.0, 0.5], [0.0, 1.0], [-1.0, 0.2], [0.3, 0.3]], dtype=np.float32)
    stretch = Stretch(piece=None, captured=True)  # type: ignore[arg-type]
    capture.take(Step(stretch, i, 2 * i, np.full(4, 300.0, np.float32)))
    source = capture.source(1)
    assert source is not None
    answer = source.answer(ReadBlock(0, 0, 10, 1), blocks(60))
    data = b"".join(payload[4:] for payload in answer.payloads)[: 4 * form.row_bytes]  # type: ignore[union-attr]
    columns = form.unpack(data)
    total = columns[Channel.I_A] + columns[Channel.I_B] + columns[Channel.I_C]
    assert_close(total, np.zeros(len(total)), 2.0**-22, of=i)
    beta = (columns[Channel.I_A] + 2 * columns[Channel.I_B]) / np.sqrt(3.0)
    assert_close(beta, columns[Channel.I_BETA], 2.0**-22)
    assert capture.source(2) is None

"""What is left in a shared room is what is found there, in this process and in one that was forked."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from orchestrator.diagnosis.fitting.shared_room import SharedRoom

numbers = st.floats(allow_nan=False) | st.integers(-(2**63), 2**63) | st.booleans() | st.none() | st.text(max_size=5)
matrices = arrays(np.float64, array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5))
in_any_order = matrices.flatmap(lambda a: st.sampled_from([a, np.asfortranarray(a), a[::2], a.T]))
contents = st.recursive(
    numbers | in_any_order,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc", max_size=3), inner, max_size=4),
    max_leaves=12,
)


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and bool(one == other)


@given(contents)
def test_what_is_left_is_found(content: Any) -> None:
    room = SharedRoom(1 << 16)
    assert same(room.opened(room.packed(content)), content)
    room.close()


@pytest.mark.parametrize("array", [np.zeros((4, 3)), np.zeros((4, 3), order="F"), np.zeros((4, 3))[:, ::2]])
def test_an_array_found_lies_in_memory_as_it_did_and_is_nobody_elses(array: np.ndarray[Any, Any]) -> None:
    room = SharedRoom(1 << 12)
    found = room.opened(room.packed(array))
    assert found.flags.writeable
    assert found.flags.f_contiguous == array.flags.f_contiguous
    room.packed(np.ones((4, 3)))
    assert not found.any()
    room.close()


def test_another_process_finds_it_too() -> None:
    room, sent = SharedRoom(1 << 12), np.arange(5.0)
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.write(writing, room.packed({"twice": 2.0 * sent}))
        os._exit(0)
    os.waitpid(pid, 0)
    np.testing.assert_array_equal(room.opened(os.read(reading, 1 << 12))["twice"], 2.0 * sent)
    os.close(reading)
    os.close(writing)
    room.close()


def test_what_does_not_fit_is_refused() -> None:
    room = SharedRoom(1 << 12)
    with pytest.raises(MemoryError, match="4096"):
        room.packed(np.zeros(513))
    assert same(room.opened(room.packed(np.zeros(512))), np.zeros(512))
    room.close()


def test_nothing_but_numbers_words_and_arrays_is_taken() -> None:
    room = SharedRoom(1 << 12)
    with pytest.raises(TypeError, match="set"):
        room.packed({"x": {1, 2}})
    room.close()

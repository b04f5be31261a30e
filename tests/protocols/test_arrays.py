"""Arrays in contracts: held by reference, checked for dtype and shape, never turned into lists."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from protocols import Capture, RealArray


def capture_fields(n: int = 4, dtype: Any = np.float32) -> dict[str, Any]:
    return {
        "start_s": 0.0,
        "sampling_frequency_hz": 1e4,
        "i_ab": np.zeros((n, 2), dtype),
        "v_ab": np.zeros((n, 2), dtype),
        "v_dc": np.zeros(n, dtype),
    }


def message_of(fields: dict[str, Any]) -> str:
    with pytest.raises(ValidationError) as caught:
        Capture(**fields)
    return str(caught.value)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_array_is_held_by_reference(dtype: Any) -> None:
    fields = capture_fields(dtype=dtype)
    capture = Capture(**fields)
    assert capture.i_ab is fields["i_ab"]
    fields["i_ab"][2, 1] = 7.0
    assert capture.i_ab[2, 1] == 7.0


def test_a_view_stays_a_view() -> None:
    whole = np.zeros((10, 2))
    capture = Capture(**{**capture_fields(dtype=np.float64), "i_ab": whole[3:7]})
    assert capture.i_ab.base is whole


@pytest.mark.parametrize("wrong", [np.int32, np.float16, np.complex128, np.bool_])
def test_another_dtype_is_refused_by_name(wrong: Any) -> None:
    message = message_of({**capture_fields(), "i_ab": np.zeros((4, 2), wrong)})
    assert "expected float32 or float64" in message
    assert np.dtype(wrong).name in message


@pytest.mark.parametrize("shape", [(4,), (4, 3), (2, 4), (4, 2, 1), ()])
def test_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    assert "expected shape (n, 2)" in message_of({**capture_fields(), "v_ab": np.zeros(shape, np.float32)})


def test_arrays_of_one_capture_agree_in_length() -> None:
    message = message_of({**capture_fields(4), "v_dc": np.zeros(5, np.float32)})
    assert "v_dc has length 5" in message
    assert "has 4" in message


def test_a_list_of_floats_is_no_array() -> None:
    assert "expected a numpy array, got list" in message_of({**capture_fields(), "v_dc": [0.0] * 4})


def test_json_describes_an_array_instead_of_listing_it() -> None:
    dumped = json.loads(Capture(**capture_fields(1000)).model_dump_json())
    assert dumped["i_ab"] == {"dtype": "float32", "shape": [1000, 2]}


def test_a_capture_cannot_be_changed() -> None:
    capture = Capture(**capture_fields())
    other: RealArray = np.zeros((4, 2))
    with pytest.raises(ValidationError, match="frozen"):
        capture.i_ab = other  # type: ignore[misc]


def test_json_schema_of_a_model_with_arrays_can_be_printed() -> None:
    schema = Capture.model_json_schema()
    assert "(n, 2)" in schema["properties"]["i_ab"]["description"]

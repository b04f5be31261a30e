"""One thread for the linear algebra while something is computed, and as before afterwards."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

from orchestrator.interface.api import one_thread


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def _two_before() -> object:
    scipy.linalg.inv(np.eye(2))
    with threadpool_limits(2, user_api="blas"):
        yield


def test_it_is_one_inside_and_as_before_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    before = threads()
    with one_thread():
        assert threads() == {1}
    assert threads() == before


def test_who_has_set_a_number_keeps_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    before = threads()
    with one_thread():
        assert threads() == before

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis._block_means import block_means
from tests.support.close import assert_close

STEP_S, BLOCK = 1e-4, 7


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("delay", [0.0, 1.0, 1.5])
def test_means_are_those_of_current_and_running_integrals(delay: float, dtype: type[np.floating]) -> None:
    random = np.random.default_rng(1)
    i, v = random.normal(size=(2, 60, 2)).astype(dtype).astype(np.float64)
    whole, part = int(delay), delay % 1.0
    rows = np.arange(60) - whole
    acting = (1.0 - part) * v[np.maximum(rows, 0)] + part * v[np.maximum(rows - 1, 0)]
    charge = STEP_S * (np.cumsum(i, axis=0) - 0.5 * i)
    impulse = STEP_S * (np.cumsum(acting, axis=0) - acting)
    found = block_means(i.astype(dtype), v.astype(dtype), sampling_s=STEP_S, delay=delay, block=BLOCK)
    for one, running in zip(found, (i, charge, impulse), strict=True):
        expected = running[:56].reshape(8, BLOCK, 2).mean(axis=1)
        assert_close(one, expected, 1e-12)

"""fluxbench's own answers: a map between its nodes, and across what it does not hold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np

from orchestrator.benchmark.answering import flux_at, stated
from protocols import DiagnosisReport, FluxMap


def saturated(i_d: np.ndarray, i_q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """psi of the co-energy log cosh(i_d / 3) + log cosh(i_q / 2)."""
    return np.tanh(i_d / 3.0) / 3.0, np.tanh(i_q / 2.0) / 2.0


def test_flux_between_nodes_is_smooth_and_holes_are_not_known() -> None:
    axis = np.linspace(-2.0, 2.0, 13)
    i_d, i_q = np.meshgrid(axis, axis, indexing="ij")
    psi_d, psi_q = saturated(i_d, i_q)
    hole = (i_d > 1.5) & (i_q > 1.5)
    zero = np.zeros_like(psi_d)
    grids = {
        "psi_d": psi_d + 0.3, "psi_q": psi_q, "l_dd": 1 / 9 / np.cosh(i_d / 3) ** 2, "l_dq": zero,
        "l_qq": 1 / 4 / np.cosh(i_q / 2) ** 2,
    }  # fmt: skip
    grids = {name: np.where(hole, np.nan, grid) for name, grid in grids.items()}
    stds = {f"{name}_std": np.where(hole, np.nan, zero + 1e-4) for name in grids}
    found = FluxMap(method="test", i_d=axis, i_q=axis, **grids, **stds)
    points = [(-1.9, 0.1), (0.5, -1.3), (1.1, 1.2), (1.9, 1.9)]
    flux, std = flux_at(found, points)
    assert flux[3] is None
    assert std[3] is None
    for point, known in zip(points[:3], flux[:3], strict=True):
        assert known is not None
        expected = [float(axis[0]) for axis in saturated(np.array([point[0]]), np.array([point[1]]))]
        assert np.allclose(known, expected, atol=3e-5), point


def test_a_cause_that_is_none_of_the_set_s_names_is_unknown() -> None:
    causes = [SimpleNamespace(name=name, parameters={}) for name in ("dead_time", "newer_than_the_set")]
    for effects, verdict in ((causes[:1], "explained"), (causes, "unknown")):
        report = cast(DiagnosisReport, SimpleNamespace(verdict="explained", effects=effects))
        answer = stated(report, None, {"id": "r001"}, 1.0)
        assert answer.verdict == verdict
        assert [one.name for one in answer.names] == ["dead_time"]

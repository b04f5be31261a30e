"""Incremental saliency over a flux map."""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.saliency import Saliency, principal
from protocols import FluxMap

__all__ = ["Saliency", "saliency"]


def saliency(flux_map: FluxMap) -> Saliency:
    """Saliency on a map's grid, shape (d, q); NaN where not measured."""
    return principal(*(np.asarray(table, dtype=np.float64) for table in (flux_map.l_dd, flux_map.l_dq, flux_map.l_qq)))

"""Sequentially thresholded least squares (doi:10.1073/pnas.1517384113), the threshold by the Bayesian criterion.

With pySINDy installed its own optimiser (`STLSQ`) does the thresholding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from regression import Problem, answer_of, main

try:
    from pysindy.optimizers import STLSQ
except ImportError:
    STLSQ = None

THRESHOLDS = np.geomspace(1e-3, 1.0, 19)
"""In units of an effect's typical size."""


def search(problem: Problem, entry: dict[str, Any]) -> dict[str, Any]:
    """Keep the set of columns of the least chi2 + k log n."""
    allowed = problem.allowed(entry)
    y, columns = problem.projected()
    return answer_of(problem, allowed[best_set(columns[:, allowed], y, offered)], entry)


def offered(x: Any, y: Any) -> list[Any]:
    """The sets that the thresholds leave."""
    return [_with_pysindy(x, y, least) if STLSQ else _thresholded(x, y, least) for least in THRESHOLDS]


def best_set(x: Any, y: Any, offers: Callable[[Any, Any], list[Any]]) -> Any:
    """Of the sets on offer and the empty one, that of the least Bayesian information criterion."""
    rest = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
    noise = max(float(rest @ rest) / len(y), 1.0)

    def criterion(kept: Any) -> float:
        left = y - x[:, kept] @ np.linalg.lstsq(x[:, kept], y, rcond=1e-9)[0] if len(kept) else y
        return float(left @ left) / noise + len(kept) * np.log(len(y))

    return min([np.zeros(0, dtype=int), *offers(x, y)], key=criterion)


def _thresholded(x: Any, y: Any, least: float) -> Any:
    kept = np.arange(x.shape[1])
    while len(kept):
        large = np.abs(np.linalg.lstsq(x[:, kept], y, rcond=1e-9)[0]) >= least
        if large.all():
            break
        kept = kept[large]
    return kept


def _with_pysindy(x: Any, y: Any, least: float) -> Any:
    found = STLSQ(threshold=least, alpha=1e-6, max_iter=50).fit(x, y).coef_
    return np.flatnonzero(np.ravel(found))


if __name__ == "__main__":
    main(search, __doc__)

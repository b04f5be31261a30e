"""Bare least squares: every effect at once; those beyond three standard deviations are named."""

from __future__ import annotations

from typing import Any

import numpy as np
from regression import Problem, answer_of, main

SIGMAS = 3.0


def search(problem: Problem, entry: dict[str, Any]) -> dict[str, Any]:
    """Fit all, keep the significant ones, fit again."""
    allowed = problem.allowed(entry)
    fit = problem.fit(allowed)
    start = len(fit.solved) - len(allowed)
    std = np.sqrt(np.diag(fit.covariance))[start:]
    return answer_of(problem, allowed[np.abs(fit.solved[start:]) > SIGMAS * std], entry)


if __name__ == "__main__":
    main(search, __doc__)

"""The LASSO's path (doi:10.1111/j.2517-6161.1996.tb02080.x) by coordinate descent, then least squares of the kept."""

from __future__ import annotations

from typing import Any

import numpy as np
from regression import Problem, answer_of, main
from thresholded import best_set


def search(problem: Problem, entry: dict[str, Any]) -> dict[str, Any]:
    """Keep the set of the path of the least chi2 + k log n."""
    allowed = problem.allowed(entry)
    y, columns = problem.projected()
    return answer_of(problem, allowed[best_set(columns[:, allowed], y, path)], entry)


def path(x: Any, y: Any) -> list[Any]:
    """The sets along the penalty, columns of unit length."""
    length = np.sqrt(np.sum(x**2, axis=0)) + 1e-300
    gram, pull = (x / length).T @ (x / length), (x / length).T @ y
    b, sets = np.zeros(len(pull)), []
    for penalty in np.geomspace(1.0, 1e-5, 40) * np.abs(pull).max():
        for _ in range(300):
            before = b.copy()
            for k in range(len(b)):
                along = pull[k] - gram[k] @ b + b[k]
                b[k] = np.sign(along) * max(abs(along) - penalty, 0.0)
            if np.abs(b - before).max() <= 1e-6 * max(float(np.abs(b).max()), 1e-12):
                break
        sets.append(np.flatnonzero(b))
    return sets


if __name__ == "__main__":
    main(search, __doc__)

"""Cases of one test, of which few belong to the fast suite."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from _pytest.mark import ParameterSet


def few(names: str, cases: Iterable[object], fast: int = 1, **options: object) -> pytest.MarkDecorator:
    """`pytest.mark.parametrize` with `fast` cases, spread over all of them; the others are slow.

    Parameters
    ----------
    names : str
        The arguments, separated by commas.
    cases
        A value each, or a tuple where there are several arguments.
    fast : int
        One is the first, two are the first and the last.
    """
    listed = [case if isinstance(case, ParameterSet) else _one(case, "," in names) for case in cases]
    kept = {round(k * (len(listed) - 1) / max(fast - 1, 1)) for k in range(fast)}
    marked = [
        case if k in kept else pytest.param(*case.values, marks=[*case.marks, pytest.mark.slow], id=case.id)
        for k, case in enumerate(listed)
    ]
    return pytest.mark.parametrize(names, marked, **options)  # type: ignore[arg-type]


def _one(case: object, several: bool) -> ParameterSet:
    return pytest.param(*case) if several and isinstance(case, tuple | list) else pytest.param(case)

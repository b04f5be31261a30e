"""In which order the estimators of a pass run: each after those whose products it requires."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter

from protocols import Estimator, PluginError


def in_order(estimators: Sequence[Estimator]) -> list[Estimator]:
    """Sort by requirements; what does not depend on each other keeps its order.

    Raises
    ------
    PluginError
        Where estimators require each other in a circle.
    """
    sorter = TopologicalSorter({k: _makers(k, estimators) for k in range(len(estimators))})
    try:
        return [estimators[k] for k in sorter.static_order()]
    except CycleError as error:
        names = " -> ".join(estimators[k].name for k in error.args[1])
        raise PluginError("estimators", "requires", f"a circle: {names}") from None


def _makers(number: int, estimators: Sequence[Estimator]) -> list[int]:
    """Those that make what one of them requires; what it makes itself is not waited for."""
    required = estimators[number].requires
    return [k for k, other in enumerate(estimators) if k != number and issubclass(other.produces, required)]

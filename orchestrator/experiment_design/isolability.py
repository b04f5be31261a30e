"""Isolability of a plan before it is measured: sizes from which effects are detected, and separated from each other.

With M of an effect's amplitudes with R_s and the map as nuisances (`information`), an effect of s times its typical
size x is detected where its log evidence, 1/2 s^2 x'M(M + 1)^-1 M x - 1/2 log det(1 + M), reaches the diagnosis'
threshold. It is separated from another effect where that one, in any shape, leaves enough chi2 unexplained:

    s^2 x'M_a|b x  >=  five sigma

Of two effects the larger size decides: the matrix is symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.selection.removing import MIN_EFFECT_SIZE
from orchestrator.experiment_design.information import Information
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Isolability:
    """Sizes, as parts of an effect's typical size; infinite where no size suffices.

    Attributes
    ----------
    names : tuple of str
    detection : dict of str to float
        Size from which an effect is detected where it is alone.
    among_all : dict of str to float
        Size from which it is detected where every other effect may be present as well.
    separation : dict of (str, str) to float
        Size from which two effects are separated, the pair in the order of `names`.
    """

    names: tuple[str, ...]
    detection: dict[str, float]
    among_all: dict[str, float]
    separation: dict[tuple[str, str], float]

    def beyond(self, size: float) -> list[tuple[str, ...]]:
        """Effects (a,) that are not detected at a size, and pairs (a, b) of detected ones that are not separated."""
        undetected = [name for name in self.names if self.detection[name] > size]
        pairs = (p for p, s in self.separation.items() if s > size and not set(p) & set(undetected))
        return [*((name,) for name in undetected), *pairs]


def isolability(known: Information, normal: Array, criteria: Criteria) -> Isolability:
    """Isolability by the pieces that `normal` is the sum of.

    Parameters
    ----------
    normal : array, shape (n, n)
        Normal matrix without the prior.
    """
    names = tuple(known.effects)
    detection = {name: detection_size(known, normal, name, (), criteria) for name in names}
    one_way = {(a, b): separation_size(known, normal, a, b, criteria) for a in names for b in names if a != b}
    among = {}
    for name in names:
        others = [other for other in names if other != name]
        with_all = detection_size(known, normal, name, others, criteria)
        among[name] = max(with_all, *(one_way[name, other] for other in others)) if others else with_all
    separation = {(a, b): max(one_way[a, b], one_way[b, a]) for a, b in combinations(names, 2)}
    return Isolability(names, detection, among, separation)


def required_size(known: Information, normal: Array, question: Sequence[str], criteria: Criteria) -> float:
    """Size from which an effect (a,) is detected, or a pair (a, b) separated."""
    if len(question) == 1:
        return detection_size(known, normal, question[0], (), criteria)
    a, b = question
    return max(separation_size(known, normal, a, b, criteria), separation_size(known, normal, b, a, criteria))


def detection_size(known: Information, normal: Array, name: str, others: Sequence[str], criteria: Criteria) -> float:
    """Size from which an effect reaches the log evidence, with other effects of typical size as nuisances."""
    m = known.marginal(normal, name, *(known.effects[other].in_typical_shape for other in others))
    x, limits = known.effects[name].typical, criteria.selection
    gain = float(x @ m @ np.linalg.solve(m + np.eye(len(x)), m @ x))
    threshold = 2.0 * limits.log_evidence + float(np.linalg.slogdet(m + np.eye(len(x)))[1])
    return max(MIN_EFFECT_SIZE, _size(threshold, gain))


def separation_size(known: Information, normal: Array, name: str, other: str, criteria: Criteria) -> float:
    """Size from which an effect is separated from another one that imitates it, in the shape that does so best."""
    x, m = known.effects[name].typical, known.marginal(normal, name, known.effects[other].all)
    return max(MIN_EFFECT_SIZE, _size(criteria.design.least_separation, float(x @ m @ x)))


def _size(threshold: float, gain: float) -> float:
    """Size s with gain s^2 = threshold; infinite where there is none."""
    return math.sqrt(threshold / gain) if gain > 1e-6 * threshold else math.inf

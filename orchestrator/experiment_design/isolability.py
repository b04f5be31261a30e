"""What a plan will tell, before it is measured: sizes from which effects are found, and told from each other.

With M of an effect's amplitudes when R_s and the map follow (`information`), an effect s times as large as is typical,
x, is found where its log evidence, 1/2 s^2 x'M(M + 1)^-1 M x - 1/2 log det(1 + M), reaches what a diagnosis asks for,
and told from another where that one, in whatever shape, leaves chi2 of it:

    s^2 x'M_a|b x  >=  five sigma

Of two effects the one that is worse told decides: the matrix is symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.selection.forward_search import LEAST_EFFECT_SIZE
from orchestrator.experiment_design.information import Information
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Isolability:
    """Sizes, as parts of what is typical of an effect; infinite where no size will do.

    Attributes
    ----------
    names : tuple of str
    found : dict of str to float
        From which an effect is found where it is alone, ...
    among_all : dict of str to float
        ... and where every other effect may be there as well.
    parted : dict of (str, str) to float
        From which two effects are told apart, the pair in the order of `names`.
    """

    names: tuple[str, ...]
    found: dict[str, float]
    among_all: dict[str, float]
    parted: dict[tuple[str, str], float]

    def beyond(self, size: float) -> list[tuple[str, ...]]:
        """Effects (a,) that are not found at a size, and pairs (a, b) of found ones that are not told apart."""
        lost = [name for name in self.names if self.found[name] > size]
        seen = (p for p, s in self.parted.items() if s > size and not set(p) & set(lost))
        return [*((name,) for name in lost), *seen]


def isolability(known: Information, normal: Array, criteria: Criteria) -> Isolability:
    """Of all that `normal` was summed over.

    Parameters
    ----------
    normal : array, shape (n, n)
        Without the prior.
    """
    names = tuple(known.effects)
    found = {name: found_from(known, normal, name, (), criteria) for name in names}
    told = {(a, b): told_from(known, normal, a, b, criteria) for a in names for b in names if a != b}
    among = {}
    for name in names:
        others = [other for other in names if other != name]
        all_there = found_from(known, normal, name, others, criteria)
        among[name] = max(all_there, *(told[name, other] for other in others)) if others else all_there
    return Isolability(names, found, among, {(a, b): max(told[a, b], told[b, a]) for a, b in combinations(names, 2)})


def answer(known: Information, normal: Array, question: Sequence[str], criteria: Criteria) -> float:
    """Size from which an effect (a,) is found, or a pair (a, b) told apart."""
    if len(question) == 1:
        return found_from(known, normal, question[0], (), criteria)
    a, b = question
    return max(told_from(known, normal, a, b, criteria), told_from(known, normal, b, a, criteria))


def found_from(known: Information, normal: Array, name: str, others: Sequence[str], criteria: Criteria) -> float:
    """Size from which an effect is worth its log evidence, other effects following as large as is typical of them."""
    left = known.left(normal, name, *(known.effects[other].in_typical_shape for other in others))
    x, limits = known.effects[name].typical, criteria.selection
    gain = float(x @ left @ np.linalg.solve(left + np.eye(len(x)), left @ x))
    asked = 2.0 * limits.log_evidence + float(np.linalg.slogdet(left + np.eye(len(x)))[1])
    return max(LEAST_EFFECT_SIZE, _size(asked, gain))


def told_from(known: Information, normal: Array, name: str, other: str, criteria: Criteria) -> float:
    """Size from which an effect is told from another one that stands in for it, in whatever shape does it best."""
    x, left = known.effects[name].typical, known.left(normal, name, known.effects[other].all)
    return max(LEAST_EFFECT_SIZE, _size(criteria.design.least_separation, float(x @ left @ x)))


def _size(asked: float, of_typical: float) -> float:
    """Where a square law that is `of_typical` at one reaches what is asked."""
    return math.sqrt(asked / of_typical) if of_typical > 1e-6 * asked else math.inf

"""Effects that resemble each other in a recording: how much of one's signal the other imitates.

With x the standardised amplitudes of an effect and M the normal matrix of their columns, the columns of R_s, the map
and all other parameters eliminated, its signal has chi2 = x'Mx. An effect resembles it where that falls to a small part
once its columns are eliminated too. Unlike `contrasts`, this needs no declaration and holds for anybody's effects.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.numerics.types import Array

MIN_IMITATED_SHARE: float = 0.8
"""Part of an effect's signal that another one imitates, from which they resemble each other."""


def imitated_shares(fitter: Fitter, fit: Fit, name: str, candidates: Sequence[CandidateEffect]) -> dict[str, float]:
    """The part of an effect's signal that each other effect imitates, the largest first.

    Parameters
    ----------
    name : str
        An effect of the fit's model.
    candidates : sequence of CandidateEffect
        Compared with it, besides the other effects of the model.
    """
    columns = [*fit.model.free, *absent_columns([c for c in candidates if c.name not in fit.model.names])]
    normal, _ = fitter.evaluate(fit.model, fit.linearisation, columns[len(fit.model.free) :], known=fit).projected()
    of = [active.name for active, _ in columns]
    own = [k for k, (active, n) in enumerate(columns) if of[k] == name and n in active.candidate.amplitudes]
    x = np.array([columns[k][0].standardised_value(columns[k][1]) for k in own])
    shares = {}
    for other in dict.fromkeys(of):
        beside = [k for k in range(len(fit.model.free)) if of[k] not in (name, other)]
        alone = _signal(normal, own, beside, x)
        if other != name and alone > 0.0:
            imitating = [k for k, effect in enumerate(of) if effect == other]
            shares[other] = 1.0 - _signal(normal, own, [*beside, *imitating], x) / alone
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def resembling(fitter: Fitter, fit: Fit, name: str, candidates: Sequence[CandidateEffect]) -> list[str]:
    """The effects of the model and candidates that resemble an effect of the model, the most similar first."""
    shares = imitated_shares(fitter, fit, name, candidates)
    return [other for other, share in shares.items() if share > MIN_IMITATED_SHARE]


def _signal(normal: Array, own: Sequence[int], others: Sequence[int], x: Array) -> float:
    """chi2 of an effect's signal that the other columns, under their unit priors, do not imitate."""
    block = normal[np.ix_(own, own)]
    if others:
        across = normal[np.ix_(others, own)]
        inner = normal[np.ix_(others, others)] + np.eye(len(others))
        block = block - across.T @ np.linalg.solve(inner, across)
    return float(x @ block @ x)

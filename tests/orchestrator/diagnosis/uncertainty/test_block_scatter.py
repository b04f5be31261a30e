"""Whether an effect is the same all through: blocks of the recording say it of its amplitude."""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.uncertainty.block_scatter import BLOCKS, block_scatter, block_scatter_ratio, certainty
from orchestrator.diagnosis.uncertainty.intervals import standardised_std
from plugins.effects.inverter import VoltageBias
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import CRITERIA, fitter, free_model, plan, prepared, with_voltage

DOUBT = CRITERIA.uncertainty


def test_an_effect_that_is_the_same_all_through_does_not_scatter_and_one_that_grows_does() -> None:
    made = prepared(plan())
    steady = with_voltage(made, np.array([0.2, 0.0]))
    last = made.pieces[-1].segment.start_s
    growing = {p.segment.id: np.array([0.4 * p.segment.start_s / last, 0.0]) for p in made.pieces}
    sizes = []
    for recording in (steady, with_voltage(made, growing)):
        maker = fitter(recording)
        fit = maker.fit(with_free(free_model(), maker, VoltageBias()))
        sizes.append(block_scatter_ratio(fit)["voltage_bias"])
        spread = standardised_std(maker, fit)
        assert (spread >= np.sqrt(np.diag(fit.covariance()))).all()
        assert certainty(fit)["voltage_bias"] > BLOCKS
    assert sizes[0] < 0.05
    assert sizes[1] > 0.2


def test_what_the_blocks_want_of_noise_alone_is_nothing() -> None:
    beyond = []
    for seed in range(4):
        maker = fitter(with_voltage(prepared(plan(), seed=seed), np.array([0.2, 0.0])))
        fit = maker.fit(with_free(free_model(), maker, VoltageBias()))
        beyond.append(scatter_beyond_noise(fit))
    assert float(np.mean(beyond)) < 2.0


def scatter_beyond_noise(fit: Fit) -> float:
    """Scatter between blocks over what noise makes of a block's own estimate."""
    return float(np.max(block_scatter(fit) / np.sqrt(BLOCKS * np.diag(fit.covariance()))))

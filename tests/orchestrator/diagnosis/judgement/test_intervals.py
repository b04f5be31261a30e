"""How far off a fitted size may be: as far as noise, disagreement, and the effect's own form allow."""

from __future__ import annotations

import dataclasses
import shutil
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import fit_baseline
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import (
    BLOCKS,
    RIPPLE_FORM_STD,
    SIZE_STD,
    block_scatter,
    block_scatter_ratio,
    certainty,
    form_std,
    is_none_significant,
    possibly_absent,
    projected_rows,
    ripple_share,
    standardised_std,
)
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.recording import Recording, open_recording, write_manifest
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import EddyCurrents
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset
from plugins.effects.timing import VoltageDelay
from protocols import Effect, ParameterRole
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import CRITERIA, fitter, free_model, plan, prepared, with_voltage

LATE_SAMPLES = 0.1

DOUBT = Criteria().uncertainty


def fitted(recording: Recording, effect: Effect) -> tuple[Fitter, Fit]:
    setup = open_for_diagnosis(recording)
    (candidate,) = scaled_library([effect], setup.prepared.manifest)
    return setup.fitter, with_effect(setup, fit_baseline(setup), candidate)


@pytest.fixture(scope="module")
def delayed(clean: Recording, tmp_path_factory: pytest.TempPathFactory) -> tuple[Fitter, Fit]:
    """A recording that says of its voltage that it acts later than it does, with the delay that takes that back."""
    directory = tmp_path_factory.mktemp("late") / "recording"
    shutil.copytree(clean.path, directory)
    drive = clean.manifest.drive.model_copy(update={"voltage_delay_samples": LATE_SAMPLES})
    write_manifest(directory, clean.manifest.model_copy(update={"drive": drive}))
    return fitted(open_recording(directory), VoltageDelay())


def test_a_model_without_effects_has_none_that_might_be_absent(clean: Recording) -> None:
    setup = open_for_diagnosis(clean)
    assert possibly_absent(setup.fitter, fit_baseline(setup)) == []


def test_ripple_tells_of_delays_and_eddies_and_the_means_of_offsets_and_gains(clean: Recording) -> None:
    setup = open_for_diagnosis(clean)
    fit = fit_baseline(setup)
    library = scaled_library([VoltageDelay(), EddyCurrents(), CurrentOffset(), CurrentGainMismatch()], clean.manifest)
    columns = absent_columns(library)
    loose = setup.fitter.evaluate(fit.model, fit.linearisation, columns)
    share = ripple_share([(piece, rows) for piece, _, rows in projected_rows(loose)])
    by_name = {active.name: float(s) for (active, _), s in zip(columns, share, strict=True)}
    assert by_name["voltage_delay"] > 0.98
    assert by_name["eddy_currents"] > 0.9
    assert by_name["current_offset"] < 0.05
    assert by_name["current_gain_mismatch"] < 0.05


def test_what_the_columns_keep_is_what_the_map_cannot_follow(delayed: tuple[Fitter, Fit]) -> None:
    _, fit = delayed
    kept = sum(float(rows[:, 0] @ rows[:, 0]) for _, _, rows in projected_rows(fit))
    known = float(fit.projected()[0][0, 0])
    # The map's prior holds it back a little from projected_rows, which counts as knowledge too.
    assert 0.97 * known < kept <= known * (1.0 + 1e-9)


def test_what_only_the_ripple_shows_is_believed_to_a_few_percent(delayed: tuple[Fitter, Fit]) -> None:
    fitter, fit = delayed
    x = fit.model.active[0].standardised_value("delay_s")
    (spread,) = standardised_std(fitter, fit)
    assert float(np.sqrt(fit.covariance()[0, 0] * fit.chi2_per_dof)) < 0.5 * RIPPLE_FORM_STD * abs(x)
    assert 0.98 * RIPPLE_FORM_STD * abs(x) < spread < 2.0 * RIPPLE_FORM_STD * abs(x)


def test_a_forms_error_leaves_a_number_no_less_known_than_before(delayed: tuple[Fitter, Fit]) -> None:
    _, fit = delayed
    (term,) = fit.model.active
    (shape,) = VoltageDelay.Parameters.declared()
    narrow = dataclasses.replace(shape, role=ParameterRole.SHAPE, prior_width=1e-5)
    known = dataclasses.replace(term, candidate=dataclasses.replace(term.candidate, parameters=(narrow,)))
    model = fit.model.with_active([known])
    rows = [(piece, columns) for piece, _, columns in projected_rows(fit)]
    assert form_std(dataclasses.replace(fit, model=model), rows) == pytest.approx([1.0])


def test_what_is_there_is_surely_there_and_what_is_not_may_be_absent(delayed: tuple[Fitter, Fit]) -> None:
    fitter, fit = delayed
    (late,) = fit.model.active
    (offset,) = scaled_library([CurrentOffset()], fit.prepared.manifest)
    model = fit.model.with_active([late, offset.absent().moved("offset_a_a", 1e-6)])
    both = fitter.evaluate(model, fit.linearisation)
    assert possibly_absent(fitter, both) == ["current_offset"]
    assert not is_none_significant(fitter, both)


class OtherDelay(VoltageDelay):
    name = "other_delay"


def test_two_that_stand_in_for_each_other_may_each_be_absent_and_not_both(delayed: tuple[Fitter, Fit]) -> None:
    fitter, fit = delayed
    (late,) = fit.model.active
    (other,) = scaled_library([OtherDelay()], fit.prepared.manifest)
    for part, sure in ((0.5, True), (1e-6, False)):
        each = part * late.standardised_value("delay_s")
        twins = [one.absent().moved("delay_s", each) for one in (late.candidate, other)]
        both = fitter.evaluate(fit.model.with_active(twins), fit.linearisation)
        assert possibly_absent(fitter, both) == list(both.model.names)
        assert is_none_significant(fitter, both) != sure


@pytest.mark.slow
def test_a_size_that_currents_at_rest_show_is_known_as_its_curve_is(with_dead_time: Recording) -> None:
    fitter, fit = fitted(with_dead_time, DeadTime())
    active, name = fit.model.free[0]
    assert name == "voltage_v"
    spread = float(standardised_std(fitter, fit)[0])
    assert SIZE_STD * active.standardised_value(name) < spread < 1.2 * SIZE_STD * active.standardised_value(name)
    assert float(np.sqrt(fit.covariance()[0, 0])) < spread


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


def test_a_block_that_knows_nearly_nothing_hardly_counts() -> None:
    """The recording's end holds a segment without information on the effect, whose own estimate is arbitrary."""
    maker = fitter(with_voltage(prepared(plan()), np.array([0.2, 0.0])))
    fit = maker.fit(with_free(free_model(), maker, VoltageBias()))
    ignorant = (*fit.columns[:-1], 1e-5 * fit.columns[-1])
    blind = replace(fit, linearisation=fit.linearisation, columns=ignorant)
    assert block_scatter(blind).max() < 2.0 * block_scatter(fit).max() + 0.01


def scatter_beyond_noise(fit: Fit) -> float:
    """Scatter between blocks over what noise makes of a block's own estimate."""
    return float(np.max(block_scatter(fit) / np.sqrt(BLOCKS * np.diag(fit.covariance()))))

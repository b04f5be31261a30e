"""The readings' zero that wanders: as much as it was made to, and none where an effect or the map can take it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import FEW_COLUMNS
from orchestrator.diagnosis.nuisances.segment_scatter import scatter_of
from orchestrator.diagnosis.weak_form.preparation import coarse
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.numerics.frames import from_two_phases
from plugins.effects.inverter import VoltageBias
from plugins.effects.resistance import SkinEffect
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset
from plugins.effects.timing import VoltageDelay
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import Array, Plan, fitter, free_model, hold, plan, prepared, with_voltage
from tests.support.cases import few


@cache
def _campaign() -> PreparedRecording:
    """A campaign with holds enough to tell a standard deviation."""
    turn = 2.0 * np.pi * np.arange(40) / 40
    return prepared(plan() + [Plan(SegmentStage.RESISTANCE, hold(2.0 * np.cos(t), 2.0 * np.sin(t))) for t in turn])


def _shifted(made: PreparedRecording, phases: Array) -> PreparedRecording:
    """Every reading of a segment off by its own two numbers, `phases` (segments, 2)."""
    pieces = []
    for p, (a, b) in zip(made.pieces, phases, strict=True):
        i_ab = p.signals.i_ab + from_two_phases(a, b)
        pieces.append(replace(p, signals=replace(p.signals, i_ab=i_ab, i_m_ab=i_ab)))
    return replace(made, pieces=tuple(pieces))


def test_scatter_is_found_as_large_as_it_is() -> None:
    made, sigma_a = _campaign(), 0.003
    offsets = np.random.default_rng(3).normal(0.0, sigma_a, (len(made.pieces), 2))
    maker = fitter(_shifted(made, offsets))
    fit = maker.fit(free_model())
    found = scatter_of(maker, fit, [])
    # Some hundred offsets tell their standard deviation to a fourteenth; three of these.
    assert found.noise.offset_scatter_a == pytest.approx(float(offsets.std()), rel=0.2)
    assert fit.chi2_per_dof > 2.0
    assert found.chi2 == pytest.approx(1.0, abs=0.1)
    # With it as noise a fit has as much error as noise makes, and tells the same scatter again.
    wider = maker.with_noise(found.noise)
    again = wider.fit(free_model())
    assert again.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    assert scatter_of(wider, again, []).noise.offset_scatter_a == pytest.approx(found.noise.offset_scatter_a, rel=0.02)


def test_a_part_is_requested_around_a_fit_of_the_whole() -> None:
    """Whose columns have other rows: none of them is taken."""
    made = _campaign()
    whole, part = fitter(made), fitter(coarse(made))
    effects = scaled_library(
        [CurrentOffset(), VoltageBias(), CurrentGainMismatch(), VoltageDelay(), SkinEffect()], made.manifest
    )
    fit = whole.fit(free_model().with_active([one.absent() for one in effects]))
    assert len(fit.parameters) > FEW_COLUMNS
    assert sum(map(len, part.relinearise(fit.model).residual)) < sum(map(len, fit.residual))
    around, anew = scatter_of(part, fit, effects), scatter_of(part, part.relinearise(fit.model), effects)
    # R_s and the map, around which all is linear, are the whole's or the part's.
    assert around.chi2 == pytest.approx(anew.chi2, rel=1e-2)
    assert around.noise.scatters == anew.noise.scatters


def test_no_scatter_is_found_where_there_is_none() -> None:
    maker = fitter(_campaign())
    found = scatter_of(maker, maker.fit(free_model()), [])
    assert not found.noise.scatters


@pytest.mark.slow
def test_one_offset_of_all_segments_is_an_effect_and_no_scatter() -> None:
    made = _campaign()
    maker = fitter(_shifted(made, np.tile([0.02, -0.01], (len(made.pieces), 1))))
    library = scaled_library([CurrentOffset()], made.manifest)
    fit = maker.fit(free_model())
    with_effect, without = scatter_of(maker, fit, library), scatter_of(maker, fit, [])
    assert not with_effect.noise.scatters
    assert without.noise.scatters


def test_voltages_that_are_off_at_rest_are_reported_from_readings_that_are() -> None:
    made, rng = _campaign(), np.random.default_rng(4)
    steps = {p.segment.id: rng.normal(0.0, 0.02, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    maker = fitter(with_voltage(made, steps))
    found = scatter_of(maker, maker.fit(free_model()), [])
    # Two numbers of each of 48 holds tell their standard deviation to a fourteenth; three of these.
    assert found.noise.voltage_scatter_v == pytest.approx(0.02, rel=0.2)
    assert found.noise.offset_scatter_a == 0.0
    assert maker.with_noise(found.noise).fit(free_model()).chi2_per_dof == pytest.approx(1.0, abs=0.1)


@few("sizes_v, alike", [((0.02, 0.04), True), ((0.0, 0.04), False), ((0.05, 0.02), False)], fast=2)
def test_voltages_scatter_as_a_timers_steps_do_or_are_no_noise(sizes_v: tuple[float, float], alike: bool) -> None:
    made, rng = _campaign(), np.random.default_rng(5)
    pieces, steps = list(made.pieces), {}
    for k, p in enumerate(pieces):
        if p.stage is SegmentStage.RESISTANCE:
            twice = k % 4 == 0
            steps[p.segment.id] = rng.normal(0.0, 1.0, 2) * sizes_v[twice]
            pwm_hz = (1.0 + twice) * p.signals.pwm_frequency_hz
            pieces[k] = replace(p, signals=replace(p.signals, pwm_frequency_hz=pwm_hz))
    maker = fitter(with_voltage(replace(made, pieces=tuple(pieces)), steps))
    found = scatter_of(maker, maker.fit(free_model()), [])
    # At twice the frequency a timer's step is twice the voltage.
    assert (found.noise.voltage_scatter_v > 0.005) is alike

"""What the estimators of an energy share: the measurements that go in, and the map that comes out."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.surface import inside_hull
from plugins.estimators._energies import Measurements, energy_measurements, gridded
from plugins.estimators._maps import InjectedFlux, SweptFlux, pm_flux
from protocols import EstimationContext, NotMeasuredError, SegmentStage
from tests.orchestrator.analysis.campaign import MOTOR, MemoryRecording
from tests.orchestrator.analysis.plant import Array
from tests.plugins.estimators.recordings import classical_of, clean, injection_of

L_D, L_Q = 0.04, 0.07


class Linear:
    """Constant inductances, known to a per mille."""

    def flux(self, at: Array) -> tuple[Array, Array]:
        psi = at * np.array([L_D, L_Q])
        return psi, 1e-3 * np.abs(psi)

    def inductance(self, at: Array) -> tuple[Array, Array]:
        values = np.tile([L_D, 0.0, L_Q], (len(at), 1))
        return values, 1e-3 * values


def both() -> EstimationContext:
    return EstimationContext((injection_of(False), classical_of(False)))


def without_zero(recording: MemoryRecording) -> MemoryRecording:
    """Injection to one side only."""
    points = injection_of(False).points
    kept = {name for name, i_dq in zip(points.segment, points.i_dq, strict=True) if i_dq[1] > 0.5}
    return recording.with_segments(tuple(s for s in recording.segments(SegmentStage.INJECTION) if s.id in kept))


def test_what_other_estimators_found_is_taken_and_each_current_knows_its_segment() -> None:
    found = energy_measurements(clean(), both())
    injected, swept = injection_of(False), classical_of(False)
    assert isinstance(injected, InjectedFlux)
    assert isinstance(swept, SweptFlux)
    assert found.injected is injected
    assert found.swept is swept
    assert found.inductances is injected.inductances
    assert found.paths is swept.paths
    assert len(found.current) == len(found.segments) == len(injected.points.i_dq) + len(swept.points.i_dq)
    assert set(found.segments) <= {segment.id for segment in clean().segments()}
    assert found.angles.shape == (len(injected.points.segment),)


@pytest.mark.slow
def test_the_misfit_is_of_each_sweep_less_its_mean() -> None:
    found = energy_measurements(clean(), both())
    misfit = found.misfit(Linear())
    assert misfit is not None
    first = len(found.paths[0].current)
    assert misfit.shape == (sum(len(path.current) for path in found.paths), 2)
    assert np.abs(misfit[:first].mean(axis=0)).max() < 1e-12 * np.abs(misfit).max()
    # Its own energy is far nearer to the sweeps than constant inductances are.
    own = found.misfit(found.fit())
    assert own is not None
    assert own.std() < 0.1 * misfit.std()


def test_without_sweeps_there_is_no_misfit() -> None:
    nothing = np.zeros((0, 2))
    assert Measurements(None, None, nothing, (), np.zeros(0), None).misfit(Linear()) is None


def test_currents_that_do_not_surround_zero_are_refused() -> None:
    with pytest.raises(NotMeasuredError, match="zero current lies outside the measured points"):
        energy_measurements(without_zero(clean()), EstimationContext())


def test_where_nothing_was_measured_both_reasons_are_reported() -> None:
    with pytest.raises(NotMeasuredError, match=r"stage classical.*; .*stage injection"):
        energy_measurements(clean().only(SegmentStage.RESISTANCE), EstimationContext())


def test_the_map_has_the_energy_s_values_within_what_was_reached_and_nothing_beyond() -> None:
    reached = np.array([[-2.0, 0.0], [2.0, 0.0], [0.0, 2.0], [0.0, -2.0]])
    found = gridded("mine", clean(), Linear(), reached)
    d, q = np.meshgrid(found.i_d, found.i_q, indexing="ij")
    inside = inside_hull(reached, np.stack([d.ravel(), q.ravel()], axis=1), "here").reshape(d.shape)
    assert 0.2 < inside.mean() < 0.9
    for name, values in (("psi_d", pm_flux(clean())[0] + L_D * d), ("psi_q", L_Q * q), ("l_dd", L_D + 0.0 * d)):
        np.testing.assert_allclose(getattr(found, name)[inside], values[inside], rtol=1e-12)
        assert np.isnan(getattr(found, name)[~inside]).all()
    np.testing.assert_allclose(found.l_qq_std[inside], 1e-3 * L_Q)
    assert found.method == "mine"


def test_the_magnets_flux_is_the_nameplate_s() -> None:
    np.testing.assert_array_equal(pm_flux(clean()), [MOTOR.pm_flux_wb, 0.0])

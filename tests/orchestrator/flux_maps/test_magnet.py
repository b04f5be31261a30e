"""A locked rotor does not show its magnet: the nameplate adds it once."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.flux_maps import MapSurface, has_no_rest_flux, with_magnet
from protocols import Motor
from tests.orchestrator.tuning.machines import flux_map, saturated

MOTOR = Motor(name="motor", pole_pairs=2, pm_flux_wb=0.3)


def test_a_stated_magnet_is_added_to_a_map_that_lacks_it_and_to_no_other() -> None:
    lacking, whole = (flux_map(saturated(pm_flux_wb=magnet), 4.0) for magnet in (0.0, 0.3))
    assert has_no_rest_flux(MapSurface(lacking))
    assert not has_no_rest_flux(MapSurface(whole))
    assert with_magnet(lacking, MOTOR).psi_d == pytest.approx(np.asarray(whole.psi_d), abs=1e-12)
    assert with_magnet(whole, MOTOR) is whole
    assert with_magnet(lacking, MOTOR.model_copy(update={"pm_flux_wb": 0.0})) is lacking
    assert with_magnet(lacking, MOTOR.model_copy(update={"pm_flux_wb": None})) is lacking

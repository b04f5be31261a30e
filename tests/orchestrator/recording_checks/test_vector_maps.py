"""The maps of wrong conventions against the phases that they come from."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.recording_checks.vector_maps import DEAD, EXCHANGES, INVERTED, VectorMap
from tests.support.rewriting import CLARKE, TO_PHASES, exchanged, gain


@pytest.mark.parametrize("of", [*EXCHANGES, *INVERTED], ids=lambda m: m.what)
def test_a_map_undone_leaves_what_was_there(of: VectorMap) -> None:
    assert of.inverse is not None
    np.testing.assert_allclose(of.inverse.matrix @ of.matrix, np.eye(2), atol=1e-12)
    z = np.array([0.3 - 1.1j, 2.0 + 0.4j])
    np.testing.assert_allclose(of.inverse(of(z)), z, rtol=1e-12)


@pytest.mark.parametrize(("pair", "of"), [("ab", EXCHANGES[1]), ("ac", EXCHANGES[2]), ("bc", EXCHANGES[3])])
def test_exchanges_are_those_of_the_phases(pair: str, of: VectorMap) -> None:
    assert of.what.endswith(f"{pair[0]} and {pair[1]}")
    np.testing.assert_allclose(of.matrix, CLARKE @ exchanged(*pair) @ TO_PHASES, atol=1e-12)


@pytest.mark.parametrize(("maps", "factor"), [(INVERTED, -1.0), (DEAD, 0.0)])
def test_one_phase_of_three_sensors_is_among_the_maps(maps: tuple[VectorMap, ...], factor: float) -> None:
    for phase in "abc":
        wanted = CLARKE @ gain(phase, factor) @ TO_PHASES
        assert any(np.allclose(m.matrix, wanted, atol=1e-12) and m.what.endswith(phase) for m in maps)


def test_what_is_lost_cannot_be_undone() -> None:
    assert VectorMap("dead", 0.5, 0.5, "").inverse is None

"""A stranger's log becomes the map, and what was wrong with the bench is reported, whatever shape the log has."""

from __future__ import annotations

import pytest

from tests.orchestrator.importing.bring import FAULTS, SHAPES, Brought, Laboratory

STEPS = next(brought for brought in SHAPES if "d axis alone" in brought.words)
LOGGERS = next(brought for brought in SHAPES if "two loggers" in brought.words)
EXPECTED = {"lag": ("estimate: 1 sample later", "diagnose: 1 sample later"), "gain": ("current gain mismatch",)}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    return Laboratory(7, tmp_path_factory.mktemp("laboratory"))


def test_voltage_steps_in_files_of_their_own_become_the_map_whatever_is_wrong(laboratory: Laboratory) -> None:
    outcome = laboratory.outcome(STEPS, "lag", diagnosed=False)
    assert outcome.map_percent < 0.1
    assert any("1 sample later" in line for line in outcome.reported)


@pytest.mark.slow
@pytest.mark.parametrize("brought", SHAPES, ids=lambda brought: brought.words)
def test_every_shape_becomes_the_map(laboratory: Laboratory, brought: Brought) -> None:
    outcome = laboratory.outcome(brought, "nothing", diagnosed=False)
    assert outcome.lines <= 10
    assert outcome.map_percent < (1.0 if brought.measured in ("steps", "states") else 0.5)
    assert not outcome.reported


@pytest.mark.slow
@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault != "nothing"])
@pytest.mark.parametrize("measured", ["campaign", "sine", "steps", "states"])
def test_what_is_wrong_is_named_however_it_was_measured(laboratory: Laboratory, measured: str, fault: str) -> None:
    brought = next(brought for brought in SHAPES if brought.measured == measured)
    reported = "; ".join(laboratory.outcome(brought, fault).reported)
    assert all(word in reported for word in EXPECTED.get(fault, ()))
    if fault == "drop":
        assert "device drop" in reported
        assert "dead time" in reported


@pytest.mark.slow
def test_a_drop_is_named_behind_two_clocks(laboratory: Laboratory) -> None:
    assert any("device drop or dead time 1 V" in line for line in laboratory.outcome(LOGGERS, "drop").reported)

"""Where the joint fit and the search disagree, the diagnosis says so."""

from __future__ import annotations

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.selection.joint_ranking import other_opinion
from protocols import FoundEffect, JointEntry

CRITERIA = Criteria().selection


def found(name: str, size: float, *twins: str) -> FoundEffect:
    return FoundEffect(name=name, parameters={}, twins=twins, relative_size=size, log_evidence=50.0)


def entry(name: str, size: float, z: float = 20.0) -> JointEntry:
    return JointEntry(name=name, relative_size=size, z=z)


def test_a_larger_effect_that_was_not_named_is_spoken_of() -> None:
    joint = [entry("voltage_delay", 0.21), entry("dead_time", 0.05)]
    remarks = other_opinion(joint, [found("dead_time", 0.05)])
    assert len(remarks) == 1
    assert "voltage_delay is the largest, 0.21 of its typical size" in remarks[0].text


def test_agreement_chance_and_small_differences_are_not_spoken_of() -> None:
    named = [found("dead_time", 0.05, "device_drop")]
    assert other_opinion([entry("dead_time", 0.05)], named) == []
    assert other_opinion([entry("device_drop", 0.3)], named) == []
    assert other_opinion([entry("bus_sag", 0.3, z=3.0)], named) == []
    assert other_opinion([entry("bus_sag", 0.06)], named) == []
    assert other_opinion([entry("bus_sag", 0.3)], []) == []

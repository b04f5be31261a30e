"""Nothing that is right, or that physics does, is taken for a convention."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.recording import open_recording
from orchestrator.recording_checks import find_convention
from tests.blind.campaign import Campaign, record
from tests.blind.effects import CATALOGUE
from tests.blind.hidden import draw_case
from tests.support.cases import few
from tests.support.rewriting import Rewritten

SMALL = Campaign(
    second_pwm=False, second_amplitude=False, classical=False, anchors=False, injection_s=0.05, dwell_s=0.05
)


def test_a_right_recording_has_none(right: Rewritten) -> None:
    assert find_convention(right) is None


def test_what_is_requested_in_between_ends_the_search(right: Rewritten) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_convention(right, poll=stop)


def test_settings_are_not_needed(right: Rewritten) -> None:
    assert find_convention(right.with_segments(lambda _: {"settings": {}})) is None


@few("name", CATALOGUE, fast=2)
def test_no_effect_at_its_largest_is_a_convention(name: str, tmp_path: Path) -> None:
    size, case = CATALOGUE[name], draw_case("clean", 1, 1)
    largest = size.low if size.inverse else size.high
    changes, _ = size.build(np.random.default_rng(2), largest, case.bench.machine)
    changes.pop("slot", None)
    changed: dict[str, Any] = dict(changes)
    bench = dataclasses.replace(case.bench, plant=case.bench.plant._replace(**changed))
    assert find_convention(open_recording(record(bench, SMALL, tmp_path))) is None

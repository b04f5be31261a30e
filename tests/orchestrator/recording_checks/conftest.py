"""One recording of the blind suite's plant, right in all conventions, made once; the tests rewrite it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from orchestrator.recording import open_recording
from tests.blind.campaign import Campaign, record
from tests.blind.hidden import draw_case
from tests.support.rewriting import Rewritten

SHORT = Campaign(second_pwm=False, second_amplitude=False, period_s=0.2, injection_s=0.1, dwell_s=0.05)


@pytest.fixture(scope="session")
def right(tmp_path_factory: pytest.TempPathFactory) -> Rewritten:
    """At an electrical angle of 0.9 rad, so that no axis is a phase's."""
    bench = dataclasses.replace(draw_case("clean", 0, 1).bench, believed_rad=0.9, drive_delay_samples=0.0)
    return Rewritten.of(open_recording(record(bench, SHORT, tmp_path_factory.mktemp("right"))))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)

"""What a recording tells of the effects that are in it: which it shows, and what fits as well in their place."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis import KnownEffects, inseparable_groups
from orchestrator.recording import Recording
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from protocols import Effect

LIBRARY: list[Effect] = [DeadTime(), DeviceDrop(), VoltageBias()]


@pytest.mark.slow
def test_a_drop_fits_as_well_as_a_dead_time_at_one_pwm_frequency(with_dead_time: Recording) -> None:
    known = KnownEffects(with_dead_time, {"dead_time": {"voltage_v": 0.8}}, LIBRARY)
    assert known.fits_as_well("dead_time", "device_drop")
    assert not known.fits_as_well("dead_time", "voltage_bias")


def test_the_recording_shows_a_large_effect_and_not_a_small_one(with_dead_time: Recording) -> None:
    true = {"dead_time": {"voltage_v": 0.8}, "voltage_bias": {"bias_a_v": 1e-6, "bias_b_v": 0.0}}
    known = KnownEffects(with_dead_time, true, LIBRARY)
    assert known.shows("dead_time")
    assert not known.shows("voltage_bias")


def test_effects_act_alike_where_the_recording_lacks_what_both_declare_as_needed(with_dead_time: Recording) -> None:
    groups = inseparable_groups(with_dead_time, LIBRARY)
    assert groups["direct currents at a second PWM frequency"] == ("dead_time", "device_drop")
    assert not any("voltage_bias" in names for names in groups.values())  # alone in what it needs

"""Cases from other projects' public records, each on the recording that is right otherwise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.recording_checks import find_convention
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.survey import survey
from protocols import Capture, RecordingReader
from tests.support.rewriting import CLARKE, TO_PHASES, Rewritten, gain

UNILOG_A = [0.0, 0.14, 0.20, 0.50, 1.00, 2.00, 3.00, 4.00, 5.00, 5.90]
SAPOG_A = [0.0, 1.58, 1.61, 1.64, 2.17, 3.07, 3.86, 4.75, 5.52, 6.12]
SET_POINTS = ("current_d_a", "current_q_a", "target_d_a", "target_q_a", "amplitude_v")


def _inductance(recording: RecordingReader) -> float:
    response = Responses(survey(recording)).impulse_response
    assert response is not None
    return response.l_h


def test_a_sensor_with_offset_and_gain_is_no_scale(right: Rewritten) -> None:
    """PX4/sapog issue 6 (https://github.com/PX4/sapog/issues/6): 1.4 A too much at small currents, 0.2 A at 5.9 A.

    Offset and slope together are a sensor's curve: no factor brings the readings back, and none is proposed.
    """

    def read(c: Capture) -> dict[str, Any]:
        phases = c.i_ab @ TO_PHASES.T
        return {"i_ab": np.sign(phases) * np.interp(np.abs(phases), UNILOG_A, SAPOG_A) @ CLARKE.T}

    convention = find_convention(right.captured(read))
    assert convention is None or "scaled" not in convention.kind


@pytest.mark.parametrize("unequal", [0.93, 1.1])
def test_unequal_shunts_are_physics(right: Rewritten, unequal: float) -> None:
    """vedderb/bldc pull request 705 (https://github.com/vedderb/bldc/pull/705): every shunt with a gain of its own.

    R and L then differ from board to board, and between +10 A and -10 A commanded. How much, it does not say.
    """
    assert find_convention(right.phases("i_ab", gain("b", unequal))) is None
    assert find_convention(right.phases("i_ab", gain("b", unequal), "ab").without_settings(*SET_POINTS)) is None


def test_offsets_of_the_duty_cycles_are_no_gains(right: Rewritten) -> None:
    """robotology/icub-firmware issue 96 (https://github.com/robotology/icub-firmware/issues/96).

    The currents' oscillation was put on sensors' gains first; it was the bridge's duty cycles, each with an offset.
    """
    bus = right.manifest.drive.dc_bus_voltage_v
    offset = CLARKE @ np.array([0.01, -0.005, 0.002]) * bus
    biased = right.captured(lambda c: {"v_ab": c.v_ab - offset})
    assert find_convention(biased) is None
    assert find_convention(biased.without_settings(*SET_POINTS)) is None


def test_a_voltage_one_period_late_and_its_negative_inductance(right: Rewritten) -> None:
    """codenocold/dgm issue 5 (https://github.com/codenocold/dgm/issues/5): "the inductance measured is negative".

    What is written to the timer acts from the next interrupt on: the current is that of the period before. By the
    steps of the current at the voltage's own edges, L is negative; by the answer at all lags it is what it was.
    """
    late = right.late(-1)
    signs = []
    for one in (right, late):
        injection = next(s for s in one.segments() if s.stage == "injection")
        c = one.load(injection)
        edges = np.flatnonzero(np.abs(np.diff(c.v_ab, axis=0)).max(axis=1) > 5.0) + 1
        edges = edges[edges < len(c) - 1]
        u = c.v_ab - c.v_ab.mean(axis=0)
        signs.append(np.sign(np.sum(u[edges] * (c.i_ab[edges + 1] - c.i_ab[edges]))))
    assert signs == [1.0, -1.0]
    convention = find_convention(late)
    assert convention is not None
    assert (convention.kind, convention.correction.add) == ("delay", 1.0)
    assert _inductance(late) == pytest.approx(_inductance(right), rel=0.05)


@pytest.mark.parametrize("cut_off_hz", [1000.0, 3000.0])
def test_a_filter_before_the_currents_is_no_scale_and_no_delay(right: Rewritten, cut_off_hz: float) -> None:
    """andrewmcgr/tmc-4671 pull request 12 (https://github.com/andrewmcgr/tmc-4671/pull/12).

    Its current filters are bypassed while L is measured at 1 kHz, for they take from the test signal; dead time is
    allowed for. A filter leaves R_s as it is, so that it passes for no scale.
    """
    keep = math.exp(-2.0 * math.pi * cut_off_hz / right.manifest.drive.sampling_frequency_hz)

    def filtered(c: Capture) -> dict[str, Any]:
        first = keep * c.i_ab[:1].astype(np.float64)
        return {"i_ab": lfilter([1.0 - keep], [1.0, -keep], c.i_ab, axis=0, zi=first)[0]}

    low = right.captured(filtered)
    assert find_convention(low) is None
    assert find_convention(low.without_settings(*SET_POINTS)) is None

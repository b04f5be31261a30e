"""Injections as ripple rows: which rows are requested, live and again, and the waveforms they stand for."""

from __future__ import annotations

from zlib import crc32

import numpy as np
import pytest

from plugins.link._demodulated import ripple_periods
from plugins.wire import Capability, Channel, DriveFacts, Scales
from protocols import DriveFault, DriveRefused, FaultCause, Hold
from tests.plugins.link.bench import LINKS, armed, taken
from tests.plugins.link.device import FS, Script, waveforms
from tests.plugins.link.test_drive import INJECTION, turned

FACTS = DriveFacts(
    bits=Capability.RIPPLE_ON_DRIVE,
    channels=Channel(15),
    scales=Scales.spanning(10.0, 100.0, 400.0, 5.0),
    memory_bytes=16384,
    ripple_rate_max_hz=500.0,
    ripple_memory_rows=2500,
)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("is_curved", [True, False], ids=["with curvature", "of version 1.0"])
def test_waveforms_come_back_from_ripple_rows(link: str, is_curved: bool) -> None:
    bits = Script().bits if is_curved else Script().bits & ~Capability.RIPPLE_CURVATURE
    with armed(link, Script(bits=bits), capture="demodulated") as b:
        capture = taken(b.drive, INJECTION)
    i_dq, v_dq = waveforms(INJECTION, len(capture))
    assert len(capture) == FS
    assert b.device.file["ripple_curvature"] == is_curved
    inner = slice(40, -40)
    swing = np.ptp(i_dq[:, 0]) / 2
    np.testing.assert_allclose(capture.i_ab[inner], turned(i_dq, 0.4)[inner], atol=0.03 * swing)
    np.testing.assert_allclose(capture.v_ab[inner], turned(v_dq, 0.4)[inner], atol=0.03 * INJECTION.amplitude_v)


def test_rows_are_yielded_while_the_drive_injects() -> None:
    with armed(script=Script(speed=1.0), capture="demodulated") as b:
        for block in b.drive.execute(INJECTION):
            if len(block):
                break
        assert b.device.ripple is not None
        assert not b.device.ripple.complete, "the first rows came only after the end"


def test_rows_that_were_yielded_and_do_not_fit_the_crc_of_the_end_are_a_fault() -> None:
    with armed(capture="demodulated", script=Script(speed=1.0)) as b:
        blocks = b.drive.execute(INJECTION)
        while not len(next(blocks)):
            pass
        source = b.device.ripple
        assert source is not None
        data = bytes(x ^ 1 for x in source._data)
        source._data, source._crc = bytearray(data), crc32(data)
        b.device._counts = b.device._counts ^ np.int16(0x0101)
        with pytest.raises(DriveFault, match="were damaged on the way") as fault:
            list(blocks)
        assert fault.value.cause is FaultCause.WRONG_DATA


def test_other_excitations_are_captured_raw() -> None:
    hold = Hold(current_d_a=1.0, current_q_a=0.0, settle_s=0.1, duration_s=0.5)
    with armed(capture="demodulated") as b:
        assert len(taken(b.drive, hold)) == 0.5 * FS
        assert b.device.ripple is None


def test_the_drives_name_says_that_samples_are_a_model() -> None:
    with armed(capture="demodulated") as b:
        machine = b.drive._machine
        assert machine is not None
        assert machine.capabilities.name == "test device (injections as ripple demodulated on the drive)"


@pytest.mark.parametrize(
    ("frequency_hz", "duration_s", "periods"),
    [(500.0, 5.0, 1), (1000.0, 1.0, 2), (1200.0, 1.0, 3), (500.0, 10.0, 2), (500.0, 20.0, 4), (700.0, 1.0, 2)],
)
def test_rows_are_as_fine_as_rate_and_memory_allow(frequency_hz: float, duration_s: float, periods: int) -> None:
    injection = INJECTION.model_copy(update={"frequency_hz": frequency_hz, "duration_s": duration_s})
    assert ripple_periods(injection, FACTS) == periods


def test_rows_too_coarse_for_the_rotation_are_refused() -> None:
    injection = INJECTION.model_copy(update={"frequency_hz": 500.0, "rotation_hz": 50.0})
    with pytest.raises(DriveRefused, match="too coarse for a rotation at 50 Hz"):
        ripple_periods(injection, FACTS)


def test_a_long_injection_leaves_the_drive_time_to_answer_at_its_end() -> None:
    long = INJECTION.model_copy(update={"settle_s": 1.0, "duration_s": 0.5})
    with armed(script=Script(speed=1.0, slow_blocks_s=0.15), capture="demodulated") as b:
        assert len(taken(b.drive, long)) == 0.5 * FS

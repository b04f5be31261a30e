"""Ripple rows of the firmware, against the samples that the same injection captured raw beside them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from plugins.wire import (
    RIPPLE_FLAG,
    VECTORS,
    AckStatus,
    CaptureFormat,
    Conversation,
    Op,
    RippleGrid,
    RowFormat,
    Scales,
    demodulate,
)
from protocols import Injection
from tests.plugins.commands.emulator.hosts import Host, Terminal
from tests.plugins.wire.firmware.built import build, host_board

ANGLE_RAD = 0.4
MOST_COUNTS = 2
"""Between the firmware's row and that of the samples, which are rounded to int16 beforehand."""


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    folder = tmp_path_factory.mktemp("board")
    with host_board(build(folder, "host", "-DFB_WATCHDOG_S=5.0f"), folder, 20.0):
        terminal = Terminal(folder / "line")
        host = Host(terminal)
        assert host.arm().status is AckStatus.OK
        yield host
        terminal.close()


@pytest.mark.slow
@pytest.mark.parametrize("is_curved", [True, False], ids=["with curvature", "of version 1.0"])
@pytest.mark.parametrize("waveform", ["square", "sine"])
@pytest.mark.parametrize(("frequency_hz", "periods"), [(500.0, 1), (333.0, 2), (2500.0, 7)])
def test_rows_are_the_least_squares_of_the_samples(
    host: Host, is_curved: bool, waveform: str, frequency_hz: float, periods: int
) -> None:
    injection = Injection(
        target_d_a=1.0,
        target_q_a=-0.5,
        settle_s=0.1,
        discard_s=0.0123,
        duration_s=0.2,
        amplitude_v=min(0.2 * frequency_hz, 140.0),
        frequency_hz=frequency_hz,
        rotation_hz=5.0,
        waveform=waveform,
        rotor_angle_rad=ANGLE_RAD,
    )
    assert host.write(ripple_curvature=float(is_curved)) is AckStatus.OK
    ack = host.run(injection, form=CaptureFormat.F32, ripple_periods=periods)
    assert ack.status is AckStatus.OK, ack
    host.finish(ack.value)
    assert host.read("fault_cause") == 0.0
    own = host.own_registers()
    fs, scales = own["sampling_frequency_hz"], Scales.of(own)
    grid = RippleGrid(fs, frequency_hz, injection.waveform, periods, 123, own["voltage_delay_samples"], is_curved)
    form = RowFormat(VECTORS, CaptureFormat.F32, scales)
    columns = list(form.unpack(host.upload(ack.value, round(0.2 * fs) * form.row_bytes)).values())
    turn = np.exp(-1j * ANGLE_RAD)
    i_dq, v_dq = ((a + 1j * b) * turn for a, b in (columns[:2], columns[2:]))
    base = host.read("base_voltage_d_v"), host.read("base_voltage_q_v")
    i, v = (np.column_stack((x.real, x.imag)) for x in (i_dq, v_dq))
    expected = demodulate(i, v, base, grid)
    rows = int(own["ripple_rows"])
    data = host.upload(ack.value + RIPPLE_FLAG, rows * grid.row_bytes)
    found = np.frombuffer(data, dtype="<i2").reshape(-1, grid.columns)
    assert len(found) == len(expected) > 10
    assert np.abs(found - expected.counts(scales).astype(int)).max() <= MOST_COUNTS
    if is_curved and waveform == "square":
        assert np.abs(found[:, 3::4]).max() > 20, "the motor saturates, and no row shows it"


@pytest.mark.slow
def test_a_host_of_version_1_0_gets_its_rows_after_one_that_requested_more(host: Host) -> None:
    assert host.write(ripple_curvature=1.0) is AckStatus.OK
    host.command(Op.DISARM)
    host.beating = False
    host.conversation = Conversation()
    assert host.arm().status is AckStatus.OK
    assert host.read("ripple_curvature") == 0.0

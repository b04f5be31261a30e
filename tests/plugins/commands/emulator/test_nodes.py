"""Several drives on one bus: each obeys its own host alone, an emergency stop stops them all, a probe finds them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import can
import numpy as np
import pytest

from plugins.commands.emulator import Device
from plugins.commands.probe._command import command
from plugins.drives.can import CanDrive
from plugins.wire import Fault, PowerState, frame_id, on_bus
from protocols import DriveFault, DriveState, FaultCause, Hold, Limits
from tests.plugins.commands.emulator.buses import WATCHDOG_S, connected, emulated
from tests.plugins.link.bench import beating

LIMITS = Limits(current_a=4.0, voltage_v=150.0)
HOLD = Hold(current_d_a=1.0, current_q_a=0.5, settle_s=0.2, duration_s=0.2)


@dataclass
class Node:
    """An emulated drive and the host that has it."""

    device: Device
    drive: CanDrive


@contextmanager
def on_one_bus(channel: str) -> Iterator[list[Node]]:
    """Nodes 0 and 3, connected."""
    with ExitStack() as running:
        yield [
            Node(running.enter_context(emulated(channel, node)), running.enter_context(connected(channel, node)))
            for node in (0, 3)
        ]


def wait_for(device: Device, state: PowerState) -> None:
    deadline = time.monotonic() + 3.0 * WATCHDOG_S
    while device.power.state is not state:
        assert time.monotonic() < deadline, f"{device.power.state.name} instead of {state.name}"
        time.sleep(0.005)


def test_each_drive_obeys_its_own_host_alone() -> None:
    with on_one_bus("own-hosts") as (first, second), beating(first.drive) as silence, beating(second.drive):
        first.drive.arm(LIMITS)
        assert second.device.power.state is PowerState.DISARMED
        second.drive.arm(LIMITS)
        i_ab = np.concatenate([block.i_ab for block in second.drive.execute(HOLD)])
        np.testing.assert_allclose(i_ab.mean(axis=0), (1.0, 0.5), atol=0.02)
        assert first.device.power.capture is None
        assert first.device.rig.reading_a < 0.02
        assert second.device.rig.reading_a > 1.0
        silence()
        wait_for(first.device, PowerState.FAULTED)
        assert first.device.power.cause is Fault.WATCHDOG
        assert second.drive.telemetry().state is DriveState.ARMED
        second.drive.ramp_down()
        second.drive.disarm()
        assert second.device.power.state is PowerState.DISARMED
        assert first.device.power.state is PowerState.FAULTED


@pytest.mark.parametrize("sender", [0, 1])
def test_an_emergency_stop_of_any_node_stops_every_drive(sender: int) -> None:
    with on_one_bus(f"estop-{sender}") as nodes, beating(nodes[0].drive), beating(nodes[1].drive):
        for node in nodes:
            node.drive.arm(LIMITS)
        with can.Bus(channel=f"estop-{sender}", interface="virtual", ignore_config=True) as bus:
            bus.send(can.Message(arbitration_id=on_bus(frame_id("EStop"), sender), is_extended_id=False))
        for node in nodes:
            wait_for(node.device, PowerState.FAULTED)
            with pytest.raises(DriveFault) as fault:
                next(iter(node.drive.execute(HOLD)))
            assert fault.value.cause is FaultCause.EMERGENCY_STOP


def test_a_probe_finds_all_and_moves_none(capsys: pytest.CaptureFixture[str]) -> None:
    with ExitStack() as running:
        devices = [running.enter_context(emulated("probed-nodes", number)) for number in (1, 2)]
        command(["--can", "virtual:probed-nodes", "--fd", "--json"])
        found = json.loads(capsys.readouterr().out)["drives"]
        assert [drive["drive"]["node"] for drive in found] == [1, 2]
        assert [drive["description"]["serial"] for drive in found] == ["11", "12"]
        assert {device.power.state for device in devices} == {PowerState.DISARMED}
        command(["--can", "virtual:probed-nodes", "--fd"])
        assert "--set drive.node=2" in capsys.readouterr().out

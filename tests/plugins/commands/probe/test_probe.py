"""`fluxbench probe`: finds a drive, says what it is, and does nothing but read."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tty

import pytest

from plugins.commands.probe import links_of_this_machine
from plugins.commands.probe._command import command
from plugins.wire import Fault, ParameterRead, PowerState, ReadBlock
from protocols import DriveError, InputError
from tests.plugins.link.bench import armed
from tests.plugins.link.device import on_a_bus, on_a_pty


def test_a_drive_on_a_serial_line_is_found_and_described(capsys: pytest.CaptureFixture[str]) -> None:
    with on_a_pty() as (_, path):
        assert command(["--serial", path]) == 0
    printed = capsys.readouterr().out
    assert "test device" in printed
    assert "disarmed, bus 300 V" in printed
    assert f"--drive serial --set drive.port={path}" in printed


def test_a_drive_on_a_can_bus_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    with on_a_bus("probed", fd=False):
        command(["--can", "virtual:probed", "--json"])
    (drive,) = json.loads(capsys.readouterr().out)["drives"]
    assert drive["drive"]["interface"] == "virtual"
    assert drive["capabilities"]["watchdog_s"] == 0.6
    assert drive["telemetry"]["state"] == "disarmed"


def test_it_only_reads_and_a_fault_stays_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    with on_a_pty() as (device, path):
        device.trip(Fault.OVERCURRENT, 7.0, 5.6)
        command(["--serial", path])
        assert {type(message) for message in device.received} == {ParameterRead, ReadBlock}
        assert device.state is PowerState.FAULTED
    assert "overcurrent" in capsys.readouterr().out


def test_an_armed_drive_is_not_disturbed() -> None:
    with armed("can") as b:
        channel = b.drive.setup.options.channel
        command(["--can", f"virtual:{channel}"])
        assert b.drive.telemetry().state.value == "armed"
        assert b.device.ledger.session == b.drive._host.conversation.session  # type: ignore[union-attr]


def test_where_nobody_answers_it_says_so() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    with pytest.raises(DriveError, match="no answer"):
        command(["--serial", os.ttyname(slave)])
    os.close(slave)
    os.close(master)
    with pytest.raises(InputError, match="expected INTERFACE:CHANNEL"):
        command(["--can", "can0"])


def test_a_bus_that_needs_a_missing_package_is_not_searched(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import can

    def opened(**_: object) -> None:
        raise can.CanInterfaceNotImplementedError("msgpack not installed")

    buses = [{"interface": "udp_multicast", "channel": channel} for channel in ("ff15::1", "239.74.163.2")]
    monkeypatch.setattr("can.detect_available_configs", lambda: buses)
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    monkeypatch.setattr("can.Bus", opened)
    assert command([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["No drive answered.", "udp_multicast: not searched, Python package msgpack is missing"]
    command(["--json"])
    assert json.loads(capsys.readouterr().out)["not_searched"] == {"udp_multicast": "msgpack"}
    with pytest.raises(DriveError, match="package msgpack is missing"):
        command(["--can", "udp_multicast:239.74.163.2"])


def test_links_of_this_machine_leave_out_what_is_no_bus() -> None:
    names = [link.text for link in links_of_this_machine(115200, 500_000, False)]
    assert len(names) == len(set(names))
    assert not [name for name in names if name.startswith(("serial:", "virtual:"))]


def test_importing_it_imports_no_link_library() -> None:
    modules = "plugins.commands.probe._command, plugins.drives.can, plugins.drives.serial"
    code = f"import sys, {modules}; print([m for m in ('can', 'serial', 'yaml', 'asammdf') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

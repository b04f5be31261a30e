"""Real processes over real pseudo-terminals: what a host can rely on, and what happens when it is not there."""

from __future__ import annotations

import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.config import load_procedure
from plugins.commands.emulator._ports import PtyPort
from plugins.drives.simulated import SimulatedOptions
from plugins.drives.simulated.rig import Rig
from plugins.wire import (
    CAN_FD_LAYOUT,
    CLASSIC_LAYOUT,
    DESCRIPTION_CAPTURE,
    RIPPLE_FLAG,
    VECTORS,
    AckStatus,
    BlockLayout,
    CaptureFormat,
    Channel,
    EStop,
    Fault,
    Frame,
    Op,
    PowerState,
    RippleD,
    RowFormat,
    Scales,
    Status,
    facts_of,
    limit_registers,
    limits_of,
    parse_description,
    program_of,
    program_registers,
    registers,
    single,
)
from protocols import Excitation, Hold, Injection, InputError
from tests.plugins.commands.emulator.hosts import FS, LIMITS, EmulatorProcess, Host, emulator, host_at
from tests.support.cases import few
from tests.support.emulator import free_port

pytestmark = pytest.mark.timeout(60)
WATCHDOG_S = 0.2
LATEST_S = 1.1 * WATCHDOG_S
HOLD = Hold(current_d_a=0.5, current_q_a=1.0, settle_s=0.2, duration_s=0.3)
INJECTION = Injection(
    target_d_a=0.5,
    target_q_a=1.0,
    settle_s=0.2,
    discard_s=0.02,
    duration_s=0.5,
    amplitude_v=20.0,
    frequency_hz=500.0,
    rotation_hz=4.0,
)
SEED = 5
FLOATS = RowFormat(VECTORS, CaptureFormat.F32, Scales.spanning(1.0, 1.0, 1.0, 1.0))
"""Rows in SI units, whatever the scales."""


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    """As fast as it can: the rows do not depend on when the host asks."""
    with emulator(tmp_path_factory.mktemp("fast"), "--speed", "max", "--seed", str(SEED)) as process:
        yield process


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    """In real time."""
    with emulator(tmp_path_factory.mktemp("real")) as process:
        yield process


@pytest.fixture
def host(real: EmulatorProcess) -> Iterator[Host]:
    with host_at(real) as host:
        yield host


def plant_in_process() -> Rig:
    """The plant of the emulator, in this process, within the limits of the tests."""
    procedure = load_procedure("demo")
    options = SimulatedOptions.model_validate({**procedure.drive.options, "overload_s": 120.0})
    rig = Rig(options, procedure.motor, SEED)
    rig.limit(limits_of(as_singles(limit_registers(LIMITS))))
    return rig


def as_singles(values: dict[str, float]) -> dict[str, float]:
    return {name: single(value) for name, value in values.items()}


def as_carried(excitation: Excitation) -> Excitation:
    """The excitation after its trip through the registers."""
    defaults = {register.name: register.default for register in registers().values()}
    return program_of(as_singles({**defaults, **program_registers(excitation, FS)}))


def row_format(host: Host, form: CaptureFormat) -> RowFormat:
    return RowFormat(VECTORS, form, facts_of(host.own_registers()).scales)


def rows_in_process(rig: Rig, excitation: Excitation, form: RowFormat) -> bytes:
    data = []
    for step in rig.excite(as_carried(excitation), 500):
        if step.stretch.captured:
            columns = {
                Channel.I_ALPHA: step.i_ab[:, 0],
                Channel.I_BETA: step.i_ab[:, 1],
                Channel.V_ALPHA: step.v_ab[:, 0],
                Channel.V_BETA: step.v_ab[:, 1],
            }
            data.append(form.pack(columns))
    return b"".join(data)


# Who is there


def test_it_tells_what_it_is_before_anybody_has_a_session(host: Host) -> None:
    own = host.own_registers()
    assert own["protocol_major"] == 1.0
    assert facts_of(own).memory_bytes == 8192 * 8
    host.identify()
    description = parse_description(host.upload(DESCRIPTION_CAPTURE, int(own["description_bytes"])))
    assert description["name"] == "fluxbench emulator"


def test_it_refuses_to_move_before_it_is_armed(host: Host) -> None:
    host.identify()
    assert host.command(Op.RUN_PROGRAM).status is AckStatus.WRONG_STATE
    assert host.command(Op.CAPTURE_ARM, 100).status is AckStatus.WRONG_STATE
    assert host.write(limit_current_a=0.0) is AckStatus.OK
    assert host.command(Op.ARM).status is AckStatus.OUT_OF_RANGE
    assert host.state() is PowerState.DISARMED


def test_another_host_is_reported_that_it_is_busy_and_an_old_session_that_it_is_stale(host: Host) -> None:
    first = host.conversation.session
    assert host.arm().status is AckStatus.OK
    issued = host.conversation.session
    assert issued != first
    host.conversation.session = first
    assert host.command(Op.DISARM).status is AckStatus.STALE_SESSION
    stranger = Host(host.link)
    stranger.beating = True
    stranger.conversation.session = issued  # keeps the watchdog fed while the stranger knocks
    stranger.receive()
    other = Host(host.link)
    assert other.identify().status is AckStatus.BUSY
    host.conversation.session = issued
    assert host.state() is PowerState.HOLDING


def test_a_new_host_hears_nothing_that_the_one_before_did_not_read(real: EmulatorProcess) -> None:
    with host_at(real) as gone:
        gone.identify()
        gone.until(lambda: gone.status is not None)
        time.sleep(0.3)
        before = len(real.events("link"))
    assert real.wait_for("link", before + 1)["open"] is False
    with host_at(real) as host:
        host.until(lambda: host.status is not None)
        assert gone.status is not None
        first = next(m.seq for m in host.messages if isinstance(m, Status))
        assert (first - gone.status.seq) % 256 > 5


# Captures


@pytest.mark.parametrize("form", list(CaptureFormat))
def test_the_rows_are_those_of_the_same_plant_in_process(fast: EmulatorProcess, form: CaptureFormat) -> None:
    """The emulator is new or has run both programs before: so many more runs the plant in process."""
    before = len(fast.events("program"))
    rig = plant_in_process()
    with host_at(fast) as host:
        layout = row_format(host, form)
        for earlier in (HOLD, INJECTION) * (before // 2):
            rows_in_process(rig, earlier, layout)
        if before:
            rig.drain()
        expected = [rows_in_process(rig, wanted, layout) for wanted in (HOLD, INJECTION)]
        assert host.arm().status is AckStatus.OK
        programs: tuple[Excitation, ...] = (HOLD, INJECTION)
        for excitation, rows in zip(programs, expected, strict=True):
            ack = host.run(excitation, form=form)
            assert ack.status is AckStatus.OK
            host.finish(ack.value)
            assert host.read("capture_rows") * host.read("capture_row_bytes") == len(rows)
            assert host.upload(ack.value, len(rows)) == rows


def test_ripple_rows_seen_live_are_those_read_afterwards(host: Host) -> None:
    host.arm()
    ack = host.run(INJECTION, channels=Channel(0), ripple_periods=1, ripple_live=True)
    host.messages.clear()
    host.finish(ack.value)
    live = {m.n: (m.mean, m.ripple, m.v) for m in host.messages if isinstance(m, RippleD)}
    count = int(host.read("ripple_rows"))
    table = np.frombuffer(host.upload(ack.value + RIPPLE_FLAG, 12 * count), dtype="<i2").reshape(-1, 6)
    assert count == 250
    assert len(live) > 0.9 * count
    assert all(tuple(table[n, :3]) == row for n, row in live.items())
    ripple_a = np.hypot(table[:, 1], table[:, 4]) * host.read("ripple_scale_a")
    # A square wave's triangle: V / (4 f L), L between those of both axes.
    assert 20.0 / (4 * 500.0 * 0.08) < ripple_a.mean() < 20.0 / (4 * 500.0 * 0.03)


# The dead man


def test_it_is_safe_soon_after_the_last_heartbeat(real: EmulatorProcess, host: Host) -> None:
    host.arm()
    ack = host.run(Hold(current_d_a=1.0, current_q_a=2.0, settle_s=0.1, duration_s=20.0))
    assert ack.status is AckStatus.OK
    host.until(lambda: host.progress is not None and host.progress.rows > 0)
    before = len(real.events("safe"))
    host.beating = False
    safe = real.wait_for("safe", before + 1)
    assert safe["cause"] == "watchdog"
    assert WATCHDOG_S < safe["latency_s"] <= LATEST_S
    assert host.state() is PowerState.FAULTED
    assert host.read("fault_cause") == Fault.WATCHDOG
    assert host.command(Op.ARM).status is AckStatus.FAULT_LATCHED
    assert host.command(Op.CLEAR_FAULT).state is PowerState.DISARMED


@few("number", [signal.SIGSTOP, signal.SIGKILL], ids=["stopped", "killed"])
def test_it_is_safe_when_the_host_is_gone(real: EmulatorProcess, number: signal.Signals) -> None:
    code = "import sys; from tests.plugins.commands.emulator.hosts import main; main(sys.argv[1:])"
    child = subprocess.Popen([sys.executable, "-c", code, str(real.path)], stdout=subprocess.PIPE)
    assert child.stdout is not None
    try:
        assert child.stdout.readline() == b"holding\n"
        before = len(real.events("safe"))
        time.sleep(0.2)
        gone_s = time.monotonic()
        child.send_signal(number)
        safe = real.wait_for("safe", before + 1)
        assert safe["cause"] == "watchdog"
        assert safe["latency_s"] <= LATEST_S
        assert safe["time_s"] - gone_s <= LATEST_S
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
    with host_at(real) as host:
        host.identify()
        assert host.command(Op.CLEAR_FAULT).state is PowerState.DISARMED


def test_heartbeats_that_queued_while_it_was_stopped_do_not_revive_it(real: EmulatorProcess, host: Host) -> None:
    host.arm()
    before = len(real.events("safe"))
    real.send_signal(signal.SIGSTOP)
    deadline = time.monotonic() + 0.4
    while time.monotonic() < deadline:
        host.receive()
    real.send_signal(signal.SIGCONT)
    safe = real.wait_for("safe", before + 1)
    assert safe["cause"] == "watchdog"
    assert host.state() is PowerState.FAULTED


def test_an_emergency_stop_needs_no_session_and_stays_latched(real: EmulatorProcess, host: Host) -> None:
    host.arm()
    host.run(Hold(current_d_a=1.0, current_q_a=1.0, settle_s=0.1, duration_s=20.0))
    before = len(real.events("safe"))
    for _ in range(3):
        host.send(EStop())
    safe = real.wait_for("safe", before + 1)
    assert (safe["cause"], len(real.events("safe"))) == ("emergency_stop", before + 1)
    assert safe["latency_s"] < 0.03
    assert host.command(Op.RUN_PROGRAM).status is AckStatus.FAULT_LATCHED


# Ends and beginnings


@pytest.mark.slow
def test_a_restart_takes_the_same_path_and_plant_and_an_end_is_safe(tmp_path: Path) -> None:
    state = str(tmp_path / "state")
    with emulator(tmp_path, "--speed", "max", "--state", state) as process, host_at(process) as host:
        host.arm()
        host.finish(host.run(HOLD).value)
        host.command(Op.DISARM)
        host.beating, host.status = False, None
        process.send_signal(signal.SIGKILL)
        process.process.wait(5.0)
    assert process.path.is_symlink()
    with emulator(tmp_path, "--speed", "max", "--state", state) as again, host_at(again) as host:
        host.arm()
        host.finish(host.run(HOLD).value)
        start = host.read("capture_start_low") + 65536 * host.read("capture_start_high")
        assert start > 5000 + 2000  # the first program, then this one's settling
        again.send_signal(signal.SIGTERM)
        assert again.process.wait(5.0) == 0
        assert [event["cause"] for event in again.events("safe")] == ["ended"]
        host.beating, host.status = False, None
    assert not again.path.is_symlink()


# Links that lose


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.01, 0.05])
def test_a_capture_over_a_lossy_link_is_exact(tmp_path: Path, part: float) -> None:
    rates = (word for name in ("drop", "duplicate", "reorder", "corrupt") for word in (f"--{name}", str(part)))
    with emulator(tmp_path, "--speed", "max", "--seed", str(SEED), *rates) as process, host_at(process) as host:
        expected = rows_in_process(plant_in_process(), INJECTION, FLOATS)
        host.arm()
        ack = host.run(INJECTION, form=CaptureFormat.F32)
        assert ack.status is AckStatus.OK
        host.until(lambda: host.state() is PowerState.HOLDING)
        assert host.upload(ack.value, len(expected)) == expected


class Bus:
    """A host on a python-can bus."""

    def __init__(self, interface: str, channel: str, layout: BlockLayout, **settings: Any) -> None:
        import can

        self.layout = layout
        self._can = can
        self._bus: Any = can.Bus(interface=interface, channel=channel, ignore_config=True, **settings)

    def send(self, frame: Frame) -> None:
        self._bus.send(self._can.Message(arbitration_id=frame.frame_id, data=frame.payload, is_extended_id=False))

    def receive(self, timeout_s: float) -> list[Frame]:
        frames: list[Frame] = []
        while len(frames) < 256 and select.select([self._bus.fileno()], [], [], 0.0 if frames else timeout_s)[0]:
            message = self._bus.recv(0.0)
            if message is not None:
                frames.append(Frame(message.arbitration_id, bytes(message.data)))
        return frames

    def close(self) -> None:
        self._bus.shutdown()


def test_a_capture_over_can_fd_is_exact(tmp_path: Path) -> None:
    pytest.importorskip("msgpack", reason="python-can's udp_multicast needs it")
    group, port = "239.74.163.2", free_port()
    words = ("--can", f"udp_multicast:{group}", "--fd", "--can-set", f"port={port}", "--can-set", "hop_limit=0")
    with emulator(tmp_path, *words, "--speed", "max", "--seed", str(SEED)):
        host = Host(Bus("udp_multicast", group, CAN_FD_LAYOUT, fd=True, port=port))
        try:
            expected = rows_in_process(plant_in_process(), INJECTION, FLOATS)
            host.arm()
            ack = host.run(INJECTION, form=CaptureFormat.F32)
            host.finish(ack.value)
            assert host.upload(ack.value, len(expected)) == expected
        finally:
            host.close()


@pytest.mark.slow
def test_classic_can_by_python_cans_serial_interface(tmp_path: Path) -> None:
    path = tmp_path / "bus"
    short = Hold(current_d_a=0.5, current_q_a=1.0, settle_s=0.1, duration_s=0.02)
    with emulator(tmp_path, "--can", f"serial:{path}", "--speed", "max", "--seed", str(SEED)):
        host = Host(Bus("serial", str(path), CLASSIC_LAYOUT, timeout=0.01))
        try:
            expected = rows_in_process(plant_in_process(), short, FLOATS)
            host.arm()
            ack = host.run(short, form=CaptureFormat.F32)
            host.finish(ack.value)
            assert host.upload(ack.value, len(expected)) == expected
        finally:
            host.close()


def test_a_path_is_left_alone_where_something_else_is(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    for name in ("file", "link", "nowhere/tty"):
        port = PtyPort(tmp_path / name)
        with pytest.raises(InputError):
            port.publish()
        port.close()
    assert (tmp_path / "link").read_text() == "mine"

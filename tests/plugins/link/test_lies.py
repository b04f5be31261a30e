"""A drive that lies, over a real line: each lie has a name, the way out is taken, and nothing made up is kept."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest

from orchestrator.engine import PowerStage
from plugins.link._timeline import Timeline
from plugins.link._timeouts import TIMEOUTS
from plugins.wire import (
    Ack,
    Command,
    Measurement,
    Message,
    Op,
    ParameterValue,
    Phase,
    PowerState,
    Progress,
    Status,
    Tick,
)
from plugins.wire import register_index as index_of
from protocols import DriveFault, Excitation, FaultCause, Hold, Note
from tests.plugins.link.bench import LIMITS, armed, beating, bench, taken
from tests.plugins.link.device import FS, Script, on_a_pty
from tests.plugins.link.test_drive import HOLD, INJECTION
from tests.support.tiny import MOTOR, STAGES, messages_of, run_tiny

ON = (PowerState.HOLDING, PowerState.RUNNING, PowerState.STOPPING)
LONG = Hold(current_d_a=1.0, current_q_a=0.0, settle_s=0.1, duration_s=30.0)
THIS_MOTOR = {**MOTOR, "name": "test motor"}
Lie = Callable[[Message], Message]


def too_much_current(message: Message) -> Message:
    return message._replace(i_d=30000) if isinstance(message, Measurement) else message


def faults_beside_power(message: Message) -> Message:
    is_on = isinstance(message, Status) and message.state in ON
    return message._replace(faults=1 << 5) if is_on and isinstance(message, Status) else message


def progress_that_goes_back() -> Lie:
    numbers = count()

    def lie(message: Message) -> Message:
        if isinstance(message, Progress):
            return message._replace(phase=Phase.CAPTURING, rows=1000 - next(numbers))
        return message

    return lie


def more_rows_than_there_are(message: Message) -> Message:
    return message._replace(rows=1 << 20) if isinstance(message, Progress) else message


def same_number_again(message: Message) -> Message:
    if isinstance(message, Ack) and message.op is Op.RUN_PROGRAM:
        return message._replace(value=1)
    return message._replace(capture=1) if isinstance(message, Progress) else message


def start_in_the_past(message: Message) -> Message:
    is_start = isinstance(message, ParameterValue) and message.parameter in (
        index_of("capture_start_low"),
        index_of("capture_start_high"),
    )
    return message._replace(value=0.0) if is_start and isinstance(message, ParameterValue) else message


def clock_that_stands_still() -> Lie:
    first: list[Message] = []

    def lie(message: Message) -> Message:
        first.extend([message] if isinstance(message, Tick) else [])
        return first[0] if isinstance(message, Tick) else message

    return lie


def clock_that_goes_back() -> Lie:
    numbers = count(1)

    def lie(message: Message) -> Message:
        return message._replace(tick=1_000_000 - 500 * next(numbers)) if isinstance(message, Tick) else message

    return lie


@pytest.mark.parametrize(
    ("lie", "excitation", "cause", "message"),
    [
        (too_much_current, HOLD, FaultCause.OVERCURRENT, r"measures 11 A, the limit is 4\.5 A, and it did not trip"),
        (faults_beside_power, HOLD, FaultCause.WRONG_DATA, "(running|holding) despite faults: overtemperature"),
        (progress_that_goes_back(), LONG, FaultCause.WRONG_DATA, "goes back from capturing at row"),
        (more_rows_than_there_are, HOLD, FaultCause.WRONG_DATA, "1048576 rows of 2000"),
        (clock_that_stands_still(), HOLD, FaultCause.WRONG_DATA, "before the end of its capture"),
        (clock_that_goes_back(), HOLD, FaultCause.WRONG_DATA, "clock went back by"),
        (clock_that_stands_still(), INJECTION, FaultCause.WRONG_DATA, "before the end of its capture"),
    ],
)
def test_each_lie_while_a_program_runs_is_named_and_the_way_out_is_taken(
    lie: Lie, excitation: Excitation, cause: FaultCause, message: str
) -> None:
    with armed() as b:
        taken(b.drive, HOLD)
        b.script.lie = lie
        with pytest.raises(DriveFault, match=message) as fault:
            [taken(b.drive, excitation) for _ in range(2)]
        assert fault.value.cause is cause
        b.drive.ramp_down()
        b.drive.disarm()
        assert b.device.state is PowerState.DISARMED


@pytest.mark.parametrize(
    ("lie", "message"),
    [
        (same_number_again, "two successive captures of the drive have number 1"),
        (start_in_the_past, "starts .* s before the last one has ended"),
    ],
)
def test_a_capture_that_cannot_be_a_new_one_is_refused(lie: Lie, message: str) -> None:
    with armed() as b:
        taken(b.drive, HOLD)
        b.script.lie = lie
        with pytest.raises(DriveFault, match=message):
            taken(b.drive, HOLD)


def test_a_program_that_never_ends_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plugins.link._running.TIMEOUTS", type(TIMEOUTS)(no_progress_s=0.2, max_duration_ratio=0.0))
    numbers = count(1)

    def lie(message: Message) -> Message:
        if isinstance(message, Progress):
            return message._replace(phase=Phase.CAPTURING, rows=next(numbers))
        return message

    with armed(script=Script(lie=lie, speed=0.5)) as b:
        with pytest.raises(DriveFault, match=r"hold: not complete after 0\.2 s") as fault:
            taken(b.drive, LONG.model_copy(update={"settle_s": 0.0}))
        assert fault.value.cause is FaultCause.PROGRAM_TOO_LONG


def test_a_memory_that_holds_no_row_is_no_drives() -> None:
    with bench(script=Script(memory_bytes=0)) as b, pytest.raises(DriveFault, match="less than a row") as fault:
        b.drive.connect()
    assert fault.value.cause is FaultCause.WRONG_DATA


@pytest.mark.parametrize(
    ("rate", "expected"),
    [(1.0, ""), (1.02, ""), (3.0, r"jumped by .* s in"), (0.0, r"advanced by only 0 s in"), (0.3, r"advanced by only")],
)
def test_a_clock_keeps_to_that_of_the_host_unless_it_is_a_simulation(
    rate: float, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    host_s = 100.0
    monkeypatch.setattr("plugins.link._timeline.time.clock_gettime", lambda clock: host_s)

    class Answering:
        def tick(self) -> Tick:
            return Tick(int(1000.0 + rate * (host_s - 100.0) * FS), 0)

    for is_simulated in (True, False):
        host_s = 100.0
        timeline = Timeline(Answering(), FS, is_simulated)  # type: ignore[arg-type]
        timeline.now()
        host_s = 110.0
        if expected and not is_simulated:
            with pytest.raises(DriveFault, match=expected):
                timeline.now()
        else:
            assert timeline.now() == 1000 + rate * 10.0 * FS


def test_a_late_tick_of_an_honest_clock_is_requested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    host_s = 100.0
    monkeypatch.setattr("plugins.link._timeline.time.clock_gettime", lambda clock: host_s)
    ticks = iter([0, 100, 20_000])

    class Answering:
        def tick(self) -> Tick:
            return Tick(next(ticks), 0)

    timeline = Timeline(Answering(), FS, False)  # type: ignore[arg-type]
    timeline.now()
    host_s = 110.0
    assert timeline.now() == 20_000


def test_a_fault_that_is_withdrawn_is_named() -> None:
    def tripped_once(message: Message) -> Message:
        is_first = isinstance(message, Status) and next(numbers) == 0
        return message._replace(state=PowerState.FAULTED, faults=1 << 5) if is_first else message  # type: ignore[call-arg]

    numbers = count()
    with armed() as b:
        statuses = b.drive._host.link.news.statuses  # type: ignore[union-attr]
        b.script.lie = tripped_once
        b.drive._host.link.wait(lambda: b.drive._host.link.news.statuses > statuses + 3, 5.0)  # type: ignore[union-attr]
        with pytest.raises(DriveFault, match="the drive reported a fault and withdrew it: overtemperature"):
            taken(b.drive, HOLD)


# Readings that the engine's check refuses, over the same line


def flash_of_a_fault() -> Lie:
    """One status of a run with a fault, and none after it."""
    numbers = count()

    def lie(message: Message) -> Message:
        is_on = isinstance(message, Status) and message.state is PowerState.RUNNING
        return message._replace(faults=1 << 5) if is_on and next(numbers) == 3 else message  # type: ignore[call-arg]

    return lie


def start_before_the_experiment(message: Message) -> Message:
    """The first capture begins a day and 22 hours before the drive was connected."""
    is_start = isinstance(message, ParameterValue) and message.parameter == index_of("capture_start_high")
    return message._replace(value=60441.0) if is_start and isinstance(message, ParameterValue) else message


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (Script(voltage_step_v=10.0), r"the voltages come in steps of 10 V, 3\.3 % of the bus voltage"),
        (Script(lie=flash_of_a_fault(), speed=1.0), "the drive reports running despite faults: overtemperature"),
        (Script(lie=start_before_the_experiment), "its clock stands at -.* s, before the experiment's begin"),
    ],
)
def test_a_run_does_not_believe_what_no_drive_reads(script: Script, reason: str, tmp_path: Path) -> None:
    stages = [stage for stage in STAGES if stage["kind"] in ("gates_off", "classical")]
    with on_a_pty(script) as (device, port):
        drive = {"name": "serial", "port": port, "telemetry_period_s": 0.15}
        result = run_tiny(tmp_path, drive=drive, stages=stages, motor=THIS_MOTOR)
        assert result.outcome.ending == "faulted"
        assert re.search(reason, result.outcome.reason), result.outcome.reason
        assert "\n" not in result.outcome.reason
        assert device.state is PowerState.DISARMED
        assert device.i_dq == (0.0, 0.0)
        ops = [message.op for message in device.received if isinstance(message, Command)]
        assert ops[ops.index(Op.STOP) :].count(Op.DISARM) == 1, "stopped first, then disarmed"


# Disarming


def always_on(message: Message) -> Message:
    """Armed once, armed for ever, by its own words."""
    if isinstance(message, Status):
        return message._replace(state=PowerState.HOLDING)
    is_answer = isinstance(message, Ack) and message.op is Op.DISARM
    return message._replace(state=PowerState.HOLDING) if is_answer and isinstance(message, Ack) else message


def test_a_drive_that_does_not_disarm_is_stopped_in_an_emergency() -> None:
    with armed(script=Script(deaf_to=frozenset({Op.DISARM}))) as b:
        with pytest.raises(DriveFault, match="only an emergency stop switched it off") as fault:
            b.drive.disarm()
        assert fault.value.cause is FaultCause.STILL_ARMED
        assert b.device.state is PowerState.FAULTED


def test_a_run_on_a_drive_that_stays_armed_ends_in_a_fault_that_shouts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = Script()
    arm = PowerStage.arm

    def arm_and_lie(power: PowerStage) -> None:
        arm(power)
        script.lie = always_on

    monkeypatch.setattr(PowerStage, "arm", arm_and_lie)
    with on_a_pty(script) as (_, port):
        drive = {"name": "serial", "port": port, "telemetry_period_s": 0.15}
        limits = {"current_a": 4.5, "voltage_v": 150.0}
        result = run_tiny(tmp_path, drive=drive, stages=STAGES[:1], limits=limits, motor=THIS_MOTOR)
    error = result.outcome.error
    assert isinstance(error, DriveFault)
    assert (result.outcome.ending, error.cause, max(error.exit_code, 3)) == ("faulted", FaultCause.STILL_ARMED, 3)
    assert "CUT ITS POWER" in result.outcome.reason
    notes = [m for m in messages_of(tmp_path / "run") if isinstance(m, Note) and m.level == "error"]
    assert any("nor by an emergency stop" in note.text for note in notes)


# Clipped rows


@pytest.mark.parametrize("capture", ["raw", "demodulated"])
def test_rows_at_the_end_of_their_scale_are_counted(capture: str) -> None:
    with armed(script=Script(saturated=7), capture=capture) as b:
        blocks = list(b.drive.execute(INJECTION))
    rows = sum(block.clipped_rows for block in blocks)
    assert rows == 7 if capture == "raw" else 7 * FS / 100.0 * 0.5 <= rows <= 7 * FS / 100.0 * 2.0


def test_a_segment_with_clipped_rows_is_marked_and_the_run_says_so(tmp_path: Path) -> None:
    script = Script(saturated=3)
    with on_a_pty(script) as (_, port):
        drive = {"name": "serial", "port": port, "telemetry_period_s": 0.15}
        result = run_tiny(tmp_path, drive=drive, stages=STAGES[:1], motor=THIS_MOTOR)
    assert result.outcome.ending == "finished", result.outcome.reason
    notes = [m.text for m in messages_of(tmp_path / "run") if isinstance(m, Note) and m.level == "warning"]
    assert notes == ["gates_off-000: 3 of 40 rows are at the end of the drive's scale (clipped)"]
    assert '"clipped_rows": 3' in (tmp_path / "run" / "recording.json").read_text()


def test_an_honest_drive_is_believed_while_it_beats() -> None:
    with bench() as b:
        b.drive.connect()
        with beating(b.drive):
            b.drive.arm(LIMITS)
            assert [sum(block.clipped_rows for block in b.drive.execute(e)) for e in (HOLD, INJECTION)] == [0, 0]
            b.drive.ramp_down()
            b.drive.disarm()

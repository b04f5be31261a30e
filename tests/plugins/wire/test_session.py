"""Sessions: a repetition does nothing twice, a stale host is ignored, and held-up heartbeats feed nobody."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import (
    Ack,
    AckStatus,
    Command,
    Conversation,
    Frame,
    Heartbeat,
    Ledger,
    Op,
    ParameterRead,
    ParameterValue,
    PowerState,
    TelemetryGate,
    Unwrapped,
    Verdict,
    Watchdog,
    answers,
    decode,
    encode,
    newer,
)
from protocols import InputError
from tests.plugins.wire.lossy import Lossy


def ack(command: Command, value: int = 0) -> Ack:
    return Ack(command.session, command.seq, command.op, AckStatus.OK, PowerState.DISARMED, value)


def opened(session: int = 100) -> tuple[Ledger, Conversation]:
    ledger, host = Ledger(), Conversation(session)
    identify = host.command(Op.IDENTIFY, 1)
    assert ledger.judge(identify) is Verdict.NEW
    ledger.open(identify)
    ledger.store(identify, ack(identify))
    return ledger, host


@given(st.integers(0, 255), st.integers(1, 127))
def test_newer_survives_the_wrap(seq: int, step: int) -> None:
    assert newer((seq + step) % 256, seq)
    assert not newer(seq, (seq + step) % 256)
    assert not newer(seq, seq)


@given(st.lists(st.integers(0, 1 << 20), max_size=30), st.integers(0, (1 << 32) - 1))
def test_a_wrapped_counter_goes_on(steps: list[int], start: int) -> None:
    unwrapped, count = Unwrapped(), start
    assert unwrapped(start) == start
    for step in steps:
        count += step
        assert unwrapped(count % (1 << 32)) == count


def test_a_late_tick_is_placed_before_the_latest() -> None:
    unwrapped = Unwrapped()
    unwrapped((1 << 32) - 5)
    assert unwrapped(10) == (1 << 32) + 10
    assert unwrapped((1 << 32) - 3) == (1 << 32) - 3
    assert unwrapped(11) == (1 << 32) + 11


def test_a_repeated_command_gets_the_stored_reply() -> None:
    ledger, host = opened()
    clear = host.command(Op.CLEAR_FAULT)
    assert ledger.judge(clear) is Verdict.NEW
    reply = ledger.store(clear, ack(clear))
    assert ledger.judge(clear) is Verdict.REPEATED
    assert ledger.reply == reply


@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.1, 0.4]))
def test_over_a_bad_link_each_command_is_done_exactly_once_and_in_order(seed: int, rate: float) -> None:
    rng, done, sent = random.Random(seed), [], []
    link = Lossy(rng, rate, rate, 0.0)
    late: list[Frame] = []
    ledger, host = opened()
    for k in range(20):
        command = host.command(Op.CAPTURE_ARM, k)
        sent.append(k)
        for _ in range(300):
            arriving = link([encode(command)])
            late += [frame for frame in arriving if rng.random() < rate]
            if late and rng.random() < rate:  # a copy that some gateway held back
                arriving.append(late.pop(0))
            replies = []
            for frame in arriving:
                got = decode(*frame)
                assert isinstance(got, Command)
                verdict = ledger.judge(got)
                if verdict is Verdict.NEW:
                    done.append(got.arg)
                    ledger.store(got, ack(got))
                if verdict in (Verdict.NEW, Verdict.REPEATED):
                    replies.append(encode(ledger.reply))
            messages = [decode(*frame) for frame in link(replies)]
            if any(message is not None and answers(message, command) for message in messages):
                break
    assert done == sent


def test_a_late_copy_of_an_older_command_is_dropped() -> None:
    ledger, host = opened()
    run, stop = host.command(Op.RUN_PROGRAM), host.command(Op.STOP)
    for command in (run, stop):
        assert ledger.judge(command) is Verdict.NEW
        ledger.store(command, ack(command))
    assert ledger.judge(run) is Verdict.OLD


def test_commands_go_on_past_the_wrap_however_many_reads_are_between() -> None:
    ledger, host = opened()
    for _ in range(20):
        for index in range(100):
            assert ledger.judge(host.read(index)) is Verdict.NEW
        command = host.command(Op.TIME_SYNC)
        assert ledger.judge(command) is Verdict.NEW
        ledger.store(command, ack(command))


def test_arming_issues_a_session_and_closes_the_one_before() -> None:
    ledger, host = opened()
    arm, stale = host.command(Op.ARM), Conversation(host.session)
    while (arm.seq - stale.command(Op.TIME_SYNC).seq) % 256 <= 2:
        pass  # Its numbers begin anywhere; the arming's own would be its repetition.
    assert ledger.judge(arm) is Verdict.NEW
    reply = ledger.store(arm, ack(arm, ledger.issue()))
    assert ledger.judge(arm) is Verdict.REPEATED, "the acknowledgement was lost, and the old session asks again"
    assert isinstance(reply, Ack)
    host.armed(reply)
    assert host.session == ledger.session != stale.session
    assert ledger.judge(host.command(Op.RUN_PROGRAM)) is Verdict.NEW
    assert ledger.judge(stale.command(Op.RUN_PROGRAM)) is Verdict.STALE
    assert ledger.judge(stale.command(Op.IDENTIFY)) is Verdict.STALE, "a closed session is not opened again"


def test_only_identify_opens_a_session_and_zero_is_none() -> None:
    ledger = Ledger()
    assert ledger.judge(Conversation(5).command(Op.ARM)) is Verdict.STALE
    assert ledger.judge(Command(0, 1, Op.ARM)) is Verdict.STALE
    assert ledger.judge(Command(0, 1, Op.IDENTIFY)) is Verdict.STALE
    assert ledger.judge(Conversation(5).command(Op.IDENTIFY)) is Verdict.NEW


def test_answers_are_recognised_and_nothing_else_is() -> None:
    host = Conversation(9)
    command, write, read = host.command(Op.ARM), host.write(3, 1.0), host.read(3)
    assert answers(ack(command), command)
    assert not answers(ack(command)._replace(seq=command.seq ^ 1), command)
    assert not answers(ack(command)._replace(op=Op.STOP), command)
    assert answers(ParameterValue(9, write.seq, 3, 1.0), write)
    assert not answers(ParameterValue(9, write.seq, 4, 1.0), write)
    assert not answers(ParameterValue(9, read.seq, 3, 1.0), write)
    assert answers(ack(command)._replace(seq=write.seq, op=Op.PARAMETER_WRITE), write)
    assert answers(ack(command)._replace(seq=read.seq, op=Op.PARAMETER_READ), read)
    assert not answers(read, read)
    assert not answers(ParameterValue(9, command.seq, 3, 1.0), command)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e39])
def test_the_host_writes_no_number_that_is_none(value: float) -> None:
    with pytest.raises(InputError, match="register 3"):
        Conversation(9).write(3, value)


def test_sessions_are_random_and_not_zero() -> None:
    assert len({Conversation().session for _ in range(50)}) > 40
    assert all(Conversation().session for _ in range(50))


def test_telemetry_is_taken_when_newer_and_stale_after_three_periods() -> None:
    gate = TelemetryGate(0.05)
    assert gate.stale(0.0), "nothing came yet"
    assert gate.accept(254, 0.0)
    assert not gate.accept(254, 0.01)
    assert gate.accept(1, 0.02)
    assert not gate.accept(255, 0.03)
    assert not gate.stale(0.169)
    assert gate.stale(0.171)
    assert gate.accept(200, 0.2), "the drive counts from anywhere after a restart"


def beats(session: int, times_s: list[float]) -> list[Heartbeat]:
    host, made = Conversation(session), []
    for now_s in times_s:
        made.append(host.heartbeat(now_s))
    return made


def test_the_watchdog_lives_on_heartbeats_and_dies_without() -> None:
    dog = Watchdog(0.2)
    dog.start(10.0)
    times = [0.05 * k for k in range(300)]
    for beat, now_s in zip(beats(7, times), times, strict=True):
        assert dog.feed(beat, 7, 10.0 + now_s)
        assert not dog.expired(10.0 + now_s + 0.199)
    assert dog.expired(10.0 + times[-1] + 0.201)


def test_foreign_and_repeated_heartbeats_feed_nobody() -> None:
    dog = Watchdog(0.2)
    dog.start(0.0)
    [first, second] = beats(7, [0.0, 0.05])
    assert not dog.feed(first, 8, 0.0)
    assert dog.feed(second, 7, 0.05)
    assert not dog.feed(second, 7, 0.1)
    assert not dog.feed(first, 7, 0.1)


def test_heartbeats_that_were_held_up_feed_nobody() -> None:
    dog = Watchdog(0.2)
    dog.start(0.0)
    times = [0.05 * k for k in range(40)]
    for k, beat in enumerate(beats(7, times)):
        arrives_s = times[k] if k < 10 else max(times[k], 1.52)
        assert dog.feed(beat, 7, arrives_s) is (k < 10 or times[k] > 1.32), k


def test_the_hosts_clock_may_wrap() -> None:
    dog, start_s = Watchdog(0.2), (1 << 32) * 1e-3 - 0.2
    dog.start(0.0)
    times = [0.05 * k for k in range(10)]
    for beat, now_s in zip(beats(7, [start_s + t for t in times]), times, strict=True):
        assert dog.feed(beat, 7, now_s)


def test_reads_never_change_what_a_stale_host_may_do() -> None:
    ledger, _ = opened(100)
    assert ledger.judge(ParameterRead(55, 1, 0)) is Verdict.STALE
    assert ledger.session == 100

"""A host of raw protocol calls, and emulators as processes: for tests that look at the drive's end alone."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from plugins.wire import (
    HEARTBEAT_PERIOD_S,
    PROTOCOL_MAJOR,
    Ack,
    AckStatus,
    BlockLayout,
    CaptureAssembly,
    Command,
    Conversation,
    Frame,
    Message,
    Op,
    ParameterRead,
    ParameterValue,
    ParameterWrite,
    Phase,
    PowerState,
    Progress,
    ReadBlock,
    SerialDecoder,
    Status,
    answers,
    capture_registers,
    decode,
    encode,
    limit_registers,
    program_registers,
    register_index,
    registers,
    serial_blocks,
    to_serial,
)
from plugins.wire import VECTORS as DEFAULT_CHANNELS
from protocols import Excitation, Limits
from tests.plugins.wire.lossy import upload
from tests.support.processes import start_fluxbench

FS = 10_000.0
LIMITS = Limits(current_a=3.0, voltage_v=150.0)


class Terminal:
    """The host's side of a pseudo-terminal."""

    def __init__(self, path: Path) -> None:
        self.layout: BlockLayout = serial_blocks(1020)
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._decoder = SerialDecoder()

    def send(self, frame: Frame) -> None:
        with suppress(BlockingIOError):
            os.write(self._fd, to_serial(frame))

    def receive(self, timeout_s: float) -> list[Frame]:
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return []
        return self._decoder.feed(os.read(self._fd, 65536))

    def close(self) -> None:
        os.close(self._fd)


class Host:
    """Stop-and-wait over a link, with a heartbeat while it listens."""

    def __init__(self, link: Any) -> None:
        self.link = link
        self.conversation = Conversation()
        self.beating = False
        self.status: Status | None = None
        self.progress: Progress | None = None
        self.messages: list[Message] = []
        self._beat_s = 0.0
        self._window = 0

    # Traffic

    def send(self, message: Message) -> None:
        self.link.send(encode(message))

    def receive(self, timeout_s: float = 0.01) -> list[Frame]:
        """Everything that is there; heartbeats go out meanwhile."""
        now_s = time.monotonic()
        if self.beating and now_s - self._beat_s >= HEARTBEAT_PERIOD_S:
            self._beat_s = now_s
            self.send(self.conversation.heartbeat(now_s))
        frames: list[Frame] = self.link.receive(timeout_s)
        for frame in frames:
            message = decode(*frame)
            if message is None:
                continue
            self.messages.append(message)
            if isinstance(message, Status):
                self.status = message
            elif isinstance(message, Progress):
                self.progress = message
        return frames

    def until(self, what: Callable[[], bool], seconds: float = 5.0) -> None:
        """Listen until something is so."""
        deadline = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < deadline, f"not in {seconds:g} s; status {self.status}, progress {self.progress}"
            self.receive()

    # Requests

    def ask(self, request: Command | ParameterRead | ParameterWrite) -> Ack | ParameterValue:
        """The answer; the request is repeated unchanged until it comes."""
        for _ in range(60):
            self.messages.clear()
            self.send(request)
            sent_s = time.monotonic()
            while time.monotonic() - sent_s < 0.05:
                self.receive()
                for message in self.messages:
                    if isinstance(message, (Ack, ParameterValue)) and answers(message, request):
                        return message
        raise AssertionError(f"no answer to {request}")

    def command(self, op: Op, arg: int = 0) -> Ack:
        reply = self.ask(self.conversation.command(op, arg))
        assert isinstance(reply, Ack)
        return reply

    def write(self, **values: float) -> AckStatus:
        """Write registers; the first refusal, or ok."""
        for name, value in values.items():
            reply = self.ask(self.conversation.write(register_index(name), value))
            if isinstance(reply, Ack):
                return reply.status
        return AckStatus.OK

    def read(self, name: str) -> float:
        reply = self.ask(self.conversation.read(register_index(name)))
        assert isinstance(reply, ParameterValue)
        return reply.value

    def own_registers(self) -> dict[str, float]:
        """What the drive says of itself."""
        return {name: self.read(name) for name, register in registers().items() if register.access == "read"}

    def identify(self) -> Ack:
        return self.command(Op.IDENTIFY, PROTOCOL_MAJOR)

    def arm(self, limits: Limits = LIMITS) -> Ack:
        """Identified, limits written, armed, beating."""
        assert self.identify().status is AckStatus.OK
        assert self.write(**limit_registers(limits)) is AckStatus.OK
        ack = self.command(Op.ARM)
        if ack.status is AckStatus.OK:
            self.conversation.armed(ack)
            self.beating = True
        return ack

    def run(self, excitation: Excitation, **capture: Any) -> Ack:
        """Start a program; does not wait for its end."""
        live = float(capture.pop("ripple_live", False))
        registers = capture_registers(capture.pop("channels", DEFAULT_CHANNELS), **capture) | {"ripple_live": live}
        status = self.write(**program_registers(excitation, FS), **registers)
        assert status is AckStatus.OK, status
        return self.command(Op.RUN_PROGRAM)

    def finish(self, number: int, seconds: float = 10.0) -> None:
        """Listen until a program is complete."""
        self.until(lambda: self._is_complete(number), seconds)

    def _is_complete(self, number: int) -> bool:
        progress, status = self.progress, self.status
        complete = progress is not None and progress.capture == number and progress.phase is Phase.COMPLETE
        return complete or (status is not None and status.state is PowerState.FAULTED)

    def upload(self, number: int, length: int) -> bytes:
        """A capture, verified."""
        assembly = CaptureAssembly(number, length, self.link.layout, first_window=self._window, blocks_each=64)

        def send(request: ReadBlock) -> None:
            self.send(request)

        data = bytes(upload(assembly, send, self.receive, timeout_s=3.0))
        self._window = assembly.next_window
        return data

    def state(self) -> PowerState:
        """As the latest answer says it."""
        return self.command(Op.TIME_SYNC).state

    def close(self) -> None:
        """Disarm, and let go."""
        self.beating = False
        if self.status is not None and self.status.state is not PowerState.DISARMED:
            self.command(Op.DISARM)
            self.command(Op.CLEAR_FAULT)
        self.link.close()


class EmulatorProcess:
    """`fluxbench emulate` in a process of its own."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.path, self.log_path = folder / "tty", folder / "log.jsonl"
        words = [*arguments, "--log", str(self.log_path)]
        if "--can" not in arguments:
            words += ["--serial", str(self.path)]
        self._started = len(self.events("started"))
        self.process = start_fluxbench("emulate", *words)
        try:
            self.wait_for("started", self._started + 1, 30.0)
        except BaseException:
            self.close()
            raise

    def events(self, name: str | None = None) -> list[dict[str, Any]]:
        """What it has logged."""
        if not self.log_path.exists():
            return []
        whole = self.log_path.read_text(encoding="utf-8").splitlines()
        found = [json.loads(line) for line in whole if line.endswith("}")]
        return [event for event in found if name in (None, event["event"])]

    def wait_for(self, name: str, count: int = 1, seconds: float = 5.0) -> dict[str, Any]:
        """The event, when there are so many of them."""
        deadline = time.monotonic() + seconds
        while len(found := self.events(name)) < count:
            code = self.process.poll()
            assert code is None, f"ended with {code}: {self.process.communicate()[1]}"
            assert time.monotonic() < deadline, f"no {name!r} in {seconds:g} s: {self.events()}"
            time.sleep(0.005)
        return found[count - 1]

    def send_signal(self, number: int) -> None:
        self.process.send_signal(number)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.process.wait()


@contextmanager
def emulator(folder: Path, *arguments: str) -> Iterator[EmulatorProcess]:
    """An emulator that is ready, and ended afterwards."""
    process = EmulatorProcess(folder, *arguments)
    try:
        yield process
    finally:
        process.close()


@contextmanager
def host_at(process: EmulatorProcess) -> Iterator[Host]:
    """A host on its terminal, which disarms at the end."""
    host = Host(Terminal(process.path))
    try:
        yield host
    finally:
        host.close()


def main(arguments: Sequence[str]) -> None:
    """A host that arms, holds and beats until somebody stops it."""
    from protocols import Hold

    host = Host(Terminal(Path(arguments[0])))
    assert host.arm().status is AckStatus.OK
    host.run(Hold(current_d_a=1.0, current_q_a=1.0, settle_s=0.1, duration_s=60.0))
    print("holding", flush=True)
    while True:
        host.receive()


if __name__ == "__main__":
    main(sys.argv[1:])

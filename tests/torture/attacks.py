"""What is done to the program, once each: an attack draws all it does from its generator, and raises what it finds."""

from __future__ import annotations

import errno
import functools
import random
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.recording import open_recording
from plugins.wire import Message, PowerState
from protocols import DriveError, Excitation, PointDone, RealArray
from tests.orchestrator.interface.cli.test_failing_disk import CALLS, compiled, ends_safely_and_resumes
from tests.orchestrator.interface.cli.test_signals_and_kills import kill_and_resume_until_done
from tests.plugins.link.bench import Bench as LinkBench
from tests.plugins.link.bench import armed, taken
from tests.plugins.link.device import FS, Script, waveforms
from tests.plugins.link.test_drive import HOLD, INJECTION, TRAPEZOID, turned
from tests.plugins.link.test_kills import Bench, require_named_end
from tests.support.processes import wait_until
from tests.support.tiny import STAGES, messages_of, run_tiny, tiny_file
from tests.torture.analyses import discovered, tuned
from tests.torture.clocks import jumped
from tests.torture.inputs import mutated
from tests.torture.kills import commissioning_killed, fleet_killed
from tests.torture.mutilations import harmless, mutilated
from tests.torture.numbers import extreme
from tests.torture.pages import flooded

SHORT = [*STAGES[:4], STAGES[5]]
"""Six points, no estimates."""


@dataclass(frozen=True)
class Attack:
    """One kind of attack."""

    name: str
    usual: int
    """How often it is made, where nothing else is requested."""
    reported: str
    """What must hold afterwards."""
    once: Callable[[random.Random, Path], str]
    """Made in an empty folder; gives what came of it in a word or two."""


# Kills


def killed(rng: random.Random, folder: Path) -> str:
    """A run is killed up to three times at random instants; what it then holds is what another has in one go.

    Not bit for bit: a kill is a power cut, after which less time has passed since the point before.
    """
    procedure = tiny_file(folder, stages=SHORT, drive={"realtime_factor": 0.7})
    run = folder / "run"
    kills = kill_and_resume_until_done(procedure, run, rng.randint(1, 3), rng)
    assert [message.id for message in messages_of(run) if isinstance(message, PointDone)] == list(_whole())
    assert {file.stem for file in (run / "captures").iterdir()} == {*_whole()}
    for name, current in _currents(run).items():
        true = _whole()[name]
        np.testing.assert_allclose(current, true, atol=0.01 * float(np.abs(true).max()), err_msg=name)
    return f"killed {kills} times"


@functools.cache
def _whole() -> dict[str, RealArray]:
    with tempfile.TemporaryDirectory() as name:
        return _currents(run_tiny(Path(name), stages=SHORT).path)


def _currents(run: Path) -> dict[str, RealArray]:
    recording = open_recording(run)
    return {segment.id: recording.load(segment).i_ab for segment in recording.segments()}


# Disks


def failed(rng: random.Random, folder: Path) -> str:
    """A call of the disk's fails, once or from then on: the run ends safely, and is whole when it was resumed."""
    error = rng.choice((errno.EIO, errno.ENOSPC))
    code = ends_safely_and_resumes(folder, compiled(), rng.choice(CALLS), rng.randint(1, 60), error, rng.random() < 0.5)
    return "finished" if code == 0 else "ended in a fault"


# Lies


def lied(rng: random.Random, folder: Path) -> str:
    """A drive that says something else than is so: what comes is what was captured, or a fault, and it is off."""
    excitation = rng.choice((HOLD, INJECTION, TRAPEZOID))
    script = Script(saturated=rng.choice((0, 0, 0, 5)))
    begun_s = time.monotonic()
    with armed(script=script) as b:
        script.lie = _lie(rng)
        named = [_named(lambda: _require_true(b, excitation)) for _ in range(2)]
        named += [_named(b.drive.ramp_down), _named(b.drive.disarm)]
        # What is sent to a drive that is given up for lost is not waited for; its watchdog ends it.
        wait_until(lambda: b.device.state in (PowerState.DISARMED, PowerState.FAULTED), 5.0)
    assert time.monotonic() - begun_s < 60.0
    return "named" if any(named) else "harmless"


def disturbed(rng: random.Random, folder: Path) -> str:
    """A line that adds noise, halves frames and holds them back: a named fault, or the true capture."""
    excitation = rng.choice((HOLD, INJECTION, TRAPEZOID))
    script = Script()
    with armed(script=script) as b:
        script.noise = noise_of(rng)
        named = [_named(lambda: _require_true(b, excitation)) for _ in range(2)]
        script.noise = bytes
        named += [_named(b.drive.ramp_down), _named(b.drive.disarm)]
        wait_until(lambda: b.device.state in (PowerState.DISARMED, PowerState.FAULTED), 5.0)
    return "named" if any(named) else "harmless"


def noise_of(rng: random.Random) -> Callable[[bytes], bytes]:
    """One kind of disturbance of a line, now and then."""
    kind, often = rng.choice(("between", "half", "endless", "burst", "again", "flipped")), rng.choice((1.0, 0.3, 0.05))

    def disturb(sent: bytes) -> bytes:
        if rng.random() > often:
            return sent
        match kind:
            case "between":
                return b"".join(frame + b"\0" + rng.randbytes(rng.randrange(30)) for frame in sent.split(b"\0"))
            case "half":
                return sent[: rng.randrange(len(sent) + 1)]
            case "endless":  # longer than any frame, and without the zero that ends one
                return sent + rng.randbytes(rng.choice((300, 10_000))).replace(b"\0", b"\1")
            case "burst":
                return rng.randbytes(5000) + b"\0" + sent
            case "again":
                return sent + sent
        at = rng.randrange(len(sent))
        return sent[:at] + bytes([sent[at] ^ 1 << rng.randrange(8)]) + sent[at + 1 :]

    return disturb


def _require_true(b: LinkBench, excitation: Excitation) -> None:
    capture = taken(b.drive, excitation)
    i_dq, _ = waveforms(excitation, excitation.rows(FS))
    true = turned(i_dq, excitation.rotor_angle_rad)
    np.testing.assert_allclose(capture.i_ab, true, atol=0.51 * b.device.facts.scales.current_a)


def _named(call: Callable[[], object]) -> str:
    """What the drive's fault says; empty where there was none."""
    try:
        call()
    except DriveError as error:
        reported = str(error)
    else:
        return ""
    assert "\n" not in reported
    return reported


def _lie(rng: random.Random) -> Callable[[Message], Message]:
    """Another value in one field of one kind of message, always, now and then, or from some time on."""
    kind = rng.choice(("Status", "Measurement", "Progress", "Tick", "Ack", "ParameterValue"))
    field, size, often = rng.random(), rng.choice((1, 255, 65535)), rng.choice((1.0, 0.3, 0.05))

    def lie(message: Any) -> Any:
        if type(message).__name__ != kind or rng.random() > often:
            return message
        name = message._fields[int(field * len(message._fields))]
        value = getattr(message, name)
        made: Any = type(value)
        if isinstance(value, float):
            return message._replace(**{name: value * rng.choice((-1.0, 0.0, 10.0, 1e6))})
        if made is int:
            return message._replace(**{name: value ^ rng.randint(0, size) if value >= 0 else -value})
        return message._replace(**{name: rng.choice(list(made))})

    return lambda message: _sendable(lie(message), message)


def _sendable(changed: Message, message: Message) -> Message:
    """The lie, where the wire has room for it."""
    from plugins.wire import encode

    try:
        encode(changed)
    except Exception:  # whatever the codec says of a value that is none
        return message
    return changed


# Links


def cut(rng: random.Random, folder: Path) -> str:
    """One end of the line is killed: the drive is safe in time, the run ends by its name and can be resumed."""
    host = rng.random() < 0.5
    with Bench.at(folder, rng.randrange(1 << 30)) as bench:
        process = bench.start()
        if not bench.wait_a_while(process):
            return "over before"
        if host:
            process.kill()
            killed_s = time.monotonic()
            process.communicate()
            bench.require_safe_since(killed_s)
        else:
            bench.machine.send(signal.SIGKILL)
            require_named_end(bench, process, time.time())
            bench.restart_machine()
        bench.require_points_kept()
        bench.finish()
    return f"{'host' if host else 'drive'} killed{', ended again by a busy machine' if bench.starved else ''}"


ATTACKS = (
    Attack("kills", 1000, "every point once, currents within 1 % of a run in one go", killed),
    Attack("inputs", 10_000, "read, or one line and exit 2 or 3", mutated),
    Attack("numbers", 5000, "`check` ends within 10 s of CPU: an answer, or one line and exit 2", extreme),
    Attack("disks", 500, "safe end, whole after resuming", failed),
    Attack("lies", 200, "a named fault or the true capture; off in the end", lied),
    Attack("noise", 300, "a named fault or the true capture; off in the end", disturbed),
    Attack("links", 400, "safe within 220 ms, named end within 1 s", cut),
    Attack("pages", 100, "events within 3 s of each other, disarmed within 5 s of the stop, the server ends", flooded),
    Attack("commissionings", 50, "resumed to a map; every point once; nothing half written", commissioning_killed),
    Attack("fleets", 50, "each recording one row, none failed; no worker left", fleet_killed),
    Attack("clocks", 200, "the wall clock jumps by up to 400 years: same points, same exit codes", jumped),
    Attack("tunings", 1000, "finite files that compile, or one line and nothing written", tuned),
    Attack("discoveries", 200, "an answer, or one line and no law written", discovered),
    Attack("mutilations", 200, "a map that is called usable is within 1 % of the rated flux", mutilated),
    Attack("harmless", 60, "the map is right; at most 5 % are not called usable", harmless),
)

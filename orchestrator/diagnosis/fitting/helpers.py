"""Processes that do a part of each job: every one has some of the segments, and what is kept of them between steps.

A helper is forked, and so knows all that this process knew then: recording, effects, frames. From then on both hear the
same: where a model stands goes there as numbers, what was made of the helper's segments comes back, and a frame made
anew is kept at both ends. Asked for anything that it cannot know, it is replaced by one forked now. This process has
all that the helpers have made: whatever happens to one, it goes on alone, to the same result.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
import weakref
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, cast

from orchestrator.diagnosis.fitting.candidates import Active
from orchestrator.diagnosis.fitting.columns import probed_segments
from orchestrator.diagnosis.fitting.model import Frame, MapSpace, Model, SegmentFrame
from orchestrator.diagnosis.fitting.segment_equations import SegmentEquations
from orchestrator.diagnosis.fitting.segment_messages import heard, said_of
from orchestrator.diagnosis.fitting.segment_work import Framed, Hands, Job, Made, OneHand, Stand
from orchestrator.diagnosis.fitting.shared_room import Content, SharedRoom
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.tensor_spline import EvenSpline

SEGMENT_COST = 2_000
"""What a segment costs by itself, in samples: 0.4 to 5 ms beside 0.2 to 3 us a sample, by what is asked of it."""
ROOM_BYTES = 1 << 30
"""Address space, not memory: of that only what a message fills is ever there."""
LOAD = Path("/proc/loadavg")
MOST_PROCESSES = 4
"""What is not shared (a sixth of a diagnosis) leaves more of them nothing to do."""


def processes_here() -> int:
    """How many processes a computation may take here: as many as there are cores that nobody else is at work on.

    One where a process cannot be forked, or not without danger: beside other threads.
    """
    if sys.platform != "linux" or threading.active_count() > 1:
        return 1
    idle = (os.cpu_count() or 1) - min(_others_at_work() for _ in range(5))
    return max(min(idle, len(os.sched_getaffinity(0)), MOST_PROCESSES), 1)


def _others_at_work() -> int:
    """How many other processes of this machine are running or ready to, a moment from now."""
    time.sleep(0.01)
    try:
        return int(LOAD.read_text().split()[3].split("/")[0]) - 1
    except (OSError, ValueError, IndexError):
        return 0


@contextmanager
def helped(processes: int) -> Iterator[Hands]:
    """Hands of so many processes, this one among them, while the block lasts; what it was asked goes on alone after."""
    helpers = Helpers(processes - 1)
    try:
        yield helpers
    finally:
        helpers.retire()


@dataclass
class Helpers:
    """Hands of this process and some others.

    Attributes
    ----------
    count : int
        Of the others.
    """

    count: int
    _hired: list[_Helper] = field(default_factory=list)
    _ending: list[_Helper] = field(default_factory=list)
    _known: dict[int, object] = field(default_factory=dict)
    """What helpers were forked with and messages refer to, by identity."""
    _frames: dict[int, weakref.ref[Frame]] = field(default_factory=dict)
    """Those frames that helpers have, too."""
    _gone: list[int] = field(default_factory=list)
    _framed: int | None = None
    _stand: weakref.ref[Stand] | None = None
    """Of the last job."""

    def made(self, job: Job, which: Sequence[int]) -> dict[int, Made]:
        """As `Hands` has it."""
        if self.count < 1:
            return OneHand().made(job, which)
        owners = _owners(job, self.count + 1)
        parts = [[k for k in which if owners[k] == n] for n in range(self.count + 1)]
        try:
            self._hire_for(job)
            message = self._message(job)
            for helper, part in zip(self._hired, parts[1:], strict=True):
                helper.ask(message, part)
            made = OneHand().made(job, parts[0])
            for helper, part in zip(self._hired, parts[1:], strict=True):
                made.update(_heard(helper.answer(), job, part))
        except (OSError, EOFError, MemoryError):
            self.retire()
            return OneHand().made(job, which)
        except BaseException:
            self._dismiss()
            raise
        return {k: made[k] for k in which}

    def keep(self, frame: Frame) -> None:
        """As `Hands` has it."""
        if self._stand is not None and self._hired:
            self._register(frame)
            self._framed = id(frame)

    def retire(self) -> None:
        """End all helpers, and wait for it; none is hired again."""
        self._dismiss()
        self._wait()
        self.count = 0

    def _dismiss(self) -> None:
        # Those of before have ended by now: what they had takes a while to be given back.
        self._wait()
        for helper in self._hired:
            helper.end()
        self._hired, self._ending, self._stand, self._framed = [], self._hired, None, None

    def _wait(self) -> None:
        for helper in self._ending:
            helper.gone()
        self._ending = []

    def _hire_for(self, job: Job) -> None:
        """See that there are helpers who know all that a job refers to."""
        stand = job.stand
        actives = [*stand.model.active, *(a for a, _ in job.columns or ())]
        objects: list[object] = [stand.equations, stand.pieces, stand.model.space, stand.model.magnetics.grid]
        objects += [a.candidate for a in actives]
        if self._hired and all(id(one) in self._known for one in objects) and self._has(stand.frame):
            return
        self._dismiss()
        self._known.update({id(one): one for one in objects})
        if stand.frame is not None:
            self._register(cast(Frame, stand.frame))
        self._gone.clear()
        for _ in range(self.count):
            self._hired.append(_Helper.hired(self._hired, self._known, self._alive()))

    def _goes_on(self, stand: Stand) -> bool:
        """Whether the last job was of the same stand: what helpers have of a frame being made is theirs alone."""
        return self._stand is not None and self._stand() is stand

    def _alive(self) -> dict[int, Framed]:
        return {key: frame for key, known in self._frames.items() if (frame := known()) is not None}

    def _has(self, frame: Framed | None) -> bool:
        return frame is None or id(frame) in self._frames

    def _register(self, frame: Frame) -> None:
        key = id(frame)
        if key not in self._frames:
            self._frames[key] = weakref.ref(frame)
            weakref.finalize(frame, self._forget, key).atexit = False

    def _forget(self, key: int) -> None:
        del self._frames[key]
        self._gone.append(key)
        if self._framed == key:
            self._framed = None

    def _message(self, job: Job) -> Content:
        """A job in numbers and references."""
        stand, actives = job.stand, _Table()
        told = None
        if not self._goes_on(stand):
            told = {
                "equations": id(stand.equations),
                "pieces": id(stand.pieces),
                "space": id(stand.model.space),
                "grid": id(stand.model.magnetics.grid),
                "coefficients": stand.model.magnetics.coefficients,
                "r_s": stand.model.r_s,
                "active": [actives.place(a) for a in stand.model.active],
                "frame": None if stand.frame is None else id(stand.frame),
                "renewed": stand.renewed,
            }
        columns = None if job.columns is None else [[actives.place(a), name] for a, name in job.columns]
        message = {
            "stand": told,
            "columns": columns,
            "answering": _sorted(job.answering),
            "probing": job.probing,
            "actives": actives.said,
            "framed": self._framed,
            "gone": list(self._gone),
        }
        self._stand, self._framed = weakref.ref(stand), None
        self._gone.clear()
        return message


@dataclass
class _Table:
    """Effects as a message has them: the candidate, values and what is free; each but once."""

    said: list[Content] = field(default_factory=list)
    _places: dict[int, int] = field(default_factory=dict)

    def place(self, active: Active) -> int:
        if id(active) not in self._places:
            self._places[id(active)] = len(self.said)
            self.said.append([id(active.candidate), dict(active.values), list(active.free)])
        return self._places[id(active)]


@dataclass(frozen=True)
class _Helper:
    """One helper as its employer sees it."""

    pid: int
    connection: Connection
    room: SharedRoom

    @classmethod
    def hired(cls, others: Sequence[_Helper], known: Mapping[int, object], frames: Mapping[int, Framed]) -> _Helper:
        mine, theirs = Pipe()
        room = SharedRoom(ROOM_BYTES)
        pid = os.fork()
        if pid == 0:
            # It ends when the employer's end of its pipe is closed, by whatever: no copy of that may stay open here.
            for connection in (mine, *(other.connection for other in others)):
                connection.close()
            _serve(theirs, room, _Bench(dict(known), dict(frames)))
        theirs.close()
        return cls(pid, mine, room)

    def ask(self, message: Content, part: Sequence[int]) -> None:
        self.connection.send_bytes(self.room.packed({**message, "which": list(part)}))

    def answer(self) -> Content:
        return self.room.opened(self.connection.recv_bytes())

    def end(self) -> None:
        # It has nothing that is not here, too.
        self.connection.close()
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(self.pid, signal.SIGKILL)
        self.room.close()

    def gone(self) -> None:
        """Wait until it has ended."""
        with suppress(ChildProcessError):
            os.waitpid(self.pid, 0)


def _serve(connection: Connection, room: SharedRoom, bench: _Bench) -> None:
    """Do what is asked until nobody is there to ask; never returns."""
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        gc.freeze()  # what was there before stays where it is, in memory that both processes share
        while True:
            message = room.opened(connection.recv_bytes())
            try:
                answer = room.packed(bench.done(message))
            except Exception:  # whatever it is, the employer meets it, too, where it can be told
                answer = room.packed(None)
            connection.send_bytes(answer)
    except (OSError, EOFError):
        pass
    finally:
        os._exit(0)


@dataclass
class _Bench:
    """What a helper knows."""

    known: Mapping[int, Any]
    frames: dict[int, Framed]
    _stand: Stand | None = None
    _actives: list[Active] = field(default_factory=list)
    _latest: dict[int, SegmentFrame] = field(default_factory=dict)
    """Of its segments, where a frame is being made anew."""

    def done(self, message: Content) -> Content:
        """Do the part of a job that a message asks for."""
        for key in message["gone"]:
            self.frames.pop(key, None)
        if message["framed"] is not None:
            self.frames[message["framed"]] = _Part(self._latest)
        self._actives = [Active(self.known[c], values, tuple(free)) for c, values, free in message["actives"]]
        if message["stand"] is not None:
            self._stand, self._latest = self._stand_of(message["stand"]), {}
        assert self._stand is not None
        job = self._job(self._stand, message)
        return [[k, self._made(job, k)] for k in message["which"]]

    def _stand_of(self, said: Content) -> Stand:
        space: MapSpace = self.known[said["space"]]
        grid: EvenSpline = self.known[said["grid"]]
        equations: SegmentEquations = self.known[said["equations"]]
        pieces: Sequence[SegmentSignals] = self.known[said["pieces"]]
        active = tuple(self._actives[place] for place in said["active"])
        model = Model(space, Magnetics(grid, said["coefficients"]), said["r_s"], active)
        frame = None if said["frame"] is None else self.frames[said["frame"]]
        return Stand(equations, pieces, model, frame, said["renewed"])

    def _job(self, stand: Stand, said: Content) -> Job:
        columns = said["columns"] if said["columns"] is None else [(self._actives[k], n) for k, n in said["columns"]]
        heard_of = said["answering"]
        answering = None if heard_of is None else [None if inner is None else frozenset(inner) for inner in heard_of]
        return Job(stand, columns, answering, said["probing"])

    def _made(self, job: Job, k: int) -> Content:
        made, stand = job.made(k), job.stand
        old = None if stand.frame is None else stand.frame.pieces[k]
        if stand.renewed:
            self._latest[k] = made.frame
        return said_of(made, stand.pieces[k], old, renewed=stand.renewed)


@dataclass(frozen=True)
class _Part:
    """A frame of a helper's segments."""

    pieces: Mapping[int, SegmentFrame]


def _sorted(answering: Sequence[frozenset[str] | None] | None) -> Content:
    return None if answering is None else [None if inner is None else sorted(inner) for inner in answering]


def _heard(said: Content, job: Job, part: Sequence[int]) -> dict[int, Made]:
    """What a helper has made; made here where it could not."""
    if said is None:
        return OneHand().made(job, part)
    stand, made = job.stand, {}
    for k, one in said:
        old = None if stand.frame is None else stand.frame.pieces[k]
        made[k] = heard(one, stand.pieces[k], old)
    return made


def _owners(job: Job, processes: int) -> list[int]:
    """Which process has each segment, so that of each kind of segment, and of all, each has as much to do."""
    pieces = job.stand.pieces
    probed = set(probed_segments(pieces, job.stand.equations.criteria.fitting))
    costs = [SEGMENT_COST + len(piece.signals.v_dc) for piece in pieces]
    owners, loads = [0] * len(pieces), Counter[tuple[object, int]]()
    for k in sorted(range(len(pieces)), key=lambda k: -costs[k]):
        kind = pieces[k].held_out, k in probed
        owners[k] = min(range(processes), key=lambda n: (loads[kind, n], loads[None, n]))
        for of in (kind, None):
            loads[of, owners[k]] += costs[k]
    return owners

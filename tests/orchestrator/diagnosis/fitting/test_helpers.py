"""Helpers change nothing of a fit but how long it takes, and leave with whoever hired them, whatever happens."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting import helpers
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.chords import fit_along_chords
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.helpers import Helpers, helped, processes_here
from orchestrator.diagnosis.fitting.model import Fit, Model
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import EddyCurrents, Hysteresis
from plugins.effects.resistance import ResistanceWithTemperature
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset
from plugins.effects.timing import VoltageDelay
from protocols import Correction, EffectLayer, EffectParameters, ModelNoise, PluginError, Signals
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import Array, fitter, free_model, plan, prepared, with_voltage
from tests.support.processes import wait_until

MANY = (
    *(DeadTime(), VoltageBias(), VoltageDelay(), CurrentGainMismatch(), CurrentOffset()),
    *(EddyCurrents(), Hysteresis(), ResistanceWithTemperature()),
)


@pytest.fixture(scope="module")
def alone() -> Fitter:
    return fitter(with_voltage(prepared(plan()), np.array([0.3, -0.2])))


@pytest.fixture
def team() -> Iterator[Helpers]:
    made = Helpers(2)
    yield made
    made.retire()


def with_all(maker: Fitter) -> Model:
    present = [
        candidate.absent().moved(candidate.amplitudes[0], 0.2)
        for candidate in scaled_library(MANY, maker.prepared.manifest)
    ]
    return free_model().with_active(present)


def arrays_of(fit: Fit) -> list[Array]:
    return [*fit.residual, *fit.volts, *fit.columns, fit.normal]


def assert_same(one: Fit, other: Fit) -> None:
    """To the last bit: not near, but the same."""
    assert one.objective == other.objective
    assert one.model.r_s == other.model.r_s
    assert [a.values for a in one.model.active] == [a.values for a in other.model.active]
    for mine, theirs in zip(arrays_of(one), arrays_of(other), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for here, there in zip(one.frame.pieces, other.frame.pieces, strict=True):
        np.testing.assert_array_equal(here.white_basis, there.white_basis)
        np.testing.assert_array_equal(here.whitener.factor, there.whitener.factor)
        assert here.carried_by == there.carried_by
        for name, array in vars(here.base).items():
            if isinstance(array, np.ndarray):
                np.testing.assert_array_equal(array, getattr(there.base, name))


def is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_fit_with_helpers_is_the_fit_without(alone: Fitter, team: Helpers) -> None:
    model = with_free(free_model(), alone, VoltageBias())
    assert_same(replace(alone, hands=team).fit(model), alone.fit(model))
    assert len(team._hired) == 2


def test_so_is_one_of_all_effects_whose_columns_are_kept_and_probed(alone: Fitter, team: Helpers) -> None:
    model, joined = with_all(alone), replace(alone, hands=team)
    assert len(model.free) > alone.criteria.few_columns
    fits = [fit_along_chords(maker, model, rounds=4, tolerance=1e-4) for maker in (joined, alone)]
    assert_same(*fits)
    assert_same(joined.hold(fits[0].model), alone.hold(fits[1].model))


def test_so_is_one_that_begins_in_a_frame_of_other_noise_or_of_before(alone: Fitter, team: Helpers) -> None:
    noisier = ModelNoise(offset_scatter_a=1e-3)
    ends = []
    for maker in (alone, replace(alone, hands=team)):
        first = maker.fit(free_model(), maker.frame(free_model()))
        biased = with_free(first.model, maker, VoltageBias())
        weighed = maker.with_noise(noisier).fit(biased, first.frame)
        ends.append(maker.fit(with_free(weighed.model, maker, VoltageDelay()), first.frame))
    assert_same(*ends)


def test_a_frame_that_helpers_have_never_seen_has_them_hired_anew(alone: Fitter, team: Helpers) -> None:
    joined, model = replace(alone, hands=team), with_free(free_model(), alone, VoltageBias())
    joined.frame(model)
    before = [helper.pid for helper in team._hired]
    frame = alone.frame(model)
    assert_same(joined.evaluate(model, frame), alone.evaluate(model, frame))
    after = [helper.pid for helper in team._hired]
    assert not {*before} & {*after}
    joined.evaluate(model, frame)
    assert [helper.pid for helper in team._hired] == after
    team.retire()
    assert not any(map(is_there, [*before, *after]))


def test_frames_are_forgotten_with_their_fits(alone: Fitter, team: Helpers) -> None:
    joined, model = replace(alone, hands=team), with_free(free_model(), alone, VoltageDelay())
    for _ in range(3):
        joined.fit(model)
    gc.collect()
    assert not team._frames


def test_whoever_loses_a_helper_goes_on_alone_to_the_same_end(alone: Fitter, team: Helpers) -> None:
    joined, model = replace(alone, hands=team), with_free(free_model(), alone, VoltageBias())
    frame = joined.frame(model)
    pids = [helper.pid for helper in team._hired]
    os.kill(pids[0], signal.SIGKILL)
    fit = joined.evaluate(model, frame)
    assert_same(fit, alone.evaluate(model, frame))
    assert not any(map(is_there, pids))
    assert_same(joined.fit(model, frame), alone.fit(model, frame))
    assert not team._hired


def test_what_is_too_large_for_the_room_is_made_alone(
    alone: Fitter, team: Helpers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(helpers, "ROOM_BYTES", 1 << 14)
    model = with_free(free_model(), alone, VoltageBias())
    assert_same(replace(alone, hands=team).fit(model), alone.fit(model))


def test_where_nobody_can_be_hired_it_is_made_alone(
    alone: Fitter, team: Helpers, monkeypatch: pytest.MonkeyPatch
) -> None:
    fork, hired = os.fork, list[int]()

    def only_one() -> int:
        if hired:
            raise BlockingIOError("Resource temporarily unavailable")
        hired.append(fork())
        return hired[0]

    monkeypatch.setattr(os, "fork", only_one)
    model = with_free(free_model(), alone, VoltageBias())
    assert_same(replace(alone, hands=team).fit(model), alone.fit(model))
    assert not any(map(is_there, hired))


class OnceTooMuch:
    """Raises where it is led through a segment that begins late."""

    name: ClassVar[str] = "once_too_much"
    summary: ClassVar[str] = "Raises late."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    Parameters: ClassVar[type[EffectParameters]] = VoltageBias.Parameters
    needs: ClassVar = VoltageBias.needs

    def __init__(self, last_s: float) -> None:
        self._last_s = last_s

    def correct(self, signals: Signals, parameters: EffectParameters) -> Correction:
        if signals.start_s > self._last_s:
            raise ValueError("this late?")
        return Correction(v_ab=signals.v_ab + 1e-3)


def test_an_effect_that_raises_is_told_of_as_without_helpers(alone: Fitter, team: Helpers) -> None:
    starts = [piece.signals.start_s for piece in alone.prepared.pieces]
    joined, good = replace(alone, hands=team), with_free(free_model(), alone, VoltageBias())
    for last_s in (-1.0, starts[-2]):
        bad = with_free(free_model(), alone, OnceTooMuch(last_s), bias_a_v=0.1)  # type: ignore[arg-type]
        with pytest.raises(PluginError, match="once_too_much: correct: ValueError: this late"):
            joined.frame(bad)
        assert_same(joined.renewed(good), alone.renewed(good))


def test_helpers_leave_at_the_end(alone: Fitter) -> None:
    with helped(3) as hands:
        assert isinstance(hands, Helpers)
        joined = replace(alone, hands=hands)
        frame = joined.frame(free_model())
        pids = [helper.pid for helper in hands._hired]
        assert len(pids) == 2
        assert all(map(is_there, pids))
    assert not any(map(is_there, pids))
    assert_same(joined.evaluate(free_model(), frame), alone.evaluate(free_model(), frame))


EMPLOYER = """
import sys, time
from dataclasses import replace
from orchestrator.diagnosis.fitting.helpers import Helpers
from tests.orchestrator.diagnosis.pieces import Array, fitter, free_model, plan, prepared

team = Helpers(2)
maker = replace(fitter(prepared(plan(sparse=True))), hands=team)
maker.frame(free_model())
print(*(helper.pid for helper in team._hired), flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_helpers_leave_with_an_employer_that_is_killed(number: signal.Signals) -> None:
    here = Path(__file__).parents[4]
    command = [sys.executable, "-c", EMPLOYER]
    with subprocess.Popen(command, cwd=here, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as employer:
        assert employer.stdout is not None
        pids = [int(word) for word in employer.stdout.readline().split()]
        assert len(pids) == 2
        employer.send_signal(number)
    wait_until(lambda: not any(map(is_there, pids)), timeout_s=20.0)


def test_nobody_is_hired_beside_other_threads_nor_for_cores_that_are_busy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = tmp_path / "loadavg"
    monkeypatch.setattr(helpers, "LOAD", load)
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)))
    load.write_text("0.10 0.20 0.30 1/200 4711\n")
    assert processes_here() == helpers.MOST_PROCESSES
    load.write_text("0.10 0.20 0.30 7/200 4711\n")
    assert processes_here() == 2
    load.write_text("9.10 9.20 9.30 30/200 4711\n")
    assert processes_here() == 1
    load.write_text("no such thing here\n")
    assert processes_here() == helpers.MOST_PROCESSES
    monkeypatch.setattr(threading, "active_count", lambda: 2)
    assert processes_here() == 1

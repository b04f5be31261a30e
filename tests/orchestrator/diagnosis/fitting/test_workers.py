"""Threads change nothing of a fit but how long it takes, and end with the block they were made for."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from types import FrameType
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.columns import probe_segments
from orchestrator.diagnosis.fitting.fit import FEW_COLUMNS, Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.fitting.workers import MAX_WORKERS, Executor, executor_of, workers_here
from orchestrator.diagnosis.weak_form.batches import in_batches
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import EddyCurrents, Hysteresis
from plugins.effects.resistance import ResistanceWithTemperature
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset
from plugins.effects.timing import VoltageDelay
from protocols import Correction, EffectLayer, EffectParameters, ModelNoise, PluginError, Signals
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import Array, fitter, free_model, plan, prepared, with_voltage

MANY = (
    *(DeadTime(), VoltageBias(), VoltageDelay(), CurrentGainMismatch(), CurrentOffset()),
    *(EddyCurrents(), Hysteresis(), ResistanceWithTemperature()),
)
WAIT_S = 20.0


def threads_here() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("fluxbench-equations")]


@pytest.fixture(params=[1, 2, 3])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    with executor_of(request.param) as made:
        yield made


def test_results_are_in_the_items_order(executor: Executor) -> None:
    def late_where_early(item: int) -> int:
        time.sleep(0.002 * (10 - item))
        return item * item

    assert executor.map(late_where_early, range(10)) == [k * k for k in range(10)]
    assert executor.map(late_where_early, []) == []


def test_items_are_worked_on_at_the_same_time() -> None:
    other_is_there = [threading.Event(), threading.Event()]

    def meet(item: int) -> bool:
        other_is_there[1 - item].set()
        return other_is_there[item].wait(WAIT_S)

    with executor_of(2) as executor:
        assert executor.map(meet, [0, 1]) == [True, True]


def test_the_first_items_exception_is_raised_whichever_came_first() -> None:
    second_has_raised = threading.Event()

    def complain(item: int) -> None:
        if item == 2:
            second_has_raised.set()
        else:
            assert second_has_raised.wait(WAIT_S)
        raise ValueError(f"item {item}")

    with executor_of(2) as executor, pytest.raises(ValueError, match="item 1"):
        executor.map(complain, [1, 2])


def test_nothing_is_still_at_work_once_an_item_has_raised() -> None:
    running, begun = set[int](), list[int]()

    def work(item: int) -> None:
        begun.append(item)
        if item == 0:
            raise ValueError("the first")
        running.add(item)
        time.sleep(0.02)
        running.discard(item)

    with executor_of(2) as executor:
        with pytest.raises(ValueError, match="the first"):
            executor.map(work, range(200))
        assert not running
        assert len(begun) < 100
        seen = len(begun)
        # The threads are free for what comes next, and none of what was cancelled is begun after all.
        assert executor.map(lambda item: item, [1, 2, 3]) == [1, 2, 3]
        assert len(begun) == seen


def test_an_interrupt_ends_what_has_not_begun() -> None:
    """Ctrl-C reaches the thread that waits, while others are at work."""
    running, begun = set[int](), list[int]()
    main = threading.get_ident()

    def work(item: int) -> None:
        begun.append(item)
        running.add(item)
        if item < 10:
            signal.pthread_kill(main, signal.SIGINT)
        time.sleep(0.02)
        running.discard(item)

    def interrupt(number: int, frame: FrameType | None) -> None:
        # Python ignores exceptions in callbacks of weak references and of the collector: the next signal interrupts.
        if frame is not None and not frame.f_code.co_filename.endswith("weakref.py"):
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, interrupt)
    gc.disable()
    try:
        with executor_of(2) as executor:
            # A thread that is only just starting is not yet the pool's own.
            executor.map(time.sleep, [0.01] * 4)
            with pytest.raises(KeyboardInterrupt):
                executor.map(work, range(200))
            assert len(begun) < 100
            assert not running
    finally:
        gc.enable()
        signal.signal(signal.SIGINT, before)
    assert not threads_here()


def test_threads_have_ended_when_the_block_is_left_however_it_is_left() -> None:
    with executor_of(3) as executor:
        executor.map(time.sleep, [0.01] * 6)
        assert len(threads_here()) == 3
    assert not threads_here()
    with pytest.raises(ZeroDivisionError), executor_of(2) as executor:
        executor.map(lambda item: 1 / item, [1, 0])
    assert not threads_here()


def _leave_by_an_exception() -> None:
    with executor_of(2) as executor:
        executor.map(abs, [1, 2])
        raise LookupError("somewhere else")


def test_threads_have_ended_when_the_block_raises() -> None:
    with pytest.raises(LookupError):
        _leave_by_an_exception()
    assert not threads_here()


def test_one_worker_is_the_callers_own_thread() -> None:
    with executor_of(1) as executor:
        assert executor.map(lambda _: threading.get_ident(), [1, 2]) == [threading.get_ident()] * 2
        assert not threads_here()


@pytest.mark.posix
def test_there_are_no_more_workers_than_cores_and_no_more_than_gain_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores, workers in ((1, 1), (2, 2), (64, MAX_WORKERS)):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, cores=cores: set(range(cores)), raising=False)
        assert workers_here() == workers
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert workers_here() == 1


@pytest.fixture(scope="module")
def alone() -> Fitter:
    """In batches so small that there are some for each thread."""
    made = with_voltage(prepared(plan()), np.array([0.3, -0.2]))
    first = probe_segments(made.pieces)
    batches = in_batches(made.pieces, first, 2500)
    assert len(batches.all) > 6
    return replace(fitter(made), batches=batches)


@pytest.fixture
def joined(alone: Fitter) -> Iterator[Fitter]:
    with executor_of(2) as executor:
        yield replace(alone, executor=executor)


def with_all(maker: Fitter) -> Model:
    library = scaled_library(MANY, maker.prepared.manifest)
    return free_model().with_active([c.absent().moved(c.amplitudes[0], 0.2) for c in library])


def arrays_of(fit: Fit) -> list[Array]:
    return [*fit.residual, *fit.volts, *fit.columns, *fit.resistance, fit.normal, fit.linearisation.gram]


def assert_same(one: Fit, other: Fit) -> None:
    """To the last bit: not near, but the same."""
    assert one.objective == other.objective
    assert one.model.r_s == other.model.r_s
    assert [a.values for a in one.model.active] == [a.values for a in other.model.active]
    np.testing.assert_array_equal(one.model.magnetics.coefficients, other.model.magnetics.coefficients)
    for mine, theirs in zip(arrays_of(one), arrays_of(other), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for here, there in zip(one.linearisation.pieces, other.linearisation.pieces, strict=True):
        np.testing.assert_array_equal(here.white_basis, there.white_basis)
        np.testing.assert_array_equal(here.whitener.factor, there.whitener.factor)
        assert here.noise_parameters == there.noise_parameters
    for first, second in zip(one.linearisation.batches, other.linearisation.batches, strict=True):
        for name in ("i_ab", "v_ab", "resistance_ohm", "heat_j", "psi_ab", "psi_smooth_ab", "inductance_ab"):
            np.testing.assert_array_equal(getattr(first.base, name), getattr(second.base, name))


def test_a_fit_by_two_threads_is_the_fit_by_one(alone: Fitter, joined: Fitter) -> None:
    model = with_free(free_model(), alone, VoltageBias())
    assert_same(joined.fit(model), alone.fit(model))


def test_so_is_one_of_all_effects_whose_columns_are_kept_and_probed(alone: Fitter, joined: Fitter) -> None:
    model = with_all(alone)
    assert len(model.free) > FEW_COLUMNS
    fits = [fit_with_frozen_jacobian(maker, model, rounds=2, tolerance=1e-4) for maker in (joined, alone)]
    assert_same(*fits)
    assert_same(joined.hold(fits[0].model), alone.hold(fits[1].model))


def test_so_is_one_that_begins_in_a_frame_of_other_noise_or_of_before(alone: Fitter, joined: Fitter) -> None:
    ends = []
    for maker in (alone, joined):
        first = maker.fit(free_model(), maker.linearise(free_model()))
        biased = with_free(first.model, maker, VoltageBias())
        weighed = maker.with_noise(ModelNoise(offset_scatter_a=1e-3)).fit(biased, first.linearisation)
        ends.append(maker.fit(with_free(weighed.model, maker, VoltageDelay()), first.linearisation))
    assert_same(*ends)


class RaisesLate:
    """Raises where it is led through a segment that begins late."""

    name: ClassVar[str] = "raises_late"
    summary: ClassVar[str] = "Raises late."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    Parameters: ClassVar[type[EffectParameters]] = VoltageBias.Parameters
    needs: ClassVar = VoltageBias.needs

    def __init__(self, last_s: float) -> None:
        self._last_s = last_s

    def correct(self, signals: Signals, parameters: EffectParameters) -> Correction:
        if signals.start_s > self._last_s:
            raise ValueError(f"this late?{'' if self._last_s < 0.0 else f' {signals.start_s:.3f}'}")
        return Correction(v_ab=signals.v_ab + 1e-3)


def test_an_effect_that_raises_in_a_thread_raises_the_same_line_as_without(alone: Fitter, joined: Fitter) -> None:
    starts = [piece.signals.start_s for piece in alone.prepared.pieces]
    good = with_free(free_model(), alone, VoltageBias())
    # Everywhere, in half of the segments, in the last one.
    for last_s in (-1.0, starts[len(starts) // 2], starts[-2]):
        bad = with_free(free_model(), alone, RaisesLate(last_s), bias_a_v=0.1)  # type: ignore[arg-type]
        lines = []
        for maker in (alone, joined):
            with pytest.raises(PluginError, match="effects: raises_late: correct: ValueError: this late") as caught:
                maker.linearise(bad)
            lines.append(str(caught.value))
        assert lines[0] == lines[1]
        assert "\n" not in lines[0]
        assert_same(joined.relinearise(good), alone.relinearise(good))


class _Stop(Exception):
    """Raised by whoever ends a fit."""


@pytest.mark.parametrize("stop", [_Stop, KeyboardInterrupt])
def test_a_fit_ends_where_its_poll_raises(alone: Fitter, stop: type[BaseException]) -> None:
    polled = 0

    def poll() -> None:
        nonlocal polled
        polled += 1
        if polled == 3:
            raise stop

    model = with_free(free_model(), alone, DeadTime(), voltage_v=0.2)
    with executor_of(2) as executor:
        maker = replace(alone, executor=executor, poll=poll)
        with pytest.raises(stop):
            maker.fit(model, steps=50, relinearisations=50)
    assert polled == 3
    assert not threads_here()


def test_batches_of_any_size_come_to_the_same_fit(alone: Fitter) -> None:
    model = with_all(alone)
    whole = fitter(alone.prepared)
    one, other = (maker.evaluate(model, maker.linearise(model)) for maker in (alone, whole))
    assert len(one.linearisation.batches) > len(other.linearisation.batches)
    assert one.objective == pytest.approx(other.objective, rel=1e-9)
    for mine, theirs in zip(one.columns, other.columns, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=1e-8 * max(np.abs(theirs).max(initial=0.0), 1.0))

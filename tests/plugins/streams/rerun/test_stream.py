"""What ends up in view.rrd: everything, one step an effect, whole after any end, torn only by a kill."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from orchestrator.testing import StreamConformance
from plugins.streams.rerun import RerunOptions, RerunStream
from plugins.streams.rerun import _blueprints as blueprints
from plugins.streams.rerun._commissioning import Commissioning
from plugins.streams.rerun._diagnosis import Contents
from plugins.streams.rerun._tape import is_whole
from protocols import (
    Limits,
    Message,
    Motor,
    PointDone,
    PointStarted,
    ResistanceEstimate,
    ResistanceEstimated,
    ResistanceReading,
    RunEnded,
    RunStarted,
    SamplesCaptured,
    Segment,
    SegmentStage,
    StateChanged,
    Stream,
    StreamSetup,
)
from tests.plugins.streams.rerun.example_diagnosis import EFFECTS, a_diagnosis
from tests.plugins.streams.rerun.reading import entities, rows
from tests.plugins.streams.test_ripple import an_injection
from tests.support.close import assert_close

POINTS = 6


class TestRerun(StreamConformance):
    def make_stream(self, setup: StreamSetup) -> Stream:
        return RerunStream(setup)

    def options(self) -> BaseModel:
        return RerunOptions()


def a_commissioning(run: Path, points: int = POINTS) -> list[Message]:
    motor = Motor(name="linear", pole_pairs=2, rated_current_rms_a=1.66)
    limits = Limits(current_a=5.0, voltage_v=150.0)
    out: list[Message] = [
        RunStarted(
            run=str(run),
            name="short",
            motor=motor,
            limits=limits,
            drive="none",
            stages=1,
            points=points,
            points_done=0,
            seconds=9.0,
        ),
        StateChanged(source="connecting", target="sweeping_injection"),
    ]
    for k in range(points):
        name = f"injection-{k:03d}"
        capture = an_injection().model_copy(update={"start_s": 0.75 * k})
        segment = Segment(
            id=name, stage=SegmentStage.INJECTION, start_s=0.75 * k, samples=5000, settings={"frequency_hz": 500.0}
        )
        out += [
            PointStarted(id=name, stage_index=0, target_d_a=1.0, target_q_a=-0.5, seconds=0.75),
            SamplesCaptured(segment=name, rotor_angle_rad=0.0, capture=capture),
            PointDone(
                id=name,
                stage_index=0,
                segment=segment,
                achieved_d_a=1.01,
                achieved_q_a=-0.5,
                points_done=k + 1,
                points=points,
                seconds_left=0.0,
            ),
        ]
    return [*out, RunEnded(outcome="finished", reason="all done", run=str(run))]


def drawn(run: Path, messages: list[Message]) -> Path:
    run.mkdir(exist_ok=True)
    stream = RerunStream(StreamSetup(run=run, options=RerunOptions()))
    for message in messages:
        stream.receive(message)
    stream.close()
    return run / "view.rrd"


def errors(file: Path) -> list[dict[str, Any]]:
    """Rows of the error's lines that have a value."""
    return [
        row for row in rows(file, "/ladder/rms_mv") if any(k.endswith("Scalars:scalars") and v for k, v in row.items())
    ]


def gaps(file: Path, content: str) -> list[dict[str, Any]]:
    """Rows that end the lines of an entity."""
    return [row for row in rows(file, content) if any("Clear" in k and v is not None for k, v in row.items())]


def scalars(file: Path, content: str) -> list[list[float]]:
    """The scalars of an entity, row by row; rows of style alone are passed over, wherever in the file they are."""
    found = [value for row in rows(file, content) for key, value in row.items() if key.endswith("Scalars:scalars")]
    assert found
    return found


def test_a_commissioning_is_drawn_whole(tmp_path: Path) -> None:
    file = drawn(tmp_path / "run", a_commissioning(tmp_path))
    found = entities(file)
    assert is_whole(file)
    assert found["/drive/current"] == found["/drive/voltage"] == 50 * POINTS
    assert found["/point/inductance"] == found["/point/off_target"] == POINTS
    assert {"/state/machine", "/plane/amperes/achieved", "/ripple/d/fitted", "/flux/d/box/points"} <= set(found)
    for values in scalars(file, "/point/inductance"):
        np.testing.assert_allclose(values, [43.0, 4.0, 69.0], atol=0.2)
    for off in scalars(file, "/point/off_target"):
        assert_close(off, [10.0, 0.0], 1e-7)


def test_each_added_effect_is_one_step_and_the_error_falls(tmp_path: Path) -> None:
    file = drawn(tmp_path / "run", a_diagnosis())
    ladder = [row for row in rows(file, "/ladder/rms_mv") if row.get("effect_added") is not None]
    values = [next(v for k, v in row.items() if k.endswith("Scalars:scalars"))[0] for row in ladder]
    assert [row["effect_added"] for row in ladder] == list(range(len(EFFECTS) + 1))
    assert values == sorted(values, reverse=True)
    found = entities(file)
    for path in ("/residual/plane/amperes/windows", "/residual/phases/a", "/excerpts/0/predicted", "/loops/0/model"):
        assert found[path] == len(EFFECTS) + 1, path


def test_a_diagnosis_keeps_the_commissioning_s_tabs_on_one_timeline(tmp_path: Path) -> None:
    whole = blueprints.diagnosis(Contents(excerpts=1, loops=1, resistance=True), measured=True)
    names = [tab.name for tab in whole.root_container.contents]
    assert names[0] == "Which effect is missing?"
    assert {"What is it doing?", "What is the flux?", "How does R_s move?"} <= set(names)
    file = drawn(tmp_path / "run", [*a_commissioning(tmp_path), *a_diagnosis(pictures=False)])
    measured = max(row["experiment"] for row in rows(file, "/drive/current") if row.get("experiment") is not None)
    steps = [row["experiment"] for row in errors(file)]
    assert len(steps) == len(EFFECTS) + 1
    assert sorted(steps) == steps
    assert steps[0] > measured


def test_r_s_is_drawn_over_the_range_that_it_went_through() -> None:
    picture = Commissioning()
    assert picture.resistance_span_ohm is None
    readings = tuple(ResistanceReading(start_s=t, value_ohm=x, std_ohm=0.01) for t, x in ((1.0, 4.2), (9.0, 4.4)))
    estimate = ResistanceEstimate(value_ohm=4.3, low=4.29, high=4.31, first_ohm=4.2, last_ohm=4.4, readings=readings)
    picture.take(ResistanceEstimated(estimate=estimate))
    assert picture.resistance_span_ohm == pytest.approx((4.16, 4.44))


def test_a_second_round_goes_on_where_the_first_ended(tmp_path: Path) -> None:
    file = drawn(tmp_path / "run", [*a_diagnosis(), *a_diagnosis(pictures=False)])
    steps = [row["effect_added"] for row in errors(file)]
    # Beside the first, which clears what an earlier file may have had; their order in the file is none.
    (gap,) = [row for row in gaps(file, "/ladder/rms_mv") if "effect_added" in row]
    first, second = steps[: len(EFFECTS) + 1], steps[len(EFFECTS) + 1 :]
    assert first == list(range(len(EFFECTS) + 1))
    assert second == [step + len(EFFECTS) + 2 for step in first]
    assert first[-1] < gap["effect_added"] < second[0]


def test_no_line_leads_from_one_estimate_of_the_resistance_to_the_next(tmp_path: Path) -> None:
    file = drawn(tmp_path / "run", [*a_commissioning(tmp_path), an_estimate(4.25), an_estimate(4.31)])
    (gap,) = gaps(file, "/resistance/estimate")
    levels = [
        (row["experiment"], next(v for k, v in row.items() if k.endswith("Scalars:scalars"))[0])
        for row in rows(file, "/resistance/estimate")
        if any(k.endswith("Scalars:scalars") and v for k, v in row.items())
    ]
    assert [level for time, level in levels if time < gap["experiment"]] == [4.25, 4.25]
    assert [level for time, level in levels if time > gap["experiment"]] == [4.31, 4.31]


def test_a_resumed_run_keeps_what_was_drawn_before(tmp_path: Path) -> None:
    first = entities(drawn(tmp_path / "run", a_commissioning(tmp_path)[:-7]))
    file = drawn(tmp_path / "run", a_commissioning(tmp_path)[-7:])
    both = entities(file)
    assert both["/drive/current"] == 50 * POINTS
    assert both["/log"] > first["/log"]
    assert sorted(p.name for p in file.parent.iterdir()) == ["view.rrd"]


def an_estimate(value_ohm: float) -> ResistanceEstimated:
    reading = ResistanceReading(value_ohm=value_ohm, std_ohm=0.01, start_s=0.5)
    return ResistanceEstimated(
        estimate=ResistanceEstimate(
            value_ohm=value_ohm,
            low=value_ohm - 0.1,
            high=value_ohm + 0.1,
            first_ohm=value_ohm,
            last_ohm=value_ohm,
            readings=(reading,),
        )
    )


def draw_and_hang(run: Path, ready: Path) -> None:
    stream = RerunStream(StreamSetup(run=run, options=RerunOptions()))
    for message in a_commissioning(run)[:-1]:
        stream.receive(message)
    time.sleep(1.0)
    ready.touch()
    time.sleep(60.0)


@pytest.mark.slow
def test_what_was_sent_before_a_kill_is_in_the_file_and_survives_a_resumption(tmp_path: Path) -> None:
    run, ready = tmp_path / "run", tmp_path / "ready"
    run.mkdir()
    process = get_context("spawn").Process(target=draw_and_hang, args=(run, ready))
    process.start()
    try:
        deadline = time.monotonic() + 30.0
        while not ready.exists() and time.monotonic() < deadline:
            time.sleep(0.02)
    finally:
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        process.join()
    assert not is_whole(run / "view.rrd")
    assert entities(run / "view.rrd")["/drive/current"] == 50 * POINTS
    with (run / "view.rrd").open("r+b") as torn:
        torn.truncate(torn.seek(0, 2) - 7)
    file = drawn(run, a_commissioning(run)[-1:])
    assert is_whole(file)
    assert entities(file)["/drive/current"] >= 50 * (POINTS - 1)


@pytest.mark.parametrize("options", [{"view": "elsewhere"}, {"port": 0}, {"memory_limit": "much"}, {"bind": "0.0.0.0"}])
def test_options_that_make_no_sense_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        RerunOptions.model_validate(options)

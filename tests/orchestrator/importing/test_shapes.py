"""Logs in the shapes that strangers bring, each with a mapping of a few lines, are the measurement that they were."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from protocols import InputError
from tests.orchestrator.importing.shapes import (
    CURRENT,
    TIME,
    VOLTAGE,
    Shape,
    a_file_a_stage,
    counts,
    dates,
    duties,
    epoch,
    line_to_line,
    matlab_struct,
    scope_channels,
    shaft,
    ticks,
    two_loggers,
)
from tests.orchestrator.importing.strangers import Desk, log_of
from tests.support.cases import few

LOG = log_of()


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


SHAPES: list[Shape] = [
    duties, line_to_line, counts, ticks, epoch, dates, shaft, a_file_a_stage, scope_channels, matlab_struct,
]  # fmt: skip


@few("shape", SHAPES, fast=3)
def test_a_shape_is_imported_with_at_most_ten_lines(desk: Desk, shape: Shape) -> None:
    shape(desk, LOG)
    assert len(desk.mapping.splitlines()) <= 10
    report = desk.run()
    found = desk.segments()
    stage_of = [segment.stage.value for segment, _ in found for _ in range(segment.samples)]
    assert (report.samples, stage_of) == (LOG.t.size, LOG.stage)
    assert found[0][0].start_s < 110.0
    i, v = (np.concatenate([getattr(c, x) for _, c in found]) for x in ("i_ab", "v_ab"))
    np.testing.assert_allclose(i, LOG.i, rtol=0, atol=0.00054 if shape is counts else 1e-6)
    np.testing.assert_allclose(v, LOG.v, rtol=0, atol=1e-4)


@pytest.mark.parametrize("numbering", ["sectors", "bits_abc", "bits_cba"])
def test_switching_states_are_the_legs_times_the_bus(desk: Desk, numbering: str) -> None:
    legs = np.random.default_rng(1).integers(0, 2, (400, 3))
    number = {
        "sectors": [[0, 5, 3, 4], [1, 6, 2, 7]],
        "bits_abc": [[0, 1, 2, 3], [4, 5, 6, 7]],
        "bits_cba": [[0, 4, 2, 6], [1, 5, 3, 7]],
    }[numbering]
    states = np.array(number)[legs[:, 0], 2 * legs[:, 1] + legs[:, 2]]
    volts = 300.0 * (legs - legs.mean(axis=1, keepdims=True))
    i = np.zeros((400, 3))
    for k in range(399):
        i[k + 1] = i[k] + 1e-4 / 0.05 * (volts[k] - 40.0 * i[k])
    columns = dict(zip(("ia", "ib", "ic"), i.T, strict=True))
    desk.write("log.csv", {"t": np.arange(400) / 1e4, **columns, "sv": states, "bus": np.full(400, 300.0)})
    desk.mapping = TIME + CURRENT + "bus: {column: bus, unit: V}\nsegments: [{stage: classical}]\n"
    desk.mapping += f"voltage: {{frame: switching, columns: {{state: sv}}, numbering: {numbering}, unit: duty}}\n"
    desk.run()
    ((_, capture),) = desk.segments()
    a = capture.v_ab[:, 0]
    b = -0.5 * a + np.sqrt(0.75) * capture.v_ab[:, 1]
    np.testing.assert_allclose(np.column_stack([a, b]), volts[:, :2], atol=1e-3)


def test_one_axis_alone_is_stated_to_be_so(desk: Desk) -> None:
    part = LOG.rows(slice(3000, 23000))
    desk.write("log.csv", {"t": part.t, "u": part.v[:, 0], "i": part.i[:, 0]})
    only = "{frame: dq, columns: {d: %s}, other_axis: zero, unit: %s, scaling: amplitude_invariant}\n"
    desk.mapping = TIME + f"current: {only % ('i', 'A')}voltage: {only % ('u', 'V')}segments: [{{stage: classical}}]\n"
    desk.run()
    ((_, capture),) = desk.segments()
    np.testing.assert_allclose(capture.i_ab, np.column_stack([part.i[:, 0], 0 * part.t]), atol=1e-6)


def test_what_was_dropped_is_counted_in_rows(desk: Desk) -> None:
    part = LOG.rows(slice(0, 3000))
    ia = part.phases["ia"].copy()
    ia[[5, 700]] = np.nan
    labels = ["warm-up"] * 100 + ["resistance"] * 2900
    desk.write("log.csv", {"t": part.t, **part.phases, "ia": ia, **part.volts, "what": labels})
    desk.mapping = TIME + CURRENT + VOLTAGE + "split_at_gaps: true\nsegment_column: what\n"
    desk.mapping += "segments: [{label: resistance, stage: resistance}]\n"
    report = desk.run()
    assert report.rows == 3000
    assert report.dropped_rows == {"a value is missing": 1, "fits no entry of segments": 100}
    assert report.samples + sum(report.dropped_rows.values()) == report.rows


def test_an_epoch_in_any_order_begins_at_zero(desk: Desk) -> None:
    for name, part in (("second", slice(1500, 3000)), ("first", slice(0, 1500))):
        log = LOG.rows(part)
        desk.write(f"{name}.csv", {"t": log.t + 1.7e9, **log.phases, **log.volts})
    desk.mapping = TIME + CURRENT + VOLTAGE + "segments: [{stage: resistance}]\n"
    desk.run()
    starts = [segment.start_s for segment, _ in desk.segments()]
    assert starts == pytest.approx([0.0, LOG.t[1500] - LOG.t[0]], abs=1e-5)


@few("offset_s, ppm", [(0.0, 0.0), (-37.25, 40.0), (1234.5, -80.0)])
def test_two_loggers_are_aligned_by_their_edges(desk: Desk, offset_s: float, ppm: float) -> None:
    log = log_of(("injection-012", "injection-013"))
    two_loggers(desk, log, offset_s, ppm)
    report = desk.run()
    assert any("by voltage edges" in note for note in report.notes)
    found = desk.segments()
    v = np.concatenate([c.v_ab for _, c in found])
    at = np.searchsorted(log.t, np.concatenate([s.start_s + np.arange(s.samples) / 1e4 for s, _ in found]) - 1e-6)
    off = v - log.v[at]
    assert np.sqrt(np.mean(off**2)) < 0.025 * np.sqrt(np.mean(log.v**2))  # a thirtieth of a sample, with square waves


@pytest.mark.slow
def test_points_that_follow_each_other_in_equal_times_are_separated_by_their_means(desk: Desk) -> None:
    names = tuple(f"injection-{k:03d}" for k in (2, 4, 7, 10, 11, 12))
    log = log_of(names)
    ends = np.flatnonzero(np.diff(log.t, append=np.inf) > 1.5e-4) + 1
    lengths = np.diff(ends, prepend=0)
    even = np.concatenate([0.55 * k + np.arange(n) / 1e4 for k, n in enumerate(lengths)])
    two_loggers(desk, dataclasses.replace(log, t=even), 12.5, 40.0, rate_hz=5e4)
    (note,) = (note for note in desk.run().notes if "by voltage edges" in note)
    assert "-12.5" in note


def test_edges_that_repeat_leave_the_offset_open(desk: Desk) -> None:
    t = np.arange(20_000) / 1e4
    v = 20.0 * np.sign(np.sin(2 * np.pi * 500.0 * t + 1e-6))
    i = 2.0 + np.concatenate([[0.0], np.cumsum(v)[:-1]]) * 1e-4 / 0.05
    desk.write("amps.csv", {"t": t, "i": i})
    desk.write("volts.csv", {"t": t, "u": v + 4.25 * 2.0})
    only = "{frame: dq, columns: {d: %s}, other_axis: zero, unit: %s, scaling: amplitude_invariant}\n"
    desk.mapping = TIME + f"current: {only % ('i', 'A')}voltage: {only % ('u', 'V')}segments: [{{stage: injection}}]\n"
    desk.mapping += "files: [{file: volts*, beside: amps*, columns: [u], align: edges}]\n"
    with pytest.raises(
        InputError, match=r"volts.csv: align: the voltage's edges fit the current at more than one offset"
    ):
        desk.run()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("columns: [va, vb, vc], ", ""), "files.0: beside needs columns: those that this file has"),
        (("beside: amps*, ", ""), "files.0: columns needs the name in the file for each, such as {ia: CH1}"),
        (("beside: amps*", "beside: A*"), "volts.csv: beside: 1 files fit 'volts*', 0 fit 'A*': one each is needed"),
        (("file: volts*", "file: scope*"), "files.0: no file fits it ('scope*')"),
        (("unit: ms", "unit: msec"), "files.0.time.unit: expected 's', 'ms'"),
        (("align: edges", "align: edge"), "files.0.align: expected 'stamps' or 'edges', got 'edge'"),
        (("{file: volts*, ", "{"), "files.0.file: missing"),
        (("[va, vb, vc]", "[va, vb]"), "amps.csv: vc: no such column"),
    ],
)
def test_what_is_wrong_with_two_loggers_is_one_line(desk: Desk, change: tuple[str, str], message: str) -> None:
    two_loggers(desk, log_of(("injection-012",)), 0.0, 0.0, rate_hz=12_500.0)
    before = desk.mapping
    desk.mapping = before.replace(*change)
    assert desk.mapping != before
    with pytest.raises(InputError) as raised:
        desk.run()
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("time: {column: t, unit: tick}", "time: unit tick and tick_hz (ticks a second) go together"),
        ("time: {column: t, unit: iso, wraps_at: 9}", "time: dates do not wrap"),
        ("voltage: {frame: abc, columns: {a: va, b: vb}, unit: duty}", "voltage: of two duties the third is not known"),
        ("voltage: {frame: switching, columns: {state: s}, unit: duty}", "voltage: frame switching and numbering"),
        (
            "voltage: {frame: switching, columns: {state: s}, unit: V, numbering: sectors}",
            "voltage: frame switching has unit: duty",
        ),
        ("current: {frame: dq, columns: {d: i}, unit: A, scaling: rms}", "current: frame dq needs columns for d and q"),
        ("current: {frame: abc, columns: {a: i}, unit: A, other_axis: zero}", "current: other_axis: zero is for one"),
        (
            "current: {frame: abc, columns: {a: i, b: j}, unit: A, offset: {a: 1}}",
            "current: offset needs one number, or one for each of a, b",
        ),
        ("current: {frame: line_to_line, columns: {ab: i, bc: j}, unit: A}", "current.frame: expected 'abc', 'alpha_b"),
    ],
)
def test_a_word_that_is_wrong_is_reported(desk: Desk, section: str, message: str) -> None:
    desk.write("log.csv", {"t": LOG.t, **LOG.phases, **LOG.volts})
    key = section.partition(":")[0]
    parts = {"time": TIME, "current": CURRENT, "voltage": VOLTAGE} | {key: section + "\n"}
    desk.mapping = "".join(parts.values()) + "segments: [{stage: classical}]\n"
    with pytest.raises(InputError) as raised:
        desk.run()
    assert message in str(raised.value)


def test_dates_that_are_none_and_states_that_are_none_are_stated(desk: Desk) -> None:
    part = LOG.rows(slice(0, 100))
    desk.write("log.csv", {"t": ["yesterday"] * 100, **part.phases, **part.volts, "sv": [*[1] * 99, 9]})
    desk.mapping = "time: {column: t, unit: iso}\n" + CURRENT + VOLTAGE + "segments: [{stage: resistance}]\n"
    with pytest.raises(InputError, match=r"log.csv: t: expected dates as 2026-11-23T06:45:35.123"):
        desk.run()
    desk.mapping = "sampling_frequency_hz: 10000\n" + CURRENT + "segments: [{stage: resistance}]\n"
    desk.mapping += "voltage: {frame: switching, columns: {state: sv}, unit: duty, numbering: bits_abc}\n"
    with pytest.raises(InputError, match="sv: expected a switching state from 0 to 7, got 9 in row 100"):
        desk.run()

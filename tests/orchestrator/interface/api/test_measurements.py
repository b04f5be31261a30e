"""An open run or recording: tables that agree with the arrays, and missing results are errors."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from orchestrator.interface.api import Measurements, open
from protocols import InputError, RecordingError

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"


@pytest.fixture
def opened() -> Measurements:
    return open(DATA)


def test_it_stands_for_its_directory(opened: Measurements) -> None:
    assert Path(opened) == opened.path == DATA
    assert os.fspath(opened) == str(DATA)
    assert "pm400-reduced" in repr(opened)


def test_segments_are_in_order_of_time(opened: Measurements) -> None:
    starts = [segment.start_s for segment in opened.segments]
    assert starts == sorted(starts)
    assert len(starts) == len(opened.manifest.segments)


def test_waveforms_are_the_capture_as_a_table(opened: Measurements) -> None:
    segment = next(s for s in opened.segments if s.stage == "classical")
    capture, table = opened.capture(segment.id), opened.waveforms(segment.id)
    assert np.array_equal(table[["i_alpha_a", "i_beta_a"]], capture.i_ab)
    assert np.array_equal(table["v_dc_v"], capture.v_dc)
    lengths = np.hypot(table["v_d_v"], table["v_q_v"]) - np.hypot(table["v_alpha_v"], table["v_beta_v"])
    assert np.abs(lengths).max() < 1e-6 * np.abs(capture.v_ab).max()
    assert table.index.name == "time_s"
    assert table.index[0] == capture.start_s
    assert np.diff(table.index) == pytest.approx(1.0 / capture.sampling_frequency_hz, rel=1e-6)


def test_an_unknown_segment_is_named(opened: Measurements) -> None:
    with pytest.raises(InputError, match="classical-999: no such segment"):
        opened.waveforms("classical-999")


def test_what_was_not_made_yet_is_stated(opened: Measurements) -> None:
    with pytest.raises(RecordingError, match=r"estimates\.json: No such file or directory; `fluxbench estimate` makes"):
        _ = opened.estimates
    with pytest.raises(RecordingError, match=r"flux_map\.nc"):
        _ = opened.flux_map
    with pytest.raises(InputError, match="was not diagnosed yet"):
        _ = opened.diagnosis
    with pytest.raises(RecordingError, match=r"model\.json"):
        _ = opened.model


def test_no_recording_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"recording\.json"):
        open(tmp_path)

"""In the viewer itself, without a screen: every view of both layouts draws and none complains; data come at once."""

from __future__ import annotations

import io
import os
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun.experimental import ViewerClient

from plugins.streams.rerun import make_view
from plugins.streams.rerun._live import LiveFeed
from plugins.streams.rerun._replay import replay
from plugins.streams.rerun._shooting import headless_viewer, shoot
from plugins.streams.rerun._tape import scalars
from protocols import RecordingError
from tests.plugins.streams.rerun.example_diagnosis import a_diagnosis
from tests.plugins.streams.rerun.reading import entities
from tests.plugins.streams.rerun.test_stream import a_commissioning, an_estimate, drawn
from tests.support.tiny import run_tiny

IMPORTED = Path(__file__).parents[3] / "data" / "pm400-reduced"
DRIVERS = ("/etc/vulkan/icd.d", "/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")
"""Where Vulkan's loader looks for the manifests of drivers, if no variable names them."""


def has_vulkan() -> bool:
    """Whether a driver that draws is installed, of a graphics card or in software."""
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    return bool(named) or any(manifest for folder in DRIVERS for manifest in Path(folder).glob("*.json"))


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not has_vulkan(), reason="no Vulkan driver is installed (Debian: mesa-vulkan-drivers)"),
]


@pytest.fixture
def viewer() -> Iterator[ViewerClient]:
    """A new one each time, for it keeps its layout."""
    with headless_viewer() as client:
        yield client


def everything_draws(viewer: ViewerClient, file: Path, tabs: int) -> None:
    shots = shoot(viewer, file)
    assert len(shots) == tabs
    assert [complaint for shot in shots for complaint in shot.complaints] == []
    known = set(entities(file))
    for shot in shots:
        assert shot.views, f"{shot.tab}: no view is visible"
        for view in shot.views:
            assert any(p == view.origin or p.startswith(f"{view.origin}/") for p in known), f"{view.name} is empty"
        picture = np.asarray(Image.open(io.BytesIO(shot.png)).convert("RGB"))
        assert len(np.unique(picture.reshape(-1, 3)[::7], axis=0)) > 50, f"{shot.tab}: hardly anything is drawn"


def test_every_view_of_a_commissioning_draws(tmp_path: Path, viewer: ViewerClient) -> None:
    run_tiny(tmp_path)
    everything_draws(viewer, make_view(tmp_path / "run").file, tabs=7)


def test_every_view_of_a_diagnosis_draws(tmp_path: Path, viewer: ViewerClient) -> None:
    everything_draws(viewer, drawn(tmp_path / "run", a_diagnosis()), tabs=4)


def test_every_view_of_an_imported_recording_and_two_diagnoses_draws(tmp_path: Path, viewer: ViewerClient) -> None:
    messages = [*replay(IMPORTED), an_estimate(4.25), *a_diagnosis(), *a_diagnosis(pictures=False)]
    shots = shoot(viewer, drawn(tmp_path / "run", messages))
    assert [complaint for shot in shots for complaint in shot.complaints] == []
    views = {view.name for shot in shots for view in shot.views}
    assert "States" not in views  # nobody logged any
    assert {"The error falling [mV]", "R_s over the experiment [Ω]"} <= views


def test_a_run_and_its_diagnosis_are_in_one_layout_and_a_wrong_tab_is_reported_the_names(
    tmp_path: Path, viewer: ViewerClient
) -> None:
    file = drawn(tmp_path / "run", [*a_commissioning(tmp_path), *a_diagnosis(pictures=False)])
    with pytest.raises(RecordingError, match=r"none is named 'Flux'; there are: Which effect .*, What is it doing\?"):
        shoot(viewer, file, "Flux")
    shots = shoot(viewer, file, "What is it doing?")
    assert [shot.complaints for shot in shots] == [()]


def test_a_diagnosis_without_pictures_has_no_empty_tabs(tmp_path: Path, viewer: ViewerClient) -> None:
    everything_draws(viewer, drawn(tmp_path / "run", a_diagnosis(pictures=False)), tabs=2)


def test_what_is_logged_is_in_the_viewer_within_a_tenth_of_a_second(viewer: ViewerClient) -> None:
    port = int(viewer.url.rsplit(":", 1)[1].split("/")[0])
    feed = LiveFeed("latency", port, 1e7)
    took = []
    for number in range(1, 22):
        feed.put(scalars("drive/current", np.array([float(number)]), np.zeros((1, 2))))
        begun = time.perf_counter()
        while _last_s(viewer) < number:
            assert time.perf_counter() - begun < 10.0
        took.append(time.perf_counter() - begun)
        time.sleep(0.05)
    feed.close()
    print(f"median {1e3 * statistics.median(took):.0f} ms, worst {1e3 * max(took):.0f} ms")
    assert statistics.median(took) < 0.1


def _last_s(viewer: ViewerClient) -> float:
    """The latest time on the experiment's timeline that the viewer knows."""
    found = [r for r in viewer.get_state().recordings if r.store_id.endswith(":latency")]
    ends = [t.end for r in found for t in r.timelines if t.name == "experiment" and t.end is not None]
    return max(ends, default=-1) / 1e9

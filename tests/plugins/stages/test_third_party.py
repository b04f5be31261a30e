"""A stage of somebody else's is run, killed, resumed, reported and drawn like a built-in one: docs/plugins.md's."""

from __future__ import annotations

import configparser
import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from protocols import Note, PointDone, SegmentStage, StageStarted, StateChanged
from tests.orchestrator.testing.test_plugins_page import ROOT, snippets
from tests.plugins.streams.rerun.reading import rows
from tests.support.processes import FLUXBENCH, called, wait_until
from tests.support.tiny import STAGES, messages_of, tiny_file

SOAK = {"kind": "thermal_soak", "current_a": 2.0, "soak_s": 3.0, "every_s": 0.5, "duration_s": 0.2}
POINTS = 6
PROCEDURE = [STAGES[0], SOAK, {"kind": "estimate", "estimators": ["resistance"]}]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's stage, installed: its module, and the metadata that an installation would leave."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "bench_plugins").mkdir()
    (folder / "bench_plugins" / "thermal_soak.py").write_text(snippets()["bench_plugins/thermal_soak.py"])
    installed = folder / "bench_plugins-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-plugins\nVersion: 0.1\n")
    declared = tomllib.loads(snippets()["pyproject.toml"])["project"]["entry-points"]
    points = configparser.ConfigParser()
    points.read_dict({"fluxbench.stages": declared["fluxbench.stages"]})
    with (installed / "entry_points.txt").open("w", encoding="utf-8") as file:
        points.write(file)
    return folder


def start(package: Path, *words: str | Path) -> subprocess.Popen[str]:
    """A command where the package is installed."""
    paths = os.pathsep.join((str(package), str(ROOT)))
    return subprocess.Popen(
        [sys.executable, FLUXBENCH, *map(str, words)],
        cwd=package,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONUNBUFFERED": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def installed(package: Path) -> Iterator[None]:
    """The same in this process."""
    with installed_from(package):
        yield


@contextmanager
def installed_from(package: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(package))
        yield
    for name in [name for name in sys.modules if name.startswith("bench_plugins")]:
        del sys.modules[name]


def soaked(run: Path) -> list[str]:
    if not (run / "journal.jsonl").exists():
        return []
    return [m.id for m in messages_of(run) if isinstance(m, PointDone) and m.id.startswith("thermal_soak")]


@pytest.fixture(scope="module")
def run(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Killed in the middle of the soak, and resumed."""
    folder = tmp_path_factory.mktemp("soaked")
    (folder / "temp1_input").write_text("31250\n")
    stages = [PROCEDURE[0], {**SOAK, "thermometer": str(folder / "temp1_input")}, PROCEDURE[2]]
    # What is proved here is no matter of time: a machine that is busy may let the heart beat late.
    procedure = tiny_file(folder, drive={"realtime_factor": 1.0, "watchdog_s": 120.0}, stages=stages)
    path = folder / "run"
    process = start(package, "run", procedure, "--out", path)
    wait_until(lambda: len(soaked(path)) >= 2 or process.poll() is not None, timeout_s=120.0)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert 2 <= len(soaked(path)) < POINTS
    with installed_from(package):
        done = called("resume", path)
    assert done.returncode == 0, done.stderr
    return path


@pytest.mark.slow
def test_every_point_is_measured_once_whatever_happened(run: Path) -> None:
    assert soaked(run) == [f"thermal_soak-{k:03d}" for k in range(POINTS)]
    segments = open_recording(run).segments(SegmentStage.RESISTANCE)
    assert [segment.id for segment in segments] == soaked(run)
    assert all(segment.settings["anchor"] and segment.settings["current_d_a"] == 2.0 for segment in segments)


def test_its_state_is_the_run_s_and_its_title_is_stated(run: Path) -> None:
    messages = messages_of(run)
    assert [m.target for m in messages if isinstance(m, StateChanged)].count("soaking") == 2
    titles = {m.title for m in messages if isinstance(m, StageStarted) and m.stage == "thermal_soak"}
    assert titles == {"thermal soak"}


def test_the_thermometer_is_read_with_each_point_and_no_reading_is_lost(run: Path) -> None:
    notes = [m.text for m in messages_of(run) if isinstance(m, Note) and "°C" in m.text]
    # That of the point in which the run was killed may be there twice.
    assert list(dict.fromkeys(notes)) == [f"{point}: 31.2 °C" for point in soaked(run)]


def test_estimators_read_what_it_records(run: Path) -> None:
    found = json.loads((run / "results" / "estimates.json").read_text())
    assert found["resistance"]["value_ohm"] == pytest.approx(4.25, rel=0.1)


def test_the_run_says_which_plugin_it_needs(run: Path) -> None:
    plugins = RunDirectory.open(run).record.provenance.plugins
    assert ("bench-plugins", "thermal_soak") in {(plugin.distribution, plugin.name) for plugin in plugins}


def test_console_report_and_viewer_speak_of_it(package: Path, run: Path) -> None:
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "thermal soak" in page
    assert "31.2 °C" in page
    logged = " ".join(map(str, rows(run / "view.rrd", "/log/**")))
    assert "thermal soak" in logged
    assert "31.2 °C" in logged
    states = " ".join(map(str, rows(run / "view.rrd", "/state/machine")))
    assert states.count("soaking") >= 2, "drawn, with a name and a colour of its own"


@pytest.mark.usefixtures("installed")
def test_check_counts_it_and_the_schema_has_it(tmp_path: Path) -> None:
    summary = json.loads(called("check", tiny_file(tmp_path, stages=PROCEDURE), "--json").stdout)
    (row,) = [row for row in summary["stages"] if row["stage"] == "thermal_soak"]
    assert row["points"] == POINTS
    assert row["duration_s"] == pytest.approx(3.0)
    schema = json.loads(called("schema", "procedure").stdout)
    assert schema["$defs"]["ThermalSoakStage"]["properties"]["kind"] == {"const": "thermal_soak", "type": "string"}


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"soak_s": -1.0}, "stages.1.soak_s: "),
        ({"soak": 1.0}, "stages.1.soak: unknown key; did you mean 'soak_s'?"),
        ({"current_a": 50.0}, "stages.1.current_a: thermal_soak reaches 50 A"),
        ({"kind": "thermal_soa"}, "did you mean 'thermal_soak'?"),
    ],
)
def test_a_mistake_in_its_settings_is_one_line(tmp_path: Path, change: dict[str, object], complaint: str) -> None:
    stages = [PROCEDURE[0], {**SOAK, **change}, PROCEDURE[2]]
    done = called("check", tiny_file(tmp_path, stages=stages))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert complaint in done.stderr


def test_where_its_package_is_missing_the_run_is_reported_so_in_one_line(run: Path, tmp_path: Path) -> None:
    done = called("check", tiny_file(tmp_path, stages=PROCEDURE))
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "stages.1.kind: no stage plugin 'thermal_soak' is installed" in done.stderr
    view = called("report", run)
    assert view.returncode == 0, view.stderr  # what was measured can be looked at without it

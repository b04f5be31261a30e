"""What `fluxbench diagnose` says of R_s and the map that it leaves."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.estimation import estimate_recording
from orchestrator.interface.cli import _diagnosis
from tests.orchestrator.estimation.made_up import RECORDING, Resistance, Ripples
from tests.orchestrator.estimation.test_delivery import AGAINST, deliver


@pytest.fixture
def estimated(tmp_path: Path) -> Path:
    estimate_recording(RECORDING, [Resistance(), Ripples()], tmp_path)
    return tmp_path


def map_lines(estimated: Path, capsys: pytest.CaptureFixture[str], *, usable: bool) -> list[str]:
    report = deliver(estimated, *(() if usable else AGAINST))
    capsys.readouterr()
    _diagnosis._print_map(report, estimated / "results")
    return capsys.readouterr().out.splitlines()


def test_a_map_that_is_usable_is_named_with_its_file(estimated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line, accuracy = map_lines(estimated, capsys, usable=True)
    assert accuracy.endswith("your sensors' gain and the bus voltage's error, which no run shows, come on top")
    assert line.startswith("R_s 4.1")
    path = Path(line.split("flux map usable: ")[1])
    assert path == estimated / "results" / "flux_map.nc"
    assert path.is_file()


def test_of_a_map_that_is_not_it_is_stated_why(estimated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = map_lines(estimated, capsys, usable=False)
    assert line == "flux map: NOT RELIABLE: the model leaves 3 % unexplained"

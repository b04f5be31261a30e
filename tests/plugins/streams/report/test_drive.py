"""The report has a section on the drive once it has been tuned."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.tuning import DriveLimits, no_compensation, tune, write_tuning
from plugins.streams.report._collect import collect
from plugins.streams.report._page import render
from tests.orchestrator.tuning.machines import machine, saturated
from tests.plugins.streams.example_run import a_run_directory

LIMITS = DriveLimits(current_a=2.0, bus_v=300.0, speed_rad_s=600.0, sampling_hz=10e3, pwm_hz=10e3)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return a_run_directory(tmp_path / "run")


def test_a_run_that_was_not_tuned_has_no_such_section(run: Path) -> None:
    assert 'id="drive"' not in render(collect(run, reads_paths=False), draws=False)


@pytest.mark.usefixtures("undrawn")
def test_a_tuned_drive_has_its_figures_picture_and_files(run: Path) -> None:
    write_tuning(tune(machine(saturated()), LIMITS, no_compensation(2.0)), run / "tuning", "run")
    page = render(collect(run, reads_paths=False), draws=False)
    section = page[page.index('id="drive"') :].split("</section>")[0]
    for part in ("2 A peak, 300 V bus", "largest torque", "phase margin at least 60°", "tuning/analytic_drive.c"):
        assert part in section
    assert '<a href="#drive">the drive</a>' in page
    assert "data:image/svg" not in section
    drawn = render(collect(run, reads_paths=False))
    assert "data:image/svg" in drawn[drawn.index('id="drive"') :].split("</section>")[0]


def test_a_damaged_tuning_is_a_line_among_the_problems(run: Path) -> None:
    (run / "tuning").mkdir()
    (run / "tuning" / "tuning.json").write_text("{}")
    page = render(collect(run, reads_paths=False), draws=False)
    assert 'id="drive"' not in page
    assert "tuning.json" in page

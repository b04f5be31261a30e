"""The paper's page, from a shortened run of its procedure."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from orchestrator.config import load_procedure
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, start_run
from plugins.commands.reproduction._material import Material, collect
from plugins.commands.reproduction._page import write_page
from protocols import Procedure, RecordingError

SHORT = (
    "stages.4.held_a=[-3.0, 0.0, 3.0]",
    "stages.4.periods=2",
    "stages.5.held_a=[-3.0, 0.0, 3.0]",
    "stages.5.step_a=1.0",
    "stages.5.duration_s=1.0",
)


def run(procedure: Procedure, path: Path) -> Path:
    result = start_run(procedure, path, RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.error is None, result.outcome.reason
    return path


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    return collect(run(load_procedure("paper", overrides=SHORT), tmp_path_factory.mktemp("paper") / "run"))


@pytest.mark.slow
def test_loops_are_wide_without_compensation_and_narrow_with_it(material: Material) -> None:
    for loop in material.loops:
        assert np.ptp(loop.uncompensated) > 10.0 * np.ptp(loop.compensated)
        assert abs(np.interp(0.0, loop.mean_current, loop.mean)) < 1e-9 * np.ptp(loop.mean)


@pytest.mark.slow
def test_one_energy_is_nearer_to_the_truth_than_the_classical_map(material: Material) -> None:
    assert material.error_percent("energy")[0] < material.error_percent("classical")[0] < 3.0


@pytest.mark.slow
def test_every_figure_of_the_page_is_there(material: Material, tmp_path: Path) -> None:
    page = write_page(material, tmp_path / "page")
    shown = re.findall(r"\]\((\w+\.png)\)", page.read_text())
    assert len(shown) == 7
    for name in shown:
        assert (page.parent / name).read_bytes().startswith(b"\x89PNG")
    assert "1.3 %" in page.read_text()
    assert "nan" not in page.read_text()


@pytest.mark.slow
def test_a_run_without_the_papers_sweeps_is_refused(tmp_path: Path) -> None:
    few = load_procedure("paper", overrides=SHORT)
    few = few.model_copy(update={"stages": tuple(stage for stage in few.stages if stage.kind != "injection")})
    with pytest.raises(RecordingError, match="no estimate of injection"):
        collect(run(few, tmp_path / "run"))

"""The literal page and its budget, from shortened experiments."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from orchestrator.config import load_procedure
from plugins.commands.reproduction.literal import budget, evaluate, write_page
from plugins.commands.reproduction.literal._bench import measured_by, plant_of, with_plant
from plugins.commands.reproduction.literal._budget import ALL, RULE, Sources, errors_against, plants, row_of
from protocols import NotMeasuredError, Procedure

SHORT = (
    "stages.4.held_a=[-3.0, 0.0, 3.0]",
    "stages.4.periods=1",
    "stages.5.held_a=[-3.0, 0.0, 3.0]",
    "stages.5.step_a=0.5",
    "stages.5.duration_s=0.2",
    "stages.5.rotation_hz=5.0",
)


@pytest.fixture(scope="module")
def procedure() -> Procedure:
    return load_procedure("paper", overrides=SHORT)


def test_without_errors_the_rule_is_what_is_left(procedure: Procedure) -> None:
    errors, _ = errors_against(procedure)
    quiet = plants(procedure, Sources())[RULE]
    row = row_of(RULE, evaluate(measured_by(with_plant(procedure, quiet))), errors)
    assert row.resistance_ohm == pytest.approx((4.5, 4.5), rel=1e-4)
    assert row.literal.rms > 5.0 * row.trapezoids.rms > 5.0 * row.regression.rms
    assert row.literal.crossings.min() > 5.0 * row.regression.crossings.max()
    assert row.second_derivatives.rms < row.first_derivatives.rms
    assert (row.gap_percent["literal"] < -1.0).all()
    assert (np.abs(row.gap_percent["regression"]) < 0.5).all()


def test_an_experiment_without_paths_is_refused(procedure: Procedure) -> None:
    sweeps = procedure.model_copy(update={"stages": procedure.stages[4:5]})
    with pytest.raises(NotMeasuredError, match="paths of injection are expected"):
        evaluate(measured_by(with_plant(sweeps, plant_of(sweeps))))


@pytest.mark.slow
def test_the_page_has_every_bench_and_every_picture(procedure: Procedure, tmp_path: Path) -> None:
    measured = evaluate(measured_by(with_plant(procedure, plant_of(procedure))))
    found = budget(procedure, measured)
    assert found.row(ALL).literal.crossings.max() > found.row(RULE).literal.crossings.max()
    page = write_page(measured, found, tmp_path)
    text = page.read_text()
    for name in re.findall(r"\]\((literal-\w+\.png)\)", text):
        assert (page.parent / name).read_bytes().startswith(b"\x89PNG")
    for heading in ("What makes the errors", "Figure 7's gap", "Parity", "In what fluxbench and these pages differ"):
        assert f"## {heading}" in text
    assert "nan" not in text

"""What an effect does by the plant: the whole where it is alone, nothing where R_s follows, by size beside others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.blind.campaign import Campaign, rows_of
from tests.blind.hidden import Case, Truth, draw_case
from tests.blind.plant import HEALTHY
from tests.blind.removal import removals, without

SHORT = Campaign(period_s=0.2, injection_s=0.05, dwell_s=0.03)


def short(kind: str, index: int) -> Case:
    return dataclasses.replace(draw_case(kind, index, 11), campaign=SHORT)


@pytest.mark.slow
def test_what_is_alone_is_the_whole_error() -> None:
    case = short("single", 0)
    (done,) = removals(case).values()
    assert case.truths[0].name == "dead_time"
    assert np.isclose(done.of_error, 1.0, rtol=1e-3)
    assert done.is_material(0.002, 0.005)


@pytest.mark.slow
def test_what_r_s_follows_is_nothing() -> None:
    case = short("clean", 0)
    ohm = case.bench.plant.resistance
    bench = dataclasses.replace(case.bench, plant=case.bench.plant._replace(step_ohm=0.3 * ohm, step_at_s=-1.0))
    noise = Truth("noise", 1.0, changes={"bias_a": 0.0})
    hidden = (Truth("warmer", 1.0, changes={"step_ohm": 0.3 * ohm}), noise)
    other = bench.plant._replace(bias_a=0.02, bias_b=-0.01)
    done = removals(dataclasses.replace(case, bench=dataclasses.replace(bench, plant=other), truths=hidden))
    assert done["noise"].of_error > 0.99
    assert done["warmer"].of_excitation < 1e-3
    assert not done["warmer"].is_material(0.002, 0.005)


def test_without_its_effects_a_bench_is_healthy() -> None:
    case = short("ordinary", 0)
    bench = case.bench
    for truth in case.truths:
        bench = without(bench, truth)
    own = ("sample_s", "pole_pairs", "resistance", "bus_v", "noise", "quantum", "substeps")
    assert bench.plant._replace(**{name: getattr(HEALTHY, name) for name in own}) == HEALTHY
    assert np.allclose(bench.table.coefficients, bench.table.coefficients[:, ::-1])


@pytest.mark.slow
def test_rows_carry_the_voltage_in_which_they_were_impressed() -> None:
    case = short("clean", 0)
    late = dataclasses.replace(case.bench, drive_delay_samples=1.0)
    prompt = dataclasses.replace(case.bench, drive_delay_samples=0.0)
    assert all(len(i) == len(v) for _, i, v in rows_of(late, SHORT))
    counts = [sum(len(i) for _, i, _ in rows_of(bench, SHORT)) for bench in (prompt, late)]
    assert 0 < counts[0] - counts[1] < 100


@pytest.mark.slow
def test_slots_alone_are_the_whole_error() -> None:
    case = short("single", 17)
    (done,) = removals(case).values()
    assert case.truths[0].name == "slot_harmonics"
    assert np.isclose(done.of_error, 1.0, rtol=1e-3)

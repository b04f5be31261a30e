"""A fleet's table made up from known distributions, so that its statistics are known beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from protocols.fleet import FleetEffect, FleetRow, FleetSetPoint, arrow_schema

BEGAN = datetime(2026, 3, 2, 8, tzinfo=UTC)


@dataclass
class Fleet:
    """Motors of a line, an hour apart, in batches of fifty; a change is applied to the row of its number."""

    count: int = 120
    seed: int = 0
    changes: Mapping[int, Callable[[dict[str, Any]], None]] = field(default_factory=dict)
    batch_shift_h: dict[int, float] = field(default_factory=dict)
    drift_wb_per_day: float = 0.0
    effects: bool = True

    def rows(self) -> list[FleetRow]:
        """One a motor."""
        rng = np.random.default_rng(self.seed)
        return [self._row(k, rng) for k in range(self.count)]

    def _row(self, k: int, rng: np.random.Generator) -> FleetRow:
        n = rng.normal(size=6)
        batch, days = k // 50, k / 24.0
        temperature = 22.0 + 3.0 * n[0]
        r_s = 4.25 * (1.0 + 0.004 * n[1]) * (1.0 + 0.00393 * (temperature - 20.0))
        l_d = 0.0433 * (1.0 + 0.01 * n[2]) + self.batch_shift_h.get(batch, 0.0)
        l_q = 0.0672 * (1.0 + 0.008 * n[2] + 0.004 * n[3])
        psi = 0.25 * (1.0 + 0.003 * n[4]) + self.drift_wb_per_day * days
        size = 0.020 + 0.010 * n[5]
        row: dict[str, Any] = {
            "key": f"{k:08x}",
            "source": f"/line/{k:04d}",
            "name": f"{k:04d}",
            "serial": f"{k:04d}",
            "motor": "pm400",
            "batch": f"week {10 + batch}",
            "started_at": BEGAN + timedelta(days=days),
            "R_s_ohm": r_s,
            "R_s_low_ohm": r_s - 0.004,
            "R_s_high_ohm": r_s + 0.004,
            "temperature_c": temperature,
            "L_d_h": l_d,
            "L_q_h": l_q,
            "psi_pm_wb": psi,
            "saliency": l_q / l_d,
            "set_points": (FleetSetPoint(i_d_a=0.0, i_q_a=2.0, psi_d_wb=psi, psi_q_wb=2.0 * l_q),),
            "verdict": "explained" if self.effects else None,
            "usable": True,
            "chi2": 1.0 + 0.03 * abs(n[3]),
            "error_mv": 3.0,
            "error_before_mv": 30.0,
        }
        if self.effects:
            row["effects"] = (effect("phase_resistance_imbalance", "extra_b_ohm", size, 0.004, "ohm"),)
        if k in self.changes:
            self.changes[k](row)
        return FleetRow.model_validate(row)


def effect(name: str, parameter: str, size: float, half: float, unit: str) -> FleetEffect:
    """An effect with its 95 % interval."""
    return FleetEffect(
        name=name, parameter=parameter, size=size, unit=unit, low=size - half, high=size + half, probability=0.99
    )


def table_of(rows: list[FleetRow]) -> pa.Table:
    """The rows as they are in memory."""
    return pa.Table.from_pylist([row.model_dump() for row in rows], schema=arrow_schema())


def written(rows: list[FleetRow], path: Path) -> Path:
    """The rows as a data set of one file."""
    pq.write_table(table_of(rows), path)
    return path

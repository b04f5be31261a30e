"""The benches' fixtures, as the procedures' tests have them."""

from __future__ import annotations

from tests.orchestrator.config.conftest import bench, every_stage, pm400

__all__ = ["bench", "every_stage", "pm400"]

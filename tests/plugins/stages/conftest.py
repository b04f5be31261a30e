"""The benches' fixtures, as the procedures' tests have them."""

from __future__ import annotations

from tests.orchestrator.config.conftest import pm400

__all__ = ["pm400"]

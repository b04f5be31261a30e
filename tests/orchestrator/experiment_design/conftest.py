"""Recordings of the diagnosis' machine on paper."""

from __future__ import annotations

from tests.orchestrator.diagnosis.conftest import clean, with_dead_time

__all__ = ["clean", "with_dead_time"]

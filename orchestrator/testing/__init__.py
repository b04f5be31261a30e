"""Conformance kits: pytest base classes that check whether a plugin keeps its contract.

A plugin's author subclasses the kit of its kind in a test file, says how the plugin is made, and
runs pytest. The kits judge behaviour alone: whether a plugin is any good at its physics is a
question for its own tests. Nothing here is used while a motor runs.
"""

from orchestrator.testing._drive import DriveConformance
from orchestrator.testing._effect import EffectConformance
from orchestrator.testing._estimator import EstimatorConformance
from orchestrator.testing._recorded import recording_with
from orchestrator.testing._signals import exciting_signals, signals_of
from orchestrator.testing._stage import StageConformance
from orchestrator.testing._stream import StreamConformance

__all__ = [
    "DriveConformance",
    "EffectConformance",
    "EstimatorConformance",
    "StageConformance",
    "StreamConformance",
    "exciting_signals",
    "recording_with",
    "signals_of",
]

"""The benchmark of missing physics: what the set is, its seals, fluxbench's answers, and the scorer."""

from orchestrator.benchmark.definition import NAME, VERSION, Row, Size, effect_sizes, frozen_rows
from orchestrator.benchmark.running import answer_set, answerer, read_answers, read_manifest
from orchestrator.benchmark.sealing import data_sha256, truth_sha256

__all__ = [
    "NAME",
    "VERSION",
    "Row",
    "Size",
    "answer_set",
    "answerer",
    "data_sha256",
    "effect_sizes",
    "frozen_rows",
    "read_answers",
    "read_manifest",
    "truth_sha256",
]

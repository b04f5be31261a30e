"""ASAM MF4 (and MDF 3) measurements as blocks of columns, by asammdf where it is installed.

A channel brings its own time stamps; they are the column `timestamps`, in seconds, and have to be
the same for all channels of an import.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing._source import (
    TIMESTAMPS,
    Block,
    Numbers,
    Source,
    Wanted,
    as_labels,
    as_numbers,
    require_columns,
    same_length,
    unreadable,
)
from protocols import InputError


def open_mf4(path: Path, wanted: Wanted) -> Source:
    """A measurement file in ASAM's MDF format; raises `InputError` where asammdf is not installed."""
    try:
        from asammdf import MDF
    except ImportError as error:
        raise InputError(
            str(path), "", f"ASAM MDF files are read by asammdf: pip install 'fluxbench[mf4]' ({error})"
        ) from None
    try:
        with MDF(path) as file:
            return channels_of(file, path, wanted)
    except InputError:
        raise
    except Exception as error:  # asammdf raises MdfException, and other types for damaged files
        raise unreadable(path, "MDF", error) from None


def channels_of(file: Any, path: Path, wanted: Wanted) -> Source:
    """The wanted channels of an opened `asammdf.MDF`.

    Of its documented interface this uses `channels_db` (names, each with its places) and
    `get(name, ignore_invalidation_bits=True)`, which returns a signal with `samples`, `timestamps`, `unit` and
    `invalidation_bits`.

    Raises
    ------
    InputError
        Where a channel is missing or ambiguous, holds no numbers, or has other time stamps than the rest.
    """
    names = [name for name in wanted.all if name != TIMESTAMPS]
    if wanted.dates is not None:
        raise InputError(str(path), wanted.dates, "dates are for texts and tables; an MDF file has timestamps in s")
    require_columns(path, names, list(file.channels_db))
    for name in names:
        if len(file.channels_db[name]) > 1:
            raise InputError(str(path), name, f"{len(file.channels_db[name])} channels have this name")
    # By default asammdf drops invalid samples; the channels would then differ in length.
    signals = {name: file.get(name, ignore_invalidation_bits=True) for name in names}
    raster = _common_raster(path, signals)
    numbers = {name: raster if name == TIMESTAMPS else _samples(path, name, signals[name]) for name in wanted.numbers}
    labels = None if wanted.label is None else as_labels(np.asarray(signals[wanted.label].samples))
    units = {name: str(signal.unit).strip() for name, signal in signals.items()}
    return Source(_once(Block(numbers, labels)), units)


def _common_raster(path: Path, signals: dict[str, Any]) -> Numbers:
    same_length(path, {name: len(signal.timestamps) for name, signal in signals.items()})
    (first, reference), *others = ((n, np.asarray(s.timestamps, dtype=np.float64)) for n, s in signals.items())
    shortest = float(np.min(np.abs(np.diff(reference)), initial=np.inf))
    for name, stamps in others:
        apart = float(np.max(np.abs(stamps - reference), initial=0.0))
        if apart > 0.01 * shortest:  # within a hundredth of a sample the stamps count as equal
            raise InputError(
                str(path), name, f"its time stamps are up to {apart:.3g} s from those of {first}; export on one raster"
            )
    return reference


def _samples(path: Path, name: str, signal: Any) -> Numbers:
    samples = as_numbers(path, name, np.asarray(signal.samples))
    invalid = getattr(signal, "invalidation_bits", None)
    if invalid is not None:
        samples = np.where(np.asarray(invalid, dtype=bool), np.nan, samples)
    return samples


def _once(block: Block) -> Iterator[Block]:
    if len(block):
        yield block

"""Read recorder files with their own time raster: ASAM's MDF by asammdf, TDMS by npTDMS, COMTRADE by comtrade.

The raster is the column `timestamps`, in seconds, and has to be the same for all channels of an import; TDMS channels
are named ``Group/Channel``.
"""

from __future__ import annotations

from collections.abc import Mapping
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
from orchestrator.validation.plain_files import MAX_FILE_SIZES, read_bytes
from protocols import InputError


def open_mf4(path: Path, wanted: Wanted) -> Source:
    """A measurement file in ASAM's MDF format; raises `InputError` where asammdf is not installed."""
    try:
        from asammdf import MDF
    except ImportError as error:
        raise _missing(path, "ASAM MDF", "asammdf", "mf4", error) from None
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
    columns = {name: np.asarray(signal.samples) for name, signal in signals.items()}
    for name in wanted.numbers:
        invalid = getattr(signals.get(name), "invalidation_bits", None)
        if invalid is not None:
            columns[name] = np.where(np.asarray(invalid, dtype=bool), np.nan, as_numbers(path, name, columns[name]))
    columns[TIMESTAMPS] = _common_raster(path, signals)
    return _source(path, wanted, columns, {name: str(signal.unit).strip() for name, signal in signals.items()})


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


def open_tdms(path: Path, wanted: Wanted) -> Source:
    """A TDMS file; raises `InputError` where npTDMS is not installed."""
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise _missing(path, "TDMS", "npTDMS", "tdms", error) from None
    try:
        with TdmsFile.open(path) as file:
            channels = {f"{group.name}/{one.name}": one for group in file.groups() for one in group.channels()}
            require_columns(path, [name for name in wanted.all if name != TIMESTAMPS], [*channels, TIMESTAMPS])
            columns = {name: np.asarray(channels[name][:]) for name in wanted.all if name != TIMESTAMPS}
            if TIMESTAMPS in wanted.all:
                columns[TIMESTAMPS] = _track(path, {name: channels[name] for name in columns})
            units = {n: str(channels[n].properties.get("unit_string", "")) for n in columns if n in channels}
    except InputError:
        raise
    except Exception as error:  # npTDMS has no common base class for errors of damaged files
        raise unreadable(path, "TDMS", error) from None
    return _source(path, wanted, columns, units)


def _track(path: Path, channels: Mapping[str, Any]) -> Numbers:
    """The common raster of the channels, from their stated start and increment."""
    rasters: dict[tuple[float, float], str] = {}
    for name, channel in channels.items():
        properties = channel.properties
        if "wf_increment" not in properties:
            raise InputError(str(path), name, "does not say its sampling: name a time channel or the frequency")
        step, start = float(properties["wf_increment"]), float(properties.get("wf_start_offset", 0.0))
        rasters[step, start] = name
    if len(rasters) > 1:
        raise InputError(str(path), next(reversed(rasters.values())), "is on another raster than the other channels")
    (step, start) = next(iter(rasters))
    length = max(len(channel) for channel in channels.values())
    return np.asarray(start + step * np.arange(length), dtype=np.float64)


def open_comtrade(path: Path, wanted: Wanted) -> Source:
    """A COMTRADE recording by its .cfg (the .dat beside it) or .cff; raises `InputError` where comtrade is missing."""
    try:
        from comtrade import Comtrade
    except ImportError as error:
        raise _missing(path, "COMTRADE", "comtrade", "comtrade", error) from None
    record = Comtrade(ignore_warnings=True)
    try:
        if path.suffix.lower() == ".cfg":
            # A table of channels; the library would read any text file to its end.
            read_bytes(path, MAX_FILE_SIZES.hand_written_bytes)
        record.load(str(path))
        names = [str(name).strip() for name in record.analog_channel_ids]
        units = {n: str(c.uu).strip() for n, c in zip(names, record.cfg.analog_channels, strict=True)}
        every = {n: np.asarray(x, dtype=np.float64) for n, x in zip(names, record.analog, strict=True)}
        every[TIMESTAMPS] = np.asarray(record.time, dtype=np.float64)
    except Exception as error:  # comtrade has no common base class either
        raise unreadable(path, "COMTRADE", error) from None
    require_columns(path, wanted.all, list(every))
    return _source(path, wanted, {name: every[name] for name in wanted.all}, units)


def _source(path: Path, wanted: Wanted, columns: Mapping[str, Any], units: Mapping[str, str]) -> Source:
    if wanted.dates is not None:
        raise InputError(str(path), wanted.dates, f"dates are for texts and tables; use {TIMESTAMPS}, in s")
    rows = same_length(path, {name: len(column) for name, column in columns.items()})
    numbers = {name: as_numbers(path, name, columns[name]) for name in wanted.numbers}
    labels = None if wanted.label is None else as_labels(columns[wanted.label])
    return Source([Block(numbers, labels)] if rows else [], {name: unit for name, unit in units.items() if unit})


def _missing(path: Path, kind: str, library: str, extra: str, error: ImportError) -> InputError:
    problem = f"{kind} files are read by {library}: pip install 'fluxbench[{extra}]' ({error})"
    return InputError(str(path), "", problem)

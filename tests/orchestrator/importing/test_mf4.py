"""ASAM MF4 through the part of asammdf's interface that it documents; asammdf itself is not needed here."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

import numpy as np
import pytest

from orchestrator.importing import ImportReport, import_files
from protocols import InputError
from tests.orchestrator.importing.benches import RATE, Bench


@dataclass
class Signal:
    """Stands in for `asammdf.Signal`."""

    samples: Any
    timestamps: Any
    unit: str = ""
    invalidation_bits: Any = None


class Measurement:
    """Stands in for an opened `asammdf.MDF`."""

    def __init__(self, signals: dict[str, Signal]) -> None:
        self.signals = signals
        self.channels_db: dict[str, tuple[tuple[int, int], ...]] = {name: ((0, k),) for k, name in enumerate(signals)}

    def get(self, name: str, ignore_invalidation_bits: bool = False) -> Signal:
        assert ignore_invalidation_bits
        return self.signals[name]

    def add(self, name: str, signal: Signal) -> None:
        self.signals[name] = signal
        self.channels_db[name] = ((0, len(self.channels_db)),)

    def damage(self, name: str) -> None:
        """Let the directory of channels name one that is not there."""
        del self.signals[name]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.signals = {}


@pytest.fixture
def measurement(bench: Bench) -> Measurement:
    """The bench's measurement as channels on one raster."""
    t = bench.columns.pop("t")
    bench.mapping["time"] = {"column": "timestamps", "unit": "s"}
    units = {name: name[0].replace("i", "A").replace("v", "V") for name in bench.columns}
    return Measurement({name: Signal(x, t, units[name]) for name, x in bench.columns.items()})


@pytest.fixture
def run(bench: Bench, measurement: Measurement, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the measurement by a module that stands in for asammdf."""
    stand_in = ModuleType("asammdf")
    stand_in.MDF = lambda path: measurement  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "asammdf", stand_in)
    path = bench.folder / "log.mf4"
    path.write_bytes(b"MDF")

    def run_() -> ImportReport:
        return import_files(bench.write_mapping(), [path], bench.folder / "recording")

    return run_


def test_channels_become_a_recording(bench: Bench, run: Any) -> None:
    assert run().notes == ()
    (capture,) = bench.captures()
    assert capture.i_abc is not None
    np.testing.assert_array_equal(capture.i_abc[:, 2], bench.columns["ic"].astype("f4"))


def test_a_unit_that_the_file_contradicts_is_doubted(measurement: Measurement, run: Any) -> None:
    measurement.signals["ib"].unit = "mA"
    with pytest.raises(InputError, match=r"log\.mf4: ib: is in mA by the file, in A by the mapping"):
        run()


def test_channels_on_different_rasters_are_refused(measurement: Measurement, run: Any) -> None:
    measurement.signals["ib"].timestamps = measurement.signals["ib"].timestamps + 5e-5
    with pytest.raises(InputError, match=r"ib: its time stamps are up to 5e-05 s from those of ia"):
        run()


def test_channels_of_different_lengths_are_refused(measurement: Measurement, run: Any) -> None:
    measurement.signals["ib"].timestamps = measurement.signals["ib"].timestamps[:-1]
    with pytest.raises(InputError, match=r"ib: has 399 samples, but ia has 400"):
        run()


def test_invalid_samples_are_missing(measurement: Measurement, run: Any) -> None:
    measurement.signals["ib"].invalidation_bits = np.arange(400) == 7
    with pytest.raises(InputError, match=r"ib: row 8 .* has no finite value"):
        run()


def test_a_missing_channel_is_stated(bench: Bench, run: Any) -> None:
    bench.mapping["current"]["columns"]["a"] = "iaa"
    with pytest.raises(InputError, match=r"iaa: no such column; did you mean 'ia'\?"):
        run()


def test_a_name_of_several_channels_is_refused(measurement: Measurement, run: Any) -> None:
    measurement.channels_db["ia"] = ((0, 0), (1, 0))
    with pytest.raises(InputError, match="ia: 2 channels have this name"):
        run()


def test_whatever_asammdf_raises_is_one_line(run: Any, measurement: Measurement) -> None:
    measurement.damage("va")
    with pytest.raises(InputError, match=r"log\.mf4: not a readable MDF file: 'va'"):
        run()


def test_labels_may_be_bytes(bench: Bench, measurement: Measurement, run: Any) -> None:
    measurement.add("what", Signal(np.repeat([b"R", b"C"], 200), np.arange(400) / RATE))
    rules = [{"label": "R", "stage": "resistance"}, {"label": "C", "stage": "classical"}]
    bench.mapping |= {"segment_column": "what", "segments": rules}
    assert run().segments == 2


def test_without_asammdf_the_way_to_get_it_is_stated(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    path: Path = bench.folder / "log.mf4"
    path.write_bytes(b"MDF")
    with pytest.raises(
        InputError, match=r"log\.mf4: ASAM MDF files are read by asammdf: pip install 'fluxbench\[mf4\]'"
    ):
        import_files(bench.write_mapping(), [path], bench.folder / "recording")

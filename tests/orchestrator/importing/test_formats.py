"""Files of recorders and of MATLAB's objects, written by their own libraries, are read as what was put into them."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter

from protocols import InputError
from tests.orchestrator.importing.strangers import Desk, log_of

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import matio
    from matio.utils.matclass import MatlabOpaque

LOG = log_of(("classical-005",)).rows(slice(0, 2000))
COLUMNS = {**LOG.phases, **LOG.volts}
T = LOG.t - LOG.t[0]


def mapping(name: Callable[[str], str], time: str) -> str:
    i, v = (", ".join(f"{x}: '{name(kind + x)}'" for x in "abc") for kind in "iv")
    return (
        f"current: {{frame: abc, columns: {{{i}}}, unit: A}}\nvoltage: {{frame: abc, columns: {{{v}}}, unit: V}}\n"
        f"time: {{column: '{time}', unit: s}}\nsegments: [{{stage: classical}}]\n"
    )


def tdms(path: Path) -> str:
    raster = {"wf_increment": 1e-4, "wf_start_offset": 0.0}
    with TdmsWriter(path) as file:
        units = {name: {"unit_string": "A" if name[0] == "i" else "V"} for name in COLUMNS}
        file.write_segment([ChannelObject("Bench", name, x, raster | units[name]) for name, x in COLUMNS.items()])
    return mapping(lambda name: f"Bench/{name}", "timestamps")


def comtrade(path: Path) -> str:
    n = len(COLUMNS)
    of = enumerate(((name, "A" if name[0] == "i" else "V") for name in COLUMNS), start=1)
    channels = [f"{k},{name},,,{unit},0.001,0,0,-999999,999999,1,1,P" for k, (name, unit) in of]
    head = ["bench,7,1999", f"{n},{n}A,0D", *channels, "50", "1", f"10000,{T.size}"]
    head += 2 * ["23/11/2026,06:45:35.000000"] + ["ASCII", "1"]
    path.write_text("\r\n".join(head) + "\r\n")
    rows = np.column_stack([np.rint(1000.0 * x) for x in COLUMNS.values()]).astype(int)
    lines = (f"{k + 1},{100 * k},{','.join(map(str, row))}" for k, row in enumerate(rows.tolist()))
    path.with_suffix(".dat").write_text("\r\n".join(lines) + "\r\n")
    return mapping(str, "timestamps")


def hdf5_datasets(path: Path) -> str:
    with h5py.File(path, "w") as file:
        file["log/t"] = T
        file["log/volts"] = np.column_stack([LOG.volts[x] for x in ("va", "vb", "vc")])
        amps = np.zeros(T.size, dtype=[(x, "f8") for x in LOG.phases])
        for name, x in LOG.phases.items():
            amps[name] = x
        file["log/amps"] = amps
    column = {"va": 1, "vb": 2, "vc": 3}
    return mapping(lambda n: f"log/volts(:,{column[n]})" if n in column else f"log/amps.{n}", "log/t")


def timeseries(x: Any, implicit: bool) -> Any:
    """As MATLAB keeps it: an even time is kept as its start, increment and length."""
    nothing = np.zeros((0, 0))
    step = np.array([[1e-4]]) if implicit else nothing
    info = {"Start_": np.array([[0.0]]), "Increment_": step, "Length": np.array([[float(T.size)]])}
    return MatlabOpaque(
        {
            "Name": np.array(["x"]),
            "Data_": np.reshape(x, (1, 1, -1)) if implicit else np.reshape(x, (-1, 1)),
            "Time_": nothing if implicit else np.reshape(T, (-1, 1)),
            "TimeInfo": MatlabOpaque(info, "tsdata.timemetadata"),
        },
        "timeseries",
    )


def series(version: str, implicit: bool) -> Callable[[Path], str]:
    def write(path: Path) -> str:
        matio.save_to_mat(path, {name: timeseries(x, implicit) for name, x in COLUMNS.items()}, version=version)
        return mapping(lambda name: f"{name}.Data", "ia.Time")

    return write


def table(path: Path) -> str:
    logged = {"log": {"amps": pd.DataFrame({"t": T, **LOG.phases})}, **LOG.volts}
    matio.save_to_mat(path, logged, version="v7")
    return mapping(lambda name: name if name[0] == "v" else f"log.amps.{name}", "log.amps.t")


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("log.tdms", tdms),
        ("log.cfg", comtrade),
        ("log.h5", hdf5_datasets),
        ("v7.mat", series("v7", True)),
        ("v73.mat", series("v7.3", False)),
        ("table.mat", table),
    ],
)
def test_what_was_written_is_read(tmp_path: Path, name: str, write: Callable[[Path], str]) -> None:
    desk = Desk(tmp_path, write(tmp_path / name), [tmp_path / name])
    desk.run()
    ((segment, capture),) = desk.segments()
    assert segment.samples == T.size
    np.testing.assert_allclose(capture.i_ab, LOG.i, atol=0.001)
    np.testing.assert_allclose(capture.v_ab, LOG.v, atol=0.001)


@pytest.mark.parametrize(
    ("name", "write", "library", "extra"),
    [
        ("log.tdms", tdms, "nptdms", "tdms"),
        ("log.cfg", comtrade, "comtrade", "comtrade"),
        ("v7.mat", series("v7", False), "matio", "matlab"),
        ("v73.mat", series("v7.3", False), "matio", "matlab"),
    ],
)
def test_without_its_library_the_way_to_get_it_is_stated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, write: Callable[[Path], str], library: str, extra: str
) -> None:
    desk = Desk(tmp_path, write(tmp_path / name), [tmp_path / name])
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=rf"{name}: .*pip install 'fluxbench\[{extra}\]'"):
        desk.run()


@pytest.mark.parametrize(("name", "write"), [("log.tdms", tdms), ("log.cfg", comtrade), ("v7.mat", series("v7", True))])
def test_a_damaged_file_and_a_missing_channel_are_one_line(
    tmp_path: Path, name: str, write: Callable[[Path], str]
) -> None:
    path = tmp_path / name
    desk = Desk(tmp_path, write(path).replace("ib", "ixx"), [path])
    with pytest.raises(InputError, match="ixx"):
        desk.run()
    path.write_bytes(path.read_bytes()[:90])
    with pytest.raises(InputError) as raised:
        desk.run()
    assert len(str(raised.value).splitlines()) == 1
    assert not (tmp_path / "recording").exists()


def test_a_table_of_channels_larger_than_any_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "log.cfg"
    desk = Desk(tmp_path, comtrade(path), [path])
    os.truncate(path, 3_000_000_000)
    with pytest.raises(InputError, match="3000 MB are too large for such a file"):
        desk.run()


def test_a_whole_object_and_a_wrong_shape_are_stated(tmp_path: Path) -> None:
    path = tmp_path / "v7.mat"
    desk = Desk(tmp_path, series("v7", True)(path).replace("ia.Data", "ia"), [path])
    with pytest.raises(InputError, match=r"v7.mat: ia: is a MATLAB object; give a property of it, e.g. ia.Data"):
        desk.run()
    path = tmp_path / "log.h5"
    desk = Desk(tmp_path, hdf5_datasets(path).replace("volts(:,1)", "volts"), [path])
    with pytest.raises(InputError, match=r"log/volts: the dataset has the shape \(2000, 3\); name a column"):
        desk.run()

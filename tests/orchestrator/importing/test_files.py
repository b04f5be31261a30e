"""Files of every kind: layouts that are read, and what is wrong with the others in one line."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.importing import ImportReport, import_files
from protocols import Capture, InputError
from tests.orchestrator.importing.benches import Bench, held_current, phase_log
from tests.orchestrator.importing.test_mapping import spoilt


def run_file(bench: Bench, path: Path) -> ImportReport:
    return import_files(bench.write_mapping(), [path], bench.folder / "recording")


def complaint(bench: Bench, path: Path) -> str:
    with pytest.raises(InputError) as raised:
        run_file(bench, path)
    assert len(str(raised.value).splitlines()) == 1
    return str(raised.value).removeprefix(f"{bench.folder}/")


def first_phase(bench: Bench) -> Any:
    (capture,) = bench.captures()
    assert isinstance(capture, Capture)
    assert capture.i_abc is not None
    return capture.i_abc[:, 0]


def expected(bench: Bench) -> Any:
    return np.asarray(bench.columns["ia"], dtype="f4")


# CSV


def as_text(bench: Bench, *, delimiter: str = ",", decimal: str = ".", before: str = "", after: str = "") -> str:
    """The measurement as text, with lines before and after the one with the names."""
    rows = (
        delimiter.join(repr(float(x)).replace(".", decimal) for x in row)
        for row in zip(*bench.columns.values(), strict=True)
    )
    return before + delimiter.join(bench.columns) + "\n" + after + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("layout", "text"),
    [
        ({"delimiter": ";", "decimal": ","}, {"delimiter": ";", "decimal": ","}),
        ({"delimiter": "\t"}, {"delimiter": "\t"}),
        ({"skip_rows": 2, "skip_rows_after_names": 1}, {"before": "Scope 7\nProbe x10\n", "after": "s,A,A,A,V,V,V\n"}),
    ],
)
def test_text_in_other_layouts_is_read(bench: Bench, layout: dict[str, Any], text: dict[str, str]) -> None:
    bench.mapping["csv"] = layout
    path = bench.folder / "log.txt"
    path.write_text(as_text(bench, **text))
    run_file(bench, path)
    np.testing.assert_array_equal(first_phase(bench), expected(bench))


def test_text_in_another_encoding_is_read(bench: Bench) -> None:
    bench.columns["Temp °C"] = np.full(400, 25.0)
    bench.mapping |= {"csv": {"encoding": "latin-1"}, "temperature": {"column": "Temp °C", "unit": "degC"}}
    path = bench.folder / "log.csv"
    path.write_bytes(as_text(bench).encode("latin-1"))
    run_file(bench, path)
    (capture,) = bench.captures()
    assert capture.temperature_c is not None


def test_text_without_names_gets_them_from_the_mapping(bench: Bench) -> None:
    bench.mapping["csv"] = {"names": list(bench.columns)}
    path = bench.folder / "log.csv"
    path.write_text(as_text(bench).split("\n", 1)[1])
    run_file(bench, path)
    np.testing.assert_array_equal(first_phase(bench), expected(bench))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("ia,", "i_a,", 1), "ia: no such column; did you mean 'i_a'?"),
        (lambda text: text.replace("ib,", "ia,", 1), "ib: no such column"),
        (lambda text: text.replace(",", "\t"), "t: no such column, but in one that holds several: separated by tabs?"),
        (lambda text: text.replace(",", ";"), "separated by semicolons? (csv: {delimiter: ';'})"),
        (lambda text: text.replace("t,ia,ib", "t,ia,ib,ia", 1), "log.csv: "),
        (lambda text: text.replace("\n0.0001,", "\n0.0001,x", 1), "log.csv: ia: line 3: expected a number, got 'x"),
        (
            lambda text: text + "1,2\n",
            "the last line is cut off: line 402 has 2 columns, but the names are 7; delete it",
        ),
        (
            lambda text: text.replace("\n", ",1\n", 9).replace(",1\n", "\n", 8),
            "line 9 has 8 columns, but the names are 7",
        ),
        (
            lambda text: text.replace(",", ";").replace(".", ","),
            "state csv: {delimiter: ';', decimal: ','} in the mapping",
        ),
        (lambda text: "", "log.csv: not a readable CSV file: Empty CSV file"),
        (lambda text: text.split("\n")[0] + "\n", "log.csv: no segment in it; it holds no complete row"),
    ],
)
def test_what_is_wrong_with_a_text_is_reported(bench: Bench, change: Any, message: str) -> None:
    path = bench.folder / "log.csv"
    path.write_text(change(as_text(bench)))
    assert message in complaint(bench, path)


def test_two_columns_of_one_name_are_not_chosen_from(bench: Bench) -> None:
    bench.columns = {"ia ": bench.columns["ia"], **bench.columns}
    path = bench.folder / "log.csv"
    path.write_text(as_text(bench).replace("ia ,", "ia,", 1))
    assert "log.csv: ia: 2 columns have this name" in complaint(bench, path)


SMALL = Bench(Path(), *phase_log(*held_current(12)))


def outcome_of(bench: Bench, path: Path) -> ImportReport | str:
    try:
        return run_file(bench, path)
    except InputError as error:
        return str(error)


@given(content=st.binary(max_size=200) | spoilt(as_text(SMALL)))
def test_any_bytes_are_a_measurement_or_the_project_s_error(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), {}, SMALL.mapping)
        path = bench.folder / "log.csv"
        path.write_bytes(content)
        outcome = outcome_of(bench, path)
        assert (bench.folder / "recording").exists() == isinstance(outcome, ImportReport)
    assert isinstance(outcome, ImportReport) or len(outcome.splitlines()) == 1


# Parquet


def test_nulls_are_missing_samples(bench: Bench) -> None:
    ia = bench.columns["ia"].tolist()
    ia[4] = None
    path = bench.folder / "log.parquet"
    pq.write_table(pa.table(bench.columns | {"ia": pa.array(ia)}), path)
    assert complaint(bench, path).startswith("log.parquet: ia: row 5 (t = 0.0004 s) has no finite value")


def test_integers_are_numbers(bench: Bench) -> None:
    bench.columns["ia"] = np.round(bench.columns["ia"] * 1e3).astype("i2")
    bench.columns |= {name: bench.columns[name] * 1e3 for name in ("ib", "ic")}
    bench.mapping["current"]["unit"] = "mA"
    bench.files = {"log.parquet": bench.columns}
    bench.run()
    np.testing.assert_allclose(first_phase(bench), bench.columns["ia"] / 1e3, rtol=1e-6)


def test_texts_are_no_numbers(bench: Bench) -> None:
    bench.files = {"log.parquet": bench.columns | {"ia": ["x"] * 400}}
    with pytest.raises(InputError, match=r"log\.parquet: ia: expected real numbers"):
        bench.run()


@pytest.mark.parametrize("name", ["log.parquet", "log.mat", "log.mf4"])
def test_a_damaged_file_is_reported(bench: Bench, name: str) -> None:
    path = bench.folder / name
    path.write_bytes(b"PAR1 this is none of them" * 20)
    assert complaint(bench, path).startswith(f"{name}: ")


# MATLAB


def renamed(bench: Bench, how: dict[str, str]) -> None:
    """Let the mapping name its columns as they are kept in the file."""
    bench.mapping["time"]["column"] = how.get("t", "t")
    for section in ("current", "voltage"):
        columns = bench.mapping[section]["columns"]
        bench.mapping[section]["columns"] = {axis: how.get(name, name) for axis, name in columns.items()}


def matrices(bench: Bench) -> dict[str, Any]:
    return {"t": bench.columns["t"], "i": np.column_stack([bench.columns[name] for name in ("ia", "ib", "ic")])}


def test_fields_elements_and_matrix_columns_of_version_5_are_read(bench: Bench) -> None:
    volts = np.zeros((1, 3), dtype=object)
    for k, name in enumerate(("va", "vb", "vc")):
        volts[0, k] = {"values": bench.columns[name]}
    path = bench.folder / "log.mat"
    scipy.io.savemat(path, {"log": {"time": bench.columns["t"], "i": matrices(bench)["i"]}, "scope": {"ch": volts}})
    how = {"t": "log.time"} | {f"i{x}": f"log.i(:,{k})" for k, x in enumerate("abc", 1)}
    with pytest.raises(InputError):
        run_file(bench, path)
    # savemat keeps a list of structs as a cell array, which has no names of its own.
    elements = np.zeros((1, 3), dtype=[("values", object)])
    for k, name in enumerate(("va", "vb", "vc")):
        elements[0, k]["values"] = bench.columns[name]
    scipy.io.savemat(path, {"log": {"time": bench.columns["t"], "i": matrices(bench)["i"], "ch": elements}})
    renamed(bench, how | {f"v{x}": f"log.ch({k}).values" for k, x in enumerate("abc", 1)})
    run_file(bench, path)
    np.testing.assert_array_equal(first_phase(bench), expected(bench))


def test_fields_elements_and_matrix_columns_of_version_7_3_are_read(bench: Bench) -> None:
    path = bench.folder / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("log")
        log["time"] = bench.columns["t"][None, :]
        log["i"] = matrices(bench)["i"].T  # kept transposed
        for k, name in enumerate(("va", "vb", "vc")):
            file[f"#refs#/{k}"] = bench.columns[name][None, :]
        values = log.create_dataset("ch/values", (3, 1), dtype=h5py.ref_dtype)
        values[:, 0] = [file[f"#refs#/{k}"].ref for k in range(3)]
    how = {"t": "log.time"} | {f"i{x}": f"log.i(:,{k})" for k, x in enumerate("abc", 1)}
    renamed(bench, how | {f"v{x}": f"log.ch({k}).values" for k, x in enumerate("abc", 1)})
    run_file(bench, path)
    np.testing.assert_array_equal(first_phase(bench), expected(bench))


def write_5(path: Path, variables: dict[str, Any]) -> None:
    scipy.io.savemat(path, variables)


def write_73(path: Path, variables: dict[str, Any]) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            array = np.asarray(values)
            file[name] = array.T if array.ndim == 2 else array[None, :]


@pytest.mark.parametrize("write", [write_5, write_73])
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("shor", "shor: no such column; did you mean 'short'?"),
        ("i", "i: expected a vector, got"),
        ("i(:,4)", "i(:,4): the matrix has 3 columns"),
        ("ia.x", "ia.x: ia is no struct"),
        ("i[2]", "i[2]: expected a name as in MATLAB"),
        ("z", "z: expected real numbers, got complex128"),
        ("short", "short: has 5 samples, but t has 400"),
    ],
)
def test_what_is_wrong_with_a_matlab_file_is_reported(bench: Bench, write: Any, name: str, message: str) -> None:
    variables = bench.columns | matrices(bench) | {"z": np.full(400, 1j), "short": np.ones(5)}
    write(bench.folder / "log.mat", variables)
    renamed(bench, {"ia": name})
    assert message in complaint(bench, bench.folder / "log.mat")


def test_labels_in_matlab_files_are_numbers_or_texts(bench: Bench) -> None:
    rules = [{"label": "one", "stage": "resistance"}, {"label": "two", "stage": "classical"}]
    bench.mapping |= {"segment_column": "what", "segments": rules}
    path = bench.folder / "log.mat"
    scipy.io.savemat(path, bench.columns | {"what": np.repeat(np.array(["one", "two"], dtype=object), 200)})
    assert run_file(bench, path).segments == 2

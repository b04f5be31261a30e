"""An inconsistent mapping is reported with file, line, key and the valid value."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.importing import MappingFile, read_mapping
from protocols import InputError
from tests.orchestrator.importing.benches import Bench, held_current, phase_log

VALID = yaml.safe_dump(phase_log(*held_current(10))[1], sort_keys=False)


def complaint(bench: Bench) -> str:
    with pytest.raises(InputError) as raised:
        read_mapping(bench.write_mapping())
    line = str(raised.value)
    assert len(line.splitlines()) == 1
    return line.removeprefix(f"{bench.folder}/")


def test_a_misspelt_key_is_named_with_its_line_and_the_nearest_one(bench: Bench) -> None:
    bench.mapping["current"]["colums"] = bench.mapping["current"].pop("columns")
    message = complaint(bench)
    assert message.startswith("mapping.yaml:")
    assert "current.colums: unknown key; did you mean 'columns'?" in message


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("current", "unit"), "Amp", "current.unit: expected 'A', 'mA', 'uA' or 'kA', got 'Amp'"),
        (("current", "unit"), "V", "current.unit: expected 'A'"),
        (("current", "frame"), "uvw", "current.frame: expected 'abc', 'alpha_beta' or 'dq'"),
        (("current", "columns"), {"a": "ia"}, "frame abc needs columns for two or all of a, b, c, got a"),
        (("current", "columns"), {"a": "ia", "q": "iq"}, "frame abc needs columns for two or all of a, b, c"),
        (("current", "scaling"), "power_invariant", "phase quantities have no transform"),
        (("current", "columns", "a"), "i\na", "current.columns.a: "),
        (("current", "factor"), 0, "current.factor: a factor of zero leaves nothing"),
        (("current", "angle"), {"value": 0.0, "unit": "rad"}, "current: frame abc has no angle"),
        (("time",), None, "time: missing; name the time column, or give sampling_frequency_hz"),
        (("rotor_angle",), {"unit": "rad"}, "rotor_angle: expected either value or column"),
        (("rotor_angle",), {"unit": "rad", "value": 1.0, "column": "x"}, "expected either value or column"),
        (("segments",), [], "segments: "),
        (("segments", 0, "label"), "x", "segments.0.label: needs segment_column"),
        (("segments", 0, "stage"), "warmup", "segments.0.stage: should be 'gates_off'"),
        (("segments", 0, "id"), "../x", "segments.0.id: "),
        (("segments", 0, "from_s"), "soon", "segments.0.from_s: expected a number in s, got 'soon'"),
        (("csv",), {"delimiter": ",", "decimal": ","}, "csv: delimiter and decimal are both ','"),
        (("accept",), ["everything"], "accept.0: should be 'current_unit'"),
        (("motor", "pole_pairs"), 1.5, "motor.pole_pairs: expected a whole number"),
        (("motor",), "plate.yaml", "plate.yaml: cannot be read: No such file"),
        (("version",), 2, "version: expected 1, got 2"),
    ],
)
def test_what_is_wrong_is_stated_with_its_key(bench: Bench, path: tuple[Any, ...], value: Any, message: str) -> None:
    here: Any = bench.mapping
    for key in path[:-1]:
        here = here[key]
    here[path[-1]] = value
    assert message in complaint(bench)


def test_a_range_that_ends_before_it_begins_is_reported(bench: Bench) -> None:
    bench.mapping["segments"][0] |= {"from_s": 2.0, "to_s": 1.0}
    assert "segments.0: to_s 1 is not after from_s 2" in complaint(bench)


def test_vectors_need_their_scaling(bench: Bench) -> None:
    bench.mapping["voltage"] = {"frame": "dq", "columns": {"d": "vd", "q": "vq"}, "unit": "V"}
    assert "voltage: frame dq needs scaling: amplitude_invariant" in complaint(bench)


def test_phase_currents_are_not_given_twice(bench: Bench) -> None:
    bench.mapping["phase_currents"] = {"columns": {"a": "x", "b": "y", "c": "z"}, "unit": "A"}
    assert "phase_currents: the current is given in phases already" in complaint(bench)


@pytest.mark.parametrize("name", ["missing.yaml", ".", "\0"])
def test_a_file_that_cannot_be_read_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"cannot be read|is a directory; expected a YAML file"):
        read_mapping(tmp_path / name)


def spoilt(text: str) -> st.SearchStrategy[bytes]:
    """Bytes of a file with a piece of it replaced by others."""
    raw = text.encode()
    places = st.tuples(
        st.integers(0, len(raw)),
        st.integers(0, 12),
        st.binary(max_size=12) | st.text(max_size=6).map(lambda inserted: inserted.encode("utf-8", "surrogatepass")),
    )
    return places.map(lambda place: raw[: place[0]] + place[2] + raw[place[0] + place[1] :])


def outcome_of(path: Path) -> MappingFile | str:
    try:
        return read_mapping(path)
    except InputError as error:
        return str(error)


@given(content=st.binary(max_size=200) | spoilt(VALID))
def test_any_bytes_are_a_mapping_or_the_project_s_error(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mapping.yaml"
        path.write_bytes(content)
        outcome = outcome_of(path)
    assert isinstance(outcome, MappingFile) or len(outcome.splitlines()) == 1

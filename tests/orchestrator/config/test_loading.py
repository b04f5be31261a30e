"""Loading procedures: strict, and every complaint is one line with file, line, key and the nearest valid name."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.config import check_plan, load_motor, load_procedure, make_plan, read_procedure
from protocols import CapabilityError, PluginError, Procedure, ProcedureError, shipped_procedure, shipped_procedures

TEXT = """\
format: fluxbench-procedure
version: 1
name: mine
motor:
  name: m
  pole_pairs: 2
  rated_current_rms_a: 1.66
drive:
  name: simulated
limits:
  current_a: 5.0
  voltage_v: 150.0
stages:
  - kind: gates_off
  - kind: resistance
    points_a: [[1.0, 0.0], [2.0, 0.0]]
  - kind: estimate
    estimators: [classical]
"""

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def make(text: str) -> Path:
        path = tmp_path / "mine.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return make


def complaint(call: Callable[[], object]) -> str:
    with pytest.raises(ProcedureError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", shipped_procedures())
def test_every_shipped_procedure_loads(name: str) -> None:
    procedure = load_procedure(name)
    assert procedure.name == name
    assert procedure.summary


def test_a_file_loads_and_leaves_are_plain(write: Write) -> None:
    procedure = load_procedure(str(write(TEXT)))
    assert procedure.motor.pole_pairs == 2
    assert procedure.stages[1].kind == "resistance"
    assert procedure.stages[1].settings == {"points_a": [[1.0, 0.0], [2.0, 0.0]]}


@pytest.mark.parametrize("name", shipped_procedures())
def test_a_shipped_procedure_survives_being_written_and_read_again(name: str, write: Write) -> None:
    procedure = load_procedure(name)
    assert Procedure.model_validate_json(procedure.model_dump_json()) == procedure
    assert load_procedure(str(write(yaml.safe_dump(procedure.model_dump(mode="json"))))) == procedure


number = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=1e-30, allow_infinity=False)
angle = st.floats(min_value=-12.0, max_value=12.0)
seconds = st.floats(min_value=1e-30, max_value=86_400)
point = st.tuples(number, number)
stages = st.one_of(
    st.fixed_dictionaries({"kind": st.just("gates_off")}, optional={"duration_s": seconds}),
    st.fixed_dictionaries({"kind": st.just("operator"), "prompt": st.text()}, optional={"answer": st.just("yes")}),
    st.fixed_dictionaries({"kind": st.just("alignment")}, optional={"angle_rad": angle, "current_a": positive}),
    st.fixed_dictionaries(
        {"kind": st.just("resistance")},
        optional={"points_a": st.lists(point, max_size=3), "settle_s": seconds, "anchor": st.booleans()},
    ),
    st.fixed_dictionaries(
        {"kind": st.just("classical")},
        optional={
            "held_a": st.lists(number, max_size=3),
            "periods": st.integers(1),
            "amplitude_a": st.none() | positive,
        },
    ),
    st.fixed_dictionaries(
        {"kind": st.just("injection")},
        optional={"pattern": st.sampled_from(["grid", "paths"]), "amplitudes_v": st.lists(positive, max_size=2)},
    ),
)


# PyYAML writes YAML 1.1, where 0E0 is a word; what it quotes too little is left out.
words = st.text(st.characters(exclude_categories=["Cs"])).filter(lambda text: not text[:1].isdigit())


@given(written=st.lists(stages, min_size=1, max_size=4), seed=st.integers(-(2**40), 2**40), summary=words)
def test_any_procedure_survives_being_written_as_yaml(
    tmp_path_factory: pytest.TempPathFactory, written: list[dict[str, Any]], seed: int, summary: str
) -> None:
    raw = yaml.safe_load(TEXT) | {"stages": written, "seed": seed, "summary": summary}
    procedure = Procedure.model_validate_json(json.dumps(raw))
    path = tmp_path_factory.getbasetemp() / "round-trip.yaml"
    path.write_text(yaml.safe_dump(procedure.model_dump(mode="json")), encoding="utf-8")
    assert load_procedure(str(path)) == procedure


def replaced(old: str, new: str) -> str:
    assert old in TEXT
    return TEXT.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "line", "field", "problem"),
    [
        (replaced("current_a: 5.0", "currant_a: 5.0"), 11, "limits.currant_a", "did you mean 'current_a'?"),
        (replaced("points_a:", "periods: 2\n    points_a:"), 16, "stages.1.periods", "unknown key"),
        (replaced("points_a:", "point_a:"), 16, "stages.1.point_a", "did you mean 'points_a'?"),
        (replaced("kind: gates_off", "kind: gates_of"), 14, "stages.0.kind", "did you mean 'gates_off'?"),
        (replaced("kind: gates_off", "duration_s: 1"), 14, "stages.0.kind", "missing"),
        (replaced("name: simulated", "name: simulatd"), 9, "drive.name", "did you mean 'simulated'?"),
        (replaced("[classical]", "[classic]"), 18, "stages.2.estimators.0", "did you mean 'classical'?"),
        (
            replaced("voltage_v: 150.0", "voltage_v: 40 A"),
            12,
            "limits.voltage_v",
            "expected a number in V, or a quantity",
        ),
        (replaced("pole_pairs: 2", "pole_pairs: 2.5"), 6, "motor.pole_pairs", "whole number"),
        (replaced("pole_pairs: 2", "pole_pairs: true"), 6, "motor.pole_pairs", "got True"),
        (replaced("current_a: 5.0", "current_a: true"), 11, "limits.current_a", "expected a number in A, got True"),
        (replaced("current_a: 5.0", "current_a: -5.0"), 11, "limits.current_a", "greater than 0, got -5.0"),
        (replaced("current_a: 5.0", "current_a: 5e-324"), 11, "limits.current_a", "4.94066e-324 is too small a number"),
        (replaced("current_a: 5.0", "current_a: .nan"), 11, "limits.current_a", "finite"),
        (replaced("current_a: 5.0", "current_a: -.inf"), 11, "limits.current_a", "finite"),
        (replaced("current_a: 5.0", "current_a: 1e999"), 11, "limits.current_a", "too large"),
        (replaced("current_a: 5.0", "current_a:"), 11, "limits.current_a", "got None"),
        (replaced("  current_a: 5.0\n", ""), 10, "limits.current_a", "missing"),
        (replaced("[2.0, 0.0]", "[2.0]"), 16, "stages.1.points_a.1.1", "missing"),
        (replaced("  name: m\n", "  name: m\n  name: n\n"), 6, "motor.name", "written twice (first in"),
        (replaced("version: 1", "version: 2"), 2, "version", "expected 1"),
        (replaced("name: mine", "name: my procedure"), 3, "name", "pattern"),
        (replaced("limits:", "limits: []\nlimit:"), 11, "limit", "did you mean 'limits'?"),
        (
            replaced("  - kind: gates_off\n", "  - kind: operator\n    prompt: x\n    answer: no\n"),
            16,
            "answer",
            "'yes'",
        ),
        (replaced("motor:", "motor: &m"), 4, "", "anchors and aliases"),
        (replaced("name: mine", "name: !!python/object:os.system x"), 3, "", "tag"),
        (replaced("name: mine", "name: !!binary aGVsbG8="), 3, "", "tag"),
        (replaced("version: 1", "? [a, b]\n: 1"), 2, "", "a key has to be a word"),
        (replaced("limits:", "limits: [1, 2"), 11, "", "not YAML"),
        (replaced("  pole_pairs: 2", "\tpole_pairs: 2"), 6, "", "indent with spaces"),
        (TEXT + "---\nname: second\n", 19, "", "a second document"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(write: Write, text: str, line: int, field: str, problem: str) -> None:
    path = write(text)
    found = complaint(lambda: load_procedure(str(path)))
    assert found.startswith(f"{path}:{line}: "), found
    assert field in found
    assert problem in found


def test_a_rule_of_the_whole_procedure_names_the_line_of_the_stage(write: Write) -> None:
    text = replaced(
        "  - kind: gates_off\n",
        "  - kind: operator\n    prompt: free?\n    brake: release\n  - {kind: classical, settle_s: 0.2}\n",
    )
    loaded = read_procedure(str(write(text)), overrides=["stages.2.duration_s=1", "stages.2.settle_s=1"])
    with (
        pytest.raises(CapabilityError, match=r"mine\.yaml:17: stages\.1: classical with the brake released"),
        loaded.locating_errors(),
    ):
        check_plan(make_plan(loaded.procedure, None), None)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# nothing\n",
        "- a\n- b\n",
        "just words",
        "[" * 5000,
        '{"a": ' * 5000,
        "a: " + "9" * 5000,
        "\x00",
        "\ud7ff\x07",
    ],
)
def test_what_is_no_procedure_at_all_is_one_line(write: Write, text: str) -> None:
    path = write(text)
    assert complaint(lambda: load_procedure(str(path))).startswith(str(path))


def test_a_file_that_is_not_text_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_bytes(b"\xff\xfe\x00")
    assert "not UTF-8" in complaint(lambda: load_procedure(str(tmp_path / "mine.yaml")))


def test_words_that_yaml_1_1_takes_for_something_else_stay_words(write: Write) -> None:
    text = replaced("kind: gates_off", "kind: operator\n    prompt: on\n    answer: yes")
    stage = load_procedure(str(write(text))).stages[0]
    assert stage.kind == "operator"
    assert stage.settings == {"prompt": "on", "answer": "yes"}


def test_numbers_may_be_written_as_people_write_them(write: Write) -> None:
    text = replaced("current_a: 5.0", "current_a: 5e0").replace("voltage_v: 150.0", "voltage_v: +150")
    limits = load_procedure(str(write(text))).limits
    assert (limits.current_a, limits.voltage_v) == (5.0, 150.0)


def test_a_name_that_is_not_shipped_lists_those_that_are() -> None:
    found = complaint(lambda: load_procedure("dmo"))
    assert "did you mean 'demo'?" in found
    for name in shipped_procedures():
        assert name in found


@pytest.mark.parametrize("source", ["nowhere.yaml", "./demo", "a/b", "/", "", "x\0y", "a" * 5000])
def test_a_file_that_is_not_there_is_one_line(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    complaint(lambda: load_procedure(source))


# --- overrides


def test_overrides_reach_keys_and_list_items_and_come_in_order() -> None:
    overrides = ["limits.current_a=3", "seed=9", "stages.6.points_a=[[0.5, 0]]", "limits.energy_j=1e4", "seed=10"]
    procedure = load_procedure("demo", overrides=overrides)
    assert (procedure.limits.current_a, procedure.limits.energy_j, procedure.seed) == (3.0, 1e4, 10)
    assert procedure.stages[6].kind == "resistance"
    assert procedure.stages[6].settings["points_a"] == [[0.5, 0.0]]


def test_an_override_may_reach_into_a_section_that_was_left_out() -> None:
    assert load_procedure("demo", overrides=["control.bandwidth_hz=40"]).control.bandwidth_hz == 40.0


def test_an_override_may_set_a_drives_own_option() -> None:
    drive = load_procedure("demo", overrides=["drive.plant.effects.dead_time.voltage_v=2", "drive.x=true"]).drive
    assert drive.options["plant"]["effects"]["dead_time"]["voltage_v"] == 2
    assert drive.options["x"] is True


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("limits.current_a", "expected key.path=value"),
        ("=3", "expected key.path=value"),
        ("limits..current_a=3", "expected key.path=value"),
        ("limits.currant_a=3", "did you mean 'current_a'?"),
        ("limit.current_a=3", "did you mean 'limits'?"),
        ("limits.current_a=40 V", "expected a number in A, or a quantity such as '5 A' or '5 mA', got '40 V'"),
        ("limits.current_a=", "expected a number in A, got None"),
        ("limits.current_a=.nan", "finite"),
        ("limits.current_a=nan", "expected a number in A, got 'nan'"),
        ("limits.current_a=[", "not YAML"),
        ("stages.99.kind=x", "expected an index from 0 to"),
        ("stages.first.kind=x", "expected an index from 0 to"),
        ("name.x=1", "nothing is below it"),
        ("stages.0.kind=gates_of", "did you mean 'gates_off'?"),
    ],
)
def test_a_wrong_override_is_named_itself(override: str, problem: str) -> None:
    found = complaint(lambda: load_procedure("demo", overrides=["seed=2", override]))
    assert found.startswith(f"--set {override}: ")
    assert problem in found


@given(value=st.floats(min_value=1e-6, max_value=1e6))
def test_any_number_can_be_set(value: float) -> None:
    assert load_procedure("demo", overrides=[f"limits.energy_j={value!r}"]).limits.energy_j == value


@given(override=st.text(max_size=20) | st.from_regex(r"(limits|stages|drive)(\.[a-z0-9_]{1,9}){0,3}=[^\n]{0,9}"))
def test_any_override_gives_a_procedure_or_the_projects_error(override: str) -> None:
    try:
        load_procedure("quick", overrides=[override])
    except ProcedureError as error:
        expect_named(error, "--set")


def expect_named(error: ProcedureError, name: str) -> None:
    assert str(error).startswith(name)


# --- another motor, another drive

SERVO = "motor:\n  name: servo\n  pole_pairs: 4\nlimits:\n  current_a: 20.0\n  voltage_v: 24.0\n"


def test_a_motor_file_goes_over_the_nameplate_and_the_limits(write: Write) -> None:
    procedure = load_procedure("demo", motor=write(SERVO), overrides=["motor.pole_pairs=5"])
    assert (procedure.motor.name, procedure.motor.pole_pairs) == ("servo", 5)
    assert procedure.motor.rated_current_rms_a is None


def test_a_simulated_drive_forgets_the_example_motor_once_there_is_another(write: Write, tmp_path: Path) -> None:
    loaded = read_procedure("demo", motor=write(SERVO), overrides=["drive.plant.sensors.noise_a=0.1"])
    assert loaded.procedure.drive.options == {"plant": {"sensors": {"noise_a": 0.1}}}
    left_out, bus = loaded.notes
    assert left_out == "drive.plant is the example motor's and left out: drive simulated follows the nameplate"
    assert bus.startswith("drive.dc_bus_voltage_v is not given: drive simulated takes the bus from the rated voltage")
    given = read_procedure("demo", motor=write(SERVO), overrides=["drive.dc_bus_voltage_v=48"])
    assert given.notes == (left_out,)
    own = write(SERVO + "drive: {name: simulated, plant: {inverter: switched}}\n")
    assert load_procedure("demo", motor=own).drive.options == {"plant": {"inverter": "switched"}}
    mine = tmp_path / "procedure.yaml"
    mine.write_text(TEXT.replace("name: simulated", "name: simulated\n  plant: {inverter: switched}"))
    assert load_procedure(str(mine), motor=write(SERVO)).drive.options == {"plant": {"inverter": "switched"}}


def test_a_motor_is_read_from_whatever_names_its_file(write: Write) -> None:
    file = write(SERVO)
    assert load_motor(file) == load_motor(str(file))
    assert load_motor(str(file)).name == "servo"
    with pytest.raises(ProcedureError, match="motor: missing"):
        load_motor(write("limits: {}\n"))


def test_a_motor_file_s_limits_leave_those_that_it_does_not_give(write: Write) -> None:
    kept, limits = load_procedure("demo").limits, load_procedure("demo", motor=write(SERVO)).limits
    assert (limits.current_a, limits.voltage_v) == (20.0, 24.0)
    assert (limits.energy_j, limits.duration_s) == (kept.energy_j, kept.duration_s)
    assert kept.energy_j is not None


RATED = """
  rated_current_rms_a: 10.0
  rated_voltage_rms_v: 30.0
  stator_resistance_ohm: 0.2
"""


def test_limits_that_a_motor_file_leaves_out_follow_from_the_nameplate(write: Write) -> None:
    path = write(SERVO.partition("limits:")[0].rstrip() + RATED)
    loaded = read_procedure("demo", motor=path)
    limits = loaded.procedure.limits
    assert limits.current_a == pytest.approx(2.2 * 10.0 * math.sqrt(2.0), rel=1e-3)
    assert limits.voltage_v == pytest.approx(30.0 * math.sqrt(2.0 / 3.0), rel=1e-3)
    assert limits.duration_s == load_procedure("demo").limits.duration_s == 120.0
    assert limits.energy_j == pytest.approx(1.5 * 0.2 * (10.0 * math.sqrt(2.0)) ** 2 * 120.0, rel=1e-3)
    assert loaded.notes[2:] == (
        "limits, as the motor file has none of these: current_a 31.11 A, 2.2 times the rated peak; "
        "voltage_v 24.49 V, the rated phase peak; energy_j 7200 J, the rated copper loss for 120 s",
    )


def test_a_given_limit_and_a_changed_nameplate_count_before_the_derived_limits(write: Write) -> None:
    path = write(SERVO.partition("limits:")[0].rstrip() + RATED + "limits:\n  voltage_v: 20 V\n")
    overrides = ["motor.rated_current_rms_a=1", "limits.energy_j=50"]
    limits = load_procedure("demo", motor=path, overrides=overrides).limits
    assert (limits.current_a, limits.voltage_v, limits.energy_j) == (3.111, 20.0, 50.0)


def test_a_motor_file_without_limits_keeps_those_of_an_own_procedure(write: Write, tmp_path: Path) -> None:
    plate = tmp_path / "plate.yaml"
    plate.write_text(SERVO.partition("limits:")[0].rstrip() + RATED)
    own = write(TEXT)
    loaded = read_procedure(str(own), motor=plate)
    assert (loaded.procedure.limits, loaded.notes) == (load_procedure(str(own)).limits, ())


def test_a_motor_file_has_the_limits_by_which_its_motor_is_accepted(write: Write) -> None:
    text = SERVO + "accept:\n  max_resistance_ohm: 20 mOhm\n"
    accept = load_procedure("demo", motor=write(text)).accept
    assert accept is not None
    assert accept.max_resistance_ohm == 0.02


@pytest.mark.parametrize(
    ("text", "line", "problem"),
    [
        (SERVO.replace("pole_pairs", "pole_pair"), 3, "did you mean 'pole_pairs'?"),
        (
            SERVO.replace("  voltage_v: 24.0\n", ""),
            4,
            "limits.voltage_v: missing: give it, or motor.rated_voltage_rms_v, from which it follows",
        ),
        (SERVO.partition("limits:")[0], None, "limits.current_a: missing: give it, or motor.rated_current_rms_a"),
        ("name: servo\npole_pairs: 4\n", None, "motor: missing: the nameplate's fields belong below a line `motor:`"),
        (SERVO.replace("limits", "limit"), 4, "did you mean 'limits'?"),
        (SERVO.replace("motor", "drive"), None, "motor: missing"),
        (
            SERVO.replace("  pole_pairs: 4", "  pole_pairs: 4\n  kv: 100", 1),
            4,
            "motor.kv: unknown key; state pm_flux_wb",
        ),
        (SERVO.replace("motor:", "motr:"), None, "motor: missing; the file has 'motr': did you mean 'motor'"),
    ],
)
def test_a_mistake_in_a_motor_file_names_that_file(write: Write, text: str, line: int | None, problem: str) -> None:
    path = write(text)
    found = complaint(lambda: load_procedure("demo", motor=path))
    assert found.startswith(f"{path}:{line}: " if line else f"{path}: ")
    assert problem in found


def test_another_drive_does_not_get_the_options_of_the_first() -> None:
    assert load_procedure("demo", drive="simulated").drive.options
    found = complaint(lambda: load_procedure("demo", drive="simulate"))
    assert found.startswith("--drive simulate: drive.name: ")
    assert "did you mean 'simulated'?" in found


# --- nothing but the project's errors

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@given(data=st.data())
def test_damaged_yaml_never_gives_anything_but_the_projects_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = list(shipped_procedure("demo"))
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
        content[place] = data.draw(st.characters(codec="utf-8") | st.sampled_from("{}[]:,&*!|>'\"%@`#\n\t -"))
    path = tmp_path_factory.getbasetemp() / "damaged.yaml"
    path.write_text("".join(content), encoding="utf-8")
    try:
        load_procedure(str(path))
    except ProcedureError as error:
        expect_named(error, str(path))


@given(data=st.data(), value=plain)
def test_any_value_at_any_key_gives_a_procedure_or_the_projects_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, value: object
) -> None:
    raw: Any = yaml.safe_load(shipped_procedure("full"))
    here = raw
    while True:
        key = data.draw(st.sampled_from(list(here) if isinstance(here, dict) else list(range(len(here)))))
        if not isinstance(here[key], dict | list) or not here[key] or data.draw(st.booleans()):
            break
        here = here[key]
    here[key] = value
    path = tmp_path_factory.getbasetemp() / "changed.yaml"
    path.write_text(json.dumps(raw), encoding="utf-8")
    try:
        load_procedure(str(path))
    except ProcedureError as error:
        expect_named(error, str(path))


@pytest.mark.parametrize(
    ("override", "reported"),
    [
        ("motor.pole_pairs=100000", "motor.pole_pairs: 100000 is not between 1 and 500"),
        ("motor.d_inductance_h=1e30", "motor.d_inductance_h"),
        ("drive.sampling_frequency_hz=1e9", "drive.sampling_frequency_hz"),
        ("stages.0.duration_s=1e6", "stages.0.duration_s: 1e+06 s is more than a day"),
        ("drive.name=nan", "no drive plugin 'nan'"),
    ],
)
def test_what_cannot_be_meant_is_refused(override: str, reported: str) -> None:
    with pytest.raises(ProcedureError, match=re.escape(reported)):
        load_procedure("demo", overrides=[override])


def test_an_effect_that_is_taken_out_has_to_be_there() -> None:
    diagnose = "stages.0={kind: diagnose, without: [dead_tim]}"
    with pytest.raises(ProcedureError, match=r"stages\.0\.without\.0.*dead_tim.*dead_time"):
        load_procedure("demo", overrides=[diagnose])
    load_procedure("demo", overrides=["stages.0={kind: diagnose, without: [dead_time, saturation]}"])


def test_an_error_found_while_planning_is_reported_with_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(shipped_procedure("demo").replace("pattern: grid", "amplitudes_v: [4000.0]"))
    loaded = read_procedure(str(file))
    line = next(k for k, text in enumerate(file.read_text().splitlines(), 1) if "amplitudes_v" in text)
    with (
        pytest.raises(ProcedureError, match=rf"mine\.yaml:{line}: stages\.8\.amplitudes_v"),
        loaded.locating_errors(),
    ):
        make_plan(loaded.procedure, None)


def test_a_motor_file_in_the_place_of_a_procedure_is_named_as_one(tmp_path: Path) -> None:
    plate = tmp_path / "plate.yaml"
    plate.write_text("motor: {name: m, pole_pairs: 2}\n")
    with pytest.raises(ProcedureError, match=r"a motor file instead of a procedure: give it as demo --motor .*plate"):
        read_procedure(str(plate))


def test_a_value_in_the_field_s_own_unit_needs_no_comment() -> None:
    assert read_procedure("demo", overrides=["limits.current_a=4.5 A"]).notes == ()


def test_a_file_that_is_missing_is_reported_with_the_nearest_beside_it(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("")
    with pytest.raises(ProcedureError, match=r"No such file or directory; did you mean '.*/mine\.yaml'"):
        load_procedure(str(tmp_path / "mines.yaml"))


def test_a_motor_that_a_drive_cannot_be_set_up_for_is_asked_about_its_nameplate(tmp_path: Path) -> None:
    motor = tmp_path / "servo.yaml"
    text = "motor: {name: servo, pole_pairs: 5, rated_power_w: 400, rated_speed_rpm: 3000, rated_torque_nm: 1.27, "
    text += "rated_current_rms_a: 9.6, rated_voltage_rms_v: 27, stator_resistance_ohm: 0.09, pm_flux_wb: 0.01248,\n"
    motor.write_text(text + "  d_inductance_h: 0.2,\n  q_inductance_h: 0.0002}\n")
    loaded = read_procedure("demo", motor=motor)
    with pytest.raises(ProcedureError) as raised, loaded.locating_errors():
        raise PluginError("drives", "simulated", "cannot be set up for this motor with these options (ValueError: x)")
    assert str(raised.value).startswith(
        f"{motor}:2: motor.d_inductance_h: 0.0002 would fit: is the stated value in mH?"
    )
    assert str(raised.value).endswith("the drive simulated cannot be set up for this motor with these options")

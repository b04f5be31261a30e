"""The registry: listing imports nothing, and a plugin that is broken in whatever way is named in one line."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import BaseModel, Field

from orchestrator.registry.plugins import PluginKind, installed, load_effects_file, load_plugin, make_options
from protocols import NoOptions, PluginError, Strict

GOOD_STREAM = """
from protocols import NoOptions

class Good:
    name = "good"
    Options = NoOptions
    wants_samples = False

    def __init__(self, setup): ...
    def receive(self, message): ...
    def close(self): ...
"""

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a distribution with one module and one entry point."""
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)

    def make(
        module: str, source: str | None, target: str, *, group: str = "streams", name: str = "third", dist: str = "acme"
    ) -> None:
        if source is not None:
            (tmp_path / f"{module}.py").write_text(source)
        info = tmp_path / f"{dist}-1.2.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {dist}\nVersion: 1.2\n")
        (info / "entry_points.txt").write_text(f"[fluxbench.{group}]\n{name} = {target}\n")

    yield make
    for name in set(sys.modules) - before:
        if name.startswith("acme"):
            del sys.modules[name]


def complaint(call: Callable[[], object]) -> str:
    with pytest.raises(PluginError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_built_in_plugins_are_listed_with_their_origin() -> None:
    (simulated,) = [info for info in installed(PluginKind.DRIVES) if info.name == "simulated"]
    assert simulated.distribution == "fluxbench"
    assert simulated.module == "plugins.drives.simulated:SimulatedDrive"
    assert {"resistance", "classical", "injection"} <= {info.name for info in installed(PluginKind.ESTIMATORS)}


def test_listing_imports_no_plugin(install: Install) -> None:
    install("acme_bomb", "raise RuntimeError('imported')", "acme_bomb:X")
    (third,) = [info for info in installed(PluginKind.STREAMS) if info.name == "third"]
    assert (third.distribution, third.version) == ("acme", "1.2")
    assert "acme_bomb" not in sys.modules
    code = (
        "import sys; from orchestrator.registry.plugins import PluginKind, installed\n"
        "[installed(kind) for kind in PluginKind]\n"
        "print([name for name in sys.modules if name.startswith('plugins')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_third_partys_plugin_is_loaded_like_a_built_in_one(install: Install) -> None:
    install("acme_good", GOOD_STREAM, "acme_good:Good")
    assert load_plugin(PluginKind.STREAMS, "third").name == "good"


def test_an_unknown_name_suggests_the_nearest() -> None:
    text = complaint(lambda: load_plugin(PluginKind.DRIVES, "simulatd"))
    assert "simulatd" in text
    assert "did you mean 'simulated'?" in text


def test_a_name_like_no_other_lists_what_there_is() -> None:
    text = complaint(lambda: load_plugin(PluginKind.ESTIMATORS, "zzz"))
    assert "classical, energy, injection, polynomial, resistance, spin, step_resistance, steps" in text


@pytest.mark.parametrize(
    ("source", "target", "problem"),
    [
        (None, "acme_nowhere:X", "ModuleNotFoundError"),
        ("import no_such_module_at_all", "acme_broken:X", "no_such_module_at_all"),
        ("def f(:", "acme_broken:X", "SyntaxError"),
        ("raise RuntimeError('no licence\\nsecond line')", "acme_broken:X", "RuntimeError: no licence"),
        ("raise SystemExit(3)", "acme_broken:X", "SystemExit"),
        ("x = 1", "acme_broken:Missing", "AttributeError"),
        ("x = 1", "acme_broken:x", "expected a class, got int"),
        ("x = 1", "acme_broken", "expected a class, got module"),
        (GOOD_STREAM.replace("name = ", "nome = "), "acme_broken:Good", "attribute 'name' is missing"),
        (GOOD_STREAM.replace('"good"', "7"), "acme_broken:Good", "attribute 'name' has to be a str"),
        (GOOD_STREAM.replace("= NoOptions", "= dict"), "acme_broken:Good", "'Options' has to be a sub-class of"),
        (GOOD_STREAM.replace("= NoOptions", "= {}"), "acme_broken:Good", "'Options' has to be a sub-class of"),
        (GOOD_STREAM.replace("= False", "= None"), "acme_broken:Good", "'wants_samples' has to be a bool"),
        (GOOD_STREAM.replace("def close", "def klose"), "acme_broken:Good", "method 'close' is missing"),
        (GOOD_STREAM.replace("self, message", "self"), "acme_broken:Good", "called as receive(message)"),
    ],
)
def test_a_broken_plugin_is_named_with_its_distribution_and_the_cause(
    install: Install, source: str | None, target: str, problem: str
) -> None:
    install("acme_broken", source, target)
    text = complaint(lambda: load_plugin(PluginKind.STREAMS, "third"))
    assert "'third'" in text
    assert "acme 1.2" in text
    assert problem in text


def test_a_name_that_two_distributions_provide_is_refused(install: Install) -> None:
    install("acme_good", GOOD_STREAM, "acme_good:Good")
    install("acme_good", None, "acme_good:Good", dist="rival")
    text = complaint(lambda: load_plugin(PluginKind.STREAMS, "third"))
    assert "twice" in text
    assert "acme 1.2" in text
    assert "rival 1.2" in text


@pytest.mark.parametrize("kind", [PluginKind.DRIVES, PluginKind.ESTIMATORS, PluginKind.EFFECTS])
def test_a_plugin_of_another_kind_does_not_keep_the_contract(install: Install, kind: PluginKind) -> None:
    install("acme_good", GOOD_STREAM, "acme_good:Good", group=kind.value)
    assert "is missing" in complaint(lambda: load_plugin(kind, "third"))


class Inner(Strict):
    depth_m: float = 1.0


class Configurable:
    name: ClassVar[str] = "configurable"

    class Options(Strict):
        bit_rate: int = 500_000
        inner: Inner = Inner()


def test_options_are_the_plugins_own() -> None:
    options: Any = make_options(Configurable, {"bit_rate": 250_000, "inner": {"depth_m": 2.0}}, "demo.yaml: drive")
    assert isinstance(options, Configurable.Options)
    assert options.inner.depth_m == 2.0


@pytest.mark.parametrize(
    ("raw", "field", "problem"),
    [
        ({"bitrate": 1}, "bitrate", "did you mean 'bit_rate'?"),
        ({"inner": {"dept_m": 1}}, "inner.dept_m", "did you mean 'depth_m'?"),
        ({"bit_rate": "fast"}, "bit_rate", "expected a whole number, got 'fast'"),
        ({"inner": {"depth_m": float("nan")}}, "inner.depth_m", "finite"),
    ],
)
def test_a_wrong_option_is_one_line_with_where_it_was_written(raw: dict[str, Any], field: str, problem: str) -> None:
    text = complaint(lambda: make_options(Configurable, raw, "demo.yaml: drive"))
    assert text.startswith(f"demo.yaml: drive: {field}: ")
    assert problem in text
    assert "configurable" in text


def test_a_missing_option_is_said_with_how_to_give_it() -> None:
    class Needy:
        name: ClassVar[str] = "needy"

        class Options(Strict):
            port: str = Field(examples=["/dev/ttyUSB0"])
            speed: int

    advice = "`--set drive.{option}={example}` gives it"
    for raw, field, example in (({"speed": 1}, "port", "/dev/ttyUSB0"), ({"port": "a"}, "speed", "...")):
        text = complaint(partial(make_options, Needy, raw, "drive", advice))
        assert text == f"drive: {field}: missing (option of 'needy'); `--set drive.{field}={example}` gives it"
    assert "`--set" not in complaint(lambda: make_options(Needy, {"port": "a", "speed": "x"}, "drive", advice))


def test_a_plugin_without_options_takes_none() -> None:
    class Plain:
        name = "plain"

    assert isinstance(make_options(Plain, {}, "x"), NoOptions)
    assert "unknown key" in complaint(lambda: make_options(Plain, {"a": 1}, "x"))
    assert issubclass(NoOptions, BaseModel)


EFFECT = """
from protocols import Correction, EffectLayer, EffectParameters, amplitude

class Mine:
    name = "mine"
    summary = "..."
    signature = "..."
    layer = EffectLayer.INVERTER
    needs = ()
    gauge = ""

    class Parameters(EffectParameters):
        offset_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-5.0, high=5.0)

    def correct(self, signals, parameters):
        return Correction()
"""


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (
            ("    layer = EffectLayer.INVERTER\n", ""),
            "write layer = EffectLayer.CURRENT_SENSORS (or DELAY, BUS, INVERTER",
        ),
        (("    needs = ()\n", ""), "write needs = ()"),
        (("    gauge = ", "    gage = "), "the class has 'gage': did you mean 'gauge'?"),
        (("class Parameters(", "class Settings("), "write class Parameters(EffectParameters) in it"),
        (("def correct", "def korrect"), "the class has 'korrect': did you mean 'correct'?"),
    ],
)
def test_what_a_new_effect_lacks_is_stated_with_what_to_write(
    change: tuple[str, str], reported: str, tmp_path: Path
) -> None:
    whole, mine = tmp_path / "whole.py", tmp_path / "mine.py"
    whole.write_text(EFFECT)
    assert [effect.name for effect in load_effects_file(whole)] == ["mine"]
    mine.write_text(EFFECT.replace(*change))
    text = complaint(lambda: load_effects_file(mine))
    assert reported in text
    assert "mine.py" in text


def test_an_unknown_contrast_is_reported_with_all_names(tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    unknown = "needs = (Contrast.SECOND_ROTOR_ANGLE,)"
    mine.write_text(EFFECT.replace("import ", "import Contrast, ", 1).replace("needs = ()", unknown))
    text = complaint(lambda: load_effects_file(mine))
    assert "mine.py: does not run: Contrast has no SECOND_ROTOR_ANGLE; did you mean SECOND_ANGLE?" in text
    assert "It has GATES_OFF, SECOND_PWM_FREQUENCY, " in text


@pytest.mark.parametrize(
    ("method", "reported"),
    [
        (
            "def doubt(self, signals, parameters): ...",
            "method 'doubt' is never called: an effect has correct",
        ),
        (
            "def doubts(self, signals): ...",
            "method 'doubts' cannot be called as doubts(signals, parameters)",
        ),
    ],
)
def test_an_effect_s_method_that_would_never_be_called_is_refused_when_it_is_loaded(
    method: str, reported: str, tmp_path: Path, install: Install
) -> None:
    source = f"{EFFECT}\n    {method}\n"
    mine = tmp_path / "mine.py"
    mine.write_text(source)
    text = complaint(lambda: load_effects_file(mine))
    assert reported in text
    assert "plugin 'mine'" in text
    assert "mine.py" in text
    install("acme_effect", source, "acme_effect:Mine", group="effects", name="mine")
    assert reported in complaint(lambda: load_plugin(PluginKind.EFFECTS, "mine"))


def test_a_method_that_is_missing_is_stated_with_its_arguments(install: Install) -> None:
    install("acme_broken", GOOD_STREAM.replace("def close", "def klose"), "acme_broken:Good")
    assert "write def close(self)" in complaint(lambda: load_plugin(PluginKind.STREAMS, "third"))

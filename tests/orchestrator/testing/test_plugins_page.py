"""What docs/plugins.md and docs/effects.md show is complete, and passes the kits that they praise."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import fields
from importlib.resources import files
from inspect import signature
from pathlib import Path

import pytest

from protocols import EFFECT_HOOKS, LAYER_CHANGES, EffectLayer, ParameterRole, Signals

ROOT = Path(__file__).parents[3]
PAGES = (ROOT / "docs" / "plugins.md", ROOT / "docs" / "effects.md")
RECORDING = ROOT / "tests" / "data" / "pm400-reduced"


def snippets() -> dict[str, str]:
    """The pages' files by name: each code block opens with a comment that holds it."""
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    return dict(re.findall(r"^```(?:python|toml)\n# (\S+)\n(.*?)^```$", text, re.M | re.S))


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's files, laid out as it says, with the metadata that an installation would leave."""
    folder = tmp_path_factory.mktemp("bench")
    for name, text in snippets().items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    project = tomllib.loads(snippets()["pyproject.toml"])["project"]
    installed = folder / "bench_plugins-0.1.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-plugins\nVersion: 0.1\n", encoding="utf-8")
    points = configparser.ConfigParser()
    points.read_dict(project["entry-points"])
    with (installed / "entry_points.txt").open("w", encoding="utf-8") as file:
        points.write(file)
    shutil.copytree(RECORDING, folder / "tests" / "recording")
    return folder


def in_package(package: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(package), str(ROOT)))}
    return subprocess.run(
        [sys.executable, *command], cwd=package, env=environment, capture_output=True, text=True, timeout=120
    )


def test_page_shows_a_plugin_of_each_kind_and_the_kits() -> None:
    assert set(snippets()) == {
        "pyproject.toml",
        "bench_plugins/supply.py",
        "bench_plugins/thermal_soak.py",
        "bench_plugins/ohmmeter.py",
        "bench_plugins/two_inductances.py",
        "bench_plugins/voltage_offset.py",
        "bench_plugins/lagging_drop.py",
        "bench_plugins/blanking_time.py",
        "bench_plugins/points_file.py",
        "phase_drop.py",
        "test_phase_drop.py",
        "tests/test_conformance.py",
        "tests/test_lagging_drop.py",
    }


@pytest.mark.slow
def test_page_s_plugins_pass_the_kits(package: Path) -> None:
    done = in_package(package, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests")
    assert done.returncode == 0, done.stdout + done.stderr
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) >= 40, done.stdout


@pytest.mark.slow
def test_the_first_effect_passes_its_kit_as_a_file_and_its_error_falls_as_printed(package: Path) -> None:
    done = in_package(package, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_phase_drop.py")
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\d+ passed, 1 skipped", done.stdout)  # it has no entry point
    fluxbench = ("-c", "from orchestrator.interface.cli import main; main()")
    assert in_package(package, *fluxbench, "mystery", "2", "--quiet").returncode == 0
    done = in_package(package, *fluxbench, "add", "runs/mystery-2", "phase_drop", "--effects", "phase_drop.py")
    assert done.returncode == 0, done.stderr
    (helps,) = (line for line in done.stdout.splitlines() if line.startswith("phase drop helps:"))
    assert helps in PAGES[1].read_text(encoding="utf-8")


def test_page_s_plugins_are_loaded_by_their_names(package: Path) -> None:
    code = (
        "from orchestrator.registry.plugins import PluginKind, load_plugin\n"
        "for kind, name in zip(PluginKind, ('supply', 'thermal_soak', 'ohmmeter', 'voltage_offset', 'points_file')):\n"
        "    assert load_plugin(kind, name).name == name\n"
    )
    done = in_package(package, "-c", code)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_plugin_that_breaks_its_contract_fails_there_too(package: Path, tmp_path: Path) -> None:
    broken = tmp_path / "bench"
    shutil.copytree(package, broken)
    file = broken / "bench_plugins" / "supply.py"
    file.write_text(file.read_text().replace("LOAD_OHM = 4.0", "LOAD_OHM = -4.0"), encoding="utf-8")
    done = in_package(broken, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests", "-k", "TestSupply")
    assert done.returncode == 1
    assert "polarity is wrong" in done.stdout


def test_effects_page_names_every_field_of_signals_every_layer_and_every_role() -> None:
    page = PAGES[1].read_text(encoding="utf-8")
    left_out = [name for name in (field.name for field in fields(Signals)) if f"`{name}`" not in page]
    left_out += [layer.name for layer in EffectLayer if f"| `{layer.name}` |" not in page]
    left_out += [role.value for role in ParameterRole if f"`{role.value}(" not in page]
    assert left_out == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.name))
def test_each_page_has_a_row_for_every_method_that_an_effect_may_have(page: Path) -> None:
    rows = re.findall(r"^\| `(\w+)\((?:self, )?([\w, ]+)\)` \|", page.read_text(encoding="utf-8"), re.M)
    declared = {hook: len(signature(getattr(contract, hook)).parameters) for hook, contract in EFFECT_HOOKS.items()}
    assert {hook: len(arguments.split(", ")) + 1 for hook, arguments in rows if hook in declared} == declared


def test_effects_page_names_the_protocol_of_every_method() -> None:
    page = PAGES[1].read_text(encoding="utf-8")
    assert [c.__name__ for c in EFFECT_HOOKS.values() if f"(`{c.__name__}`)" not in page] == []


def test_effects_page_says_what_an_effect_of_each_layer_may_change() -> None:
    rows = re.findall(r"^\| `([A-Z_]+)` \|.*\| (.*) \|$", PAGES[1].read_text(encoding="utf-8"), re.M)
    assert {layer: set(re.findall(r"`(\w+)`", may)) for layer, may in rows} == {
        layer.name: set(changes) for layer, changes in LAYER_CHANGES.items()
    }


def test_example_and_scaffold_take_from_the_voltage_what_the_inverter_keeps() -> None:
    template = (
        files("orchestrator.interface.scaffolding").joinpath("templates", "effect.py.txt").read_text(encoding="utf-8")
    )
    assert "signals.v_ab - " in template
    assert "signals.v_ab - " in snippets()["bench_plugins/voltage_offset.py"]

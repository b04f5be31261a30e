"""Numbers at the ends of what a float holds, in every numeric field of a procedure: its motor, plan and drive."""

from __future__ import annotations

import copy
import functools
import math
import random
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from orchestrator.registry.plugins import PluginKind, load_plugin
from orchestrator.stages import with_stages
from protocols import Procedure
from tests.support.processes import called
from tests.support.tiny import STAGES, tiny_document

EXTREMES = (0, -0.0, 5e-324, 1e-300, 1e-9, -1.0, 1e9, 1e300, -1e300, math.nan, math.inf, -math.inf, 2**70)
MAX_SECONDS = 10.0
Place = tuple[str | int, ...]


def extreme(rng: random.Random, folder: Path) -> str:
    """`check` of a procedure with one or two extreme numbers ends in time, with an answer or a refusal of one line."""
    document = copy.deepcopy(tiny_document())
    for place, kind in rng.sample(numeric_fields(), rng.choice((1, 1, 1, 2))):
        put(document, place, value_of(rng, kind))
    file = folder / "procedure.yaml"
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    with limited(MAX_SECONDS):
        done = called("check", file)
    assert done.returncode in (0, 2), done.stderr
    assert done.stderr.count("\n") == (done.returncode != 0), done.stderr
    return "refused" if done.returncode else "taken"


def value_of(rng: random.Random, kind: str) -> Any:
    """An extreme number, or as many of them as a pair or list takes."""
    if kind == "array":
        return [rng.choice(EXTREMES) for _ in range(rng.choice((1, 2, 2, 3)))]
    return rng.choice(EXTREMES)


@functools.cache
def numeric_fields() -> Sequence[tuple[Place, str]]:
    """Every place of a number, or of a list of numbers, that the schemas know, and which of both it is."""
    schema = with_stages(Procedure.model_json_schema())
    options = load_plugin(PluginKind.DRIVES, "simulated").Options.model_json_schema()
    found = [place for place in _numbers(schema, schema, ()) if "stages" not in place[0] and place[0][0] != "drive"]
    found += _numbers(options, options, ("drive",))
    kinds = {one["kind"]: at for at, one in enumerate(STAGES)}
    for variant in _variants(schema, schema["properties"]["stages"]["items"]):
        kind = variant.get("properties", {}).get("kind", {}).get("const")
        if kind in kinds:
            found += _numbers(schema, variant, ("stages", kinds[kind]))
    return sorted(set(found), key=str)


def _numbers(root: Mapping[str, Any], schema: Mapping[str, Any], at: Place) -> Iterator[tuple[Place, str]]:
    if len(at) > 8:
        return
    for one in _variants(root, schema):
        if one.get("type") in ("number", "integer"):
            yield at, "number"
        elif one.get("type") == "array":
            inner = [*_variants(root, one.get("items", {})), *one.get("prefixItems", [])]
            if any(item.get("type") in ("number", "integer", "array") for item in inner):
                yield at, "array"
        for name, field in one.get("properties", {}).items():
            yield from _numbers(root, field, (*at, name))


def _variants(root: Mapping[str, Any], schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A schema without references and alternatives."""
    if "$ref" in schema:
        here: Any = root
        for key in schema["$ref"].removeprefix("#/").split("/"):
            here = here[key]
        return _variants(root, here)
    several = [*schema.get("anyOf", []), *schema.get("oneOf", []), *schema.get("allOf", [])]
    return [variant for one in several for variant in _variants(root, one)] if several else [schema]


def put(document: dict[str, Any], place: Place, value: Any) -> None:
    """Set a field of a document; what is missing on the way to it is made."""
    here: Any = document
    for key in place[:-1]:
        if isinstance(here, dict) and not isinstance(here.get(key), dict | list):
            here[key] = {}
        here = here[key]
    here[place[-1]] = value


class TooLong(BaseException):
    """A call took longer than it may; no error that the program would catch."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """A call that takes more processor time is an `AssertionError`: whatever else the machine does."""

    def over(number: int, frame: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    except TooLong:
        raise AssertionError(f"not over within {seconds:g} s of processor time") from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)

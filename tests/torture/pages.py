"""The operator's page under floods of tabs, streams, slow readers and silent connections."""

from __future__ import annotations

import random
from contextlib import ExitStack
from pathlib import Path

import yaml

from tests.plugins.commands.serve.flooding import lines, tabs
from tests.plugins.commands.serve.served import Served, serving
from tests.plugins.commands.serve.test_floods import LONG, withstood
from tests.support.tiny import tiny_document


def flooded(rng: random.Random, folder: Path) -> str:
    """One or two kinds of flood of random size: events arrive, the stop stops, the server ends."""
    document = tiny_document(stages=LONG, drive={"realtime_factor": 1.0, "watchdog_s": 60.0})
    (folder / "asking.yaml").write_text(yaml.safe_dump(document))
    chosen = rng.sample(("tabs", "streams", "slow readers", "silence"), rng.choice((1, 2)))

    def flood(served: Served) -> ExitStack:
        opened = ExitStack()
        if "tabs" in chosen:
            opened.enter_context(tabs(served, rng.randint(5, 200), random.Random(rng.random())))
        if "streams" in chosen:
            opened.enter_context(lines(served, rng.randint(50, 500), silent=False, read=True))
        if "slow readers" in chosen:
            opened.enter_context(lines(served, rng.randint(20, 300), silent=False))
        if "silence" in chosen:
            opened.enter_context(lines(served, rng.randint(100, 1500), silent=True))
        return opened

    with serving(folder) as served:
        withstood(served, lambda: flood(served), 5.0)
    return " and ".join(sorted(chosen))

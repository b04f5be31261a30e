"""A small part of what `make torture` does, and that it goes on where it was ended."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.torture.__main__ import HEADING, attempts, main, section
from tests.torture.attacks import ATTACKS, Attack

SEED = 20261122
SAMPLE = {"kills": 0, "inputs": 10, "disks": 0, "lies": 1, "noise": 6, "links": 0} | {
    "numbers": 20,
    "pages": 0,
    "commissionings": 0,
    "fleets": 0,
    "clocks": 0,
    "tunings": 0,
    "discoveries": 0,
    "mutilations": 1,
    "harmless": 1,
}
SLOW = ("mutilations", "harmless")
"""Of each attack; most have tests of their own, and hundreds of them in `make torture`."""


@pytest.mark.parametrize(
    "attack",
    [pytest.param(a, id=a.name, marks=[pytest.mark.slow] * (a.name in SLOW)) for a in ATTACKS if SAMPLE[a.name]],
)
def test_a_sample_of_each_attack_finds_nothing(attack: Attack) -> None:
    kept = list(attempts(attack, SEED, range(SAMPLE[attack.name]), seconds=200.0))
    assert [one for one in kept if one["finding"]] == []
    assert len(kept) == SAMPLE[attack.name]


def test_a_finding_is_kept_with_what_makes_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def once(rng: random.Random, folder: Path) -> str:
        drawn = rng.randrange(1000)
        assert drawn % 3, f"drew {drawn}"
        return "held"

    attack = Attack("thirds", 30, "nothing divisible", once)
    monkeypatch.setattr("tests.torture.__main__.ATTACKS", (attack,))
    log, page = tmp_path / "log.jsonl", tmp_path / "page.md"
    page.write_text(f"# Before\n\n{HEADING}\n\nof last time\n", encoding="utf-8")
    assert main(["--seed", "7", "--log", str(log), "--part", "0.5"]) == 1
    half = log.read_text(encoding="utf-8")
    assert main(["--log", str(log), "--write", str(page)]) == 1  # the seed is the log's
    whole = log.read_text(encoding="utf-8")
    assert whole.startswith(half)
    assert len(whole.splitlines()) == 30
    again = list(attempts(attack, 7, range(30), 10.0))
    assert [one["outcome"] for one in again].count("held") == whole.count('"held"')
    findings = sum(bool(one["finding"]) for one in again)
    assert f"| {findings} |" in section(again, 7)
    assert "thirds" in page.read_text(encoding="utf-8")
    assert "of last time" not in page.read_text(encoding="utf-8")
    assert f"{findings} findings" in capsys.readouterr().out


def test_it_stops_when_its_time_is_over() -> None:
    attack = Attack("slow", 10, "nothing", lambda rng, folder: "held")
    assert list(attempts(attack, 1, range(10), seconds=-1.0)) == []

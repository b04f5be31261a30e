"""The pictures of the documentation: each is made by a command, stands on a page, and is not of old."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tests.motor_time.__main__ import PICTURE as OF_MOTOR_TIME
from tests.pictures.discover import NAMES as OF_DISCOVERY
from tests.pictures.page import NAMES as OF_THE_PAGE
from tests.pictures.report import MAP, PICTURES, WANTED
from tests.pictures.viewer import NAMES as OF_THE_VIEWER

ROOT = Path(__file__).parents[2]
OLDEST_DAYS = 21.0
"""By which what draws a picture may be younger than the picture."""
DRAWN_BY = {
    "report": ("plugins/streams/report", "orchestrator/formatting"),
    "demo": ("plugins/streams/report", "orchestrator/formatting"),
    "viewer": ("plugins/streams/rerun", "orchestrator/formatting"),
    "motor-time": ("tests/motor_time",),
    "discover": ("orchestrator/discovery", "orchestrator/formatting"),
    "serve": ("plugins/commands/serve/page", "plugins/streams/remote"),
}
"""What draws the pictures whose names begin like that."""


def pictures() -> list[Path]:
    return sorted(PICTURES.iterdir())


def committed_s(*paths: str) -> float:
    """When one of these was committed last; 0 where nobody knows."""
    words = ["git", "log", "-1", "--format=%ct", "--", *paths]
    return float(subprocess.run(words, cwd=ROOT, capture_output=True, text=True).stdout or 0.0)


def test_every_picture_is_made_by_the_command() -> None:
    named = (*WANTED, MAP, "report-phone", *OF_THE_PAGE, *OF_THE_VIEWER, *OF_DISCOVERY)
    by_pictures = {f"{name}.png" for name in named}
    assert {picture.name for picture in pictures()} == by_pictures | {OF_MOTOR_TIME.name}


def test_every_picture_stands_on_a_page() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    shown = {Path(name).name for page in pages for name in re.findall(r"\]\(([^)]*\.png)\)", page.read_text())}
    assert [picture.name for picture in pictures() if picture.name not in shown] == []


@pytest.mark.parametrize("picture", pictures(), ids=lambda picture: picture.name)
def test_no_picture_is_much_older_than_what_draws_it(picture: Path) -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("there is no history here")
    sources = next(drawn_by for begins, drawn_by in DRAWN_BY.items() if picture.name.startswith(begins))
    behind_days = (committed_s(*sources) - committed_s(str(picture))) / 86400.0
    reported = f"{picture.name} is {behind_days:.0f} days behind: `make pictures`, or `make motor-time`"
    assert behind_days <= OLDEST_DAYS, reported

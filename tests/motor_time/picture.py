"""The map's error over motor time, drawn and as a table. Computes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.formatting.colours import BLUE, VERMILION
from orchestrator.formatting.drawing import STYLE, bare, empty_figure, name_axes
from orchestrator.formatting.quantities import fixed
from orchestrator.formatting.sentences import markdown_table
from tests.motor_time.measuring import Known

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = {"demo": "s", "quick": "D", "paper": "^"}


def draw(found: Mapping[str, Sequence[Known]], path: Path) -> None:
    """One panel a bench: the adaptive stage on its way, and what each run delivers."""
    figure = empty_figure(9.4, 3.6 * ((len(found) + 1) // 2))
    panels = figure.subplots((len(found) + 1) // 2, 2, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (words, known) in zip(panels, found.items(), strict=False):
        _panel(axes, words, known)
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    panels[0].legend(frameon=False, fontsize=STYLE.small_pt, ncols=2)
    figure.savefig(path, dpi=STYLE.dpi, metadata={"Software": None})


def _panel(axes: Axes, words: str, known: Sequence[Known]) -> None:
    on_the_way = [one for one in known if one.band is not None]
    ends = [one for one in known if one.band is None]
    for colour, name in ((BLUE, "rms"), (VERMILION, "worst")):
        axes.loglog([k.seconds for k in on_the_way], [getattr(k, name) for k in on_the_way], color=colour, label=name)
        for one in ends:
            marker = MARKERS.get(one.how, "o")
            axes.loglog(one.seconds, getattr(one, name), marker, color=colour, mfc="none", ms=6)
    for how, marker in (*MARKERS.items(), ("--until", "o")):
        axes.plot([], [], marker, color="black", mfc="none", label=how)
    axes.set_title(words, fontsize=STYLE.small_pt)
    name_axes(bare(axes), "motor time [s]", "error of the flux map [% of rated]")


def table(found: Mapping[str, Sequence[Known]]) -> str:
    """What every run delivers."""
    rows = [
        (words if k == 0 else "", one.how, _seconds(one.seconds), str(one.points), *_errors(one), one.method)
        for words, known in found.items()
        for k, one in enumerate(sorted((x for x in known if x.band is None), key=lambda x: x.seconds))
    ]
    return markdown_table(
        ("motor, inverter", "procedure", "motor time", "points", "error rms", "worst", "map by"), rows
    )


def course(found: Mapping[str, Sequence[Known]]) -> str:
    """What the adaptive stage knew while it went on: at first each time that it chose, then ever more seldom."""
    rows = [
        (words if k == 0 else "", _seconds(one.seconds), str(one.points), *_errors(one), *map(_percent, one.band or ()))
        for words, known in found.items()
        for k, one in enumerate(x for x in known if x.band is not None)
        if k.bit_count() <= 1
    ]
    head = ("motor, inverter", "motor time", "points", "error rms", "worst", "band rms", "band at worst")
    return markdown_table(head, rows)


def _errors(one: Known) -> tuple[str, str]:
    return _percent(one.rms), _percent(one.worst)


def _seconds(value: float) -> str:
    return f"{fixed(value, 1 if value < 1000.0 else 0)} s"


def _percent(value: float) -> str:
    return f"{fixed(value, 3 if value < 0.1 else 2)} %"

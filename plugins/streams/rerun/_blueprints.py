"""The two layouts: tabs named for what a person wants to know, views for how it is answered."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from orchestrator.formatting.colours import SCREEN, packed
from plugins.streams.rerun._axes import chart_bounds, plane_bounds
from plugins.streams.rerun._detail import DETAIL
from plugins.streams.rerun._diagnosis import Contents
from plugins.streams.rerun._maps import INDUCTANCES
from plugins.streams.rerun._tape import EFFECT_ADDED, EXPERIMENT

COMMISSIONING, DIAGNOSIS = "commissioning", "diagnosis"
CHANGES = "What changed?"


Span = tuple[float, float]


def commissioning(
    end_s: float | None = None, *, states: bool = True, resistance_ohm: Span | None = None
) -> rrb.Blueprint:
    """For watching a run and scrubbing through it; time axes reach to the cursor, or to the end where it is known.

    A recording that no run has made has no `states`. `resistance_ohm` is what R_s went through, where that is known:
    the viewer's own axis begins at zero.
    """
    return _layout(EXPERIMENT, *_of_commissioning(_from_the_start(end_s), states, resistance_ohm))


def _of_commissioning(time: rrb.TimeAxis, states: bool, resistance_ohm: Span | None) -> tuple[rrb.Container, ...]:
    state_views = [rrb.StateTimelineView(origin="/state", name="States", time_view=time)] if states else []
    return (
        rrb.Horizontal(
            rrb.Vertical(
                *state_views,
                _plot("Current [A]", time, "/drive/current", "/drive/limit/current"),
                _plot("Voltage [V]", time, "/drive/voltage", "/drive/limit/voltage"),
                row_shares=[2, 5, 5] if states else [1, 1],
            ),
            rrb.Vertical(_text("How it stands", "/status"), _log(), row_shares=[1, 1]),
            column_shares=[5, 2],
            name="What is it doing?",
        ),
        rrb.Horizontal(
            _plane("Current plane: target (grey), reached (blue)", "/plane"),
            rrb.Vertical(
                _plot("How far off target [mA]", time, "/point/off_target"), _text("How it stands", "/status")
            ),
            name="Is every point reached?",
        ),
        rrb.Horizontal(
            rrb.Vertical(
                _chart("Ripple of i_d: measured, fitted", "/ripple/d"),
                _chart("Ripple of i_q: measured, fitted", "/ripple/q"),
            ),
            _plot("Inductances, provisional [mH]", time, "/point/inductance"),
            name="What does the ripple say?",
        ),
        rrb.Horizontal(
            _plot(
                "R_s over the experiment [Ω]",
                time,
                "/resistance/readings",
                "/resistance/estimate",
                within=resistance_ohm,
            ),
            _text("Stator resistance", "/resistance/page"),
            column_shares=[5, 2],
            name="How does R_s move?",
        ),
        rrb.Horizontal(
            _surface("ψ_d less its value at zero current", "/flux/d"),
            _surface("ψ_q", "/flux/q"),
            name="What is the flux?",
        ),
        rrb.Grid(
            *(_plane(title, f"/maps/{name}", bar=True) for name, title in INDUCTANCES.items()),
            _text("How it stands", "/status"),
            grid_columns=2,
            name="How does it saturate?",
        ),
        rrb.Horizontal(
            _chart("Self-consistency checks", "/checks"),
            _text("Can the map be trusted?", "/trust"),
            column_shares=[3, 2],
            name="Can I trust the map?",
        ),
    )


def diagnosis(
    contents: Contents,
    *,
    measured: bool,
    end_s: float | None = None,
    states: bool = True,
    resistance_ohm: Span | None = None,
) -> rrb.Blueprint:
    """For watching the error fall as effects are added; behind that, the run that was `measured` in the same file."""
    tabs: list[rrb.Container] = [
        rrb.Horizontal(
            rrb.Vertical(
                _chart("The error ladder: fitted (bars), held out (dots)", "/ladder/chart"),
                _falling(measured),
                row_shares=[2, 1],
            ),
            rrb.Vertical(_text("The diagnosis", "/diagnosis"), _text("This step", "/ladder/page")),
            column_shares=[3, 2],
            name="Which effect is missing?",
        ),
        rrb.Horizontal(
            _plane("Residual over the current plane", "/residual/plane", bar=True),
            _chart("Residual over each phase's current", "/residual/phases"),
            name="Where does the model fail?",
        ),
    ]
    if contents.excerpts:
        views = [_chart(f"Excerpt {n + 1}", f"/excerpts/{n}") for n in range(contents.excerpts)]
        tabs.append(rrb.Grid(*views, grid_columns=2, name="Does it predict the current?"))
    heat = [_chart("R_s over heat", "/heat")] if contents.resistance else []
    loops = [_chart(f"Flux loop {n + 1}", f"/loops/{n}") for n in range(contents.loops)]
    if loops or heat:
        tabs.append(rrb.Grid(*loops, *heat, grid_columns=2, name="Do the flux loops close?"))
    if contents.laws:
        laws = [_chart(f"Learned law {n + 1}", f"/law/{n}") for n in range(contents.laws)]
        text = _text("What was learned", "/law/page")
        tabs.append(rrb.Horizontal(rrb.Vertical(*laws), text, column_shares=[3, 2], name="Which law is missing?"))
    if not measured:
        return _layout(EFFECT_ADDED, *tabs)
    # The steps stand on the experiment's time too, a second each after its end: one timeline serves all tabs.
    return _layout(EXPERIMENT, *tabs, *_of_commissioning(_from_the_start(end_s), states, resistance_ohm))


def side_by_side(planes: Sequence[tuple[str, str]]) -> rrb.Blueprint:
    """For several runs: the tables, and beside them a plane for each difference, by title and path."""
    views = [_plane(title, path, bar=True) for title, path in planes]
    page = _text("Runs side by side", "/comparison/changes")
    tab = rrb.Horizontal(page, rrb.Vertical(*views), column_shares=[3, 2]) if views else rrb.Vertical(page)
    tab.name = CHANGES
    return _layout(EXPERIMENT, tab, rrb.Vertical(_text("The runs", "/comparison/runs"), name="Which runs are these?"))


def of_a_fleet(pages: Sequence[str], courses: Sequence[str], end_s: float, abreast: int = 2) -> rrb.Blueprint:
    """For a fleet's table: what it tells, its tables by name, and each quantity over time."""
    time = _from_the_start(end_s)
    plots = [_plot(title, time, f"/course/{place}") for place, title in enumerate(courses)]
    tables = {page: page.replace("_", " ") for page in pages[1:]}
    tabs = [
        rrb.Vertical(_text("Remarks on the table", "/fleet/remarks"), name="What does the table show?"),
        *([rrb.Grid(*plots, grid_columns=abreast, name="Does it drift?")] if plots else []),
        *(rrb.Vertical(_text(title, f"/fleet/{page}"), name=title.capitalize()) for page, title in tables.items()),
    ]
    return _layout(EXPERIMENT, *tabs)


def _layout(timeline: str, *tabs: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def _from_the_start(end_s: float | None) -> rrb.TimeAxis:
    """The whole experiment. (Axes linked with each other would open on half a minute about the cursor.)"""
    edge = rr.TimeRangeBoundary
    end = (
        edge.cursor_relative(seconds=DETAIL.margin_s)
        if end_s is None
        else edge.absolute(seconds=end_s + DETAIL.margin_s)
    )
    return rrb.TimeAxis(view_range=rr.TimeRange(start=edge.absolute(seconds=0.0), end=end))


def _plot(name: str, time: rrb.TimeAxis, *paths: str, within: Span | None = None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=paths[0],
        contents=list(paths),
        name=name,
        axis_x=time,
        axis_y=None if within is None else rrb.ScalarAxis(range=within),
        plot_legend=rrb.Corner2D.LeftTop,
    )


def _falling(on_experiment: bool) -> rrb.TimeSeriesView:
    """The steps up to the cursor, of which each takes a second of the experiment's time: the last diagnosis first."""
    edge, steps = rr.TimeRangeBoundary, DETAIL.ladder_steps
    start = edge.cursor_relative(seconds=-steps) if on_experiment else edge.cursor_relative(seq=-steps)
    end = edge.cursor_relative(seconds=1) if on_experiment else edge.cursor_relative(seq=1)
    return rrb.TimeSeriesView(
        origin="/ladder/rms_mv",
        contents=["/ladder/rms_mv"],
        name="The error falling [mV]",
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        plot_legend=rrb.Corner2D.RightTop,
    )


def _chart(name: str, path: str) -> rrb.Spatial2DView:
    return _flat(name, path, *chart_bounds())


def _plane(name: str, path: str, bar: bool = False) -> rrb.Spatial2DView:
    return _flat(name, path, *plane_bounds(bar))


def _flat(name: str, path: str, x: tuple[float, float], y: tuple[float, float]) -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(x_range=x, y_range=y)
    return rrb.Spatial2DView(origin=path, name=name, background=_screen(), visual_bounds=bounds)


def _surface(name: str, path: str) -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(position=[-2.3, -2.7, 1.6], look_target=[0.0, 0.0, -0.15], eye_up=[0.0, 0.0, 1.0])
    bare = rrb.LineGrid3D(visible=False)
    return rrb.Spatial3DView(origin=path, name=name, background=_screen(), eye_controls=eye, line_grid=bare)


def _screen() -> rrb.Background:
    return rrb.Background(color=packed(SCREEN), kind="SolidColor")


def _text(name: str, path: str) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(origin=path, name=name)


def _log() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"], timeline_columns=[EXPERIMENT])
    return rrb.TextLogView(origin="/log", name="Events and faults", columns=columns)

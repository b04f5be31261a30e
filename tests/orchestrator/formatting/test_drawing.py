"""Figures: whole numbers at the ticks."""

from __future__ import annotations

from orchestrator.formatting.drawing import new_figure


def test_ticks_are_whole_numbers_without_an_offset_beside_the_axis() -> None:
    figure, axes = new_figure()
    axes.plot([0.0, 1.0], [15.500, 15.503])
    figure.draw_without_rendering()
    assert axes.yaxis.get_major_formatter().get_offset() == ""
    assert [label.get_text() for label in axes.get_yticklabels()][1].startswith("15.50")

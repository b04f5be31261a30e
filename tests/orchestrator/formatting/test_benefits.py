"""A change that did not help comes with the command that undoes it."""

from __future__ import annotations

import pytest

from orchestrator.formatting.benefits import benefit_line
from protocols import Remark


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("helps", "It did."),
        ("not_needed", "It did."),
        ("does_not_help", "It did; `fluxbench remove runs/a dead_time` takes it out again."),
        ("needed", "It did; `fluxbench add runs/a dead_time` puts it back."),
    ],
)
def test_a_change_that_did_not_help_says_how_to_undo_it(code: str, told: str) -> None:
    remark = Remark(code=code, values={"effect": "dead_time"}, text="It did")
    assert benefit_line(remark, "runs/a") == told

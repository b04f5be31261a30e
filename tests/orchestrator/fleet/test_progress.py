"""How far a job is, in one line."""

from __future__ import annotations

from orchestrator.fleet import JobProgress


def test_time_left_follows_from_what_is_done_and_not_from_what_was_there() -> None:
    now, lines = [0.0], list[str]()
    progress = JobProgress(10, lines.append, clock=lambda: now[0])
    for _ in range(4):
        progress.skip()
    now[0] = 6.0
    progress.done()
    progress.done(failed=True)
    assert lines[-1] == "6 of 10 done, 1 failed, 0.333 a second, 12 s left"
    for _ in range(4):
        progress.done()
    assert "left" not in lines[-1]

"""A segment is heard as it was said; what an earlier frame has is neither said again nor made twice."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.segment_messages import heard, said_of
from orchestrator.diagnosis.fitting.segment_work import Job, Stand
from orchestrator.diagnosis.fitting.shared_room import SharedRoom
from plugins.effects.inverter import VoltageBias
from plugins.effects.timing import VoltageDelay
from protocols import LossHistory
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(prepared(plan(sparse=True)))


def sent(content: Any) -> Any:
    room = SharedRoom(1 << 24)
    found = room.opened(room.packed(content))
    room.close()
    return found


def test_a_segment_is_heard_as_it_was_said(maker: Fitter) -> None:
    losses = LossHistory(time_s=np.array([0.0, 1.0]), power_w=np.array([3.0, 5.0]))
    bare = maker.prepared.pieces[-1]
    piece = replace(bare, signals=bare.signals.model_copy(update={"losses": losses}))
    model = with_free(free_model(), maker, VoltageBias(), bias_a_v=0.1)
    columns = [(a, n) for a in model.active for n in a.free]
    stand = Stand(maker.equations, [piece], model, None, renewed=True)
    made = Job(stand, columns, [None] * len(columns), probing=True).made(0)
    there = heard(sent(said_of(made, piece, None, renewed=True)), piece, None)
    assert there.rows is not None
    assert made.rows is not None
    assert there.probe is not None
    assert made.probe is not None
    assert there.probe.answers == made.probe.answers
    np.testing.assert_array_equal(there.rows.white, made.rows.white)
    np.testing.assert_array_equal(there.probe.columns, made.probe.columns)
    np.testing.assert_array_equal(there.frame.base.inductance_ab, made.frame.base.inductance_ab)
    assert there.frame.base.losses is not None
    assert made.frame.base.losses is not None
    np.testing.assert_array_equal(there.frame.base.losses.power_w, made.frame.base.losses.power_w)
    np.testing.assert_array_equal(there.frame.base.resistance_ohm, made.frame.base.resistance_ohm)
    assert there.frame.base.i_ab is piece.signals.i_ab


def test_what_has_not_changed_is_not_said_again(maker: Fitter) -> None:
    piece, model = maker.prepared.pieces[-1], free_model()
    old = maker.equations.renewed(model, piece, None).frame
    delayed = with_free(model, maker, VoltageDelay(), delay_s=1e-6)
    stand = Stand(maker.equations, [piece], delayed, _Only(old), renewed=True)
    said = said_of(Job(stand).made(0), piece, old, renewed=True)
    assert said["frame"]["noise"] is said["frame"]["basis"] is said["frame"]["white_basis"] is None
    assert not {"i_ab", "v_ab", "theta_rad"} & said["frame"]["base"].keys()
    there = heard(sent(said), piece, old).frame
    assert there.whitener is old.whitener
    assert there.white_basis is old.white_basis
    in_old = said_of(Job(replace(stand, renewed=False)).made(0), piece, old, renewed=False)
    assert in_old["frame"] is None
    assert heard(sent(in_old), piece, old).frame is old


class _Only:
    """A frame of one segment."""

    def __init__(self, piece: Any) -> None:
        self.pieces = [piece]

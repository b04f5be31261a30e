"""The frozen set and the names of its answers."""

from __future__ import annotations

from collections import Counter

from orchestrator.benchmark import effect_sizes, frozen_rows
from orchestrator.registry.plugins import PluginKind, make_plugins


def test_the_set_has_120_recordings_of_nine_classes_on_three_plants() -> None:
    rows = frozen_rows()
    assert len(rows) == len({row.id for row in rows}) == 120
    assert len({row.kind for row in rows}) == 9
    assert Counter(row.origin for row in rows) == {"own": 63, "outer": 57}
    assert {row.plant for row in rows} == {"blind", "foreign", "motulator"}


def test_every_recording_has_its_hashes() -> None:
    assert all(len(row.data_sha256) == len(row.truth_sha256) == 64 for row in frozen_rows())


def test_every_effect_of_the_library_may_be_named_with_a_size_in_its_own_unit() -> None:
    library = {effect.name: effect for effect in make_plugins(PluginKind.EFFECTS)}
    # What the library has got since is none of the set's names.
    assert set(library) - set(effect_sizes()) == {"shunt_reconstruction"}
    assert set(effect_sizes()) < set(library)
    for name, size in effect_sizes().items():
        units = {parameter.name: parameter.unit for parameter in library[name].Parameters.declared()}
        assert units[size.parameter] == size.unit, name


def test_a_name_that_may_not_be_used_is_not_always_one_that_is_hidden() -> None:
    kinds = Counter(row.kind for row in frozen_rows() if row.without)
    assert kinds["left_out"] == 10
    assert sum(kinds.values()) > 12

"""Files of the stage that change on disk."""

import os

from previs.ui.watching import INTERVAL, REST, FileWatch


def test_a_change_is_told_once_and_only_after_it_has_rested(tmp_path):
    file = tmp_path / "a.usda"
    file.write_text("one")
    watch = FileWatch()
    watch.watch([str(file)])
    now = 0.0
    assert not watch.changed(now)
    now += INTERVAL
    assert not watch.changed(now)
    file.write_text("one and two")
    now += INTERVAL
    assert not watch.changed(now), "it may still be written"
    file.write_text("one and two and three")
    now += REST
    assert not watch.changed(now), "it was: the rest begins anew"
    now += REST
    assert watch.changed(now)
    now += INTERVAL
    assert not watch.changed(now)


def test_most_looks_cost_nothing(tmp_path, monkeypatch):
    file = tmp_path / "a.usda"
    file.write_text("one")
    watch = FileWatch()
    watch.watch([str(file)])
    watch.changed(0.0)
    monkeypatch.setattr(os, "stat", lambda *_: 1 / 0)
    assert not watch.changed(0.5 * INTERVAL)


def test_files_that_vanish_or_come_are_changes(tmp_path):
    file = tmp_path / "a.vdb"
    watch = FileWatch()
    watch.watch([str(file)])
    watch.changed(0.0)
    file.write_bytes(b"x")
    assert not watch.changed(INTERVAL)
    assert watch.changed(INTERVAL + REST)
    file.unlink()
    assert not watch.changed(3 * INTERVAL)
    assert watch.changed(3 * INTERVAL + REST)


def test_watching_other_files_is_no_change(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    first.write_text("1")
    second.write_text("2")
    watch = FileWatch()
    watch.watch([str(first)])
    watch.changed(0.0)
    watch.watch([str(first), str(second)])
    assert not watch.changed(INTERVAL)
    assert not watch.changed(3 * INTERVAL)

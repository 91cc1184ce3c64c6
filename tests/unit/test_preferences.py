"""Preferences: where they are, what survives, and what no file can do to the application."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import previs
from previs.ui.preferences import RECENT_FILES, Preferences, config_folder, set_aside, write_atomically


def test_where_they_are(monkeypatch, tmp_path):
    monkeypatch.setattr(Path, "home", lambda: Path("/home/me"))
    assert config_folder({}, "linux") == Path("/home/me/.config/previs")
    assert config_folder({"XDG_CONFIG_HOME": "/x"}, "linux") == Path("/x/previs")
    assert config_folder({"XDG_CONFIG_HOME": "relative"}, "linux") == Path("/home/me/.config/previs")
    assert config_folder({"XDG_CONFIG_HOME": "/x"}, "darwin") == Path("/home/me/Library/Application Support/previs")
    assert config_folder({"APPDATA": "/roaming"}, "win32") == Path("/roaming/previs")
    assert config_folder({}, "win32") == Path("/home/me/AppData/Roaming/previs")
    for platform in ("linux", "darwin", "win32"):
        assert config_folder({"PREVIS_CONFIG": str(tmp_path), "XDG_CONFIG_HOME": "/x"}, platform) == tmp_path
    monkeypatch.setenv("PREVIS_CONFIG", str(tmp_path / "mine"))
    assert Preferences.load().path == tmp_path / "mine" / "preferences.json"
    assert Preferences.load().layout_path.parent == tmp_path / "mine"


def test_a_first_start_has_the_defaults_and_leaves_no_trace(tmp_path):
    folder = tmp_path / "new"
    preferences = Preferences.load(folder)
    assert (preferences.recent, preferences.ocio_display, preferences.gate_mask) == ([], "", True)
    assert preferences.problem == ""
    preferences.save()
    assert not folder.exists()


def test_values_survive(tmp_path):
    preferences = Preferences.load(tmp_path)
    preferences.ocio_display = "monitor"
    preferences.gate_mask = False
    preferences.ocio_view = "Ünïcode ✓"
    preferences.add_recent(tmp_path / "a.usda")
    preferences.save()
    again = Preferences.load(tmp_path)
    assert again == preferences
    assert again.recent == [str(tmp_path / "a.usda")]
    # Only what differs from the defaults is kept: they may change for those who never chose.
    assert set(json.loads(again.path.read_text())) == {"ocio_display", "gate_mask", "ocio_view", "recent"}
    again.gate_mask = True
    again.save()
    assert "gate_mask" not in json.loads(again.path.read_text())
    assert Preferences.load(tmp_path).gate_mask is True


def test_recent_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    preferences = Preferences.load(tmp_path)
    for i in range(20):
        preferences.add_recent(f"{i}.usda")
    assert len(preferences.recent) == RECENT_FILES
    assert preferences.recent[0] == str(tmp_path / "19.usda")
    preferences.add_recent("15.usda")
    assert [Path(f).stem for f in preferences.recent[:3]] == ["15", "19", "18"]
    assert len(set(preferences.recent)) == RECENT_FILES
    preferences.forget_recent("19.usda")
    assert [Path(f).stem for f in preferences.recent[:2]] == ["15", "18"]


def test_two_processes_do_not_undo_each_other(tmp_path):
    one, two = Preferences.load(tmp_path), Preferences.load(tmp_path)
    one.ocio_display = "two"
    one.add_recent("/one.usda")
    one.save()
    two.gate_mask = False
    two.add_recent("/two.usda")
    two.save()
    again = Preferences.load(tmp_path)
    assert (again.ocio_display, again.gate_mask) == ("two", False)
    assert again.recent == [os.path.abspath("/two.usda"), os.path.abspath("/one.usda")]
    # What one has forgotten does not come back from the file.
    two.forget_recent("/one.usda")
    two.save()
    assert Preferences.load(tmp_path).recent == [os.path.abspath("/two.usda")]


def test_what_a_newer_version_wrote_stays(tmp_path):
    (tmp_path / "preferences.json").write_text('{"from_the_future": [1, {"a": null}], "ocio_display": "one"}')
    preferences = Preferences.load(tmp_path)
    assert (preferences.ocio_display, preferences.problem) == ("one", "")
    preferences.ocio_display = "three"
    preferences.save()
    assert json.loads(preferences.path.read_text()) == {"from_the_future": [1, {"a": None}], "ocio_display": "three"}


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[1, 2]", b"null", b'"text"', b"\xff\xfe\x00", b"\0" * 100, b"[" * 100_000, b'{"ocio_display": "one"'],
    ids=range(9),
)
def test_damaged_files_are_set_aside(tmp_path, content):
    path = tmp_path / "preferences.json"
    path.write_bytes(content)
    preferences = Preferences.load(tmp_path)
    assert preferences.ocio_display == ""
    assert "damaged" in preferences.problem and "\n" not in preferences.problem
    assert (tmp_path / "preferences.json.damaged").read_bytes() == content
    preferences.ocio_display = "one"
    preferences.save()
    assert Preferences.load(tmp_path).ocio_display == "one"
    assert Preferences.load(tmp_path).problem == ""
    # A second one does not replace the first.
    path.write_bytes(b"again")
    Preferences.load(tmp_path)
    assert (tmp_path / "preferences.json.damaged").read_bytes() == content
    assert (tmp_path / "preferences.json.damaged2").read_bytes() == b"again"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("recent", "1"),
        ("ocio_display", True),
        ("ocio_display", float("nan")),
        ("ocio_view", float("inf")),
        ("color_correction", 1),
        ("ocio_display", None),
        ("recent", "a.usda"),
        ("recent", ["a.usda", 3]),
        ("ocio_view", ["x"]),
    ],
)
def test_a_value_of_the_wrong_kind_is_the_default(tmp_path, name, value):
    (tmp_path / "preferences.json").write_text(json.dumps({name: value, "gate_mask": False}))
    preferences = Preferences.load(tmp_path)
    assert getattr(preferences, name) == getattr(Preferences(folder=tmp_path), name)
    assert preferences.gate_mask is False
    assert name in preferences.problem and "\n" not in preferences.problem
    # It does not stand in the way of saving either.
    preferences.add_recent("/a.usda")
    preferences.save()
    again = Preferences.load(tmp_path)
    assert again.recent == [os.path.abspath("/a.usda")]
    assert again.problem == ""


def test_a_folder_that_cannot_be_written_is_an_error_in_words(tmp_path):
    (tmp_path / "file").write_text("")
    preferences = Preferences.load(tmp_path / "file" / "folder")
    preferences.ocio_display = "one"
    with pytest.raises(previs.PrevisError, match=r"preferences\.json: preferences cannot be saved") as error:
        preferences.save()
    assert "\n" not in str(error.value)


def test_a_file_that_cannot_be_read_is_said(tmp_path):
    (tmp_path / "preferences.json").mkdir()
    assert "cannot be read" in Preferences.load(tmp_path).problem


def test_writing_leaves_the_old_file_where_it_fails(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    write_atomically(path, "old")

    def fail(*_):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="no space"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_setting_aside_moves(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("x")
    assert set_aside(path) == tmp_path / "a.json.damaged"
    assert not path.exists()


def test_nothing_of_a_window_is_imported():
    code = "import sys, previs.ui.preferences, previs.ui.recovery, previs.ui.camera_control, previs.ui.picking\n"
    code += "print([m for m in ('imgui_bundle', 'glfw') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"

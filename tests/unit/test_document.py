"""A document: edits and their history, what a refusal and an unreadable file leave, and what was seen before."""

import numpy as np
import pytest
from pxr import Sdf
from stages import PREVIS_VOLUME, SMOKE_AND_LAMP, usda, write_field

from previs import vdb
from previs.errors import PrevisError
from previs.scene import Scene
from previs.ui.document import HISTORY_LIMIT, Document


@pytest.fixture
def shot(tmp_path):
    write_field(tmp_path / "smoke.vdb")
    path = tmp_path / "shot.usda"
    path.write_text(usda(SMOKE_AND_LAMP) + PREVIS_VOLUME % "")
    return path


@pytest.fixture
def document(shot):
    opened = Document(Scene.open(shot), shot)
    yield opened
    opened.close()


def extinction(document: Document) -> tuple[float, ...]:
    return document.description.volumes["/V"].medium.extinction


def thicken(document: Document, value: float, label: str = "Extinction") -> None:
    document.edit(label, lambda scene: scene.set_medium("/V", extinction=(value,) * 3))


# --- edits --------------------------------------------------------------------------------------------------------


def test_what_was_opened(document: Document) -> None:
    assert document.name == "shot.usda"
    assert document.animated
    assert document.time == 1.0
    assert not document.modified
    assert document.error == ""
    assert (document.undo_label, document.redo_label) == ("", "")
    assert document.undo() == ""
    assert document.redo() == ""


def test_an_edit_is_seen_and_undone_exactly(document: Document) -> None:
    before, version, snapshot = extinction(document), document.version, document.scene.snapshot()
    thicken(document, 7.0)
    assert extinction(document) == (7.0, 7.0, 7.0)
    assert document.version > version
    assert document.modified
    assert document.undo_label == "Extinction"
    after = document.scene.snapshot()
    assert document.undo() == "Extinction"
    assert extinction(document) == before
    assert document.scene.snapshot() == snapshot
    assert not document.modified
    assert document.redo() == "Extinction"
    assert document.scene.snapshot() == after
    assert extinction(document) == (7.0, 7.0, 7.0)


def test_a_random_history_is_gone_through_exactly(document: Document) -> None:
    """Forth and back over many kinds of edits: every state comes again, as text and as a description."""
    random = np.random.default_rng(5)
    edits = [
        lambda s: s.set_medium("/V", albedo=tuple(random.uniform(0.1, 0.9, 3))),
        lambda s: s.set_medium("/V", scattering=tuple(random.uniform(0.1, 5.0, 3))),
        lambda s: s.reset_medium("/V"),
        lambda s: s.set_light("/L", intensity=float(random.uniform(0.0, 9.0))),
        lambda s: s.set_light("/L", time=3.0, intensity=float(random.uniform(0.0, 9.0))),
        lambda s: s.set_light("/L", color_temperature=float(random.uniform(2000, 9000))),
        lambda s: s.reset_light("/L"),
        lambda s: s.set_visible("/V", bool(random.integers(2))),
        lambda s: s.set_setting("steps", int(random.integers(10, 90))),
        lambda s: s.reset_settings(),
        lambda s: s.discard_overrides(),
    ]
    states = [(document.scene.snapshot(), document.description.volumes, document.settings)]
    for number in range(60):
        document.edit(f"edit {number}", edits[random.integers(len(edits))])
        state = (document.scene.snapshot(), document.description.volumes, document.settings)
        if state[0] != states[-1][0]:
            states.append(state)
    assert len(states) > 30

    def assert_at(i: int) -> None:
        snapshot, volumes, settings = states[i]
        assert document.scene.snapshot() == snapshot
        assert document.settings == settings
        assert set(document.description.volumes) == set(volumes)
        for path, volume in volumes.items():
            assert document.description.volumes[path].medium == volume.medium

    for i in range(len(states) - 2, -1, -1):
        document.undo()
        assert_at(i)
    assert document.undo() == ""
    for i in range(1, len(states)):
        document.redo()
        assert_at(i)
    assert document.redo() == ""


def test_an_edit_that_changes_nothing_is_none(document: Document) -> None:
    thicken(document, 7.0)
    thicken(document, 7.0)
    document.undo()
    assert document.undo_label == ""
    thicken(document, 3.0)
    assert document.redo_label == ""


@pytest.mark.parametrize("error", [PrevisError, ValueError, RuntimeError])
def test_a_refused_edit_leaves_everything_as_it_was(document: Document, error) -> None:
    thicken(document, 7.0)
    before = document.scene.snapshot(), document.version, document.description

    def half_done(scene: Scene) -> None:
        scene.set_medium("/V", extinction=(1.0, 2.0, 3.0))
        raise error("no further")

    with pytest.raises(RuntimeError if error is RuntimeError else PrevisError, match="no further"):
        document.edit("Half", half_done)
    document.refresh()
    assert document.scene.snapshot() == before[0]
    assert extinction(document) == (7.0, 7.0, 7.0)
    assert document.undo_label == "Extinction"
    assert document.error == ""


def test_what_the_scene_refuses_is_a_previs_error(document: Document) -> None:
    with pytest.raises(PrevisError, match="albedo"):
        document.edit("Albedo", lambda scene: scene.set_medium("/V", albedo=(2.0, 0.0, 0.0)))
    assert not document.modified


def test_the_history_is_bounded(document: Document) -> None:
    for i in range(HISTORY_LIMIT + 5):
        document._done.append(document._done[0]) if document._done else thicken(document, 1.0 + i)
    thicken(document, 99.0)
    assert len(document._done) == HISTORY_LIMIT


# --- groups -------------------------------------------------------------------------------------------------------


def test_a_drag_is_one_entry(document: Document) -> None:
    before = extinction(document)
    document.begin("Drag")
    for value in (2.0, 3.0, 4.0):
        thicken(document, value, "ignored")
        assert extinction(document) == (value,) * 3
    document.end()
    assert document.undo_label == "Drag"
    document.undo()
    assert extinction(document) == before
    assert document.undo_label == ""
    document.redo()
    assert extinction(document) == (4.0, 4.0, 4.0)


def test_a_drag_that_ends_where_it_began_is_no_entry(document: Document) -> None:
    thicken(document, 2.0)
    document.undo()
    document.begin("Drag")
    thicken(document, 5.0)
    document.edit("back", lambda scene: scene.reset_medium("/V"))
    document.end()
    assert document.undo_label == ""
    assert document.redo_label == "Extinction"
    document.end()
    document.begin("Nothing")
    document.end()
    assert document.undo_label == ""


def test_undo_in_the_middle_of_a_drag(document: Document) -> None:
    """What was dragged so far is taken back, and the rest of the drag is still one entry."""
    before = extinction(document)
    document.begin("Drag")
    thicken(document, 2.0)
    assert document.undo() == "Drag"
    assert extinction(document) == before
    for value in (3.0, 4.0):
        thicken(document, value)
    document.end()
    assert document.undo_label == "Drag"
    document.undo()
    assert extinction(document) == before
    assert document.undo_label == ""


def test_saving_in_the_middle_of_a_drag(document: Document, tmp_path) -> None:
    before = extinction(document)
    document.begin("Drag")
    thicken(document, 2.0)
    document.save_overrides(tmp_path / "look.usda")
    assert not document.modified
    thicken(document, 3.0)
    document.end()
    assert document.modified
    while document.undo():
        pass
    assert extinction(document) == before


def test_a_refused_edit_inside_a_drag_keeps_the_drag(document: Document) -> None:
    before = extinction(document)
    document.begin("Drag")
    thicken(document, 2.0)
    with pytest.raises(PrevisError):
        thicken(document, -1.0)
    thicken(document, 3.0)
    document.end()
    assert extinction(document) == (3.0, 3.0, 3.0)
    document.undo()
    assert extinction(document) == before


# --- what was seen before -----------------------------------------------------------------------------------------


def test_before_is_what_was_seen_before_the_last_edit(document: Document) -> None:
    first = extinction(document)
    thicken(document, 2.0)
    assert document.before.description.volumes["/V"].medium.extinction == first
    document.begin("Drag")
    thicken(document, 3.0)
    thicken(document, 4.0)
    document.end()
    assert document.before.description.volumes["/V"].medium.extinction == (2.0, 2.0, 2.0)
    document.undo()
    assert document.before.description.volumes["/V"].medium.extinction == (4.0, 4.0, 4.0)
    document.edit("Steps", lambda scene: scene.set_setting("steps", 33))
    assert document.before.settings.steps != 33


def test_before_is_of_the_time_shown(document: Document) -> None:
    """Scrubbing must not compare two times."""
    thicken(document, 2.0)
    shown = extinction(document)
    snapshot = document.scene.snapshot()
    document.set_time(5.0)
    assert document.description.lights["/L"].strength[0] == pytest.approx(
        document.before.description.lights["/L"].strength[0]
    )
    assert document.before.description.volumes["/V"].medium.extinction == (1.0, 1.0, 1.0)
    assert document.before is document.before
    assert document.scene.snapshot() == snapshot
    assert extinction(document) == shown
    assert document.undo_label == "Extinction"


def test_before_is_of_the_files_as_they_are(document: Document, tmp_path) -> None:
    thicken(document, 2.0)
    write_field(tmp_path / "smoke.vdb", size=6)
    document.reload()
    [now, before] = [d.volumes["/V"].density.grid for d in (document.description, document.before.description)]
    assert now.active_count == before.active_count == 216


# --- time and files -----------------------------------------------------------------------------------------------


def test_another_time(document: Document) -> None:
    version = document.version
    document.set_time(1.0)
    assert document.version == version
    strength = document.description.lights["/L"].strength[0]
    document.set_time(5.0)
    assert document.version > version
    assert document.description.lights["/L"].strength[0] == pytest.approx(5.0 * strength)
    assert not document.modified


def test_what_cannot_be_read_keeps_the_last_good_description(document: Document, tmp_path) -> None:
    thicken(document, 2.0)
    good, version = document.description, document.version
    (tmp_path / "smoke.vdb").rename(tmp_path / "away.vdb")
    document.reload()
    assert "smoke.vdb" in document.error
    assert document.description is good
    assert document.version == version
    # Edits go on meanwhile, and are there when the file is.
    thicken(document, 3.0)
    assert "smoke.vdb" in document.error
    (tmp_path / "away.vdb").rename(tmp_path / "smoke.vdb")
    document.reload()
    assert document.error == ""
    assert extinction(document) == (3.0, 3.0, 3.0)
    document.undo()
    assert extinction(document) == (2.0, 2.0, 2.0)


def test_a_stage_that_became_unreadable(document: Document, shot) -> None:
    text = shot.read_text()
    thicken(document, 2.0)
    shot.write_text("#usda 1.0\ndef Volume {")
    document.reload()
    assert "shot.usda" in document.error
    assert extinction(document) == (2.0, 2.0, 2.0)
    shot.write_text(text.replace("1: 1, 5: 5", "1: 1, 9: 9"))
    document.reload()
    assert document.error == ""
    assert document.time_range.end == 9.0
    assert extinction(document) == (2.0, 2.0, 2.0)


def test_an_animation_that_goes_away(document: Document, shot) -> None:
    document.set_time(5.0)
    shot.write_text(
        shot.read_text()
        .replace(".timeSamples = {\n 1: 1, 5: 5 \n}", " = 1")
        .replace(".timeSamples = { 1: 1, 5: 5 \n}", " = 1")
    )
    document.reload()
    assert document.error == ""
    assert not document.animated
    assert document.time_code is None


def test_saved_overrides_give_the_same_picture(document: Document, shot, tmp_path) -> None:
    thicken(document, 2.0)
    document.edit("Steps", lambda scene: scene.set_setting("steps", 33))
    document.save_overrides(tmp_path / "look.usda")
    assert not document.modified
    with Scene.open(shot, tmp_path / "look.usda") as scene:
        assert scene.medium("/V").extinction == (2.0, 2.0, 2.0)
        assert scene.settings()["steps"] == 33
    document.undo()
    assert document.modified


@pytest.mark.parametrize("name", ["nowhere/look.usda", "look.txt", "shot.usda", "smoke.vdb"])
def test_overrides_that_cannot_be_saved(document: Document, tmp_path, name) -> None:
    thicken(document, 2.0)
    content = {f.name: f.read_bytes() for f in tmp_path.iterdir()}
    with pytest.raises(PrevisError):
        document.save_overrides(tmp_path / name)
    assert document.modified
    assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == content


def test_discarding_and_recovering_can_be_undone(document: Document) -> None:
    thicken(document, 2.0)
    edits = document.scene.snapshot()
    document.discard()
    assert not document.modified
    document.restore_edits(edits)
    assert extinction(document) == (2.0, 2.0, 2.0)
    with pytest.raises(PrevisError):
        document.restore_edits("no usda")
    assert document.scene.snapshot() == edits
    document.undo()
    document.undo()
    assert document.scene.snapshot() == edits


def test_an_edit_of_the_session_layer_by_others_is_seen(document: Document) -> None:
    """Nothing is kept beside the stage that could be wrong about it."""
    session = document.scene.stage.GetSessionLayer()
    prim = Sdf.CreatePrimInLayer(session, "/V")
    prim.SetInfo("active", False)
    document.refresh()
    assert not document.description.volumes
    assert document.modified


def test_a_frame_that_is_missing(tmp_path) -> None:
    """The time moves on; the last good picture stays with a reason."""
    for frame in (1, 3):
        vdb.write(tmp_path / f"s.{frame}.vdb", [vdb.Grid.from_dense("density", np.full((4, 4, 4), frame, np.float32))])
    path = tmp_path / "anim.usda"
    samples = "{ 1: @./s.1.vdb@, 2: @./s.2.vdb@, 3: @./s.3.vdb@ }"
    path.write_text(
        usda(SMOKE_AND_LAMP).replace("filePath = @./smoke.vdb@", f"filePath.timeSamples = {samples}")
        + PREVIS_VOLUME % ""
    )
    document = Document(Scene.open(path), path)
    first = document.description
    document.set_time(2.0)
    assert "s.2.vdb" in document.error
    assert document.description is first
    document.set_time(3.0)
    assert document.error == ""
    assert document.description is not first
    document.close()


def test_one_unreadable_layer_does_not_hold_up_the_others(document: Document, shot, tmp_path) -> None:
    (tmp_path / "lights.usda").write_text(usda('def SphereLight "K" { float inputs:intensity = 2 }'))
    text = shot.read_text()
    shot.write_text(text.replace("#usda 1.0\n", "#usda 1.0\n(\n subLayers = [@./lights.usda@]\n)\n"))
    document.reload()
    assert set(document.description.lights) == {"/L", "/K"}
    (tmp_path / "lights.usda").write_text("no usda")
    write_field(tmp_path / "smoke.vdb", size=6)
    document.reload()
    assert "lights.usda" in document.error
    assert document.description.volumes["/V"].density.grid.active_count == 216


def test_an_error_of_ours_in_reading_costs_nothing(document: Document, monkeypatch, capfd) -> None:
    good = document.description
    with monkeypatch.context() as patched:
        patched.setattr(document.scene, "describe", lambda *_: 1 / 0)
        thicken(document, 2.0)
        thicken(document, 3.0)
        assert "ZeroDivisionError" in document.error
        assert document.description is good
    assert capfd.readouterr().err.count("Traceback") == 1
    document.undo()
    assert document.error == ""
    assert extinction(document) == (2.0, 2.0, 2.0)

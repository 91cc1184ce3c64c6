"""A picture that refines itself: which levels follow one another, what is shown meanwhile, and what an error leaves."""

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from building import box_mesh, camera, distant, index_of, scene, smooth_noise, volume

import previs
from previs import Medium, PrevisError, Settings
from previs.quality import preset
from previs.render import renderer as rendering
from previs.ui.picture import Picture, Request
from previs.ui.refinement import draft_settings

pytestmark = pytest.mark.gl

NOISE = smooth_noise((12, 12, 12))
VIEW = camera((0.5, 1.0, 6.0))
SIZE = (96, 54)
KNOBS = Settings(steps=80, light_steps=16, shadow_map_size=64, map_size=48)
SUN = distant((0.1, -1.0, 0.2), (3.0, 3.0, 3.0))
GROUND = box_mesh((-2.0, -2.5, -2.0), (2.0, -2.0, 2.0))
SMOKE = volume(NOISE, Medium())
SCENE = index_of(scene(SMOKE, GROUND, SUN))
OTHER_SCENE = index_of(scene(volume(smooth_noise((10, 11, 9), seed=4), Medium()), SUN))

_keys = itertools.count()


def request(index=SCENE, settings=KNOBS, size=SIZE, key=None) -> Request:
    return Request(key if key is not None else next(_keys), index, VIEW, size, settings)


@pytest.fixture
def picture(renderer: previs.Renderer) -> Iterator[Picture]:
    made = Picture(renderer.context)
    slow(made)
    yield made
    made.release()


def slow(picture: Picture) -> None:
    """Let the picture believe that its machine needs all levels."""
    picture.pace._seconds = {"draft": 1e-4, "preview": 1e-3, "final": 1e-2}
    picture.pace.measured = lambda *_: None


def fast(picture: Picture) -> None:
    """Let the picture believe that its machine draws the final level at once."""
    picture.pace._seconds = {"draft": 1e-9, "preview": 1e-9, "final": 1e-9}
    picture.pace.measured = lambda *_: None


def settle(picture: Picture, moving: bool = False, limit: int = 400) -> list[str]:
    """Work until there is nothing to do; the levels shown on the way."""
    levels = []
    for _ in range(limit):
        serial = picture.serial
        if picture.work(0.0, moving):
            assert picture.serial > serial
            levels.append(picture.level)
        if not picture.pending(moving):
            return levels
    raise AssertionError(f"still at work after {limit} turns: {levels}")


def drawn(index, settings=KNOBS, size=SIZE) -> np.ndarray:
    with previs.Renderer() as alone:
        return alone.render(index, VIEW, size, settings).color


# --- levels -------------------------------------------------------------------------------------------------------


def test_levels_follow_one_another(picture: Picture) -> None:
    assert picture.texture is None
    assert not picture.pending(False)
    picture.show(request())
    assert picture.pending(True)
    assert settle(picture) == ["draft", "preview", "final"]
    assert picture.finished
    assert picture.current
    assert picture.error == ""
    np.testing.assert_array_equal(picture.read(), drawn(SCENE))


def test_the_finished_picture_is_that_of_a_record(picture: Picture) -> None:
    picture.show(request())
    assert picture.image() is None
    settle(picture)
    image = picture.image()
    np.testing.assert_array_equal(image.color, drawn(SCENE))
    assert {"march", "composite"} <= set(image.stats["times"]) <= {p.name for p in picture.plan.passes}


def test_while_something_moves_a_draft_is_enough(picture: Picture) -> None:
    picture.show(request())
    assert settle(picture, moving=True) == ["draft"]
    assert picture.current
    assert not picture.finished
    assert picture.texture.size < SIZE
    assert not picture.work(1.0, True)
    assert settle(picture) == ["preview", "final"]


def test_a_draft_takes_few_steps_whatever_is_asked_for() -> None:
    draft = draft_settings(KNOBS.replace(steps=0, transmittance="march", map_size=512))
    quick = preset("draft")
    assert (draft.steps, draft.map_size) == (quick["steps"], quick["map_size"])
    assert draft.transmittance == Settings().transmittance
    assert draft.steps < 64 and draft.map_size < 100


def test_a_fast_machine_has_no_ladder(picture: Picture) -> None:
    fast(picture)
    picture.show(request())
    assert settle(picture) == ["final"]


def test_a_fast_machine_shows_pictures_while_something_moves(picture: Picture) -> None:
    """The one level there is must come to its end, however many pieces it takes."""
    fast(picture)
    picture.show(request(size=(320, 180)))
    assert settle(picture, moving=True) == ["final"]
    assert picture.finished


def test_moving_ends_the_levels_after_the_first(picture: Picture) -> None:
    picture.show(request())
    settle(picture, moving=True)
    picture._start()
    assert picture._drawing.level.name == "preview"
    assert not picture.work(1.0, True)
    assert picture._drawing is None
    assert picture.level == "draft"
    assert settle(picture) == ["preview", "final"]
    np.testing.assert_array_equal(picture.read(), drawn(SCENE))


def test_no_time_at_all_still_gets_somewhere(picture: Picture) -> None:
    """Each turn draws one piece at least, so that a window with no time to spare is not stuck."""
    picture.show(request(size=(320, 180)))
    assert settle(picture, limit=2000)[-1] == "final"


@pytest.mark.parametrize("speed", [slow, fast])
def test_a_picture_at_rest_takes_the_samples_that_are_asked_for(picture: Picture, speed) -> None:
    """Of a first picture too, which comes sooner; the mean is that of a record, plane by plane."""
    speed(picture)
    knobs = KNOBS.replace(antialias=2)
    picture.show(request(settings=knobs))
    assert settle(picture, moving=True) == (["draft"] if speed is slow else ["preview"])
    assert settle(picture)[-1] == "final"
    with previs.Renderer() as alone:
        wanted = alone.render(SCENE, VIEW, SIZE, knobs)
    found = picture.image()
    np.testing.assert_array_equal(found.color, wanted.color)
    np.testing.assert_array_equal(picture.read(), wanted.color)
    np.testing.assert_array_equal(found.depth, wanted.depth)
    assert set(found.aovs) == set(wanted.aovs)
    for name, plane in wanted.aovs.items():
        np.testing.assert_array_equal(found.aovs[name], plane, err_msg=name)
    picture.show(request())
    settle(picture)
    np.testing.assert_array_equal(picture.image().color, drawn(SCENE))


def test_samples_can_be_dropped_in_the_middle(picture: Picture) -> None:
    picture.show(request(settings=KNOBS.replace(antialias=4)))
    settle(picture, moving=True)
    while picture.level != "preview" or picture.progress < 0.5:
        picture.work(0.0, False)
    assert not picture.work(0.0, True)
    assert picture._drawing is None
    picture.show(request(OTHER_SCENE))
    settle(picture)
    np.testing.assert_array_equal(picture.read(), drawn(OTHER_SCENE))


# --- requests -----------------------------------------------------------------------------------------------------


def test_the_same_key_again_changes_nothing(picture: Picture) -> None:
    one = request()
    picture.show(one)
    settle(picture)
    serial = picture.serial
    picture.show(replace(one))
    assert not picture.pending(False)
    assert not picture.work(1.0, False)
    assert picture.serial == serial


def test_the_latest_request_wins(picture: Picture) -> None:
    picture.show(request())
    settle(picture)
    picture.show(request(settings=KNOBS.replace(coefficients=14)))
    picture.show(request(OTHER_SCENE))
    assert not picture.current
    settle(picture)
    np.testing.assert_array_equal(picture.read(), drawn(OTHER_SCENE))


def test_a_first_picture_under_way_is_finished_when_the_request_changes(picture: Picture) -> None:
    """A hand that never rests would see nothing otherwise."""
    picture.show(request())
    picture._start()
    shown = 0
    for _ in range(200):
        picture.show(request())
        shown += picture.work(0.0, True)
        assert not picture.finished
    assert shown > 20


def test_what_is_shown_is_not_taken_for_another_request(picture: Picture) -> None:
    one, other = request(), request(OTHER_SCENE)
    picture.show(one)
    settle(picture)
    picture.show(other)
    picture._start()
    picture.show(one)
    # The other one's draft may still come; it must not pass for this one.
    assert picture.pending(False) or picture.finished
    settle(picture)
    assert picture.finished
    np.testing.assert_array_equal(picture.read(), drawn(SCENE))
    np.testing.assert_array_equal(picture.image().color, drawn(SCENE))


def test_a_request_taken_back_leaves_the_finished_picture_readable(picture: Picture) -> None:
    """Also where both are drawn by the one renderer of the final level."""
    fast(picture)
    one, other = request(), request(OTHER_SCENE, size=(320, 180))
    picture.show(one)
    settle(picture)
    picture.show(other)
    picture._start()
    picture._piece(picture._drawing)
    picture.show(one)
    assert picture.image() is None
    settle(picture)
    assert picture.finished
    np.testing.assert_array_equal(picture.image().color, drawn(SCENE))


def test_what_an_edit_costs_is_that_of_its_first_picture(picture: Picture) -> None:
    picture.show(request())
    settle(picture)
    assert "march" in picture.executed
    brighter = index_of(scene(SMOKE, GROUND, SUN))
    picture.show(request(brighter, KNOBS.replace(ambient=0.5)))
    settle(picture)
    assert not any(name.startswith("map") for name in picture.executed)
    assert "march" in picture.executed
    assert picture.latency > 0.0


def test_another_size(picture: Picture) -> None:
    for size in ((96, 54), (31, 17), (1, 1), (200, 40)):
        picture.show(request(size=size))
        settle(picture)
        assert picture.texture.size == size
        assert picture.read().shape == (size[1], size[0], 3)


# --- errors -------------------------------------------------------------------------------------------------------


def failing(monkeypatch: pytest.MonkeyPatch, error: Exception) -> list[int]:
    """Let every march fail; returns a list that gets an entry per attempt."""
    attempts = []

    def fail(*_):
        attempts.append(1)
        raise error
        yield

    monkeypatch.setitem(rendering.RUNNERS, "march", fail)
    return attempts


def test_an_error_keeps_the_last_good_picture_and_is_not_tried_again(picture: Picture, monkeypatch) -> None:
    picture.show(request())
    settle(picture)
    before = picture.read()
    with monkeypatch.context() as patched:
        attempts = failing(patched, RuntimeError("no such texture unit"))
        bad = request(settings=KNOBS.replace(coefficients=14))
        picture.show(bad)
        assert settle(picture) == []
        assert "no such texture unit" in picture.error
        assert len(attempts) == 1
        assert not picture.current
        assert not picture.work(1.0, False)
        picture.show(bad)
        assert not picture.pending(False)
        assert len(attempts) == 1
    np.testing.assert_array_equal(picture.read(), before)
    picture.show(request(settings=KNOBS.replace(coefficients=14)))
    assert picture.error == ""
    assert settle(picture)[-1] == "final"


def test_a_failed_request_is_tried_again_after_another(picture: Picture, monkeypatch) -> None:
    """Otherwise the picture of the other one would stay, without a word."""
    bad = request()
    with monkeypatch.context() as patched:
        failing(patched, RuntimeError("lost"))
        picture.show(bad)
        settle(picture)
    picture.show(request(OTHER_SCENE))
    settle(picture)
    picture.show(bad)
    assert picture.pending(False)
    settle(picture)
    np.testing.assert_array_equal(picture.read(), drawn(SCENE))


def test_an_error_of_a_request_of_the_past_is_not_said_of_the_present_one(picture: Picture, monkeypatch) -> None:
    with monkeypatch.context() as patched:
        failing(patched, RuntimeError("lost"))
        picture.show(request())
        picture._start()
        picture.show(request(index_of(scene(GROUND, SUN))))
        assert settle(picture)[-1] == "final"
    assert picture.error == ""


def test_an_error_of_ours_does_not_pass_for_a_picture(picture: Picture, monkeypatch) -> None:
    """The caller tells; the request may be tried again."""
    picture.show(request())
    with monkeypatch.context() as patched:
        failing(patched, ZeroDivisionError("ours"))
        with pytest.raises(ZeroDivisionError):
            settle(picture)
    assert not picture.current
    assert picture.texture is None
    assert settle(picture)[-1] == "final"


def test_a_plan_that_cannot_be_made(picture: Picture, monkeypatch) -> None:
    def refuse(*_):
        raise PrevisError("too many lights")

    with monkeypatch.context() as patched:
        patched.setattr(picture.renderer, "plan", refuse)
        picture.show(request())
        assert settle(picture) == []
    assert picture.error == "too many lights"
    assert picture.texture is None
    assert picture.image() is None
    with pytest.raises(ValueError, match="no picture"):
        picture.read()


def test_giving_up(picture: Picture) -> None:
    picture.show(request())
    settle(picture)
    picture.show(request(OTHER_SCENE))
    picture._start()
    picture.give_up()
    assert not picture.pending(False)
    assert not picture.work(1.0, False)
    np.testing.assert_array_equal(picture.read(), drawn(SCENE))


# --- two pictures -------------------------------------------------------------------------------------------------


def test_voxels_that_are_taken_away_in_the_middle_of_a_drawing(picture: Picture) -> None:
    other = Picture(picture.context, share=picture)
    slow(other)
    try:
        picture.show(request())
        other.show(request(OTHER_SCENE))
        picture._start()
        for _ in range(3):
            picture._piece(picture._drawing)
        settle(other)
        settle(picture)
        np.testing.assert_allclose(picture.read(), drawn(SCENE), 1e-3, 1e-5)
        np.testing.assert_allclose(other.read(), drawn(OTHER_SCENE), 1e-3, 1e-5)
    finally:
        other.release()


@pytest.mark.parametrize("other_index", [SCENE, OTHER_SCENE], ids=["one scene", "other voxels"])
def test_two_pictures_side_by_side(picture: Picture, other_index) -> None:
    """Whatever voxels the other one put into the atlas, each shows its own picture."""
    other = Picture(picture.context, share=picture)
    slow(other)
    try:
        for coefficients in (6, 14, 6):
            knobs = KNOBS.replace(coefficients=coefficients)
            picture.show(request(settings=knobs))
            other.show(request(other_index, KNOBS))
            for _ in range(2000):
                picture.work(0.0, False)
                if picture.finished:
                    other.work(0.0, False)
                if picture.finished and other.finished:
                    break
            assert picture.finished
            assert other.finished
            # Voxels may lie elsewhere in an atlas that holds another's too.
            np.testing.assert_allclose(picture.read(), drawn(SCENE, knobs), 1e-3, 1e-5)
            np.testing.assert_allclose(other.read(), drawn(other_index), 1e-3, 1e-5)
    finally:
        other.release()
    picture.show(request())
    settle(picture)
    np.testing.assert_allclose(picture.read(), drawn(SCENE), 1e-3, 1e-5)


# --- letting go ---------------------------------------------------------------------------------------------------


def test_forgetting_a_scene(picture: Picture) -> None:
    one = request()
    picture.show(one)
    settle(picture)
    picture.forget()
    assert picture.texture is None
    assert picture.level == ""
    assert not picture.pending(False)
    assert not picture.finished
    picture.show(one)
    assert settle(picture)[-1] == "final"
    np.testing.assert_array_equal(picture.read(), drawn(SCENE))


def test_forgetting_in_the_middle_of_a_drawing(picture: Picture) -> None:
    picture.show(request(size=(320, 180)))
    picture._start()
    picture._piece(picture._drawing)
    picture.forget()
    picture.show(request(OTHER_SCENE))
    settle(picture)
    np.testing.assert_array_equal(picture.read(), drawn(OTHER_SCENE))

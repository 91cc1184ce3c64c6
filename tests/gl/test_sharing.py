"""Renderers that share in one context: what they have in common is there once, and neither disturbs the other."""

import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from building import box_mesh, camera, distant, field, index_of, point, scene, smooth_noise, translation, volume

import previs
from previs import Medium, Settings
from previs.render import fields
from previs.render.context import create_context
from previs.render.fields import PackedStore

pytestmark = pytest.mark.gl

NOISE = smooth_noise((12, 12, 12))
OTHER_NOISE = smooth_noise((9, 10, 11), seed=3)
VIEW = camera((0.5, 1.0, 6.0))
SIZE = (96, 54)
QUICK = Settings(steps=24, light_steps=16, shadow_map_size=64, map_size=48)
SUN = distant((0.1, -1.0, 0.2), (3.0, 3.0, 3.0))
MESH = box_mesh((-0.5, -2.0, -0.5), (0.5, -1.0, 0.5))
GLOW = volume(NOISE, Medium(emission=(2, 1, 1)), translation(-1.1, 0, 0), "/A", 3000.0 * NOISE, OTHER_NOISE)
CLOUD = volume(OTHER_NOISE, Medium(), translation(1.1, 0, 0), "/B")
SCENES = [
    scene(GLOW, CLOUD, MESH, SUN),
    scene(replace(CLOUD, path="/A"), SUN, point((0, 3, 0))),
    scene(volume(NOISE, Medium(), path="/B"), box_mesh((-1, -3, -1), (1, -2, 1)), SUN),
    scene(GLOW, SUN),
    scene(MESH, SUN),
    scene(),
]


@pytest.fixture
def pair() -> Iterator[tuple[previs.Renderer, previs.Renderer]]:
    with previs.Renderer() as one, previs.Renderer(share=one) as other:
        yield one, other


def alone(description, settings=QUICK) -> previs.Image:
    with previs.Renderer() as renderer:
        return renderer.render(index_of(description), VIEW, SIZE, settings)


def assert_equal(image: previs.Image, expected: previs.Image, rtol: float = 0.0) -> None:
    """`rtol` is for voxels that may lie elsewhere in their atlas, beside those of the other renderer: texture
    coordinates are rounded differently then."""
    for name in ("color", "alpha", "depth"):
        found, wanted = getattr(image, name), getattr(expected, name)
        np.testing.assert_allclose(found, wanted, rtol, 0.01 * rtol, err_msg=name)
    assert set(image.aovs) == set(expected.aovs)
    for name, plane in expected.aovs.items():
        np.testing.assert_allclose(image.aovs[name], plane, rtol, 0.01 * rtol, err_msg=name)


@pytest.mark.parametrize(
    "values",
    [({"coefficients": 6}, {"coefficients": 14}), ({"transmittance": "quantile"}, {"transmittance": "tfm"})],
    ids=["values", "methods"],
)
def test_two_qualities_of_one_scene_side_by_side(pair, values) -> None:
    """After the first frames nothing runs again, and each picture is that of a renderer of its own."""
    index = index_of(SCENES[0])
    knobs = [QUICK.replace(**v) for v in values]
    expected = [alone(SCENES[0], k) for k in knobs]
    for repeat in range(3):
        for renderer, settings, picture in zip(pair, knobs, expected, strict=True):
            image = renderer.render(index, VIEW, SIZE, settings)
            assert_equal(image, picture)
            assert (renderer.executed == []) == (repeat > 0)
    one, other = (r._frame for r in pair)
    assert one.density.texture is other.density.texture
    assert one.shaders is other.shaders
    assert len(one.meshes._shapes.geometries) == 1


def test_different_scenes_in_turn(pair) -> None:
    """Whatever the other one put in the place of its voxels, a renderer's picture is right."""
    indices = [index_of(s) for s in SCENES]
    expected = [alone(s) for s in SCENES]
    random = np.random.default_rng(1)
    for _ in range(40):
        which, renderer = int(random.integers(len(SCENES))), pair[random.integers(2)]
        assert_equal(renderer.render(indices[which], VIEW, SIZE, QUICK), expected[which], 2e-4)


def test_scenes_that_take_turns_between_pieces(pair) -> None:
    """A drawing whose voxels the other renderer replaced meanwhile takes them up again, wherever it was."""
    one, other = pair
    finer = QUICK.replace(steps=25)
    expected = alone(SCENES[0], finer), alone(SCENES[1]), alone(SCENES[2])
    plans = [other.plan(index_of(s), VIEW, *SIZE, QUICK) for s in SCENES[1:3]]
    one.render(index_of(SCENES[0]), VIEW, SIZE, QUICK)
    for moment in range(0, 12, 2):
        plan = one.plan(index_of(SCENES[0]), VIEW, *SIZE, finer if moment % 4 else QUICK)
        told = []
        for number, part in enumerate(one.drawing(plan, 1e-4)):
            told.append(part)
            if number == moment:
                for other_plan, picture in zip(plans, expected[1:], strict=True):
                    other.draw(other_plan)
                    assert_equal(other.image(other_plan), picture, 2e-4)
        assert len(told) > moment
        assert told == sorted(told) and told[-1] == 1.0
        assert_equal(one.image(plan), expected[0] if moment % 4 else alone(SCENES[0]), 2e-4)


@pytest.mark.parametrize("first", [0, 1])
def test_released_in_any_order(first: int) -> None:
    """The one that stays draws on; a context that a renderer made goes with the last."""
    one = previs.Renderer()
    pair = (one, previs.Renderer(share=one))
    for renderer in pair:
        renderer.render(index_of(SCENES[0]), VIEW, SIZE, QUICK)
    pair[first].release()
    left = pair[1 - first]
    for description in (SCENES[0], SCENES[1]):
        assert_equal(left.render(index_of(description), VIEW, SIZE, QUICK), alone(description))
    with left.context:
        assert left.context.error == "GL_NO_ERROR"
    third = previs.Renderer(share=left)
    left.release()
    assert_equal(third.render(index_of(SCENES[0]), VIEW, SIZE, QUICK), alone(SCENES[0]))
    third.release()


def test_forgetting_a_scene_leaves_it_to_the_other(pair) -> None:
    index = index_of(SCENES[0])
    for renderer in pair:
        renderer.render(index, VIEW, SIZE, QUICK)
    pair[0].forget_scene()
    pair[1].render(index, VIEW, SIZE, QUICK)
    assert pair[1].executed == []
    pair[1].forget_scene()
    assert pair[1]._frame.density._voxels.texture is None
    assert not pair[1]._frame.meshes._shapes.geometries


def test_what_was_drawn_can_be_read_when_the_voxels_have_moved_on(pair) -> None:
    """Until the renderer itself begins another picture."""
    plan = pair[0].plan(index_of(SCENES[0]), VIEW, *SIZE, QUICK)
    pair[0].draw(plan)
    pair[1].render(index_of(scene(volume(smooth_noise((8, 8, 8), 5), Medium()), SUN)), VIEW, SIZE, QUICK)
    assert "fields" in pair[0].stale(plan)
    assert_equal(pair[0].image(plan), alone(SCENES[0]))
    drawing = pair[0].drawing(pair[0].plan(index_of(SCENES[2]), VIEW, *SIZE, QUICK), 1e-3)
    next(drawing)
    with pytest.raises(previs.PrevisError, match="not drawn"):
        pair[0].image(plan)


def test_sharing_is_refused_across_contexts(pair) -> None:
    with previs.Renderer() as stranger, pytest.raises(ValueError, match="one context"):
        previs.Renderer(stranger.context, share=pair[0])
    with pytest.raises(ValueError, match="released"):
        previs.Renderer(share=stranger)


@pytest.fixture
def packings(monkeypatch) -> list[tuple[str, int, str]]:
    """What is packed: key of the field, components, thread."""
    made = []
    pack = fields.pack

    def counted(f, memory, limit, components, sparse):
        made.append((f.key, components, threading.current_thread().name))
        return pack(f, memory, limit, components, sparse)

    monkeypatch.setattr(fields, "pack", counted)
    return made


def test_prepared_fields_are_not_packed_again(pair, packings) -> None:
    """Packed in a thread, found by both renderers."""
    expected = alone(SCENES[0])
    packings.clear()
    told: list[float] = []
    thread = threading.Thread(target=pair[0].prepare, args=(SCENES[0], QUICK, told.append), name="packer")
    thread.start()
    thread.join()
    assert {name for _, _, name in packings} == {"packer"}
    assert len(packings) == len(set(packings)) == 4
    assert told == sorted(told) and told[-1] == 1.0
    for renderer in pair:
        assert_equal(renderer.render(index_of(SCENES[0]), VIEW, SIZE, QUICK), expected)
    assert len(packings) == 4
    pair[0].render(index_of(SCENES[0]), VIEW, SIZE, QUICK.replace(field_memory=8))
    assert len(packings) == 8


def test_preparing_stops_where_it_is_told_to(pair, packings) -> None:
    class Stop(Exception):
        pass

    def stop(part: float) -> None:
        if part > 0.0:
            raise Stop

    with pytest.raises(Stop):
        pair[0].prepare(SCENES[0], QUICK, stop)
    assert len(packings) == 1
    assert_equal(pair[0].render(index_of(SCENES[0]), VIEW, SIZE, QUICK), alone(SCENES[0]))


def test_who_wants_a_field_that_is_being_packed_waits_for_it(monkeypatch) -> None:
    begun, go = threading.Event(), threading.Event()
    made = []
    pack = fields.pack

    def slow(*arguments):
        begun.set()
        assert go.wait(10.0)
        made.append(arguments)
        return pack(*arguments)

    monkeypatch.setattr(fields, "pack", slow)
    store, f = PackedStore(), field(NOISE)
    packer = threading.Thread(target=store.prepare, args=(f, 2**20, 512, 1))
    packer.start()
    assert begun.wait(10.0)
    found = []
    taker = threading.Thread(target=lambda: found.append(store.take(f, 2**20, 512, 1)))
    taker.start()
    go.set()
    packer.join()
    taker.join()
    assert len(made) == 1
    assert found[0] is store.take(f, 2**20, 512, 1)


def test_a_packing_that_fails_is_tried_again(monkeypatch) -> None:
    pack = fields.pack
    store, f = PackedStore(), field(NOISE)
    monkeypatch.setattr(fields, "pack", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        store.prepare(f, 2**20, 512, 1)
    monkeypatch.setattr(fields, "pack", pack)
    assert store.take(f, 2**20, 512, 1).size == (14, 14, 14)


def test_the_store_keeps_to_its_memory() -> None:
    """The oldest go; one that was used lately stays, and the last one does however large it is."""
    blocks = [field(NOISE + 0.01 * i) for i in range(4)]
    size = 14**3 * 2
    store = PackedStore(2 * size)
    for f in blocks[:2]:
        store.prepare(f, 2**20, 512, 1)
    held = [store.take(f, 2**20, 512, 1) for f in blocks[1::-1]]
    store.prepare(blocks[2], 2**20, 512, 1)
    assert store.take(blocks[0], 2**20, 512, 1) is held[1]
    assert store.take(blocks[1], 2**20, 512, 1) is not held[0]
    tiny = PackedStore(1)
    tiny.prepare(blocks[0], 2**20, 512, 1)
    assert tiny.take(blocks[0], 2**20, 512, 1) is tiny.take(blocks[0], 2**20, 512, 1)


def test_what_other_scenes_packed_goes_with_the_next_scene() -> None:
    """One stage after the other may be opened, and none is left in memory."""
    with previs.Renderer() as renderer:
        stored = renderer._frame.shared.packed._stored
        renderer.prepare(SCENES[0], QUICK)
        before = len(stored)
        renderer.prepare_field(field(NOISE + 1.0), QUICK, "density")
        assert len(stored) == before + 1
        renderer.prepare(SCENES[1], QUICK)
        assert {s.field for s in stored.values()} == {CLOUD.density.key}
        assert_equal(renderer.render(index_of(SCENES[0]), VIEW, SIZE, QUICK), alone(SCENES[0]))
        renderer.prepare(scene(), QUICK)
        assert not stored


def test_one_renderer_after_another_in_a_context_of_the_caller() -> None:
    """The framebuffer that a released renderer leaves bound is gone, and moderngl must not bind it again."""
    context = create_context()
    try:
        for _ in range(3):
            with previs.Renderer(context) as renderer:
                assert_equal(renderer.render(index_of(SCENES[0]), VIEW, SIZE, QUICK), alone(SCENES[0]))
            with context:
                assert context.error == "GL_NO_ERROR"
    finally:
        context.release()


def test_an_error_that_others_left_behind_is_not_ours() -> None:
    with previs.Renderer() as renderer:
        with renderer.context as context:
            framebuffer = context.simple_framebuffer((1, 1))
            framebuffer.use()
            framebuffer.release()
            context.simple_framebuffer((1, 1)).release()
        assert_equal(renderer.render(index_of(SCENES[3]), VIEW, SIZE, QUICK), alone(SCENES[3]))

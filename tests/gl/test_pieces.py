"""A frame drawn in pieces, with other things drawn in between: the same picture, bit for bit."""

import itertools
import time
from collections.abc import Iterator

import moderngl
import numpy as np
import pytest
from building import box, box_mesh, camera, distant, index_of, point, scene, smooth_noise, spot, translation, volume

import previs
from previs import Medium, Settings
from previs.description import SceneDescription
from previs.render.pieces import BIN, Pace
from previs.render.plan import Plan

pytestmark = pytest.mark.gl

NOISE = smooth_noise((12, 12, 12))
SIZE = (200, 150)
VIEW = camera((0.5, 1.0, 6.0))
QUICK = Settings(steps=24, light_steps=16, shadow_map_size=64, map_size=100)


def cloud(path: str = "/A", x: float = 0.0, **values):
    return volume(NOISE, Medium(extinction=(2.0, 2.5, 3.0), **values), translation(x, 0, 0), path)


def lamps(count: int):
    return [point((i % 9 - 4.0, 3.0, i // 9), (2.0, 1.0, 0.5), path=f"/Lamp{i}") for i in range(count)]


SUN = distant((0.1, -1.0, 0.2), (3.0, 3.0, 3.0))
MESH = box_mesh((-0.5, -2.0, -0.5), (0.5, -1.0, 0.5))
GLOW = volume(NOISE, Medium(emission=(2.0, 1.0, 0.5)), path="/Glow", temperature=3000.0 * NOISE, emission=NOISE)
SCENES: dict[str, tuple[SceneDescription, Settings]] = {
    "meshes, two lights": (scene(cloud("/A", -1.1), cloud("/B", 1.1), MESH, SUN, point((0, 3, 1))), QUICK),
    "emission": (scene(GLOW, SUN), QUICK),
    "slices": (scene(cloud(), MESH, SUN), QUICK.replace(transmittance="march", steps=300, light_steps=300)),
    "slices and emission": (scene(GLOW, SUN), QUICK.replace(transmittance="march", steps=300, light_steps=300)),
    "batches of lights": (scene(cloud(), MESH, *lamps(70)), QUICK.replace(map_size=16)),
    "shafts": (
        scene(box(Medium(extinction=(0.3, 0.3, 0.3)), (-3, -3, -3), (3, 3, 3)), MESH, spot((0, 3, 0), (0, 0, 0))),
        QUICK,
    ),
    "no volume": (scene(MESH, SUN), QUICK),
}


@pytest.fixture
def fresh() -> Iterator[previs.Renderer]:
    """A renderer that has measured nothing yet."""
    with previs.Renderer() as mine:
        yield mine


def plan_of(renderer: previs.Renderer, name: str, size=SIZE, **knobs) -> Plan:
    description, settings = SCENES[name]
    return renderer.plan(index_of(description), VIEW, *size, settings.replace(**knobs))


def planes(image: previs.Image) -> dict[str, np.ndarray]:
    return {"color": image.color, "alpha": image.alpha, "depth": image.depth, **image.aovs}


def assert_equal(image: previs.Image, expected: previs.Image) -> None:
    assert set(planes(image)) == set(planes(expected))
    for name, plane in planes(expected).items():
        np.testing.assert_array_equal(planes(image)[name], plane, err_msg=name)


class Interface:
    """Draws as a user interface might between two pieces, and leaves everything bound and enabled that can disturb."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.target = context.simple_framebuffer((32, 32))
        self.texture = context.texture((2, 2), 4, b"\x80" * 16)
        self.volume = context.texture3d((2, 2, 2), 1, b"\x80" * 8)
        self.buffer = context.buffer(b"\xff" * 65536)
        self.program = context.program(
            vertex_shader="#version 330\nvoid main() { gl_Position = vec4(gl_VertexID - 1, gl_VertexID, 0, 1); }",
            fragment_shader="#version 330\nout vec4 c;\nvoid main() { c = vec4(1); }",
        )

    def draw(self) -> None:
        self.target.scissor = (3, 3, 9, 9)
        self.target.viewport = (1, 2, 20, 20)
        self.target.use()
        self.target.clear(0.3)
        for unit in range(16):
            (self.volume if unit % 2 else self.texture).use(unit)
        for binding in range(4):
            self.buffer.bind_to_uniform_block(binding)
        self.context.enable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self.context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        self.context.blend_equation = moderngl.FUNC_REVERSE_SUBTRACT
        vertices = self.context.vertex_array(self.program, [])
        vertices.render(moderngl.TRIANGLES, vertices=3)
        vertices.release()

    def restore(self) -> None:
        self.context.disable(moderngl.BLEND | moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        self.context.blend_func = moderngl.DEFAULT_BLENDING
        self.context.blend_equation = moderngl.FUNC_ADD


@pytest.mark.parametrize("name", SCENES)
def test_pieces_give_the_picture_of_whole_passes(fresh: previs.Renderer, name: str) -> None:
    """Small pieces, with something else drawn between any two of them."""
    plan = plan_of(fresh, name)
    fresh.draw(plan)
    expected = fresh.image(plan)
    fresh.forget_scene()
    with fresh.context:
        interface = Interface(fresh.context)
    told = []
    for part in fresh.drawing(plan, 1e-3):
        told.append(part)
        with fresh.context:
            interface.draw()
    with fresh.context:
        interface.restore()
    assert_equal(fresh.image(plan), expected)
    assert len(told) > len(plan.passes)
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert min(told) > 0.0
    assert fresh.stale(plan) == ()


def test_a_dropped_drawing_leaves_the_others_right(fresh: previs.Renderer) -> None:
    """Dropped after any number of pieces, and another plan drawn then, and the first one again."""
    plans = [plan_of(fresh, n) for n in ("meshes, two lights", "emission")]
    plans.append(plan_of(fresh, "meshes, two lights", (128, 96), coefficients=8))
    expected = []
    for plan in plans:
        fresh.draw(plan)
        expected.append(fresh.image(plan))
    random = np.random.default_rng(2)
    for _ in range(12):
        dropped, drawn = random.integers(0, len(plans), 2)
        drawing = fresh.drawing(plans[dropped], 1e-3)
        for _ in itertools.islice(drawing, int(random.integers(1, 60))):
            pass
        drawing.close()
        fresh.draw(plans[drawn])
        assert_equal(fresh.image(plans[drawn]), expected[drawn])


def test_the_pass_under_way_runs_again(fresh: previs.Renderer) -> None:
    """And no other one."""
    plan = plan_of(fresh, "meshes, two lights")
    drawing = fresh.drawing(plan, 1e-4)
    while "surface" in fresh.stale(plan):
        next(drawing)
    before = fresh.stale(plan)
    assert before == ("march", "composite")
    next(drawing)
    next(drawing)
    drawing.close()
    assert fresh.stale(plan) == before
    fresh.draw(plan)
    assert tuple(fresh.executed) == before


def test_a_dropped_edit_does_not_pass_for_the_picture_before(fresh: previs.Renderer) -> None:
    """A march that was drawn over in part is out of date for the plan that it belonged to as well."""
    index = index_of(SCENES["meshes, two lights"][0])
    plans = [fresh.plan(index, VIEW, *SIZE, QUICK.replace(steps=n)) for n in (24, 30)]
    fresh.draw(plans[0])
    expected = fresh.image(plans[0])
    drawing = fresh.drawing(plans[1], 1e-4)
    next(drawing)
    next(drawing)
    drawing.close()
    assert fresh.stale(plans[0]) == ("march", "composite")
    with pytest.raises(previs.PrevisError, match="not drawn"):
        fresh.image(plans[0])
    fresh.draw(plans[0])
    assert_equal(fresh.image(plans[0]), expected)


def test_a_drawing_that_another_one_ended_says_so(fresh: previs.Renderer) -> None:
    plan = plan_of(fresh, "emission")
    first = fresh.drawing(plan, 1e-3)
    next(first)
    fresh.draw(plan)
    with pytest.raises(RuntimeError, match="another drawing"):
        next(first)


def test_stale_is_what_runs(fresh: previs.Renderer) -> None:
    plan = plan_of(fresh, "meshes, two lights")
    assert fresh.stale(plan) == tuple(p.name for p in plan.passes)
    fresh.draw(plan)
    assert fresh.executed == [p.name for p in plan.passes]
    assert fresh.stale(plan) == ()
    other = plan_of(fresh, "meshes, two lights", map_size=64)
    expected = fresh.stale(other)
    fresh.draw(other)
    assert tuple(fresh.executed) == expected
    assert list(fresh.drawing(other, 1e-3)) == [1.0]
    assert fresh.executed == []


def test_the_texture_is_the_picture(fresh: previs.Renderer) -> None:
    """Bottom row first; nothing before the first frame."""
    with pytest.raises(previs.PrevisError, match="composite"):
        fresh.texture()
    plan = plan_of(fresh, "meshes, two lights")
    times: dict[str, float] = {}
    fresh.draw(plan, times=times)
    image = fresh.image(plan, times)
    texture = fresh.texture()
    assert texture.size == SIZE
    with fresh.context:
        values = np.frombuffer(texture.read(), np.float32).reshape(SIZE[1], SIZE[0], 4)[::-1]
    np.testing.assert_array_equal(values[..., :3], image.color)
    np.testing.assert_array_equal(values[..., 3], image.alpha)
    assert set(image.stats["times"]) == set(times) == {p.name for p in plan.passes}
    assert_equal(fresh.render(index_of(SCENES["meshes, two lights"][0]), VIEW, SIZE, QUICK), image)


def test_other_work_is_not_in_the_times(fresh: previs.Renderer) -> None:
    times: dict[str, float] = {}
    count = 0
    started = time.perf_counter()
    for _ in fresh.drawing(plan_of(fresh, "emission"), 1e-3, times):
        time.sleep(0.01)
        count += 1
    assert sum(times.values()) < time.perf_counter() - started - 0.01 * count + 1e-3


@pytest.mark.parametrize("size", [(1, 1), (63, 5), (64, 64), (130, 70), (1000, 333), (129, 1000)])
@pytest.mark.parametrize("cost", [1e-9, 1e-7, 3e-6, 1e-4, 1.0])
def test_pieces_cover_everything_once(size: tuple[int, int], cost: float) -> None:
    """Whatever a pixel costs; and no piece that could be small is long."""

    class Context:
        def finish(self) -> None:
            pass

    pace = Pace(Context())
    pace.seconds = 0.01
    random = np.random.default_rng(0)
    covered = np.zeros(size[::-1], int)
    done = 0.0
    for piece in pace.pieces("kind", size, 0.25, 0.5):
        x, y, width, height = piece.scissor
        assert width > 0 and height > 0 and x + width <= size[0] and y + height <= size[1]
        covered[y : y + height, x : x + width] += 1
        pace._costs["kind"], pace._areas["kind"] = cost * random.uniform(0.5, 1.5), width * height
        assert piece.done > done
        done = piece.done
        assert width * height * cost <= 0.03 or width * height <= 2 * BIN * BIN
    assert (covered == 1).all()
    assert done == pytest.approx(0.5)


def test_pieces_take_about_their_time(fresh: previs.Renderer) -> None:
    """On the whole: a slow march is cut into more pieces, and a longer time into fewer."""
    plan = plan_of(fresh, "emission", steps=500)
    counts = []
    for seconds in (0.05, 0.002):
        for _ in range(2):
            fresh.forget_scene()
            count = sum(1 for _ in fresh.drawing(plan, seconds))
        counts.append(count)
    assert counts[0] < counts[1]

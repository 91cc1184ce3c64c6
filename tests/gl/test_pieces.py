"""A frame drawn in pieces, with other things drawn in between: the same picture, bit for bit."""

import ctypes
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
from previs.render import pieces
from previs.render.context import finisher
from previs.render.pieces import Pace
from previs.render.planned import Plan

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


class Clock:
    """Stands in for the context and the clock: a piece takes as long as its pixels cost."""

    def __init__(self, pace_seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = self.queued = 0.0
        monkeypatch.setattr(pieces.time, "perf_counter", lambda: self.now)
        self.pace = Pace(self)
        self.pace.seconds = pace_seconds

    def finish(self) -> None:
        self.now, self.queued = self.now + self.queued, 0.0

    def frame(self, costs: np.ndarray, settings: int = 0, others: float = 0.0) -> list[float]:
        """Draw a picture of those costs per pixel, seconds; what its pieces took. `others` is what a window draws
        before every piece, seconds; like all drawing it is only queued, and done when somebody waits."""
        covered = np.zeros(costs.shape, int)
        took, done = [], 0.25
        for piece in self.pace.pieces(("kind", settings), costs.shape[::-1], 0.25, 0.5):
            x, y, width, height = piece.scissor
            assert width > 0 and height > 0 and x + width <= costs.shape[1] and y + height <= costs.shape[0]
            covered[y : y + height, x : x + width] += 1
            self.queued += others
            with piece:
                took.append(float(costs[y : y + height, x : x + width].sum()))
                self.queued += took[-1]
            assert piece.done > done
            done = piece.done
        assert (covered == 1).all()
        assert done == pytest.approx(0.5)
        return took


@pytest.mark.parametrize("size", [(1, 1), (63, 5), (64, 64), (130, 70), (1000, 333), (129, 1000)])
@pytest.mark.parametrize("cost", [0.0, 1e-9, 1e-7, 3e-6, 1e-4, 1.0])
def test_pieces_cover_everything_once(size: tuple[int, int], cost: float, monkeypatch) -> None:
    """Whatever a pixel costs, and nothing that could be drawn in smaller pieces takes long."""
    clock = Clock(0.01, monkeypatch)
    costs = cost * np.random.default_rng(0).uniform(0.5, 1.5, size[::-1])
    for _ in range(3):
        took = clock.frame(costs)
    assert max(took) <= max(0.02, 130 * 4 * 1.5 * cost)


def test_pieces_know_where_a_picture_is_slow(monkeypatch) -> None:
    """A dense cloud before an empty sky: after a coarse picture, the fine one keeps its time; so does one moved on."""
    clock = Clock(0.014, monkeypatch)

    def sky(width: int, height: int, shift: float = 0.0) -> np.ndarray:
        u, v = np.meshgrid((np.arange(width) + 0.5) / width - 0.5 - shift, (np.arange(height) + 0.5) / height - 0.5)
        return np.where(u * u + v * v < 0.09, 1e-5, 2e-8)

    for divisor in (8, 4, 2):
        clock.frame(sky(1280 // divisor, 720 // divisor))
    for shift in (0.0, 0.01, 0.02):
        took = np.array(clock.frame(sky(1280, 720, shift)))
        assert (took > 0.03).sum() <= 0.05 * len(took)
        assert took.max() <= 0.1
        # And not in needlessly many pieces.
        assert len(took) <= 3.0 * took.sum() / 0.014


def test_other_settings_are_slow_in_the_same_places(monkeypatch) -> None:
    """A draft with few steps tells where the pieces of the final picture have to be small."""
    clock = Clock(0.014, monkeypatch)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 1280), np.linspace(-0.5, 0.5, 720))
    costs = np.where(u * u + v * v < 0.09, 1e-5, 2e-8)
    clock.frame(0.2 * costs)
    for _ in range(3):
        clock.frame(0.2 * costs)
        took = np.array(clock.frame(costs, 1))
    assert took.max() <= 0.1
    assert (took > 0.03).sum() <= 0.05 * len(took)


def test_pieces_follow_another_scene(monkeypatch) -> None:
    """What was cheap is suddenly slow: some pieces are too long, not the whole frame in one."""
    clock = Clock(0.014, monkeypatch)
    clock.frame(np.full((720, 1280), 1e-8))
    took = np.array(clock.frame(np.full((720, 1280), 5e-6)))
    assert took.max() <= 0.25
    assert (took > 0.03).sum() <= 0.1 * len(took)


def test_what_others_draw_does_not_make_pieces_small(monkeypatch) -> None:
    clock = Clock(0.008, monkeypatch)
    costs = np.full((360, 640), 3e-6)
    alone = [len(clock.frame(costs)) for _ in range(3)]
    beside = [len(clock.frame(costs, others=0.02)) for _ in range(3)]
    assert beside[-1] <= 1.1 * alone[-1]


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


def test_other_threads_run_while_a_drawing_is_waited_for(renderer):
    """`finish` of moderngl holds the interpreter: what is called here instead must be a function of ctypes."""
    with renderer.context:
        wait = finisher(renderer.context)
        assert isinstance(wait, ctypes._CFuncPtr)
        wait()
        assert renderer.context.error == "GL_NO_ERROR"

"""The Python API: scenes from arrays, rendered in a few lines."""

import gc
import os
import weakref
from pathlib import Path

import numpy as np
import pytest

import previs
from previs import api
from previs.description import Camera

pytestmark = pytest.mark.gl

SIZE = (32, 18)
QUICK = {"steps": 8, "light_steps": 8, "map_size": 64, "shadow_map_size": 64}


@pytest.fixture
def scene():
    """A soft ball of smoke, a ground, a sun and two cameras."""
    axis = np.linspace(-1.0, 1.0, 16)
    distance = np.sqrt(sum(c**2 for c in np.meshgrid(axis, axis, axis)))
    with previs.Scene() as made:
        made.add_volume("/smoke", np.clip(1.0 - distance, 0.0, 1.0), bounds=((-1, -1, -1), (1, 1, 1)), extinction=3)
        made.add_ground(height=-1.2, size=20.0)
        made.add_distant_light("/sun", direction=(1, -2, -1), irradiance=3)
        made.add_camera("/front", position=(0, 0.5, 6), target=(0, 0, 0))
        made.add_camera("/top", position=(0, 8, 0.1), target=(0, 0, 0))
        yield made


def test_five_lines_of_a_notebook(tmp_path):
    density = np.ones((8, 8, 8))
    scene = previs.Scene()
    scene.add_volume("/smoke", density, bounds=((-1, -1, -1), (1, 1, 1)))
    scene.add_distant_light("/sun")
    previs.render(scene, size=SIZE).save(tmp_path / "smoke.png")
    assert (tmp_path / "smoke.png").stat().st_size > 100
    scene.close()


def test_what_an_image_holds(scene):
    image = previs.render(scene, size=SIZE)
    assert image.size == SIZE
    for plane, shape in (("color", (18, 32, 3)), ("alpha", (18, 32)), ("depth", (18, 32))):
        array = getattr(image, plane)
        assert array.shape == shape
        assert array.dtype == np.float32
    assert set(image.aovs) == {"albedo", "normal", "transmittance", "volume"}
    assert all(a.shape == (18, 32, 3) and a.dtype == np.float32 for a in image.aovs.values())
    assert np.isfinite(image.color).all() and image.color.max() > 0.01
    assert np.isinf(image.depth).any() and np.isfinite(image.depth).any()
    # The smoke hides part of what is behind the middle, nothing is in the upper corners.
    assert 0.1 < image.alpha[9, 16] <= 1.0
    assert image.alpha[0, 0] == 0.0
    assert repr(image) == f"<Image 32×18: color, alpha, depth, {', '.join(image.aovs)}>"
    assert {"plan", "executed", "times", "seconds", "memory", "device", "settings", "notes"} <= set(image.stats)


def test_rows_run_from_the_top(scene):
    image = previs.render(scene, "/front", SIZE)
    assert np.isinf(image.depth[0]).all(), "sky above"
    assert np.isfinite(image.depth[-1]).all(), "ground below"


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (64, (64, 36)),
        (None, (960, 540)),
        ((40, 40), (40, 40)),
        ([33, 7], (33, 7)),
        (np.array([5, 6]), (5, 6)),
        (1, (1, 1)),
    ],
)
def test_sizes(scene, size, expected):
    description = scene.describe()
    assert api.choose_size(api.choose_camera(scene, description, "/front", None), size) == expected
    if max(expected) < 100:
        assert previs.render(scene, "/front", size).size == expected


@pytest.mark.parametrize("size", [(64,), (64, 32, 1), "64x32", 64.5, (64.0, 32.0)])
def test_sizes_that_are_no_sizes(scene, size):
    with pytest.raises(ValueError, match=r"neither .width, height. nor a width"):
        previs.render(scene, size=size)


@pytest.mark.parametrize("size", [0, (0, 10), (10, -1), (10**6, 10)])
def test_sizes_that_are_none(scene, size):
    with pytest.raises(previs.PrevisError, match=r"image of .*×.* pixels"):
        previs.render(scene, size=size)


def test_cameras_by_path_by_name_and_as_records(scene):
    by_path = previs.render(scene, "/top", SIZE)
    np.testing.assert_array_equal(previs.render(scene, "top", SIZE).color, by_path.color)
    np.testing.assert_array_equal(previs.render(scene, scene.camera("/top"), SIZE).color, by_path.color)
    first = previs.render(scene, size=SIZE)
    assert not np.array_equal(first.color, by_path.color)
    np.testing.assert_array_equal(previs.render(scene, "/front", SIZE).color, first.color)


def test_a_scene_without_cameras_is_framed(scene):
    scene.remove("/front")
    scene.remove("/top")
    scene.remove("/ground")
    image = previs.render(scene, size=SIZE)
    assert 0.02 < (image.alpha > 0.0).mean() < 0.9
    assert not image.alpha[0].any() and not image.alpha[-1].any()


def test_an_unknown_camera_lists_the_others(scene):
    with pytest.raises(previs.PrevisError, match=r"^side: .*/front, /top"):
        previs.render(scene, "side", SIZE)


@pytest.mark.parametrize("bad", [{"coefficients": 7}, {"quality": 3}])
def test_bad_settings_are_refused_before_the_stage_is_opened(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        previs.render("no such stage.usda", **bad)


def test_settings_reach_the_renderer(scene):
    image = previs.render(scene, size=SIZE, coefficients="14", steps=33)
    assert (image.stats["settings"]["coefficients"], image.stats["settings"]["steps"]) == (14, 33)


@pytest.mark.parametrize("name", ["missing.usda", "folder", "text.txt", "broken.usda"])
def test_stages_that_cannot_be_opened_are_named(name, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.txt").write_text("hello")
    (tmp_path / "broken.usda").write_text("#usda 1.0\ndef Xform {")
    for use in (previs.open, previs.render):
        with pytest.raises(previs.PrevisError) as error:
            use(tmp_path / name)
        assert name in str(error.value)
        assert "\n" not in str(error.value)


def test_a_path_is_opened_rendered_and_closed(scene, tmp_path):
    scene.save(tmp_path / "s.usda")
    np.testing.assert_array_equal(
        previs.render(tmp_path / "s.usda", "/front", SIZE).color, previs.render(scene, "/front", SIZE).color
    )


def test_edits_show_and_run_only_what_they_must(scene):
    first = previs.render(scene, "/front", SIZE)
    same = previs.render(scene, "/front", SIZE)
    assert same.stats["executed"] == []
    np.testing.assert_array_equal(same.color, first.color)
    scene.set_medium("/smoke", albedo=0.1)
    darker = previs.render(scene, "/front", SIZE)
    assert darker.stats["executed"] == ["march", "composite"]
    assert darker.color[9, 16].sum() < first.color[9, 16].sum()


def test_one_renderer_serves_the_process(scene):
    previs.render(scene, "/front", SIZE)
    renderer = api._shared._renderer
    with previs.Scene() as other:
        other.add_box_medium("/fog")
        other.add_sphere_light("/bulb", (0, 3, 0), radiant_intensity=10)
        before = previs.render(other, size=SIZE)
        previs.render(scene, "/front", SIZE)
        assert api._shared._renderer is renderer
        np.testing.assert_array_equal(previs.render(other, size=SIZE).color, before.color)


def test_a_closed_scene_is_not_rendered_and_not_kept_alive(scene):
    with previs.Scene() as short:
        short.add_box_medium("/fog")
        previs.render(short, size=SIZE)
    with pytest.raises(ValueError, match="closed"):
        previs.render(short, size=SIZE)
    gone = weakref.ref(short)
    del short
    gc.collect()
    assert gone() is None
    previs.render(scene, size=SIZE)


def test_a_failed_render_does_not_spoil_the_next(scene, tmp_path):
    first = previs.render(scene, "/front", SIZE)
    (tmp_path / "s.usda").write_text(
        '#usda 1.0\ndef Volume "V" {\n rel field:density = </V/f>\n'
        ' def OpenVDBAsset "f" {\n asset filePath = @no.vdb@\n }\n}\n'
    )
    with pytest.raises(previs.PrevisError, match=r"no\.vdb"):
        previs.render(tmp_path / "s.usda", size=SIZE)
    np.testing.assert_array_equal(previs.render(scene, "/front", SIZE).color, first.color)


def test_progress_ends_at_one_and_may_stop_the_frame(scene):
    told: list[float] = []
    previs.render(scene, "/front", SIZE, progress=told.append)
    assert told[-1] == 1.0
    assert told == sorted(told)
    assert all(0.0 <= part <= 1.0 for part in told)

    class Stop(Exception):
        pass

    def stop(part: float) -> None:
        raise Stop

    scene.set_medium("/smoke", albedo=0.3)
    with pytest.raises(Stop):
        previs.render(scene, "/front", SIZE, progress=stop)
    after = previs.render(scene, "/front", SIZE)
    assert np.isfinite(after.color).all()
    assert previs.render(scene, "/front", SIZE).stats["executed"] == []


def test_time_selects_the_frame(tmp_path):
    (tmp_path / "s.usda").write_text(
        '#usda 1.0\ndef DistantLight "L" {\n float inputs:intensity.timeSamples = {1: 1, 2: 0}\n}\n'
        'def Mesh "M" {\n int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 1, 2, 3]\n'
        " point3f[] points = [(-9, -9, -5), (9, -9, -5), (9, 9, -5), (-9, 9, -5)]\n}\n"
    )
    camera = Camera("/c", np.eye(4))
    with previs.open(tmp_path / "s.usda") as scene:
        lit = [previs.render(scene, camera, SIZE, time=t).color.max() for t in (1.0, None, 2.0)]
    assert lit[0] == lit[1] > 0.0
    assert lit[2] == 0.0


def test_two_renderers_with_contexts_of_their_own(scene):
    index = previs.RenderIndex()
    index.update(scene.describe())
    expected = previs.render(scene, "/front", SIZE).color
    with previs.Renderer() as one, previs.Renderer() as other:
        for renderer in (one, other, one):
            image = renderer.render(index, scene.camera("/front"), SIZE)
            np.testing.assert_array_equal(image.color, expected)
    one.release()  # a second time does nothing


def resident() -> int:
    """Bytes of memory that the process holds."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_renders_in_a_loop_do_not_grow_memory(scene):
    """200 frames of edits, new voxels and other scenes. One map of light leaked a frame would be 20 MB."""

    def work(count: int) -> None:
        for i in range(count):
            scene.set_medium("/smoke", density_scale=1.0 + 0.01 * i)
            if i % 10 == 0:
                scene.set_voxels("/smoke", np.full((16, 16, 16), 0.1 + 0.01 * i))
            previs.render(scene, "/front", (96, 54), **QUICK)
            if i % 10 == 5:
                with previs.Scene() as other:
                    other.add_volume("/v", np.ones((16, 16, 16)))
                    other.add_sphere_light("/l", (20, 0, 0))
                    previs.render(other, size=(96, 54), **QUICK)

    work(40)
    before = resident()
    work(200)
    assert resident() - before < 8 * 2**20


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_released_contexts_leave_nothing(scene):
    index = previs.RenderIndex()
    index.update(scene.describe())

    def work(count: int) -> None:
        for _ in range(count):
            with previs.Renderer() as renderer:
                renderer.render(index, scene.camera("/front"), (96, 54), previs.Settings(**QUICK))

    work(3)
    before = resident()
    work(7)
    assert resident() - before < 30 * 2**20

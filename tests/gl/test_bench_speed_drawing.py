"""What ``bench --speed`` draws while it times, and whether the errors it tells are those of the picture."""

import numpy as np
import pytest
from building import box_mesh, camera, distant, index_of, scene, smooth_noise, volume

from previs import Medium, Settings, metrics
from previs.bench.run import Subject
from previs.bench.speed.accuracy import Truth
from previs.bench.speed.clock import Stopwatch
from previs.bench.speed.ways import plain

pytestmark = pytest.mark.gl

SIZE = (64, 36)
COARSE = Settings(steps=24, light_steps=24, map_size=48, coefficients=2, shadow_map_size=64, antialias=2)


@pytest.fixture
def subject() -> Subject:
    medium = Medium(extinction=(4.0, 4.0, 4.0), albedo=(0.8, 0.8, 0.8))
    cloud = volume(smooth_noise((12, 12, 12)), medium, path="/Cloud")
    ground = box_mesh((-2.0, -1.6, -2.0), (2.0, -1.2, 2.0))
    index = index_of(scene(cloud, ground, distant((0.4, -1.0, -0.3), (3.0, 3.0, 3.0))))
    return Subject("made", "made.usda", index, camera((1.0, 1.0, 6.0)), SIZE, COARSE)


@pytest.fixture
def watch(renderer, subject):
    with Stopwatch(renderer, subject) as made:
        yield made


def test_a_whole_frame_is_all_but_the_upload(watch):
    settings = watch.settings({})
    wanted = {p.name for p in watch.plan(settings).passes} - {"fields"}
    for _ in range(2):
        assert watch.whole(settings).wall > 0.0
        assert set(watch.renderer.executed) == wanted


def test_moves_run_what_they_must_and_leave_the_scene_as_it_was(watch, subject):
    settings = watch.settings({})
    maps = {p.name for p in watch.plan(settings).passes if p.kind == "transmittance_map"}
    watch.whole(settings)
    before = watch.picture(settings).color
    watch.camera_move(settings)
    assert "march" in watch.renderer.executed and not maps & set(watch.renderer.executed)
    watch.light_move(settings)
    assert maps <= set(watch.renderer.executed) and "gbuffer" not in watch.renderer.executed
    np.testing.assert_array_equal(watch.picture(settings).color, before)
    assert subject.index.scene is watch.description


def test_the_floor_and_the_frames_leave_each_other_alone(watch):
    settings = watch.settings({})
    watch.whole(settings)
    assert watch.floor().process >= 0.0 and watch.floor(7).wall > 0.0
    watch.renderer.draw(watch.plan(settings))
    assert watch.renderer.executed == []


def test_the_time_by_pass_is_that_of_all_passes(watch):
    settings = watch.settings({})
    assert set(watch.passes(settings)) == {p.kind for p in watch.plan(settings).passes} - {"fields"}


def test_rows_stand_for_the_picture(watch):
    assert watch.rows(watch.settings(plain(16)), 4).wall > 0.0


def test_errors_of_pixels_are_those_of_the_picture(renderer, watch, subject):
    settings = watch.settings({})
    image = watch.picture(settings)
    with watch.meter() as meter:
        truth = Truth(meter, subject, image, 600)
        everything = watch.picture(truth.settings).color
        found = truth.of_image(image).mean_relative_error
        assert truth.of_settings(truth.settings).mean_relative_error.value == pytest.approx(0.0, abs=1e-6)
        rough = truth.of_settings(watch.settings(plain(8))).mean_relative_error.value
    exact = metrics.mean_relative_error(image.color, everything)
    assert exact > 5e-4 and found.low <= exact <= found.high
    worse = metrics.mean_relative_error(watch.picture(watch.settings(plain(8))).color, everything)
    assert rough == pytest.approx(worse, rel=0.2)

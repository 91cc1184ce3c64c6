"""The floor: its transmittance is exp(-optical depth), whatever it marches through."""

import numpy as np
import pytest
from building import (
    box,
    camera,
    distant,
    index_of,
    orthographic_camera,
    scene,
    smooth_noise,
    sphere,
    translation,
    volume,
)

import previs
from previs import Medium, Settings
from previs.render.floor import floor_plan, floor_transmittance

pytestmark = pytest.mark.gl

SIZE = (32, 18)
ACROSS = orthographic_camera((0.0, 0.0, 5.0), width=1.0)
GREY = Medium(extinction=(0.7, 0.7, 0.7))


def floor_of(renderer, description, view=ACROSS, steps=100, settings=None):
    plan = renderer.plan(index_of(description), view, *SIZE, settings or Settings())
    floor = floor_plan(plan, steps)
    renderer.draw(floor)
    return floor_transmittance(renderer, floor)


@pytest.mark.parametrize("steps", [1, 7, 100])
def test_a_uniform_slab_attenuates_exponentially(renderer, steps):
    medium = Medium(extinction=(0.2, 0.7, 3.0), density_scale=0.5)
    found = floor_of(renderer, scene(box(medium), distant((0, -1, 0))), steps=steps)
    np.testing.assert_allclose(found, np.broadcast_to(np.exp([-0.2, -0.7, -3.0]), found.shape), rtol=1e-5)


def test_voxels_of_one_value_are_a_slab_with_soft_faces(renderer):
    # Trilinear to 0 over a voxel beyond the outermost centres: along an axis of n voxels the sum is n voxels.
    found = floor_of(renderer, scene(volume(np.full((8, 8, 8), 0.5), GREY)), steps=900)
    np.testing.assert_allclose(found, np.exp(-0.7 * 0.5 * 8 * 2.0 / 9.0), rtol=2e-4)


def test_volumes_side_by_side_and_overlapping_add_up(renderer):
    apart = [box(GREY, local_to_world=translation(0, 0, 2.0), path="/A"), box(GREY, path="/B")]
    found = floor_of(renderer, scene(*apart), steps=200)
    np.testing.assert_allclose(found, np.exp(-0.7 * 4.0), rtol=1e-2)
    mixed = [volume(np.full((8, 8, 8), 0.5), GREY, path="/A"), box(GREY, path="/B")]
    found = floor_of(renderer, scene(*mixed), steps=900)
    np.testing.assert_allclose(found, np.exp(-0.7 * (2.0 + 0.5 * 8 * 2.0 / 9.0)), rtol=1e-3)


def test_it_sees_what_the_march_sees(renderer):
    description = scene(volume(smooth_noise((16, 12, 14)), Medium(extinction=(2.0, 1.0, 0.5))), distant((0, -1, 0)))
    view = camera((2.0, 1.5, 5.0))
    image = renderer.render(index_of(description), view, SIZE, Settings(opacity_cutoff=0.0))
    np.testing.assert_allclose(floor_of(renderer, description, view, 400), image.aovs["transmittance"], atol=2e-4)


def test_every_floor_is_drawn_anew_and_the_voxels_stay(renderer):
    description = scene(volume(smooth_noise((8, 8, 8)), GREY))
    plan = renderer.plan(index_of(description), ACROSS, *SIZE, Settings())
    renderer.draw(floor_plan(plan))
    renderer.draw(floor_plan(plan))
    assert renderer.executed == ["floor"]


def test_beside_the_volumes_and_behind_the_far_plane_nothing_is_lost(renderer):
    off = orthographic_camera((9.0, 0.0, 5.0), (9.0, 0.0, 0.0), width=1.0)
    near = orthographic_camera((0.0, 0.0, 5.0), width=1.0, clip=(0.1, 1.0))
    for view in (off, near):
        np.testing.assert_array_equal(floor_of(renderer, scene(sphere(GREY)), view), 1.0)


def test_without_a_volume_there_is_no_floor(renderer):
    with pytest.raises(previs.PrevisError, match="no"):
        floor_of(renderer, scene(distant((0, -1, 0))))

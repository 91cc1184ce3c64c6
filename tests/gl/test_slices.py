"""Light-space grids: light marched once along every light ray."""

import numpy as np
import pytest
from building import camera, distant, index_of, point, scene, smooth_noise, spot, translation, volume

import previs
from previs import metrics
from previs.description import Medium
from previs.settings import Settings

FRONT = camera((0.5, 0.6, 4.0), (0, 0, 0))
GRID = np.maximum(smooth_noise((24, 20, 22), 3), 0.0)
LIGHTS = {
    "sun": distant((0.3, -1.0, -0.4), (3.0, 3.0, 3.0)),
    "point": point((1.6, 2.0, 1.0), (30.0, 30.0, 30.0)),
    "inside": point((0.1, 0.15, 0.1), (3.0, 3.0, 3.0)),
    "spot": spot((-2.0, 2.5, 1.0), (0, 0, 0), (60.0, 60.0, 60.0)),
}
MEDIA = {"grey": Medium(extinction=(6.0, 6.0, 6.0)), "coloured": Medium(extinction=(2.0, 6.0, 12.0))}


def drawn(renderer: previs.Renderer, description, **settings) -> previs.Image:
    values = {"steps": 96, "shadow_map_size": 256, **settings}
    return renderer.render(index_of(description), FRONT, (48, 36), Settings(**values))


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("light", LIGHTS)
def test_slices_are_the_exact_march(renderer: previs.Renderer, light: str, medium: str) -> None:
    """At two texels and slices per voxel what is left is interpolation, and it falls with more of both."""
    description = scene(volume(GRID, MEDIA[medium]), LIGHTS[light])
    exact = drawn(renderer, description, transmittance="march").color
    errors = [
        metrics.mean_relative_error(drawn(renderer, description, map_size=size, slices=slices).color, exact)
        for size, slices in ((24, 28), (96, 112))
    ]
    assert errors[1] < 0.01
    assert errors[1] < 0.6 * errors[0]


def test_several_volumes_shade_each_other(renderer: previs.Renderer) -> None:
    grids = volume(GRID, MEDIA["grey"]), volume(GRID[::-1], MEDIA["coloured"], translation(0.2, 1.0, 0.1), "/Above")
    description = scene(*grids, LIGHTS["sun"], LIGHTS["spot"])
    exact = drawn(renderer, description, transmittance="march").color
    assert metrics.mean_relative_error(drawn(renderer, description).color, exact) < 0.01


def test_the_number_of_coefficients_changes_nothing(renderer: previs.Renderer) -> None:
    description = scene(volume(GRID, MEDIA["grey"]), LIGHTS["sun"])
    images = [drawn(renderer, description, coefficients=n).color for n in (6, 14)]
    assert np.array_equal(*images)


def test_pieces_are_the_whole(renderer: previs.Renderer) -> None:
    """A grid that is filled a piece at a time holds what one that is filled at once does."""
    index = index_of(scene(volume(GRID, MEDIA["grey"]), LIGHTS["spot"]))
    textures = []
    for seconds in (None, 1e-5):
        renderer.forget_scene()
        plan = renderer.plan(index, FRONT, 32, 24, Settings(map_size=256, slices=56))
        for _ in renderer.drawing(plan, seconds):
            pass
        with renderer.context:
            textures.append(np.frombuffer(renderer._frame.slices.texture.read(alignment=1), np.float16))
    assert textures[0].max() > 0.5
    assert np.array_equal(*textures)

"""Lights are left out where they do not reach, and the picture stays the same."""

import numpy as np
import pytest
from building import box_mesh, camera, index_of, point, scene, smooth_noise, spot, translation, volume

from previs.description import Medium, SceneDescription, Shaping
from previs.render.renderer import Renderer
from previs.settings import Settings

KNOBS = Settings(steps=40, light_steps=24, map_size=32, shadow_map_size=64)
SIZE = (64, 36)
SMOKE = Medium(extinction=(3.0, 4.0, 5.0), albedo=(0.8, 0.7, 0.6), anisotropy=0.4)
CAMERA = camera((3.0, 1.5, 4.0), degrees=40)


@pytest.fixture(scope="module")
def renderer():
    with Renderer() as made:
        yield made


def spots(count: int, kind: str = "sphere", angle: float = 6.0, hard: bool = True) -> list:
    random = np.random.default_rng(count)
    made = []
    for i in range(count):
        x, z, a, b = random.uniform(-1.0, 1.0, 4)
        shaping = Shaping(cone_angle=angle, cone_softness=0.0 if hard and i % 2 == 0 else 0.4)
        target = (x + 0.2 * a, -1.0, z + 0.2 * b)
        made.append(spot((x, 2.5, z), target, (3.0, 2.0, 1.0), shaping, kind=kind, path=f"/Spot{i}"))
    return made


def both(renderer: Renderer, description: SceneDescription, **knobs):
    index = index_of(description)
    settings = KNOBS.replace(**knobs)
    pictures, plans = [], []
    for cull in (True, False):
        chosen = settings.replace(cull_lights=cull)
        plans.append(renderer.plan(index, CAMERA, *SIZE, chosen))
        pictures.append(renderer.render(index, CAMERA, SIZE, chosen))
        renderer.forget_scene()
    return pictures, plans


@pytest.mark.parametrize("kind", ["sphere", "disk"])
@pytest.mark.parametrize("method", ["quantile", "march"])
def test_lists_leave_the_picture_as_it_is(renderer: Renderer, kind: str, method: str):
    smoke = volume(smooth_noise((16, 16, 16), 3), SMOKE)
    floor = box_mesh((-3, -1.3, -3), (3, -1.2, 3))
    description = scene(smoke, floor, *spots(12, kind))
    (culled, whole), (plan, all_lights) = both(renderer, description, transmittance=method)
    assert plan.light_lists and not all_lights.light_lists
    np.testing.assert_allclose(culled.color, whole.color, rtol=0, atol=1e-6)
    assert whole.aovs["volume"].max() > 1e-3


def test_many_lights_in_one_batch(renderer: Renderer):
    """Without hard edges, which the steps of a batch follow."""
    description = scene(volume(smooth_noise((16, 16, 16), 3), SMOKE), *spots(80, angle=3.0, hard=False))
    (culled, whole), (plan, all_lights) = both(renderer, description, steps=16)
    assert len(plan.batches) == 1 < len(all_lights.batches)
    assert len(plan.slices) < len(all_lights.slices)
    np.testing.assert_allclose(culled.color, whole.color, rtol=0, atol=1e-6)


def test_maps_only_where_a_cone_meets_a_volume(renderer: Renderer):
    values = smooth_noise((12, 12, 12), 1)
    left = volume(values, SMOKE, translation(-1.5, 0, 0), path="/Left")
    right = volume(values, SMOKE, translation(1.5, 0, 0), path="/Right")
    narrow = Shaping(cone_angle=10.0)
    lights = [
        spot((-1.5, 4, 0), (-1.5, 0, 0), (9.0, 9.0, 9.0), narrow, path="/OnLeft"),
        spot((1.5, 4, 0), (1.5, 0, 0), (9.0, 9.0, 9.0), narrow, path="/OnRight"),
        spot((0, 4, 0), (0, 9, 0), (9.0, 9.0, 9.0), narrow, path="/Away"),
        point((0, 4, 2), path="/Around"),
    ]
    mesh = box_mesh((-0.2, -0.2, 1.2), (0.2, 0.2, 1.6))
    (culled, whole), (plan, all_pairs) = both(renderer, scene(left, right, mesh, *lights))
    pairs = {(plan.lights[m.light].record.path, plan.volumes[m.volume].path) for m in plan.maps}
    assert pairs == {("/OnLeft", "/Left"), ("/OnRight", "/Right"), ("/Around", "/Left"), ("/Around", "/Right")}
    assert len(all_pairs.maps) == 8
    assert [p.name for p in plan.passes if p.kind == "shadow_map"] == ["shadow_map /Around"]
    np.testing.assert_allclose(culled.color, whole.color, rtol=0, atol=1e-6)


@pytest.mark.parametrize("cull", [True, False])
def test_what_is_outside_the_view_still_shadows(renderer: Renderer, cull: bool):
    """A volume and a mesh high above the picture, between the light and what the camera sees."""
    seen = volume(smooth_noise((12, 12, 12), 1), SMOKE, path="/Seen")
    ground = box_mesh((-2, -1.3, -2), (2, -1.2, 2), path="/Ground")
    lamp = spot((0, 12, 0), (0, 0, 0), (200.0, 200.0, 200.0), Shaping(cone_angle=15.0))
    cloud = volume(smooth_noise((12, 12, 12), 2), Medium(extinction=(5.0,) * 3), translation(0, 6, 0), path="/Cloud")
    card = box_mesh((-3, 6, -3), (3, 6.1, 3), path="/Card")

    def mean(*records) -> float:
        image = renderer.render(
            index_of(scene(seen, ground, lamp, *records)), CAMERA, SIZE, KNOBS.replace(cull_lights=cull)
        )
        renderer.forget_scene()
        return float(image.color.mean())

    lit = mean()
    assert 0.0 < mean(cloud) < 0.8 * lit
    assert mean(card) < 0.02 * lit

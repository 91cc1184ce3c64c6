"""A march that is drawn in batches of lights and slices of its steps gives the picture that one draw would.

To rounding where nothing but the medium has a say in the steps. Where edges of shadows do, the steps of a batch follow
those of its own lights: the pictures then differ by less than any of them is off.
"""

from dataclasses import replace

import numpy as np
import pytest
from building import box_mesh, distant, index_of, point, scene, spot, translation, volume
from cases import CASES, FRONT, GRID, ROTATED, SIDE, fog

import previs
from previs import Settings, metrics
from previs.description import SceneDescription, Shaping
from previs.render import draws
from previs.settings import BY_NAME

pytestmark = pytest.mark.gl

SIZE = (32, 18)
METHODS = BY_NAME["transmittance"].choices


def two_volumes_three_lights(*more, softness: float = 0.0) -> SceneDescription:
    glowing = fog((1.0, 2.0, 4.0), albedo=(0.7, 0.7, 0.7), emission=(0.1, 0.05, 0.02))
    other = volume(GRID[::-1], fog((4.0, 2.0, 1.0)), translation(0.5, 0.3, 0.2), "/Other")
    beam = spot((-1.0, 2.0, 1.0), (0, 0, 0), (1.0, 4.0, 9.0), Shaping(30.0, softness))
    lights = (SIDE, point((1.5, 1.5, 1.0), (4.0, 1.0, 1.0)), beam)
    return scene(volume(GRID, glowing, ROTATED), other, *lights, *more)


def render(renderer: previs.Renderer, description: SceneDescription, size=SIZE, **settings) -> previs.Image:
    return renderer.render(index_of(description), FRONT, size, Settings(**settings))


def assert_same(image: previs.Image, expected: previs.Image, tolerance: float = 2e-6) -> None:
    assert metrics.mean_relative_error(image.color, expected.color) <= tolerance
    assert np.abs(image.alpha - expected.alpha).max() <= max(2.0 * tolerance, 1e-5)


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("edges", [True, False], ids=["edges", "no edges"])
def test_batches_of_lights(renderer: previs.Renderer, monkeypatch, edges: bool, method: str, size: int) -> None:
    """Five lights over two glowing volumes and, for edges, a lit mesh and a hard cone: the batches do not show."""
    solid = box_mesh((-0.3, -0.2, -0.3), (0.2, 0.3, 0.3), emissive_color=(0.1, 0.2, 0.3))
    more = (distant((0.2, 1.0, 0.3), (0.5, 1.0, 2.0), "/Fill"), point((0.0, -2.0, 0.5), (2.0, 2.0, 0.0), path="/Low"))
    description = two_volumes_three_lights(*((solid, *more) if edges else more), softness=0.0 if edges else 0.3)
    settings = {"transmittance": method, "steps": 48, "light_steps": 48, "shadow_map_size": 256, "ambient": 0.1}
    expected = render(renderer, description, **settings)
    monkeypatch.setattr(draws, "MAX_LIGHTS_PER_BATCH", size)
    # At 48 steps either picture is off by 2e-4.
    assert_same(render(renderer, description, **settings), expected, 6e-5 if edges else 2e-6)


def test_a_batched_march_is_right(renderer: previs.Renderer, monkeypatch) -> None:
    """Against the quadrature, with lights in batches of two."""
    from test_march_against_reference import measure

    monkeypatch.setattr(draws, "MAX_LIGHTS_PER_BATCH", 2)
    case = CASES["five lights"]()
    assert measure(renderer, case, SIZE, 1e-4) <= case.limit


@pytest.mark.parametrize(("budget", "batches", "tolerance"), [(900, 3, 1e-4), (3000, 1, 2e-6), (20_000, 1, 2e-6)])
def test_slices_of_steps(renderer: previs.Renderer, monkeypatch, budget: int, batches: int, tolerance: float) -> None:
    """However few steps a draw may take, the picture is that of a single draw; at the least budget, of one for each
    light, which has an edge."""
    description = two_volumes_three_lights()
    settings = {"transmittance": "march", "steps": 40, "light_steps": 8}
    expected = render(renderer, description, **settings)
    monkeypatch.setattr(draws, "LOOP_BUDGET", budget)
    plan = renderer.plan(index_of(description), FRONT, *SIZE, Settings(**settings))
    assert len(plan.batches) == batches and len(plan.slices) > 1
    assert_same(render(renderer, description, **settings), expected, tolerance)


def test_slices_of_one_step(renderer: previs.Renderer, monkeypatch) -> None:
    """The least that a draw can do: every ray arrives, no step is cut, and a note says so."""
    description = two_volumes_three_lights()
    settings = {"transmittance": "march", "steps": 40, "light_steps": 8}
    expected = render(renderer, description, **settings)
    monkeypatch.setattr(draws, "LOOP_BUDGET", 60)
    image = render(renderer, description, **settings)
    assert [n for n in image.stats["notes"] if "cut finer" in n]
    assert metrics.mean_relative_error(image.color, expected.color) <= 2e-3
    assert np.abs(image.alpha - expected.alpha).max() <= 1e-3


def test_a_long_march_is_the_sum_of_its_lights(renderer: previs.Renderer) -> None:
    """Two volumes and three lights, with more steps than a software rasteriser's loops may take in one draw."""
    description = two_volumes_three_lights()
    settings = {"transmittance": "march", "steps": 768, "light_steps": 512}
    size = (12, 7)
    together = render(renderer, description, size, **settings)
    alone = [
        render(renderer, replace(description, lights={path: light}), size, **settings)
        for path, light in description.lights.items()
    ]
    emission = together.aovs["emission"]
    total = sum(image.aovs["volume"] for image in alone) + emission
    assert emission.max() > 0.0
    assert metrics.mean_relative_error(together.color, total) <= 5e-6

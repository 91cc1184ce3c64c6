"""Transmittance maps against the brute-force march of the same steps: what the maps alone cost, in decibels."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from building import distant, index_of, point, scene, smooth_noise, spot, volume
from cases import FRONT, fog

import previs
from previs import Settings, metrics
from previs.description import SceneDescription, Shaping
from previs.render.plan import make_plan

pytestmark = pytest.mark.gl

SIZE = (64, 36)


def ball(x: float, y: float, z: float, radius: float, edge: float) -> np.ndarray:
    """Density 1 inside a ball, falling to 0 over about four times `edge`; 32³ voxels over the cube from −1 to 1."""
    axis = np.linspace(-1.0, 1.0, 32)
    at = np.meshgrid(axis, axis, axis, indexing="ij")
    distance = np.sqrt(sum((a - c) ** 2 for a, c in zip(at, (x, y, z), strict=True)))
    return 1.0 / (1.0 + np.exp(np.minimum((distance - radius) / edge, 60.0)))


@cache
def volumes() -> dict:
    noise = 1.0 + 0.5 * smooth_noise((32, 32, 32), 1, 4)
    return {
        "smooth blob": volume(ball(0, 0, 0, 0.55, 0.12), fog(4.0, anisotropy=0.3)),
        # Optical depth 500 across the middle.
        "dense ball": volume(ball(0, 0, 0, 0.7, 0.02), fog(360.0)),
        "two blobs with a gap": volume(ball(-0.55, 0.3, 0, 0.3, 0.04) + ball(0.5, -0.35, 0, 0.35, 0.04), fog(8.0)),
        "coloured blob": volume(ball(0, 0, 0, 0.55, 0.12) * noise, fog((2.0, 4.0, 8.0))),
    }


LIGHTS = {
    "sun": distant((-1.0, -0.7, -0.4), (3.0, 3.0, 3.0)),
    "lamp": point((1.5, 1.6, 1.2), (9.0, 9.0, 9.0)),
    "lamp inside": point((0.05, 0.9, 0.0), (2.0, 2.0, 2.0), radius=0.1),
    "spot": spot((0.5, 2.2, 1.0), (0.0, 0.0, 0.0), (20.0, 20.0, 20.0), Shaping(25.0, 0.3)),
    "spot inside": spot((0.0, 0.8, 0.0), (0.0, -1.0, 0.0), (4.0, 4.0, 4.0), Shaping(40.0, 0.3), radius=0.1),
}
METHODS = ("quantile", "tfm", "tfm-plain")
#: Content, light, kind of map, knobs, and the least decibels with 6 and with 14 values of each of the methods.
CASES = [
    ("smooth blob", "sun", "orthographic", {}, (51, 65, 53, 69, 47, 75)),
    ("smooth blob", "lamp", "perspective", {}, (51, 67, 54, 71, 44, 75)),
    ("smooth blob", "lamp inside", "octahedral", {}, (69, 69, 65, 69, 62, 84)),
    ("coloured blob", "spot", "perspective", {}, (47, 57, 56, 69, 38, 66)),
    ("coloured blob", "spot inside", "perspective", {}, (57, 61, 63, 72, 51, 65)),
    # Its surface is thinner than a texel that follows the voxels.
    (
        "dense ball",
        "sun",
        "orthographic",
        {"map_size": 256, "steps": 1024, "light_steps": 1024},
        (43, 54, 47, 55, 21, 27),
    ),
    ("two blobs with a gap", "sun", "orthographic", {}, (48, 58, 44, 70, 34, 58)),
    ("two blobs with a gap", "lamp", "perspective", {}, (51, 63, 46, 72, 36, 59)),
]


def render(renderer: previs.Renderer, description: SceneDescription, **knobs) -> np.ndarray:
    settings = Settings(**{"steps": 384, "light_steps": 384, **knobs})
    return renderer.render(index_of(description), FRONT, SIZE, settings).color


@pytest.mark.parametrize(("content", "light", "kind", "knobs", "floors"), CASES, ids=[f"{c[0]}, {c[1]}" for c in CASES])
def test_decibels(renderer: previs.Renderer, record_property, content: str, light: str, kind, knobs, floors) -> None:
    """Each method and number of coefficients reaches what it did when measured, and 14 are better than 6."""
    description = scene(volumes()[content], LIGHTS[light])
    plan = make_plan(index_of(description), FRONT, *SIZE, Settings(**knobs))
    assert [m.fit.kind for m in plan.maps] == [kind]
    truth = render(renderer, description, **knobs, transmittance="march")
    found = {}
    for method in METHODS:
        for count in (6, 14):
            image = render(renderer, description, **knobs, transmittance=method, coefficients=count)
            found[f"{method} {count}"] = metrics.psnr(image, truth)
    for name, value in found.items():
        record_property(name, value)
    assert all(value >= floor for value, floor in zip(found.values(), floors, strict=True)), found
    assert all(found[f"{method} 14"] > found[f"{method} 6"] for method in METHODS), found
    assert min(found["quantile 6"], found["tfm 6"]) > found["tfm-plain 6"]


@pytest.mark.parametrize(("method", "gain"), [("quantile", 20.0), ("tfm", 20.0), ("tfm-plain", 20.0)])
def test_more_values_are_better(renderer: previs.Renderer, method: str, gain: float) -> None:
    """From 2 to 16, while the values are what limits."""
    description = scene(volumes()["two blobs with a gap"], LIGHTS["sun"])
    truth = render(renderer, description, transmittance="march")
    knobs = {"transmittance": method, "map_size": 256}
    found = [metrics.psnr(render(renderer, description, coefficients=n, **knobs), truth) for n in (2, 4, 6, 10, 14, 16)]
    assert found == sorted(found)
    assert found[-1] > found[0] + gain, found


def test_two_blobs_with_a_gap_take_six_values(renderer: previs.Renderer, record_property) -> None:
    """Less than 3 % of the light is in the wrong place with six values, because the gap takes none of the range."""
    for light in ("sun", "lamp"):
        description = scene(volumes()["two blobs with a gap"], LIGHTS[light])
        truth = render(renderer, description, transmittance="march")
        for method in ("quantile", "tfm"):
            image = render(renderer, description, transmittance=method, coefficients=6)
            error = metrics.mean_relative_error(image, truth)
            record_property(f"{light} {method}", error)
            assert error <= 0.03, (light, method)


def test_density_weighting(renderer: previs.Renderer, record_property) -> None:
    """Storing a root of the transmittance helps the full-range map where the medium is thin enough to see through."""
    description = scene(volumes()["coloured blob"], LIGHTS["sun"])
    truth = render(renderer, description, transmittance="march")
    knobs = {"transmittance": "tfm-plain", "coefficients": 6}
    plain, weighted = (
        metrics.psnr(render(renderer, description, density_weighting=alpha, **knobs), truth) for alpha in (1.0, 4.0)
    )
    record_property("alpha 1", plain)
    record_property("alpha 4", weighted)
    assert weighted > plain + 6.0


@pytest.mark.parametrize("method", ["quantile", "tfm"])
def test_nearest_texel(renderer: previs.Renderer, record_property, method: str) -> None:
    """Without blending the map's texels show, and cost a few decibels, not the picture."""
    description = scene(volumes()["smooth blob"], LIGHTS["lamp"])
    truth = render(renderer, description, transmittance="march")
    blend, nearest = (
        metrics.psnr(render(renderer, description, transmittance=method, coefficients=14, map_filter=name), truth)
        for name in ("blend", "nearest")
    )
    record_property("blend", blend)
    record_property("nearest", nearest)
    assert blend > nearest >= 45.0


@pytest.mark.parametrize("method", ["quantile", "tfm"])
def test_finer_maps_are_better(renderer: previs.Renderer, method: str) -> None:
    """The edge of a dense ball is as sharp as the map's texels."""
    description = scene(volumes()["dense ball"], LIGHTS["sun"])
    knobs = {"steps": 1024, "light_steps": 1024}
    truth = render(renderer, description, transmittance="march", **knobs)
    found = [
        metrics.psnr(render(renderer, description, transmittance=method, coefficients=14, map_size=n, **knobs), truth)
        for n in (32, 64, 128, 256)
    ]
    assert all(b > a + 3.0 for a, b in pairwise(found)), found


@pytest.mark.parametrize("method", METHODS)
def test_maps_of_overlapping_volumes_multiply(renderer: previs.Renderer, method: str) -> None:
    """A cloud given as two halves of its density is the cloud."""
    whole = volumes()["smooth blob"]
    values = whole.density.grid.dense((0, 0, 0), (31, 31, 31))
    medium = fog(4.0, anisotropy=0.3)
    halves = [volume(values * share, medium, path=f"/{share}") for share in (0.3, 0.7)]
    knobs = {"transmittance": method, "coefficients": 14}
    together = render(renderer, scene(whole, LIGHTS["lamp"]), **knobs)
    apart = render(renderer, scene(*halves, LIGHTS["lamp"]), **knobs)
    assert metrics.psnr(apart, together) >= 50.0


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_brighter_than_unshadowed_light(renderer: previs.Renderer, method: str) -> None:
    """Neither the ringing of a cosine series nor a cubic between depths ever makes light."""
    for content, held in volumes().items():
        lit = render(renderer, scene(held, LIGHTS["sun"]), transmittance=method, steps=64, light_steps=64)
        free = distant((-1.0, -0.7, -0.4), (3.0, 3.0, 3.0), casts_shadows=False)
        unshadowed = render(renderer, scene(held, free), transmittance=method, steps=64, light_steps=64)
        assert np.all(lit <= unshadowed * (1.0 + 1e-4) + 1e-7), content

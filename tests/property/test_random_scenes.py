"""Random small scenes: the GPU against the float64 reference, and pictures that stay finite and within bounds.

PREVIS_EXAMPLES sets how many scenes every test takes, new ones in every run; without it there are few, always
the same. What fails is shrunk by hypothesis, and the scene is printed in one line.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
from building import index_of
from figures import FIGURES
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

import previs
from previs import Settings, metrics
from previs.bench.random_scenes import (
    GENTLE,
    WILD,
    RandomChoices,
    RandomScene,
    Structure,
    Tier,
    field,
    look_at,
    polygons,
    random_scene,
    random_structure,
    unshadowed,
)
from previs.bench.reference_scene import reference_image
from previs.description import Box, Camera, Light, Mesh, SceneDescription, Volume, framing_camera
from previs.settings import BY_NAME

pytestmark = pytest.mark.gl

T = TypeVar("T")

SIZE = (10, 8)
METHODS = BY_NAME["transmittance"].choices
#: A march whose steps are fine enough that those of a gentle scene are not what limits.
CONVERGED = {
    "transmittance": "march",
    "steps": 512,
    "light_steps": 128,
    "shadow_map_size": 2048,
    "opacity_cutoff": 1e-6,
}
#: The share of a picture's light that may be in the wrong place. Smooth pictures are met to 1e-5; the edge of a cone or
#: of another volume's shadow falls inside a step, half floats hold voxels to 5e-4 of their peak, and one step through
#: a dense medium is a visible part of what it scatters.
LIMIT = 5e-3
#: How far, in pixels, a rasterised edge or the edge of a shadow may be from where it is: vertices are placed to
#: 1/256 of a pixel, a texel of a shadow map of 2048² is up to a hundredth of one of these small pictures' pixels.
EDGE_SHIFT = 0.02
#: Light below this part of what the scene would have without shadows is as good as none.
DARK = 5e-2

#: Shaders are compiled for a structure: a few that together have everything keep that short.
STRUCTURES = (
    Structure(("grid",), ("distant",), ("hg",)),
    Structure(("grid",), ("point",), ("isotropic",), chromatic=True),
    Structure(("sphere",), ("sphere",), ("schlick",)),
    Structure(("box",), ("spot",), ("rayleigh",)),
    Structure(("box",), ("spot",), ("hg",), occluders=("box",)),
    Structure(("capsule",), ("disk", "distant"), ("two_lobe",), chromatic=True),
    Structure(("grid",), ("spot",), ("two_lobe",), occluders=("box", "quad")),
    Structure(("grid", "sphere"), ("rect", "sphere"), ("hg", "rayleigh")),
    Structure(("grid", "grid"), ("point", "spot", "distant"), ("schlick", "hg"), True, "none", ("quad",), dome=True),
    Structure(("grid",), ("sphere",), ("hg",), emission="field"),
    Structure(("grid",), ("distant",), ("isotropic",), True, "temperature", ("box",)),
    Structure(
        ("box", "capsule", "grid"), ("spot", "disk", "point"), ("hg", "isotropic", "two_lobe"), False, "constant"
    ),
    Structure(("sphere", "sphere", "box"), ("distant", "sphere"), ("rayleigh",) * 3, occluders=("quad",)),
    Structure(("grid", "grid", "grid"), ("distant", "point"), ("hg",) * 3, chromatic=True),
)
#: For pictures by maps: grids, one and several, grey and coloured, near every kind of light and map.
MAPPED = (STRUCTURES[0], STRUCTURES[1], STRUCTURES[7])
#: For wild scenes, which are drawn by every method.
BOUNDED = (STRUCTURES[8], STRUCTURES[11])


class Drawn:
    """Choices by hypothesis."""

    def __init__(self, draw: st.DrawFn) -> None:
        self._draw = draw

    def number(self, lo: float, hi: float) -> float:
        return self._draw(st.floats(lo, hi))

    def integer(self, lo: int, hi: int) -> int:
        return self._draw(st.integers(lo, hi))

    def pick(self, options: Sequence[T]) -> T:
        return options[self._draw(st.integers(0, len(options) - 1))]


@st.composite
def scenes(draw: st.DrawFn, tier: Tier, structures: Sequence[Structure] = ()) -> RandomScene:
    """Scenes of the given structures, or of any."""
    choose = Drawn(draw)
    return random_scene(choose, tier, choose.pick(structures) if structures else random_structure(choose))


def examples(count: int):
    """So many scenes; as many as PREVIS_EXAMPLES says, and new ones, where it is set."""
    wanted = int(os.environ.get("PREVIS_EXAMPLES", "0"))
    return settings(
        max_examples=wanted or count,
        derandomize=not wanted,
        deadline=None,
        database=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
    )


def render(renderer: previs.Renderer, made: RandomScene, size: tuple[int, int] = SIZE, **knobs) -> previs.Image:
    return renderer.render(index_of(made.description), made.camera, size, Settings(**knobs))


def shifted(camera: Camera, size: tuple[int, int], across: float, up: float) -> Camera:
    """The camera whose picture lies that many pixels off."""
    conformed = camera.conformed(size[0] / size[1])
    pixel = conformed.horizontal_aperture / size[0]
    return replace(
        camera,
        horizontal_aperture_offset=camera.horizontal_aperture_offset + across * pixel,
        vertical_aperture_offset=camera.vertical_aperture_offset + up * pixel,
    )


def brightness(picture: np.ndarray) -> float:
    """Mean over the lit pixels."""
    lit = picture[metrics.lit_mask(picture)]
    return float(lit.mean()) if lit.size else 0.0


def share_misplaced(color: np.ndarray, made: RandomScene, size: tuple[int, int] = SIZE, limit: float = LIMIT) -> float:
    """The part of the picture's light that is in the wrong place, as `metrics.mean_relative_error` has it.

    Where that is above the limit it is measured again, allowing every pixel what the reference shows within
    `EDGE_SHIFT` of its centre, and for light that is hardly there.
    """
    truth = reference_image(made.description, made.camera, *size, max_error=1e-4).color
    error = metrics.mean_relative_error(color, truth)
    if error <= limit:
        return error
    around = [truth]
    for across in (-EDGE_SHIFT, 0.0, EDGE_SHIFT):
        for up in (-EDGE_SHIFT, 0.0, EDGE_SHIFT):
            if across or up:
                camera = shifted(made.camera, size, across, up)
                around.append(reference_image(made.description, camera, *size, max_error=1e-3).color)
    low, high = np.min(around, axis=0), np.max(around, axis=0)
    excess = np.abs(color - np.clip(color, low, high))
    bright = reference_image(unshadowed(made.description), made.camera, *size, max_error=1e-3).color
    lit = max(int(np.count_nonzero(metrics.lit_mask(truth))) * 3, 1)
    scale = max(brightness(truth), DARK * brightness(bright))
    return float(excess.sum()) / lit / scale if scale > 0.0 else float(excess.max())


@examples(100)
@given(made=scenes(GENTLE, STRUCTURES))
def test_march_equals_the_reference(made: RandomScene, renderer: previs.Renderer) -> None:
    """At converged steps the brute-force march is the quadrature's picture."""
    note(made.text)
    error = share_misplaced(render(renderer, made, **CONVERGED).color, made)
    FIGURES["march, share of light misplaced"].append(error)
    assert error <= LIMIT


@pytest.mark.slow
@examples(2000)
@given(made=scenes(GENTLE))
def test_march_equals_the_reference_in_any_structure(made: RandomScene, renderer: previs.Renderer) -> None:
    """The same for scenes of any structure, each of which compiles shaders of its own."""
    note(made.text)
    error = share_misplaced(render(renderer, made, **CONVERGED).color, made)
    FIGURES["march, any structure, share of light misplaced"].append(error)
    assert error <= LIMIT


#: By number of coefficients: the greatest mean error and the fewest decibels that every gentle scene must keep to. Most
#: do far better; a picture of 80 pixels in which one lies on the edge of a dense medium does no better.
MAP_LIMITS = {6: (0.06, 30.0), 14: (0.03, 34.0)}


@examples(12)
@given(made=scenes(GENTLE, MAPPED))
def test_maps_at_default_settings(made: RandomScene, renderer: previs.Renderer) -> None:
    """The default method with 6 and 14 coefficients, against a march of the same steps: what the maps cost."""
    note(made.text)
    truth = render(renderer, made, transmittance="march").color
    if brightness(truth) <= DARK * brightness(render(renderer, bright(made), transmittance="march").color):
        return
    for count, (most, least) in MAP_LIMITS.items():
        color = render(renderer, made, coefficients=count).color
        error, decibels = metrics.mean_relative_error(color, truth), metrics.psnr(color, truth)
        FIGURES[f"default method, {count} coefficients, mean error"].append(error)
        FIGURES[f"default method, {count} coefficients, decibels"].append(min(decibels, 120.0))
        assert error <= most
        assert decibels >= least


def bright(made: RandomScene) -> RandomScene:
    """The same without shadows."""
    return RandomScene(unshadowed(made.description), made.camera, made.text, made.structure)


def assert_bounded(renderer: previs.Renderer, made: RandomScene, **knobs) -> None:
    """Every plane is finite, transmittance and opacity are in [0, 1], and no light is more than unshadowed light."""
    size, common = (8, 6), {"steps": 24, "light_steps": 24, "map_size": 16, "shadow_map_size": 64, **knobs}
    most = render(renderer, bright(made), size, **{**common, "transmittance": "march"}).color
    for method in METHODS:
        image = render(renderer, made, size, **{**common, "transmittance": method})
        for name, plane in {"color": image.color, "alpha": image.alpha, **image.aovs}.items():
            assert np.isfinite(plane).all(), (method, name)
        FIGURES["wild pictures drawn"].append(1.0)
        assert image.color.min() >= 0.0, method
        assert 0.0 <= image.alpha.min() and image.alpha.max() <= 1.0, method
        passed = image.aovs.get("transmittance", np.ones(1))
        assert 0.0 <= passed.min() and passed.max() <= 1.0, method
        # Of few steps, which shadows cut where their edges are: a soft cone, looked at once a step, is then met
        # elsewhere. What this is for is light out of nothing.
        assert np.all(image.color <= 1.5 * most + 0.02 * most.max()), method


@examples(30)
@given(made=scenes(WILD, BOUNDED))
def test_wild_scenes_stay_in_bounds(made: RandomScene, renderer: previs.Renderer) -> None:
    """Whatever the records hold, by every method."""
    note(made.text)
    assert_bounded(renderer, made)


@pytest.mark.slow
def test_ten_thousand_pictures_are_finite(renderer: previs.Renderer) -> None:
    """Wild scenes of any structure, evenly distributed; a new structure every tenth, as each compiles shaders."""
    structures = RandomChoices(np.random.default_rng(1))
    number = 0
    while len(FIGURES["wild pictures drawn"]) < 10_000:
        if number % 10 == 0:
            structure = random_structure(structures)
        made = random_scene(RandomChoices(np.random.default_rng((7, number))), WILD, structure)
        try:
            assert_bounded(renderer, made)
        except AssertionError as error:
            raise AssertionError(f"scene {number}: {made.structure}: {made.text}") from error
        number += 1


@pytest.mark.parametrize("role", ["emission", "temperature"])
def test_an_empty_emission_field_emits_nothing(role: str, renderer: previs.Renderer) -> None:
    """As the first frame of an explosion has it: smoke is there, fire is not yet."""
    ones, none = np.ones((4, 4, 4)), np.zeros((4, 4, 4))
    medium = previs.Medium(albedo=(0.5,) * 3, emission=(1.0,) * 3)
    smoke = Volume("/Smoke", np.eye(4), medium, density=field(ones), **{role: field(none)})
    description = SceneDescription(volumes={"/Smoke": smoke})
    image = renderer.render(index_of(description), framing_camera(description), SIZE, Settings())
    assert not image.color.any()


def test_a_flat_mesh_edge_on_to_the_sun(renderer: previs.Renderer) -> None:
    """A card whose plane holds the direction of the light shades nothing."""
    card = Mesh("/Card", polygons([(-1, 0, 1), (1, 0, 1), (1, 1, 1), (-1, 1, 1)], [(0, 1, 2, 3)]), np.eye(4)[None])
    sun = Light("/Sun", "distant", look_at((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (1.0,) * 3, (1.0,) * 3)
    fog = Volume("/Fog", np.eye(4), shape=Box((-1.0,) * 3, (1.0,) * 3))
    description = SceneDescription({"/Fog": fog}, {"/Sun": sun}, {"/Card": card})
    image = renderer.render(index_of(description), framing_camera(description), SIZE, Settings())
    assert image.color.max() > 0.0

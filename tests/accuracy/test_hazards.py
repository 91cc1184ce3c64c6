"""Values at the limits of what 32-bit floats can hold: the picture is finite, and right where the reference can say."""

import numpy as np
import pytest
from building import (
    box,
    box_mesh,
    camera,
    distant,
    index_of,
    moved,
    point,
    quad_mesh,
    scaling,
    scene,
    sphere,
    spot,
    translation,
    volume,
)
from cases import CONVERGED, EDGES, FRONT, GRID, ROTATED, SIDE, TURNED, Case, fog

import previs
from previs import Settings, metrics
from previs.bench.reference_scene import reference_image
from previs.description import SceneDescription
from previs.settings import BY_NAME

pytestmark = pytest.mark.gl

SIZE = (32, 18)
METHODS = BY_NAME["transmittance"].choices


def render(renderer: previs.Renderer, description: SceneDescription, view=FRONT, **settings) -> previs.Image:
    image = renderer.render(index_of(description), view, SIZE, Settings(**settings))
    for name, plane in {"color": image.color, "alpha": image.alpha, **image.aovs}.items():
        assert np.isfinite(plane).all(), name
    assert image.alpha.min() >= -1e-6
    assert image.alpha.max() <= 1.0 + 1e-6
    assert image.color.min() >= 0.0
    return image


def assert_right(renderer: previs.Renderer, case: Case, **settings) -> None:
    image = render(renderer, case.scene, case.camera, **{**CONVERGED, **case.settings, **settings})
    truth = reference_image(case.scene, case.camera, *SIZE, Settings(**case.settings))
    assert metrics.mean_relative_error(image.color, truth.color) <= case.limit


@pytest.mark.parametrize("method", METHODS)
def test_zero_density(renderer: previs.Renderer, method: str) -> None:
    """A medium without extinction, and voxels with a hole of zeros, show nothing and break nothing."""
    hollow = GRID.copy()
    hollow[3:10, 3:10, 3:10] = 0.0
    image = render(renderer, scene(box(fog(0.0)), SIDE), transmittance=method)
    assert not image.color.any()
    assert not image.alpha.any()
    image = render(renderer, scene(volume(hollow, fog(3.0)), SIDE), transmittance=method)
    assert image.color.max() > 0.0


@pytest.mark.parametrize(
    ("exponent", "limit"),
    # Of the last one a 32-bit position places the surface to a small part of what light gets into.
    [(-6, 2e-5), (-4, 1e-5), (-2, 1e-5), (0, 1e-5), (2, 4e-3), (4, 4e-3), (6, 0.08)],
)
def test_optical_depths_of_a_shape(renderer: previs.Renderer, record_property, exponent: int, limit: float) -> None:
    """A homogeneous box, from one that nothing stops in to one that is solid: its front is resolved all the same."""
    depth = 10.0**exponent
    description = scene(box(fog(depth / 2.0), local_to_world=TURNED), SIDE)
    image = render(renderer, description, **{**CONVERGED, "opacity_cutoff": 0.0})
    truth = reference_image(description, FRONT, *SIZE)
    error = metrics.mean_relative_error(image.color, truth.color)
    record_property("mean_relative_error", error)
    assert error <= limit
    assert np.abs(image.alpha - truth.alpha).max() <= 1e-5


#: Mean relative error at extinctions of 10^-6 to 10^6. Light on the densest surfaces is finer than a texel of maps,
#: and than the way from slice to slice, and cosines over the full range blur it.
VOXEL_LIMITS = {
    "slices": (1e-5, 1e-5, 1e-5, 2e-4, 0.02, 0.7, 1.0),
    "quantile": (1e-5, 1e-5, 5e-4, 2e-4, 1e-3, 0.03, 0.5),
    "tfm": (2e-4, 2e-3, 8e-4, 1e-3, 2e-3, 0.03, 0.5),
    "tfm-plain": (2e-4, 1e-3, 8e-4, 8e-4, 5e-3, 0.5, 1.0),
    "march": (1e-5, 1e-5, 1e-5, 1e-5, 2e-4, 3e-3, 1e-3),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("exponent", range(-6, 7, 2))
def test_optical_depths_of_voxels(renderer: previs.Renderer, record_property, exponent: int, method: str) -> None:
    """Every method gives a finite picture, in thin media one that is proportional to the density, and up to dense ones
    that of the march."""
    description = scene(volume(GRID, fog(10.0**exponent, anisotropy=0.3), ROTATED), SIDE)
    image = render(renderer, description, transmittance=method, coefficients=14, steps=256)
    assert image.color.max() > 0.0
    truth = render(renderer, description, transmittance="march", steps=1024)
    error = metrics.mean_relative_error(image.color, truth.color)
    record_property("mean_relative_error", error)
    assert error <= VOXEL_LIMITS[method][exponent // 2 + 3]
    if exponent <= -4:
        thinner = scene(volume(GRID, fog(0.1 * 10.0**exponent, anisotropy=0.3), ROTATED), SIDE)
        tenth = render(renderer, thinner, transmittance=method, coefficients=14, steps=256)
        assert metrics.mean_relative_error(10.0 * tenth.color, image.color) <= 1e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scale", [1e-8, 1e-3, 1e4, 1e8])
def test_densities_outside_half_floats(renderer: previs.Renderer, scale: float, method: str) -> None:
    """Voxels of any magnitude with the strength turned down accordingly are the same medium."""
    plain = render(renderer, scene(volume(GRID, fog(3.0), ROTATED), SIDE), transmittance=method)
    other = scene(volume(GRID * scale, fog(3.0 / scale), ROTATED), SIDE)
    assert metrics.mean_relative_error(render(renderer, other, transmittance=method).color, plain.color) <= 1e-3


@pytest.mark.parametrize("albedo", [0.0, 1.0])
def test_albedo_of_none_and_one(renderer: previs.Renderer, albedo: float) -> None:
    """Nothing scattered, or nothing absorbed and so no emission either."""
    medium = fog(1.0, albedo=(albedo,) * 3, emission=(1.0, 1.0, 1.0))
    assert_right(renderer, Case(scene(sphere(medium), SIDE)))


@pytest.mark.parametrize("phase", ["hg", "schlick", "two_lobe"])
@pytest.mark.parametrize("anisotropy", [-0.999, 0.95, 0.999])
def test_narrow_phase_functions(renderer: previs.Renderer, phase: str, anisotropy: float) -> None:
    """Lobes almost as narrow as a beam; Schlick's k would leave [−1, 1]. The sun stands in the picture."""
    medium = fog(0.5, phase=phase, anisotropy=anisotropy, anisotropy2=-anisotropy, lobe_mix=0.3)
    assert_right(renderer, Case(scene(sphere(medium), distant((1.0, 1.0, 5.5), (3.0, 2.0, 1.0))), limit=0.002))


@pytest.mark.parametrize("method", METHODS)
def test_channels_a_thousand_apart(renderer: previs.Renderer, record_property, method: str) -> None:
    """Extinctions of 0, 0.05 and 50 in one medium: finite, the clear channel empty, the others close to the march."""
    cloud = volume(GRID, fog((0.0, 0.05, 50.0)), ROTATED)
    image = render(renderer, scene(cloud, SIDE), transmittance=method, coefficients=14)
    truth = render(renderer, scene(cloud, SIDE), transmittance="march")
    assert not image.color[..., 0].any()
    thin, dense = (metrics.mean_relative_error(image.color[..., c], truth.color[..., c]) for c in (1, 2))
    record_property("thin", thin)
    record_property("dense", dense)
    assert thin <= 0.003
    assert dense <= 0.01


@pytest.mark.parametrize(
    ("method", "coefficients", "limit"), [("quantile", 6, 0.01), ("quantile", 14, 0.002), ("slices", 6, 0.015)]
)
@pytest.mark.parametrize("light", [SIDE, point((1.5, 1.4, 1.0), (6.0, 6.0, 6.0))], ids=["sun", "lamp"])
@pytest.mark.parametrize("density", [1.0, 8.0])
def test_channels_a_hundred_apart(
    renderer, record_property, method: str, coefficients: int, limit: float, light, density: float
) -> None:
    """Every channel of one map on its own, in a thin and in a dense medium."""
    cloud = volume(GRID, fog((0.1 * density, density, 10.0 * density)), ROTATED)
    settings = {"transmittance": method, "coefficients": coefficients, "steps": 256}
    image = render(renderer, scene(cloud, light), **settings)
    truth = render(renderer, scene(cloud, light), **{**settings, "transmittance": "march"})
    for name, c in (("red", 0), ("green", 1), ("blue", 2)):
        error = metrics.mean_relative_error(image.color[..., c], truth.color[..., c])
        record_property(name, error)
        assert error <= limit, name


@pytest.mark.parametrize(
    ("method", "extinction", "limits"),
    [
        ("quantile", 5.0, (0.002, 0.0004)),
        ("quantile", 20.0, (0.01, 0.002)),
        ("quantile", 60.0, (0.07, 0.02)),
        ("tfm", 5.0, (0.01, 0.004)),
        ("tfm", 20.0, (0.04, 0.007)),
        ("tfm", 60.0, (0.07, 0.01)),
    ],
)
def test_a_light_deep_inside_a_dense_uneven_medium(renderer, record_property, method, extinction, limits) -> None:
    """What little gets out is as right as the rest, from the picture's brightest parts to its darkest."""
    lamp = point((0.1, 0.0, 0.1), (1.0, 1.0, 1.0), radius=0.1)
    description = scene(volume(GRID, fog(extinction), ROTATED), lamp)
    truth = render(renderer, description, transmittance="march").color
    for coefficients, limit in zip((6, 14), limits, strict=True):
        image = render(renderer, description, transmittance=method, coefficients=coefficients).color
        error = metrics.mean_relative_error(image, truth)
        record_property(f"{coefficients} values", error)
        assert error <= limit, coefficients


@pytest.mark.parametrize("method", METHODS)
def test_flat_volumes(renderer: previs.Renderer, method: str) -> None:
    """Volumes that a transform or their own bounds make flat are left out, with a note; the rest of the scene stays."""
    rest = (sphere(fog()), SIDE)
    flat = [
        box(fog(), (-1, 0, -1), (1, 0, 1), path="/Sheet"),
        box(fog(), local_to_world=scaling(1.0, 0.0, 1.0), path="/Pressed"),
        volume(GRID, fog(), scaling(1.0, 0.0, 1.0), "/Voxels"),
    ]
    image = render(renderer, scene(*rest, *flat), transmittance=method)
    assert np.array_equal(image.color, render(renderer, scene(*rest), transmittance=method).color)
    for path in ("/Sheet", "/Pressed", "/Voxels"):
        assert any(path in note for note in image.stats["notes"])


def test_one_voxel(renderer: previs.Renderer) -> None:
    """The field of a single voxel is a tent over two voxels."""
    assert_right(renderer, Case(scene(volume(np.full((1, 1, 1), 2.0), fog(1.5), TURNED), SIDE), limit=EDGES))


@pytest.mark.parametrize("method", METHODS)
def test_an_empty_grid(renderer: previs.Renderer, method: str) -> None:
    """A grid without an active voxel is not there."""
    image = render(renderer, scene(volume(np.zeros((4, 4, 4)), fog()), SIDE), transmittance=method)
    assert not image.color.any()


def everything() -> SceneDescription:
    ground = quad_mesh([(-3, -1.2, -3), (-3, -1.2, 3), (3, -1.2, 3), (3, -1.2, -3)], (0.6, 0.5, 0.4))
    pillar = box_mesh((0.6, -1.2, 0.6), (0.9, 0.6, 0.9), path="/Pillar")
    ball = sphere(fog(0.7), 0.5, translation(-1.2, 0.3, 0.3))
    lights = (SIDE, point((1.5, 1.5, 1.0), (4.0, 2.0, 1.0)), spot((-1.0, 2.0, 1.0), (0, 0, 0), (1.0, 4.0, 9.0)))
    return scene(volume(GRID, fog((1.0, 2.0, 3.0)), ROTATED), ball, ground, pillar, *lights)


def seen_from(matrix: np.ndarray, scale: float = 1.0):
    view = camera((1.2, 0.9, 5.5), clip=(1e-3 * scale, 1e6 * scale))
    placed = np.array(view.camera_to_world)
    placed[3, :3] = placed[3, :3] @ matrix[:3, :3] + matrix[3, :3]
    return previs.description.Camera(**{**vars(view), "camera_to_world": placed})


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("offset", [(1e5, 0.0, 0.0), (-7e4, 9e4, 3e4)])
def test_far_from_the_origin(renderer: previs.Renderer, offset, method: str) -> None:
    """A scene a hundred thousand units away looks as it does at the origin."""
    settings = {"transmittance": method, "steps": 96, "light_steps": 96, "shadow_map_size": 1024}
    near = render(renderer, everything(), **settings)
    there = translation(*offset)
    far = render(renderer, moved(everything(), there), seen_from(there), **settings)
    assert metrics.mean_relative_error(far.color, near.color) <= 1e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scale", [1e-3, 1e5])
def test_small_and_large_scenes(renderer: previs.Renderer, scale: float, method: str) -> None:
    """Lengths times s, extinctions over s and intensities times s²: the same picture."""
    settings = {"transmittance": method, "steps": 96, "light_steps": 96, "shadow_map_size": 1024}
    near = render(renderer, everything(), **settings)
    grown = scaling(scale, scale, scale)
    description = moved(everything(), grown)
    for path, held in description.volumes.items():
        medium = previs.Medium(**{**vars(held.medium), "density_scale": 1.0 / scale})
        description.volumes[path] = previs.description.Volume(**{**vars(held), "medium": medium})
    for path, light in description.lights.items():
        if light.kind != "distant":
            strength = tuple(c * scale * scale for c in light.strength)
            description.lights[path] = previs.description.Light(**{**vars(light), "strength": strength})
    far = render(renderer, description, seen_from(grown, scale), **settings)
    assert metrics.mean_relative_error(far.color, near.color) <= 1e-3


def test_a_far_camera(renderer: previs.Renderer) -> None:
    """Seen from a hundred thousand radii away through a long lens."""
    view = camera((2e4, 1.5e4, 9e4), degrees=2e-3, clip=(1.0, 1e9))
    assert_right(renderer, Case(scene(sphere(fog(1.0)), SIDE), view, limit=EDGES))


def test_a_far_light(renderer: previs.Renderer) -> None:
    """A point light so far away that its rays are parallel."""
    light = point((-1e6, -0.7e6, 0.4e6), (1e12, 1e12, 1e12))
    assert_right(renderer, Case(scene(sphere(fog(1.0)), light), limit=EDGES))


@pytest.mark.parametrize("method", METHODS)
def test_lights_in_awkward_places(renderer: previs.Renderer, method: str) -> None:
    """On the boundary of a volume, on a mesh, behind it: lit. Inside a closed mesh: dark but for a sliver at it."""
    cloud = volume(GRID, fog(2.0))
    shell = box_mesh((-0.2,) * 3, (0.2,) * 3)
    for position in ((1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (-0.4, -0.3, -1.8)):
        image = render(renderer, scene(cloud, shell, point(position)), transmittance=method)
        inside = max(map(abs, position)) < 0.2
        assert (image.color.max() < 1e-3) == inside, position


@pytest.mark.parametrize("method", METHODS)
def test_long_light_marches(renderer: previs.Renderer, method: str) -> None:
    """As many light steps as the knob allows give the picture that a tenth of them gives."""
    description = scene(volume(GRID, fog(2.0), ROTATED), SIDE)
    settings = {"transmittance": method, "coefficients": 14, "steps": 16, "map_size": 16}
    few = render(renderer, description, light_steps=1638, **settings)
    many = render(renderer, description, light_steps=16384, **settings)
    assert metrics.mean_relative_error(many.color, few.color) <= 1e-3


@pytest.mark.parametrize("count", [8, 40])
def test_many_volumes(renderer: previs.Renderer, count: int) -> None:
    """Many small overlapping balls in one another's shadow."""
    random = np.random.default_rng(count)
    balls = [
        sphere(fog(2.0 / count**0.5), 0.5, translation(*random.uniform(-0.7, 0.7, 3)), f"/Ball{i}")
        for i in range(count)
    ]
    case = Case(scene(*balls, SIDE))
    image = render(renderer, case.scene, transmittance="march", steps=64)
    truth = reference_image(case.scene, FRONT, *SIZE, max_error=1e-3)
    assert metrics.mean_relative_error(image.color, truth.color) <= EDGES

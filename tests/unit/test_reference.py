"""The quadrature against closed forms and against sums so plain that they cannot be wrong in the same way."""

import ast
from pathlib import Path

import numpy as np
import pytest

from previs import reference as ref

SIGMA = np.array([0.5, 1.0, 3.0])
ISOTROPIC = 0.25 / np.pi


def front(width: float = 0.5, height: float = 0.5, distance: float = 5.0, **options) -> ref.Camera:
    """An orthographic camera on +Z that looks along −Z at the origin."""
    matrix = ref.look_at((0, 0, distance), (0, 0, 0))
    return ref.Camera(matrix, "orthographic", (-width, width, -height, height), **options)


def slab(sigma=SIGMA, half: float = 1.0, **medium) -> ref.Volume:
    """A box that fills the view of `front`, 2·half deep."""
    return ref.Volume(ref.HomogeneousBox((-5, -5, -half), (5, 5, half)), ref.Medium(extinction=sigma, **medium))


def rotation(axis, degrees: float) -> np.ndarray:
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(degrees)
    return (np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k).T


def affine(linear: np.ndarray, offset=(0.0, 0.0, 0.0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = linear, offset
    return matrix


SHEAR = np.array([[1.0, 0.3, 0.0], [0.0, 1.0, -0.2], [0.4, 0.0, 1.0]])
TRANSFORMS = {
    "identity": np.eye(4),
    "rotated": affine(rotation((1, 2, 3), 40), (0.1, -0.2, 0.3)),
    "non_uniform": affine(np.diag([0.5, 1.4, 0.9]) @ rotation((3, 1, 0), 70)),
    "sheared": affine(SHEAR @ rotation((0, 1, 1), 25), (0.2, 0.0, 0.0)),
    "mirrored": affine(np.diag([-1.0, 0.8, 1.1]) @ rotation((1, 0, 1), 15)),
}


def grid_matrix(shape, linear=None) -> np.ndarray:
    """An index_to_world that centres a grid of that shape on the origin, about two units wide."""
    linear = np.eye(3) if linear is None else linear
    centre = np.eye(4)
    centre[3, :3] = -0.5 * (np.array(shape) - 1.0)
    return centre @ affine(np.diag(2.0 / np.array(shape)) @ linear)


def trilinear(values: np.ndarray, matrix: np.ndarray, points: np.ndarray, background: float = 0.0) -> np.ndarray:
    """The field by the definition: a sum of hat functions, one per voxel."""
    index = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ np.linalg.inv(matrix)
    padded = np.pad(values, 1, constant_values=background)
    hats = [np.maximum(1 - np.abs(index[:, [a]] - np.arange(-1, n + 1)), 0) for a, n in enumerate(values.shape)]
    inside = np.all([(index[:, a] >= -1) & (index[:, a] <= n) for a, n in enumerate(values.shape)], axis=0)
    return np.where(inside, np.einsum("mi,mj,mk,ijk->m", *hats, padded), 0.0)


# --- phase functions -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", ["isotropic", "hg", "schlick", "rayleigh", "two_lobe"])
@pytest.mark.parametrize("g", [-0.9, -0.3, 0.0, 0.5, 0.95, 0.999])
def test_phase_functions_integrate_to_one(phase, g):
    # Gauss–Legendre in a variable that crowds the nodes at both poles, where the lobes are: 1 ∓ cosθ = 2·u⁴.
    x, w = np.polynomial.legendre.leggauss(200)
    top = 0.5**0.25
    u, w = 0.5 * top * (1 + x), 0.5 * top * w
    total = 0.0
    for sign in (1.0, -1.0):
        value = ref.phase_function(phase, sign * (1.0 - 2.0 * u**4), g, -0.4, 0.3)
        total += 2 * np.pi * np.sum(w * 8.0 * u**3 * value)
    assert total == pytest.approx(1.0, abs=1e-6)


def test_positive_anisotropy_scatters_forward():
    for phase in ("hg", "schlick", "two_lobe"):
        forward, backward = ref.phase_function(phase, np.array([1.0, -1.0]), 0.6)
        assert forward > 10 * backward
    assert ref.phase_function("hg", 0.3, 0.0) == pytest.approx(ISOTROPIC)
    mean = np.polynomial.legendre.leggauss(200)
    assert 2 * np.pi * np.sum(mean[1] * mean[0] * ref.phase_function("hg", mean[0], 0.6)) == pytest.approx(0.6)


def test_unknown_phase_function():
    with pytest.raises(ValueError, match="mie"):
        ref.phase_function("mie", 0.0)
    with pytest.raises(ValueError, match="mie"):
        ref.Medium(phase="mie")


# --- optical depth ---------------------------------------------------------------------------------------------------


def test_beer_lambert():
    image = ref.render(ref.Scene([slab()]), front(), 4, 3)
    np.testing.assert_allclose(image.transmittance, np.broadcast_to(np.exp(-2 * SIGMA), (3, 4, 3)), rtol=1e-13)
    np.testing.assert_allclose(image.alpha, 1 - np.exp(-2 * SIGMA).mean(), rtol=1e-13)
    assert not image.color.any() and np.all(np.isinf(image.depth))


@pytest.mark.parametrize("transform", TRANSFORMS)
@pytest.mark.parametrize("shape", ["box", "sphere", "capsule_x", "capsule_z"])
def test_shapes_against_dense_sampling(shape, transform):
    matrix = TRANSFORMS[transform]
    density = {
        "box": lambda: ref.HomogeneousBox((-0.7, -0.5, -0.3), (0.4, 0.9, 0.8), matrix),
        "sphere": lambda: ref.HomogeneousSphere(0.8, matrix),
        "capsule_x": lambda: ref.HomogeneousCapsule(0.3, 0.8, "X", matrix),
        "capsule_z": lambda: ref.HomogeneousCapsule(0.4, 0.5, "Z", matrix),
    }[shape]()

    def inside(points):
        p = (np.concatenate([points, np.ones((len(points), 1))], axis=1) @ np.linalg.inv(matrix))[:, :3]
        if shape == "box":
            return np.all((p > (-0.7, -0.5, -0.3)) & (p < (0.4, 0.9, 0.8)), axis=1)
        if shape == "sphere":
            return np.linalg.norm(p, axis=1) < 0.8
        axis, half, radius = (0, 0.4, 0.3) if shape == "capsule_x" else (2, 0.25, 0.4)
        p[:, axis] -= np.clip(p[:, axis], -half, half)
        return np.linalg.norm(p, axis=1) < radius

    rng = np.random.default_rng(1)
    origins = rng.uniform(-1.2, 1.2, (40, 3))
    directions = rng.uniform(-0.3, 0.3, (40, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distances = rng.uniform(0.5, 3.0, 40)
    scene = ref.Scene([ref.Volume(density, ref.Medium(SIGMA))])
    depth = ref.optical_depth(scene, origins, directions, distances)
    steps = 20000
    s = (np.arange(steps) + 0.5) / steps
    for i in range(40):
        hit = inside(origins[i] + s[:, None] * distances[i] * directions[i]).mean() * distances[i]
        np.testing.assert_allclose(depth[i], hit * SIGMA, atol=3 * 2 * distances[i] / steps)
    assert np.count_nonzero(depth[:, 0]) > 10


def test_directions_along_the_axes_and_rays_in_the_faces():
    box = ref.Scene([ref.Volume(ref.HomogeneousBox((0, 0, 0), (1, 2, 3)), ref.Medium(1.0))])
    origins = np.array([[0.5, 0.5, -1], [0.5, -1, 0.5], [-1, 0.5, 0.5], [5, 0.5, -1], [0.5, 0.5, 0.5]])
    directions = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 0, 7.0]])
    np.testing.assert_allclose(ref.optical_depth(box, origins, directions)[:, 0], [3, 2, 1, 0, 2.5])
    capsule = ref.Scene([ref.Volume(ref.HomogeneousCapsule(1.0, 2.0, "Y"), ref.Medium(1.0))])
    np.testing.assert_allclose(ref.optical_depth(capsule, [[0, -9, 0]], [[0, 1, 0]])[:, 0], [4.0])
    grid = ref.Scene([ref.Volume(ref.GridMedium(np.ones((4, 4, 4))), ref.Medium(1.0))])
    # A ray that runs in the plane between two layers of cells.
    np.testing.assert_allclose(ref.optical_depth(grid, [[2, 2, -9]], [[0, 0, 1]])[:, 0], [4.0])


@pytest.mark.parametrize("transform", TRANSFORMS)
@pytest.mark.parametrize("background", [0.0, 0.4])
def test_grid_optical_depth_against_dense_sampling(transform, background):
    rng = np.random.default_rng(2)
    values = rng.random((5, 7, 4)) * (rng.random((5, 7, 4)) > 0.3)
    matrix = grid_matrix(values.shape, TRANSFORMS[transform][:3, :3])
    scene = ref.Scene([ref.Volume(ref.GridMedium(values, matrix, background), ref.Medium(SIGMA))])
    origins = rng.uniform(-2, 2, (25, 3))
    directions = rng.uniform(-0.5, 0.5, (25, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    depth = ref.optical_depth(scene, origins, directions, 3.0)
    steps = 20000
    s = 3.0 * (np.arange(steps) + 0.5) / steps
    for i in range(25):
        expected = trilinear(values, matrix, origins[i] + s[:, None] * directions[i], background).mean() * 3.0
        np.testing.assert_allclose(depth[i], expected * SIGMA, atol=1e-6 if background == 0 else 1e-3)
    assert np.count_nonzero(depth[:, 0]) > 10


def test_grid_of_one_value_equals_the_box_inside():
    values = np.full((6, 6, 6), 0.7)
    matrix = grid_matrix(values.shape, rotation((1, 1, 0), 30))
    box = ref.HomogeneousBox((0, 0, 0), (5, 5, 5), matrix)
    grid = ref.GridMedium(values, matrix)
    rng = np.random.default_rng(3)
    to_world = lambda p: p @ matrix[:3, :3] + matrix[3, :3]  # noqa: E731
    a, b = (to_world(rng.uniform(0, 5, (50, 3))) for _ in range(2))
    length = np.linalg.norm(b - a, axis=1)
    scenes = [ref.Scene([ref.Volume(d, ref.Medium(SIGMA * k))]) for d, k in ((box, 0.7), (grid, 1.0))]
    depths = [ref.optical_depth(s, a, b - a, length) for s in scenes]
    np.testing.assert_allclose(*depths, rtol=1e-12)
    # Across the whole grid there is one voxel's worth more: half a voxel of falling density on either side.
    whole = ref.optical_depth(scenes[1], to_world(np.array([[-9.0, 2.5, 2.5]])), matrix[:1, :3])
    np.testing.assert_allclose(whole[0], SIGMA * 0.7 * 6 * np.linalg.norm(matrix[0, :3]), rtol=1e-12)


def test_one_voxel():
    grid = ref.GridMedium(np.full((1, 1, 1), 2.0), background=0.5)
    scene = ref.Scene([ref.Volume(grid, ref.Medium(1.0))])
    depth = ref.optical_depth(scene, [[0, 0, -9], [0.5, 0, -9]], [[0, 0, 1], [0, 0, 1]])
    np.testing.assert_allclose(depth[:, 0], [2.5, 1.75])


def test_transmittance_multiplies_over_overlapping_volumes():
    parts = [
        ref.Volume(ref.HomogeneousSphere(0.9), ref.Medium(SIGMA)),
        slab(0.3),
        ref.Volume(ref.GridMedium(np.ones((3, 3, 3)), grid_matrix((3, 3, 3))), ref.Medium(SIGMA[::-1].copy())),
    ]
    origins, directions = np.array([[0.1, 0.2, 4.0]] * 2), np.array([[0, 0, -1.0], [0.1, 0, -1]])
    together = ref.transmittance_along(ref.Scene(parts), origins, directions, [4.0, 9.0])
    alone = [ref.transmittance_along(ref.Scene([p]), origins, directions, [4.0, 9.0]) for p in parts]
    np.testing.assert_allclose(together, np.prod(alone, axis=0), rtol=1e-12)


def test_optical_depth_argument_errors():
    scene = ref.Scene([slab()])
    with pytest.raises(ValueError, match="zero vector"):
        ref.optical_depth(scene, [[0, 0, 0]], [[0, 0, 0]])
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        ref.optical_depth(scene, [[0, 0, 0]], [[0, 0, 1], [0, 0, 1]])


# --- emission and ambient light --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [1e-7, 1.0, 40.0, 1e6])
def test_furnace(sigma):
    """Albedo 1 under a uniform radiance: what the medium takes from the view it gives back."""
    wall = ref.Triangles([[[-9, -9, -2], [9, -9, -2], [0, 18, -2]]], emission=(0.5, 1.0, 2.0))
    ambient = np.array([0.5, 1.0, 2.0])
    scene = ref.Scene([slab(sigma * SIGMA, albedo=1.0)], solids=[wall], ambient=ambient)
    image = ref.render(scene, front(), 3, 2)
    np.testing.assert_allclose(image.color, np.broadcast_to(ambient, (2, 3, 3)), rtol=1e-6)
    np.testing.assert_allclose(image.volume[0, 0], -ambient * np.expm1(-2 * sigma * SIGMA), rtol=1e-6)


@pytest.mark.parametrize("sigma", [1e-7, 1.0, 1e6])
def test_emission_slab(sigma):
    radiance = np.array([3.0, 2.0, 0.0])
    volume = slab(sigma * SIGMA, albedo=0.0, emission=radiance)
    image = ref.render(ref.Scene([volume]), front(), 2, 2)
    np.testing.assert_allclose(image.color[1, 1], -radiance * np.expm1(-2 * sigma * SIGMA), rtol=1e-6)
    partly = slab(sigma * SIGMA, albedo=(0.25, 0.5, 0.5), emission=radiance)
    image = ref.render(ref.Scene([partly]), front(), 2, 2)
    expected = -radiance * (0.75, 0.5, 0.5) * np.expm1(-2 * sigma * SIGMA)
    np.testing.assert_allclose(image.color[0, 1], expected, rtol=1e-6)


def test_emission_field_with_a_curve():
    rng = np.random.default_rng(4)
    density, heat = rng.random((4, 4, 4)), rng.random((3, 5, 4))
    at, heat_at = grid_matrix(density.shape), grid_matrix(heat.shape, rotation((0, 1, 0), 20))
    curve = lambda v: np.stack([v**2, v, np.sqrt(v)], axis=-1)  # noqa: E731
    field = ref.EmissionField(ref.GridMedium(heat, heat_at), curve)
    medium = ref.Medium(SIGMA, albedo=0.5, emission=2.0, emission_fields=[field])
    image = ref.render(ref.Scene([ref.Volume(ref.GridMedium(density, at), medium)]), front(), 2, 2)
    steps = 40000
    z = 1.5 - 3.0 * (np.arange(steps) + 0.5) / steps
    points = np.stack([np.full(steps, 0.25), np.full(steps, -0.25), z], axis=-1)
    d = trilinear(density, at, points)
    depth = (np.cumsum(d) - 0.5 * d)[:, None] * (3.0 / steps) * SIGMA
    source = 0.5 * SIGMA * d[:, None] * 2.0 * curve(trilinear(heat, heat_at, points))
    np.testing.assert_allclose(image.color[1, 1], np.sum(np.exp(-depth) * source, axis=0) * 3.0 / steps, rtol=1e-5)
    plain = ref.EmissionField(ref.GridMedium(heat, heat_at))
    assert plain.factor(np.zeros((2, 3))).shape == (2, 3)
    with pytest.raises(ValueError, match="to_radiance"):
        ref.EmissionField(field.grid, lambda v: v).factor(np.zeros((2, 3)))


# --- in-scattering ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [1e-6, 1.0, 30.0, 1e6])
@pytest.mark.parametrize("phase,g", [("isotropic", 0.0), ("hg", 0.6), ("schlick", -0.4), ("rayleigh", 0.0)])
def test_slab_lit_from_the_front(sigma, phase, g):
    """Light along the view: both decay alike, ρ·p(−1)·E·(1 − e^(−2τ))/2."""
    scene = ref.Scene(
        [slab(sigma * SIGMA, albedo=(0.2, 0.6, 1.0), phase=phase, anisotropy=g)],
        [ref.DistantLight((0, 0, -1), (1, 2, 3))],
    )
    image = ref.render(scene, front(), 2, 2)
    p = ref.phase_function(phase, -1.0, g)
    expected = p * np.array([0.2, 0.6, 1.0]) * (1, 2, 3) * -np.expm1(-4 * sigma * SIGMA) / 2
    np.testing.assert_allclose(image.color[0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize("sigma", [1e-6, 1.0, 10.0])
def test_slab_lit_from_behind(sigma):
    """Light against the view: every point sees the whole slab, σs·p(1)·E·d·e^(−τ)."""
    scene = ref.Scene([slab(sigma * SIGMA, albedo=0.5, phase="hg", anisotropy=0.7)], [ref.DistantLight((0, 0, 1), 2.0)])
    image = ref.render(scene, front(), 2, 2)
    expected = 0.5 * sigma * SIGMA * ref.phase_function("hg", 1.0, 0.7) * 2.0 * 2.0 * np.exp(-2 * sigma * SIGMA)
    np.testing.assert_allclose(image.color[0, 0], expected, rtol=1e-6)


def test_sphere_against_a_riemann_sum():
    travel = np.array([1.0, -1.0, -0.5]) / 1.5
    medium = ref.Medium(SIGMA, albedo=0.8)
    scene = ref.Scene([ref.Volume(ref.HomogeneousSphere(1.0), medium)], [ref.DistantLight(travel, 3.0)])
    camera = ref.Camera(ref.look_at((0.5, 0.3, 4), (0, 0, 0)), window=(-0.3, 0.3, -0.2, 0.2))
    image = ref.render(scene, camera, 6, 4)
    steps = 100_000
    origins, directions, _ = camera.rays(6, 4)
    for origin, direction, color in zip(origins, directions, image.color.reshape(-1, 3), strict=True):
        b = origin @ direction
        root = b * b - origin @ origin + 1.0
        if root <= 0.0:
            assert not color.any()
            continue
        entry, length = -b - np.sqrt(root), 2 * np.sqrt(root)
        t = (np.arange(steps) + 0.5) / steps * length
        points = origin + (entry + t)[:, None] * direction
        along = points @ -travel
        to_light = -along + np.sqrt(along**2 + 1.0 - np.sum(points**2, axis=1))
        decay = np.exp(-(t + to_light)[:, None] * SIGMA)
        expected = 0.8 * SIGMA * ISOTROPIC * 3.0 * decay.sum(axis=0) * length / steps
        np.testing.assert_allclose(color, expected, rtol=2e-6)


def test_grid_against_a_riemann_sum():
    """A grid with a homogeneous sphere through it, and a point light: one ray, everything by plain sums."""
    rng = np.random.default_rng(5)
    values = 3 * rng.random((4, 3, 5))
    matrix = grid_matrix(values.shape, SHEAR)
    lamp = np.array([0.7, 1.6, 0.8])
    cloud = ref.Medium(SIGMA, albedo=(0.9, 0.5, 0.2), phase="hg", anisotropy=0.5)
    ball = ref.Medium(0.8, albedo=1.0, phase="rayleigh")
    volumes = [ref.Volume(ref.GridMedium(values, matrix), cloud), ref.Volume(ref.HomogeneousSphere(0.6), ball)]
    image = ref.render(ref.Scene(volumes, [ref.PointLight(lamp, 5.0)]), front(0.2, 0.2), 1, 1)
    steps, fine = 1500, 600
    t = 3.0 + 4.0 * (np.arange(steps) + 0.5) / steps
    points = np.array([0, 0, 5.0]) + t[:, None] * np.array([0, 0, -1.0])

    def coefficients(p):
        return trilinear(values, matrix, p), (np.sum(p * p, axis=-1) < 0.36).astype(float)

    d, h = coefficients(points)
    tau = np.cumsum(d)[:, None] * SIGMA + np.cumsum(h)[:, None] * 0.8
    tau = (tau - 0.5 * (d[:, None] * SIGMA + h[:, None] * 0.8)) * 4.0 / steps
    total = np.zeros(3)
    s = (np.arange(fine) + 0.5) / fine
    for i in np.flatnonzero((d > 0) | (h > 0)):
        offset = lamp - points[i]
        distance = np.linalg.norm(offset)
        ld, lh = coefficients(points[i] + s[:, None] * offset)
        reach = np.exp(-(ld.mean() * SIGMA + lh.mean() * 0.8) * distance)
        cos_theta = -(offset / distance) @ np.array([0, 0, 1.0])
        source = d[i] * SIGMA * cloud.albedo * ref.phase_function("hg", cos_theta, 0.5)
        source = source + h[i] * 0.8 * ref.phase_function("rayleigh", cos_theta)
        total += np.exp(-tau[i]) * source * 5.0 / distance**2 * reach * 4.0 / steps
    np.testing.assert_allclose(image.color[0, 0], total, rtol=1e-3)


@pytest.mark.parametrize("camera_z", [5.0, 0.5])
@pytest.mark.parametrize("offset", [0.3, 1e-3])
def test_point_light_inside_a_thin_medium(camera_z, offset):
    """σs·I/(4π·b)·(atan(z₁/b) − atan(z₀/b)), with the camera outside and inside the medium."""
    scene = ref.Scene([slab(1e-9, albedo=1.0)], [ref.PointLight((offset, 0, 0.2), 2.0)])
    image = ref.render(scene, front(1e-9, 1e-9, camera_z), 1, 1)
    start = min(camera_z, 1.0)
    angle = np.arctan((start - 0.2) / offset) - np.arctan((-1 - 0.2) / offset)
    np.testing.assert_allclose(image.color[0, 0], 1e-9 * ISOTROPIC * 2.0 / offset * angle, rtol=1e-6)


def test_point_light_inside_a_dense_medium_against_a_sum():
    scene = ref.Scene([slab(SIGMA, albedo=1.0)], [ref.PointLight((0.05, 0, 0.2), 2.0)])
    image = ref.render(scene, front(1e-9, 1e-9, 0.6), 1, 1)
    steps = 400_000
    t = 1.6 * (np.arange(steps) + 0.5) / steps
    distance = np.hypot(0.05, 0.6 - t - 0.2)
    f = SIGMA * ISOTROPIC * 2.0 / distance[:, None] ** 2 * np.exp(-(t + distance)[:, None] * SIGMA)
    np.testing.assert_allclose(image.color[0, 0], f.sum(axis=0) * 1.6 / steps, rtol=1e-6)


def test_radius_bounds_the_irradiance():
    light = ref.PointLight((0, 0, 0), 3.0, radius=0.5)
    irradiance, _, distance = light.illuminate(np.array([[0.1, 0, 0], [0, 0, 0], [2, 0, 0]]))
    np.testing.assert_allclose(irradiance[:, 0], [12, 12, 0.75])
    np.testing.assert_allclose(distance, [0.1, 0, 2])
    scene = ref.Scene([slab(1e-9, albedo=1.0)], [light])
    image = ref.render(scene, front(1e-9, 1e-9), 1, 1)
    # Straight through the light: constant over its diameter, 1/d² outside.
    expected = 1e-9 * ISOTROPIC * (12 * 1.0 + 3.0 * 2 * (1 / 0.5 - 1 / 1.0))
    np.testing.assert_allclose(image.color[0, 0], expected, rtol=1e-6)


def test_light_on_the_ray_and_on_the_boundary_is_finite():
    for position in ((0, 0, 0), (0, 0, 1), (0, 0, -1), (0, 0, 5)):
        for camera in (front(1e-9, 1e-9), ref.Camera(ref.look_at((0, 0, 5), (0, 0, 0)))):
            image = ref.render(ref.Scene([slab()], [ref.PointLight(position)]), camera, 1, 1)
            assert np.all(np.isfinite(image.color)) and np.all(image.color > 0)


def test_two_overlapping_boxes_equal_their_sum():
    lights = [ref.DistantLight((1, -1, -1), 2.0), ref.PointLight((0.3, 1.5, 0.2), 4.0)]
    medium = {"phase": "hg", "anisotropy": 0.3, "emission": (1, 0, 2)}
    pair = [slab(SIGMA, albedo=0.9, **medium), slab(2 * SIGMA, albedo=0.3, **medium)]
    one = [slab(3 * SIGMA, albedo=0.5, **medium)]
    a, b = (ref.render(ref.Scene(v, lights, ambient=0.4), front(), 5, 4) for v in (pair, one))
    np.testing.assert_allclose(a.color, b.color, rtol=1e-6)
    np.testing.assert_allclose(a.transmittance, b.transmittance, rtol=1e-12)


def test_a_volume_shadows_another():
    """A slab above darkens the one below: the light is scaled by its transmittance, and the view by nothing."""
    below = ref.Volume(ref.HomogeneousBox((-2, -1, -1), (2, 0, 1)), ref.Medium(SIGMA))
    above = ref.Volume(ref.HomogeneousBox((-9, 2, -9), (9, 3, 9)), ref.Medium((0.0, 0.5, 2.0), albedo=0.0))
    camera = ref.Camera(ref.look_at((0, -0.5, 5), (0, -0.5, 0)), "orthographic", (-0.5, 0.5, -0.4, 0.4))
    light = ref.DistantLight((0, -1, 0), 3.0)
    alone, both = (ref.render(ref.Scene(v, [light]), camera, 3, 3) for v in ([below], [below, above]))
    np.testing.assert_allclose(both.color, alone.color * np.exp([-0.0, -0.5, -2.0]), rtol=1e-6)
    free = ref.DistantLight((0, -1, 0), 3.0, casts_shadows=False)
    image = ref.render(ref.Scene([below, above], [free]), camera, 3, 3)
    expected = 0.9 * 3.0 * ISOTROPIC * (1 - np.exp(-2 * SIGMA))
    np.testing.assert_allclose(image.color, np.broadcast_to(expected, (3, 3, 3)), rtol=1e-6)
    np.testing.assert_allclose(
        ref.light_transmittance(ref.Scene([above]), light, [[0, 0, 0], [0, 2.5, 0], [0, 4, 0]])[:, 1],
        np.exp([-0.5, -0.25, 0.0]),
    )
    assert np.all(ref.light_transmittance(ref.Scene([above]), free, [[0, 0, 0]]) == 1.0)


# --- solids ----------------------------------------------------------------------------------------------------------


def _shadow_scene(sigma, slope: float, **medium):
    """A slab 2 deep under a black sheet at y = 2, z in [−0.4, 0.3], lit along (0, −1, slope)."""
    sheet = [[[-9, 2, -0.4], [9, 2, -0.4], [9, 2, 0.3]], [[-9, 2, -0.4], [9, 2, 0.3], [-9, 2, 0.3]]]
    box = ref.Volume(ref.HomogeneousBox((-2, -1, -1), (2, 1, 1)), ref.Medium(sigma, **medium))
    return ref.Scene([box], [ref.DistantLight((0, -1, slope), 2.0)], [ref.Triangles(sheet)])


def test_shadow_of_a_sheet_in_the_thin_limit():
    """What is lit of each view ray is its length less the width of the sheet, where the shadow lies inside."""
    image = ref.render(_shadow_scene(1e-8, 0.35, albedo=1.0), front(0.5, 0.9), 2, 9)
    y = 0.9 - 1.8 * (np.arange(9) + 0.5) / 9
    low, high = np.clip(-0.4 + 0.35 * (2 - y), -1, 1), np.clip(0.3 + 0.35 * (2 - y), -1, 1)
    expected = 1e-8 * ISOTROPIC * 2.0 * (2 - (high - low))
    np.testing.assert_allclose(image.color[:, 0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize("sigma", [0.5, 8.0])
def test_shadow_of_a_sheet_in_a_dense_medium(sigma):
    """Light from straight above: everything has a closed form."""
    image = ref.render(_shadow_scene(sigma, 0.0, albedo=0.5), front(0.5, 0.9), 2, 6)
    y = 0.9 - 1.8 * (np.arange(6) + 0.5) / 6
    seen = (1 - np.exp(-sigma * 0.7)) + (np.exp(-sigma * 1.4) - np.exp(-sigma * 2.0))
    expected = 0.5 * ISOTROPIC * 2.0 * np.exp(-sigma * (1 - y)) * seen
    np.testing.assert_allclose(image.color[:, 1, 2], expected, rtol=1e-6)


@pytest.mark.parametrize("shape", ["box", "sphere", "capsule"])
@pytest.mark.parametrize("light", ["distant", "point"])
def test_a_very_dense_volume_shadows_like_a_solid(shape, light):
    """Lit lengths in the thin limit: in the plane z–x the cross-section of every shape's shadow is known."""
    dense = {
        "box": lambda: ref.HomogeneousBox((-0.5, 1.5, -0.4), (0.5, 1.6, 0.3)),
        "sphere": lambda: ref.HomogeneousSphere(0.6, affine(np.eye(3), (0, 2, 0))),
        "capsule": lambda: ref.HomogeneousCapsule(0.3, 0.8, "Z", affine(np.eye(3), (0, 2, 0))),
    }[shape]()
    # Straight down from so far away that the point light's rays are parallel, too.
    far = 1e5
    lamp = ref.DistantLight((0, -1, 0), 2.0) if light == "distant" else ref.PointLight((0, far, 0), 2.0 * far**2)
    volumes = [
        ref.Volume(ref.HomogeneousBox((-1, -1, -1), (1, 1, 1)), ref.Medium(1e-8, albedo=1.0)),
        ref.Volume(dense, ref.Medium(1e9, albedo=0.0)),
    ]
    image = ref.render(ref.Scene(volumes, [lamp]), front(0.8, 0.01), 9, 1)
    x = np.abs(-0.8 + 1.6 * (np.arange(9) + 0.5) / 9)
    with np.errstate(invalid="ignore"):
        dark = {
            "box": np.where(x < 0.5, 0.7, 0.0),
            "sphere": np.nan_to_num(2 * np.sqrt(0.36 - x**2)),
            "capsule": np.where(x < 0.3, 0.8 + 2 * np.nan_to_num(np.sqrt(0.09 - x**2)), 0.0),
        }[shape]
    expected = 1e-8 * ISOTROPIC * 2.0 * (2 - dark)
    np.testing.assert_allclose(image.color[0, :, 0], expected, rtol=1e-6 if light == "distant" else 1e-4)


def test_shadow_breakpoints_find_what_dense_nodes_find():
    """A point light over a rotated box: visible lengths in the thin limit against a dense sum of visibility tests."""
    box = ref.box_triangles((-0.3, -0.2, -0.1), (0.2, 0.4, 0.3), affine(rotation((1, 2, 0), 35), (0.1, 0.8, 0.1)))
    light = ref.PointLight((0.4, 2.5, 0.6), 1.0)
    scene = ref.Scene([slab(1e-9, albedo=1.0)], [light], [box])
    camera = ref.Camera(ref.look_at((0.2, -0.3, 5), (0, -0.3, 0)), window=(-0.2, 0.2, -0.1, 0.1))
    image = ref.render(scene, camera, 8, 4)
    origins, directions, _ = camera.rays(8, 4)
    steps = 20000
    shadowed = 0
    for origin, direction, color in zip(origins, directions, image.volume.reshape(-1, 3), strict=True):
        entry, exit_ = sorted(((1 - origin[2]) / direction[2], (-1 - origin[2]) / direction[2]))
        t = entry + (exit_ - entry) * (np.arange(steps) + 0.5) / steps
        points = origin + t[:, None] * direction
        clear = ref.light_transmittance(scene, light, points, solids=True)[:, 0] > 0.5
        irradiance = light.illuminate(points)[0][:, 0]
        expected = 1e-9 * ISOTROPIC * np.mean(clear * irradiance) * (exit_ - entry)
        shadowed += not clear.all()
        assert color[0] == pytest.approx(expected, rel=1e-3)
    assert shadowed > 8


def test_closed_box_around_the_light():
    shell = ref.box_triangles((-0.1, 0.4, -0.1), (0.1, 0.6, 0.1))
    scene = ref.Scene([slab()], [ref.PointLight((0, 0.5, 0))], [shell])
    image = ref.render(scene, front(0.9, 0.9), 6, 6)
    assert not image.volume.any()


def test_colours_and_normals_at_the_corners():
    """Both are linear over a triangle: at its centroid, a third of each."""
    points = np.array([[[-9.0, -9.0, -2.0], [9.0, -9.0, -2.0], [0.0, 18.0, -2.0]]])
    albedo = np.array([[[0.9, 0.0, 0.0], [0.0, 0.6, 0.0], [0.0, 0.0, 0.3]]])
    normals = np.array([[[0.6, 0.0, 0.8], [-0.6, 0.0, 0.8], [0.0, 0.0, 1.0]]])
    wall = ref.Triangles(points, albedo, normals=normals)
    image = ref.render(ref.Scene([], [ref.DistantLight((0.6, 0, -0.8), 2.0)], [wall]), front(0.001, 0.001), 1, 1)
    normal = normals[0].mean(axis=0) / np.linalg.norm(normals[0].mean(axis=0))
    expected = albedo[0].mean(axis=0) / np.pi * 2.0 * (normal @ (-0.6, 0.0, 0.8))
    np.testing.assert_allclose(image.color[0, 0], expected, rtol=1e-3)
    with pytest.raises(ValueError, match="one per corner"):
        ref.Triangles(points, albedo[:, :2])
    with pytest.raises(ValueError, match="normals"):
        ref.Triangles(points, 0.5, normals=normals[0])


def test_lambertian_surface():
    """albedo/π·E·cosθ through a slab, from both sides, with emission and ambient light."""
    wall = ref.Triangles([[[-9, -9, -2], [9, -9, -2], [0, 18, -2]]], albedo=(0.2, 0.5, 1.0), emission=0.1)
    light = ref.DistantLight((0, -1, -1), 2.0)
    for solid in (wall, ref.Triangles(wall.points[:, ::-1], wall.albedo, wall.emission)):
        image = ref.render(ref.Scene([slab(albedo=0.0)], [light], [solid], ambient=0.3), front(0.4, 0.4), 2, 2)
        reflected = wall.albedo[0, 0] * (0.3 + 2.0 / np.pi * np.sqrt(0.5) * np.exp(-2 * np.sqrt(2) * SIGMA))
        np.testing.assert_allclose(image.color[0, 0], np.exp(-2 * SIGMA) * (0.1 + reflected), rtol=1e-12)
        np.testing.assert_allclose(image.depth, 7.0)
        assert np.all(image.alpha == 1.0)
    behind = ref.Scene([], [ref.DistantLight((0, 0, 1), 2.0), ref.PointLight((0, 0, -3), 2.0)], [wall])
    np.testing.assert_allclose(ref.render(behind, front(), 1, 1).color, 0.1)
    near = ref.Scene([], [ref.PointLight((0, 3, 2), 2.0)], [wall])
    expected = 0.1 + wall.albedo[0, 0] / np.pi * 2.0 / 25 * 0.8
    np.testing.assert_allclose(ref.render(near, front(1e-9, 1e-9), 1, 1).color[0, 0], expected, rtol=1e-9)


def test_a_surface_ends_the_view_and_shadows_itself():
    box = ref.box_triangles((-0.4, -0.4, -0.4), (0.4, 0.4, 0.4), albedo=0.5)
    lights = [ref.DistantLight((0, 0, -1), np.pi)]
    image = ref.render(ref.Scene([slab(albedo=0.0)], lights, [box]), front(0.8, 0.8), 4, 4)
    hit = np.zeros((4, 4), bool)
    hit[1:3, 1:3] = True
    np.testing.assert_array_equal(np.isfinite(image.depth), hit)
    np.testing.assert_allclose(image.transmittance[hit], np.exp(-0.6 * SIGMA)[None].repeat(4, 0))
    np.testing.assert_allclose(image.color[hit], (0.5 * np.exp(-1.2 * SIGMA))[None].repeat(4, 0))
    dark = ref.render(ref.Scene([slab(albedo=0.0)], [ref.DistantLight((0, 0, 1))], [box]), front(0.8, 0.8), 4, 4)
    assert not dark.color.any()


def test_rays_through_shared_edges_hit():
    """Pixel centres on the diagonal and on the edges of a box find no crack."""
    box = ref.box_triangles((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    image = ref.render(ref.Scene(solids=[box]), front(0.5 + 1e-13, 0.5 + 1e-13), 33, 33)
    np.testing.assert_allclose(image.depth, 4.5)


# --- spot lights -----------------------------------------------------------------------------------------------------


def test_cone_of_a_spot_in_the_thin_limit():
    """A ray across the axis at height h is lit within the cone: σs·I/(4π·h)·2θ."""
    light = ref.SpotLight((0, 1.5, 0), 2.0, axis=(0, -1, 0), cone_angle=25.0)
    image = ref.render(ref.Scene([slab(1e-9, albedo=1.0)], [light]), front(1e-9, 0.5), 1, 4)
    height = 1.5 - (0.5 - (np.arange(4) + 0.5) / 4)
    expected = 1e-9 * ISOTROPIC * 2.0 / height * 2 * np.radians(25.0)
    np.testing.assert_allclose(image.color[:, 0, 0], expected, rtol=1e-6)


def test_shape_of_a_spot():
    angles = np.array([0.0, 10.0, 20.0, 25.0, 30.0, 39.99, 40.01, 90.0, 120.0])
    points = np.stack([np.sin(np.radians(angles)), 0 * angles, -np.cos(np.radians(angles))], axis=-1)
    light = ref.SpotLight((0, 0, 0), 2.0, cone_angle=40.0, softness=0.5, focus=3.0, focus_tint=(1.0, 0.5, 0.0))
    x = np.clip((angles - 20.0) / 20.0, 0, 1)
    cone = 1 - x * x * (3 - 2 * x)
    focus = np.maximum(np.cos(np.radians(angles)), 0.0)[:, None] ** 3
    expected = 2.0 * cone[:, None] * (np.array([1.0, 0.5, 0.0]) * (1 - focus) + focus)
    np.testing.assert_allclose(light.illuminate(points)[0], expected, atol=1e-12)
    hard = ref.SpotLight((0, 0, 0), 2.0, cone_angle=40.0)
    np.testing.assert_array_equal(hard.illuminate(points)[0][:, 0] > 0, angles < 40.0)
    disk = ref.SpotLight((0, 0, 0), 2.0, cosine=True)
    np.testing.assert_allclose(
        disk.illuminate(points)[0][:, 1], 2 * np.maximum(np.cos(np.radians(angles)), 0), atol=1e-12
    )


# --- symmetries, scale, hard cases -----------------------------------------------------------------------------------


def _busy_scene(transform=None) -> ref.Scene:
    """A grid, a capsule, a box in the way, a distant light and a soft spot; everything moved by `transform`."""
    m = np.eye(4) if transform is None else transform

    def point(p):
        return np.asarray(p, float) @ m[:3, :3] + m[3, :3]

    def vector(v):
        return np.asarray(v, float) @ m[:3, :3]

    values = np.random.default_rng(6).random((4, 5, 3))
    size = abs(np.linalg.det(m[:3, :3])) ** (1 / 3)
    medium = ref.Medium(2 * SIGMA / size, albedo=0.9, phase="two_lobe", anisotropy=0.6, anisotropy2=-0.3, lobe_mix=0.4)
    return ref.Scene(
        [
            ref.Volume(ref.GridMedium(values, grid_matrix(values.shape, rotation((1, 1, 0), 20)) @ m), medium),
            ref.Volume(ref.HomogeneousCapsule(0.4, 0.8, "X", m), ref.Medium(0.7 / size, albedo=0.5)),
        ],
        [
            ref.DistantLight(vector((1, -2, -1)), (2, 1, 1)),
            ref.SpotLight(point((0.2, 1.9, 0.4)), 6 * size**2, axis=vector((0, -1, -0.2)), cone_angle=35, softness=0.6),
        ],
        [ref.box_triangles((-0.2, 0.9, -0.3), (0.3, 1.2, 0.3), m, albedo=0.5)],
        ambient=0.1,
    )


BUSY_CAMERA = ref.Camera(ref.look_at((0.4, 0.3, 4), (0, 0.2, 0)), window=(-0.3, 0.3, -0.3, 0.3))


@pytest.fixture(scope="module")
def busy() -> ref.ReferenceImage:
    return ref.render(_busy_scene(), BUSY_CAMERA, 8, 8, max_error=1e-6)


def test_doubling_the_accuracy_changes_nothing(busy):
    coarse = ref.render(_busy_scene(), BUSY_CAMERA, 8, 8)
    scale = busy.volume.mean()
    assert np.max(np.abs(coarse.volume - busy.volume)) < 1e-5 * scale
    assert np.max(np.abs(coarse.volume - busy.volume).max(axis=-1) - coarse.error) < 1e-6 * scale
    np.testing.assert_array_equal(coarse.transmittance, busy.transmittance)


def test_mirror_symmetry(busy):
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    camera = ref.Camera(ref.look_at((-0.4, 0.3, 4), (0, 0.2, 0)), window=BUSY_CAMERA.window)
    image = ref.render(_busy_scene(mirror), camera, 8, 8)
    np.testing.assert_allclose(image.color[:, ::-1], busy.color, rtol=1e-5)
    np.testing.assert_allclose(image.depth[:, ::-1], busy.depth, rtol=1e-9)


@pytest.mark.parametrize("size,offset", [(1e-3, 0.0), (1e5, 0.0), (1.0, 1e5)])
def test_scale_and_distance_from_the_origin(busy, size, offset):
    m = affine(size * np.eye(3), (offset, -offset, offset))
    camera_matrix = BUSY_CAMERA.camera_to_world.copy()
    camera_matrix[3, :3] = camera_matrix[3, :3] * size + m[3, :3]
    image = ref.render(_busy_scene(m), ref.Camera(camera_matrix, window=BUSY_CAMERA.window), 8, 8)
    np.testing.assert_allclose(image.color, busy.color, rtol=2e-5)


def test_clip_distances():
    image = ref.render(ref.Scene([slab(SIGMA)], ambient=1.0), front(clip=(4.5, 5.25)), 2, 2)
    np.testing.assert_allclose(image.transmittance[0, 0], np.exp(-0.75 * SIGMA))
    perspective = ref.Camera(ref.look_at((0, 0, 5), (0, 0, 0)), window=(-1, 1, -1, 1), clip=(4.5, 5.25))
    image = ref.render(
        ref.Scene([ref.Volume(ref.HomogeneousBox((-9, -9, -1), (9, 9, 1)), ref.Medium(SIGMA))]), perspective, 2, 2
    )
    np.testing.assert_allclose(image.transmittance[0, 0], np.exp(-0.75 * SIGMA * np.sqrt(1.5)))
    behind = ref.Scene(solids=[ref.box_triangles((-1, -1, -1), (1, 1, 1), emission=1.0)])
    assert ref.render(behind, front(clip=(4.5, 5.25)), 2, 2).color.max() == 0.0


def test_rows_run_down_and_columns_right():
    lamp = ref.box_triangles((0.1, 0.2, -0.1), (0.4, 0.4, 0.1), emission=1.0)
    for camera in (front(), ref.Camera(ref.look_at((0, 0, 5), (0, 0, 0)), window=(-0.1, 0.1, -0.1, 0.1))):
        color = ref.render(ref.Scene(solids=[lamp]), camera, 4, 4).color[..., 0]
        assert color[:2, 2:].any() and not color[2:].any() and not color[:, :2].any()


def test_empty_scenes():
    for scene in (
        ref.Scene(),
        ref.Scene([slab()]),
        ref.Scene([slab(0.0)], [ref.DistantLight((0, -1, 0))], ambient=1.0),
        ref.Scene([ref.Volume(ref.GridMedium(np.zeros((3, 3, 3))))], [ref.PointLight((0, 3, 0))]),
        ref.Scene([ref.Volume(ref.HomogeneousBox((-1, 0, -1), (1, 0, 1)))], [ref.DistantLight((0, -1, 0))]),
        ref.Scene([], [ref.DistantLight((0, -1, 0))]),
    ):
        image = ref.render(scene, front(), 3, 2)
        assert image.color.shape == (2, 3, 3) and not image.color.any() and np.isfinite(image.alpha).all()


def test_channels_far_apart_and_a_dense_grid_stay_finite():
    values = np.random.default_rng(8).random((4, 4, 4))
    grid = ref.GridMedium(values, grid_matrix(values.shape))
    for sigma in ((0.0, 1.0, 100.0), (1e-6, 1.0, 1e6)):
        scene = ref.Scene([ref.Volume(grid, ref.Medium(sigma))], [ref.DistantLight((1, -1, -1))])
        image = ref.render(scene, front(0.9, 0.9), 4, 4)
        assert np.isfinite(image.color).all() and image.color[..., 2].max() > 0.0
        assert image.color[..., 2].max() < 1.0


@pytest.mark.parametrize(
    "make,words",
    [
        (lambda: ref.GridMedium(np.full((2, 2, 2), np.nan)), "8 of 8 grid values"),
        (lambda: ref.GridMedium(np.full((2, 2, 2), -1.0)), "negative"),
        (lambda: ref.GridMedium(np.zeros((2, 2))), "three-dimensional"),
        (lambda: ref.HomogeneousSphere(1.0, np.diag([1.0, 0, 1, 1])), "singular"),
        (lambda: ref.HomogeneousSphere(1.0, np.eye(4)[::-1]), "affine"),
        (lambda: ref.HomogeneousSphere(-1.0), "radius"),
        (lambda: ref.HomogeneousCapsule(axis="W"), "axis"),
        (lambda: ref.HomogeneousBox((1, 0, 0), (0, 1, 1)), "inside out"),
        (lambda: ref.Medium(albedo=1.5), "albedo"),
        (lambda: ref.Medium(extinction=(1, -1, 1)), "extinction"),
        (lambda: ref.Medium(extinction=(1, 1)), "shape"),
        (lambda: ref.Medium(phase="hg", anisotropy=1.0), "anisotropy"),
        (lambda: ref.DistantLight((0, 0, 0)), "zero vector"),
        (lambda: ref.PointLight((0, 0)), "position"),
        (lambda: ref.SpotLight((0, 0, 0), cone_angle=190), "cone_angle"),
        (lambda: ref.Triangles(np.zeros((3, 3))), "shape"),
        (lambda: ref.Triangles(np.full((1, 3, 3), np.inf)), "9 coordinates"),
        (lambda: ref.Camera(np.diag([2.0, 1, 1, 1])), "orthonormal"),
        (lambda: ref.Camera(np.eye(4), window=(1, 0, 0, 1)), "empty"),
        (lambda: ref.Camera(np.eye(4), clip=(2, 1)), "clip"),
        (lambda: ref.Camera(np.eye(4), "fisheye"), "fisheye"),
        (lambda: ref.render(ref.Scene(), ref.Camera(np.eye(4)), 0, 1), "empty"),
        (lambda: ref.render(ref.Scene(), ref.Camera(np.eye(4)), 1, 1, max_error=0.0), "max_error"),
    ],
)
def test_bad_input_is_a_sentence(make, words):
    with pytest.raises(ValueError, match=words) as caught:
        make()
    assert str(caught.value).endswith(".")


@pytest.mark.parametrize("module", ["reference", "metrics"])
def test_truth_imports_nothing_else_of_previs(module):
    import previs

    root = Path(previs.__file__).parent
    files = [root / f"{module}.py"] if (root / f"{module}.py").exists() else sorted((root / module).glob("*.py"))
    assert files
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, file
                names = [node.module or ""]
            for name in names:
                assert not name.startswith("previs") or name.startswith(f"previs.{module}"), (file, name)

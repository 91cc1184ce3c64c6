"""Projections as plain geometry: what a pixel, a map texel and a shadow-map face see. No OpenGL."""

import numpy as np
import pytest
from building import (
    box,
    camera,
    distant,
    orthographic_camera,
    point,
    rotation,
    scaling,
    scene,
    shear,
    smooth_noise,
    sphere,
    spot,
    translation,
    volume,
)

from previs import Medium
from previs.bench.reference_scene import reference_camera
from previs.description import Camera, Shaping, box_corners
from previs.render.projection import (
    CUBE_FACES,
    LightMap,
    camera_rays,
    light_map,
    occupied_points,
    relative_to,
    render_origin,
    shadow_fit,
)

WIDTH, HEIGHT = 7, 5
FAR_AWAY = translation(1e5, -2e5, 5e4)
CAMERAS = {
    "perspective": camera((1.0, 2.0, 9.0)),
    "wide": camera((1.0, 2.0, 2.5), degrees=90.0),
    "offset": camera((1.0, 2.0, 9.0), offset=(0.3, -0.2)),
    "inside": camera((0.1, 0.2, 0.3), (0.0, 0.0, -1.0)),
    "distant": camera((100.0, 200.0, 9000.0), degrees=0.03),
    "orthographic": orthographic_camera((1.0, 2.0, 9.0)),
    "orthographic offset": orthographic_camera((1.0, 2.0, 9.0), offset=(0.7, 0.3)),
}
BALL = scene(sphere(Medium()))


def conformed(view: Camera) -> Camera:
    return view.conformed(WIDTH / HEIGHT)


def pixel_coordinates() -> np.ndarray:
    """(u, v) of the pixel centres, row 0 on top, (H·W, 2)."""
    u, v = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH, 1.0 - (np.arange(HEIGHT) + 0.5) / HEIGHT)
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def affine(columns: np.ndarray, uv: np.ndarray) -> np.ndarray:
    return columns[0] + uv[:, :1] * columns[1] + uv[:, 1:] * columns[2]


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (3.0, -4.0, 5.0)])
def test_camera_rays_are_those_of_the_camera(name: str, origin) -> None:
    """The same lines as the reference's camera; the anchors lie on them, on one plane, at the depth that is said."""
    view = CAMERAS[name]
    rays = camera_rays(conformed(view), np.array(origin), BALL, (0.0, 0.0))
    eyes, directions, cosine = reference_camera(view, WIDTH, HEIGHT).rays(WIDTH, HEIGHT)
    uv = pixel_coordinates()
    anchor, direction = affine(rays.anchor, uv) + origin, affine(rays.direction, uv)
    length = np.linalg.norm(direction, axis=1)
    np.testing.assert_allclose(direction / length[:, None], directions, atol=1e-12)
    np.testing.assert_allclose(length, 1.0 / cosine, rtol=1e-12)
    np.testing.assert_allclose(anchor, eyes + rays.anchor_depth * direction, atol=1e-9)


@pytest.mark.parametrize("name", CAMERAS)
def test_rasterised_points_fall_where_their_rays_are(name: str) -> None:
    """A point on a pixel's ray is drawn at that pixel; depth runs from −1 to 1 over near and far."""
    rays = camera_rays(conformed(CAMERAS[name]), np.zeros(3), BALL, (0.0, 0.0))
    uv = pixel_coordinates()
    for depth, expected in ((rays.near, -1.0), (rays.far, 1.0), (0.5 * (rays.near + rays.far), None)):
        points = affine(rays.anchor, uv) + (depth - rays.anchor_depth) * affine(rays.direction, uv)
        clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ rays.view_projection
        np.testing.assert_allclose(clip[:, :2] / clip[:, 3:], 2.0 * uv - 1.0, atol=1e-6)
        if expected is not None:
            np.testing.assert_allclose(clip[:, 2] / clip[:, 3], expected, atol=1e-6)


def test_a_shift_moves_the_samples() -> None:
    """By fractions of the image: half a pixel to the right is the ray between two pixels."""
    plain = camera_rays(conformed(CAMERAS["offset"]), np.zeros(3), BALL, (0.0, 0.0))
    moved = camera_rays(conformed(CAMERAS["offset"]), np.zeros(3), BALL, (0.5 / WIDTH, -0.25 / HEIGHT))
    uv = pixel_coordinates()
    expected = affine(plain.direction, uv + np.array([0.5 / WIDTH, -0.25 / HEIGHT]))
    np.testing.assert_allclose(affine(moved.direction, uv), expected, atol=1e-12)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_depth_range_holds_the_scene(name: str) -> None:
    """Everything in front of the near clip, and little besides, so that a depth buffer keeps its digits."""
    view = CAMERAS[name]
    rays = camera_rays(conformed(view), np.zeros(3), BALL, (0.0, 0.0))
    depths = -((box_corners(*BALL.world_bounds()) - view.camera_to_world[3, :3]) @ view.camera_to_world[2, :3])
    assert rays.near <= max(depths.min(), view.clipping_range[0])
    assert rays.far >= depths.max()
    assert rays.far - rays.near <= 1.2 * np.linalg.norm([2.0, 2.0, 2.0])


def test_the_clipping_range_of_the_camera_counts() -> None:
    rays = camera_rays(conformed(camera((0.0, 0.0, 9.0), clip=(8.5, 9.25))), np.zeros(3), BALL, (0.0, 0.0))
    assert (rays.near, rays.far) == pytest.approx((8.5, 9.25))


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_keep_their_digits_in_32_bits(name: str) -> None:
    """Far from the world's origin and from the camera, a ray in 32-bit floats still passes its point of the scene."""
    view = CAMERAS[name]
    placed = Camera(**{**vars(view), "camera_to_world": view.camera_to_world @ FAR_AWAY})
    description = scene(sphere(Medium(), local_to_world=FAR_AWAY))
    origin = render_origin(description)
    rays = camera_rays(conformed(placed), origin, description, (0.0, 0.0))
    uv = pixel_coordinates()
    single = affine(rays.anchor.astype(np.float32), uv.astype(np.float32))
    double = affine(rays.anchor, uv)
    reach = max(1.0, np.abs(double).max())
    assert np.abs(single - double).max() <= 1e-6 * reach
    assert reach < 20.0


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (1e5, 3.0, -7e6)])
def test_the_render_origin_is_near_and_steady(size: float, place) -> None:
    """Within the scene's radius of its centre, and the same after a move that is small against the scene."""
    first = scene(sphere(Medium(), size, translation(*place)))
    radius = size * 3.0**0.5
    origin = render_origin(first)
    assert np.linalg.norm(origin - place) <= 2.0 * radius * 3.0**0.5
    origins = {
        tuple(render_origin(scene(sphere(Medium(), size, translation(*(np.array(place) + 0.01 * size * i))))))
        for i in range(20)
    }
    assert len(origins) <= 8


def test_the_render_origin_of_nothing() -> None:
    assert np.array_equal(render_origin(scene()), np.zeros(3))


PLACED = scaling(1.0, 2.0, 0.5) @ shear(0.4) @ rotation((1.0, 2.0, 3.0), 40.0)
LIGHTS = {
    "sun": (distant((0.3, -1.0, 0.2)), "orthographic"),
    "sun along an axis": (distant((0.0, 0.0, 1.0)), "orthographic"),
    "near lamp": (point((0.0, 5.0, 1.0)), "perspective"),
    "far lamp": (point((3e4, 5e4, 1e4)), "perspective"),
    "lamp inside": (point((0.1, 0.2, 0.0)), "octahedral"),
    "lamp at the boundary": (point((0.0, 2.2, 0.0)), "octahedral"),
    "narrow spot": (spot((0.0, 5.0, 1.0), (0.0, 0.0, 0.0), shaping=Shaping(5.0)), "perspective"),
    "spot inside": (spot((0.0, 0.1, 0.0), (0.5, -1.0, 0.0), shaping=Shaping(40.0)), "perspective"),
}


def seen_points(fit: LightMap, light, held, count: int = 500) -> np.ndarray:
    """Random points of the volume, relative to the map's centre; for a spot those in its cone."""
    random = np.random.default_rng(1)
    corners = occupied_points(held)
    weights = random.dirichlet(np.full(len(corners), 0.2), count)
    points = weights @ corners
    if light.shaping is not None:
        offset = points - light.position
        cosine = offset @ light.direction / np.linalg.norm(offset, axis=1)
        points = points[cosine > np.cos(np.radians(light.shaping.cone_angle))]
    return points - fit.centre


@pytest.mark.parametrize("place", [np.eye(4), FAR_AWAY], ids=["at the origin", "far away"])
@pytest.mark.parametrize("name", LIGHTS)
def test_a_point_lies_on_the_ray_of_its_map_coordinate(name: str, place: np.ndarray) -> None:
    """Point → (u, v) → ray: the ray passes the point, and (u, v) is inside the map."""
    light, kind = LIGHTS[name]
    light = type(light)(**{**vars(light), "light_to_world": light.light_to_world @ place})
    held = volume(smooth_noise((6, 6, 6)), Medium(), PLACED @ place)
    fit = light_map(light, held, 64)
    assert fit.kind == kind
    points = seen_points(fit, light, held)
    assert len(points) > 10
    mapped = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ fit.to_map
    tolerance = 1e-9 * (1.0 + np.abs(fit.from_light).max())
    if kind == "octahedral":
        # There the coordinate is made of the direction from the light.
        np.testing.assert_allclose(mapped[:, :3], points + fit.centre - light.position, atol=max(tolerance, 1e-9))
        return
    assert mapped[:, 3].min() > 0.0
    uv = mapped[:, :2] / mapped[:, 3:]
    assert uv.min() > 0.0
    assert uv.max() < 1.0
    origin, direction = affine(fit.ray_origin, uv), affine(fit.ray_direction, uv)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    offset = points - origin
    along = np.einsum("ij,ij->i", offset, direction)
    assert along.min() > -tolerance
    np.testing.assert_allclose(offset, along[:, None] * direction, atol=tolerance)


@pytest.mark.parametrize("name", LIGHTS)
def test_depths_along_a_light_ray(name: str) -> None:
    """The distance |x − L| − |c − L| holds its digits in 32 bits however far the light is."""
    light, kind = LIGHTS[name]
    held = volume(smooth_noise((6, 6, 6)), Medium(), PLACED)
    fit = light_map(light, held, 64)
    points = seen_points(fit, light, held)
    if kind == "orthographic":
        expected = points @ light.direction
        found = points.astype(np.float32) @ fit.from_light.astype(np.float32)
    else:
        np.testing.assert_allclose(fit.from_light, fit.centre - light.position, atol=1e-12)
        position = light.position - fit.centre
        expected = np.linalg.norm(points - position, axis=1) - np.linalg.norm(position)
        y, e = points.astype(np.float32), fit.from_light.astype(np.float32)
        lengths = np.linalg.norm(y + e, axis=1) + np.float32(np.linalg.norm(e))
        found = np.einsum("ij,ij->i", y, y + np.float32(2.0) * e) / lengths
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_map_is_fitted_to_what_the_volume_holds() -> None:
    """Not to its bounds: two far corners of a large grid, one behind the other, take no wider a map than one."""
    values = np.zeros((64, 64, 64))
    values[:8, :8, :8] = values[56:, 56:, 56:] = 1.0
    fit = light_map(distant((1.0, 1.0, 1.0)), volume(values, Medium(), index_to_local=np.eye(4)), 64)
    assert np.linalg.norm(fit.ray_origin[1]) < 20.0
    assert np.linalg.norm(fit.ray_origin[2]) < 20.0


def corners_of(lo, hi) -> np.ndarray:
    return box_corners(np.array(lo, float), np.array(hi, float))


CASTERS = corners_of((-0.5, 0.0, -0.5), (0.5, 1.0, 0.5))
MEDIA = corners_of((-2.0, -1.0, -2.0), (2.0, 3.0, 2.0))
RECEIVERS = np.concatenate([CASTERS, MEDIA, corners_of((-50.0, -1.0, -50.0), (50.0, -1.0, 50.0))])


def clip_of(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    h = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ matrix
    return h[:, :3] / h[:, 3:]


@pytest.mark.parametrize("direction", [(0.0, -1.0, 0.0), (0.4, -1.0, 0.3), (1.0, -0.05, 0.0)])
def test_a_suns_shadow_map_holds_all_that_casts(direction) -> None:
    """Every caster lies in the last face, and in the depth range of both; the first holds all shadowed media."""
    fit = shadow_fit(distant(direction), CASTERS, RECEIVERS, MEDIA)
    assert fit.kind == "orthographic"
    random = np.random.default_rng(0)
    inside = random.dirichlet(np.full(8, 0.2), 500) @ CASTERS
    assert np.abs(clip_of(fit.matrices[-1], inside)).max() <= 1.0
    for matrix in fit.matrices:
        assert np.abs(clip_of(matrix, inside)[:, 2]).max() <= 1.0
    # Where a caster stands between the sun and a point of the media, the first face sees both.
    shadowed = inside + random.uniform(0.0, 1.0, (500, 1)) * np.array(direction)
    kept = shadowed[np.all((shadowed >= MEDIA.min(axis=0)) & (shadowed <= MEDIA.max(axis=0)), axis=1)]
    assert len(kept) > 100
    assert np.abs(clip_of(fit.matrices[0], kept)[:, :2]).max() <= 1.0


def test_a_sun_over_a_wide_ground_gets_a_close_map_for_the_media() -> None:
    """A hundred units of ground that cast too would leave the fog a handful of texels."""
    ground = corners_of((-50.0, -1.0, -50.0), (50.0, -0.9, 50.0))
    fit = shadow_fit(distant((0.0, -1.0, 0.0)), np.concatenate([CASTERS, ground]), RECEIVERS, MEDIA)
    assert len(fit.matrices) == 2
    near, far = (np.linalg.norm(m[:3, 0]) for m in fit.matrices)
    assert near > 10.0 * far


@pytest.mark.parametrize("angle", [1.0, 20.0, 60.0])
def test_a_spots_shadow_map_holds_its_cone(angle: float) -> None:
    """Every direction in the cone is inside the face, and the face is not much wider."""
    light = spot((1.0, 4.0, 2.0), (0.0, 0.0, 0.0), shaping=Shaping(angle))
    fit = shadow_fit(light, CASTERS, RECEIVERS, MEDIA)
    assert fit.kind == "perspective"
    rim = rotation(np.cross(light.direction, (0.0, 1.0, 0.0)), angle)[:3, :3]
    spokes = [rotation(light.direction, a)[:3, :3] for a in range(0, 360, 10)]
    points = light.position + 3.0 * np.array([light.direction @ rim @ s for s in spokes])
    reach = np.abs(clip_of(fit.matrices[0], points)[:, :2]).max(axis=1)
    assert reach.max() <= 1.0
    assert np.linalg.norm(clip_of(fit.matrices[0], points)[:, :2], axis=1).max() >= 0.95


def test_the_faces_of_a_cube_are_those_that_the_shader_picks() -> None:
    """By the largest component; (u, v) from the other two as the shader reads them."""
    light = point((0.3, 0.2, -0.1))
    fit = shadow_fit(light, CASTERS, RECEIVERS, MEDIA)
    assert (fit.kind, len(fit.matrices)) == ("cube", 6)
    directions = np.random.default_rng(2).normal(size=(300, 3))
    for d in directions:
        axis = int(np.argmax(np.abs(d)))
        face = 2 * axis + (d[axis] <= 0.0)
        uv = np.array([d[(axis + 1) % 3], d[(axis + 2) % 3]]) / abs(d[axis])
        inside = light.position + 0.5 * fit.far * d / np.linalg.norm(d)
        clip = clip_of(fit.matrices[face], inside[None])[0]
        np.testing.assert_allclose(clip[:2], uv, atol=1e-9)
        assert -1.0 <= clip[2] <= 1.0
        np.testing.assert_array_equal(CUBE_FACES[face][0], np.sign(d[axis]) * np.eye(3)[axis])


def test_no_caster_is_farther_than_far() -> None:
    """Their distances from the light over `far` fit a depth buffer."""
    fit = shadow_fit(point((1.0, 4.0, 2.0)), CASTERS, RECEIVERS, MEDIA)
    assert np.linalg.norm(CASTERS - fit.position, axis=1).max() < fit.far
    assert fit.far < 1.01 * np.linalg.norm(RECEIVERS - fit.position, axis=1).max()


def test_relative_matrices() -> None:
    """A matrix for points relative to an origin gives what the plain one gives for the points themselves."""
    matrix = PLACED @ translation(1.0, 2.0, 3.0)
    origin = np.array([10.0, -20.0, 30.0])
    np.testing.assert_allclose(clip_of(relative_to(matrix, origin), CASTERS - origin), clip_of(matrix, CASTERS))


def test_keys_tell_projections_apart() -> None:
    """Equal for equal inputs, different after a small move of a light or camera."""
    held = box(Medium())
    first, again = (light_map(point((0.0, 5.0, 1.0)), held, 64).key() for _ in range(2))
    assert first == again
    assert first != light_map(point((0.0, 5.0, 1.0 + 1e-9)), held, 64).key()
    fits = [shadow_fit(point((0.0, y, 1.0)), CASTERS, RECEIVERS, MEDIA).key() for y in (5.0, 5.0, 5.0 + 1e-9)]
    assert fits[0] == fits[1] != fits[2]

"""The scenes on which the renderer is judged, small enough for the reference.

A case is a description, a camera, and settings besides those of a converged march.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from building import (
    box,
    box_mesh,
    camera,
    capsule,
    distant,
    orthographic_camera,
    point,
    quad_mesh,
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
from building import field as voxels

from previs.description import Camera, Medium, SceneDescription, Shaping

FRONT = camera((1.2, 0.9, 5.5))
SIDE = distant((-1.0, -0.7, -0.4), (3.0, 3.0, 3.0))
#: What a converged march takes besides; shadow maps are fine because a texel of the map shows as an error.
CONVERGED = {"transmittance": "march", "steps": 1024, "light_steps": 512, "shadow_map_size": 4096}


@dataclass(frozen=True)
class Case:
    scene: SceneDescription
    camera: Camera = FRONT
    settings: Mapping[str, Any] = field(default_factory=dict)
    # World position of a point light inside a medium: the radiance of a ray through it is infinite.
    singular: tuple[float, float, float] | None = None
    # The share of the picture's light that may be in the wrong place. Smooth integrands are met to rounding; voxels are
    # half floats, and the edge of a shadow or a cone falls inside a step.
    limit: float = 5e-5


EDGES = 0.0008

CASES: dict[str, Callable[[], Case]] = {}


def case(function: Callable[[], Case]) -> Callable[[], Case]:
    CASES[function.__name__.replace("_", " ")] = function
    return function


def fog(extinction=0.8, **values: Any) -> Medium:
    rgb = (extinction,) * 3 if np.isscalar(extinction) else extinction
    return Medium(extinction=rgb, **{"albedo": (0.9, 0.9, 0.9), **values})


TURNED = rotation((0.3, 1.0, 0.2), 35.0)


@case
def box_and_sun() -> Case:
    return Case(scene(box(fog(), local_to_world=TURNED), SIDE))


@case
def sphere_and_sun() -> Case:
    return Case(scene(sphere(fog(1.5, anisotropy=0.4)), SIDE))


@case
def stretched_sphere() -> Case:
    placed = scaling(0.6, 1.2, 0.9) @ shear(0.4) @ TURNED
    return Case(scene(sphere(fog(1.5), local_to_world=placed), SIDE))


@case
def capsule_along_x() -> Case:
    return Case(scene(capsule(fog(2.0), "X", 1.2, 0.5, TURNED), SIDE))


@case
def capsule_along_y() -> Case:
    return Case(scene(capsule(fog(2.0), "Y", 1.2, 0.5, TURNED), point((1.5, 1.5, 1.0), (4.0, 4.0, 4.0))))


@case
def dense_box() -> Case:
    return Case(scene(box(fog(40.0), local_to_world=TURNED), SIDE), limit=0.003)


@case
def thin_box() -> Case:
    return Case(scene(box(fog(1e-4), local_to_world=TURNED), SIDE))


@case
def coloured_extinction() -> Case:
    medium = fog((0.1, 1.0, 8.0), albedo=(0.95, 0.5, 0.8))
    return Case(scene(sphere(medium), SIDE, distant((0.2, 1.0, 0.3), (0.5, 1.0, 2.0), "/Fill")), limit=EDGES)


def _phase(name: str, **values: Any) -> Callable[[], Case]:
    def make() -> Case:
        return Case(scene(sphere(fog(1.0, phase=name, **values)), distant((0.6, -0.5, 1.0), (3.0, 2.0, 1.0))))

    return make


CASES["phase isotropic"] = _phase("isotropic")
CASES["phase hg forward"] = _phase("hg", anisotropy=0.85)
CASES["phase hg backward"] = _phase("hg", anisotropy=-0.6)
CASES["phase schlick"] = _phase("schlick", anisotropy=0.7)
CASES["phase rayleigh"] = _phase("rayleigh")
CASES["phase two lobe"] = _phase("two_lobe", anisotropy=0.8, anisotropy2=-0.4, lobe_mix=0.35)


@case
def phases_side_by_side() -> Case:
    media = [
        sphere(fog(2.0, phase=name, anisotropy=0.5), 0.45, translation(x, 0.0, 0.0), f"/{name}")
        for x, name in ((-1.0, "isotropic"), (0.0, "schlick"), (1.0, "hg"))
    ]
    return Case(scene(*media, distant((0.3, -0.5, 1.0), (3.0, 3.0, 3.0))))


@case
def point_light_outside() -> Case:
    return Case(scene(box(fog(), local_to_world=TURNED), point((1.5, 1.2, 1.8), (6.0, 5.0, 4.0))))


@case
def light_inside() -> Case:
    light = point((0.2, 0.1, -0.3), (2.0, 2.0, 2.0))
    return Case(scene(box(fog(), local_to_world=TURNED), light), singular=(0.2, 0.1, -0.3))


@case
def sphere_light_inside() -> Case:
    light = point((0.2, 0.1, -0.3), (2.0, 2.0, 2.0), radius=0.15)
    return Case(scene(sphere(fog()), light))


@case
def camera_inside() -> Case:
    return Case(scene(box(fog(0.5, anisotropy=0.3)), SIDE), camera((0.3, 0.2, 0.6), (0.0, 0.0, 0.0), 60.0))


@case
def spot_with_hard_edge() -> Case:
    return Case(
        scene(box(fog(0.5)), spot((0.3, 2.5, 0.5), (0.0, 0.0, 0.0), (20.0, 20.0, 20.0), Shaping(20.0))), limit=EDGES
    )


@case
def spot_with_softness_and_focus() -> Case:
    shaping = Shaping(cone_angle=30.0, cone_softness=0.6, focus=8.0, focus_tint=(0.4, 0.1, 0.0))
    return Case(scene(box(fog(0.5)), spot((0.3, 2.5, 0.5), (0.0, 0.0, 0.0), (20.0, 20.0, 20.0), shaping)), limit=EDGES)


@case
def spot_wider_than_a_hemisphere() -> Case:
    shaping = Shaping(cone_angle=110.0, cone_softness=0.3)
    light = spot((0.3, 1.6, 0.5), (0.0, 0.0, 0.0), (6.0, 6.0, 6.0), shaping)
    return Case(scene(box(fog(0.5)), light))


@case
def spot_inside() -> Case:
    light = spot((0.1, 0.5, 0.1), (0.0, -1.0, 0.0), (4.0, 4.0, 4.0), Shaping(35.0, 0.5))
    return Case(scene(box(fog(0.5)), light), singular=(0.1, 0.5, 0.1), limit=EDGES)


@case
def disk_light() -> Case:
    light = spot((0.4, 1.7, 0.4), (0.0, 0.0, 0.0), (5.0, 5.0, 5.0), kind="disk", shaped=False)
    return Case(scene(box(fog(0.8)), light))


@case
def rect_light_with_cone() -> Case:
    light = spot((0.4, 1.7, 0.4), (0.0, 0.0, 0.0), (5.0, 5.0, 5.0), Shaping(50.0, 0.4), kind="rect")
    return Case(scene(box(fog(0.8)), light), limit=EDGES)


@case
def light_without_shadows() -> Case:
    free = point((1.5, 1.2, 1.8), (6.0, 5.0, 4.0), casts_shadows=False)
    return Case(
        scene(box(fog(1.5), local_to_world=TURNED), free, SIDE, box_mesh((0.2, 0.2, 0.9), (0.6, 0.6, 1.2))), limit=EDGES
    )


@case
def ambient() -> Case:
    return Case(scene(sphere(fog((0.5, 1.0, 2.0))), box_mesh((-0.3,) * 3, (0.3,) * 3)), settings={"ambient": 0.7})


@case
def orthographic_with_offsets() -> Case:
    view = orthographic_camera((1.2, 0.9, 5.5), width=3.2, offset=(0.3, -0.2))
    return Case(scene(box(fog(), local_to_world=TURNED), SIDE), view)


@case
def perspective_with_offsets() -> Case:
    return Case(scene(box(fog(), local_to_world=TURNED), SIDE), camera((1.2, 0.9, 5.5), offset=(0.15, 0.1)))


@case
def clipped_by_the_camera() -> Case:
    return Case(scene(box(fog(), local_to_world=TURNED), SIDE), camera((1.2, 0.9, 5.5), clip=(5.0, 6.2)))


@case
def two_shapes_overlap() -> Case:
    red = fog((0.3, 1.0, 2.0), albedo=(0.9, 0.5, 0.3), anisotropy=0.6)
    blue = fog((2.0, 1.0, 0.3), albedo=(0.3, 0.5, 0.9), phase="rayleigh")
    first = box(red, (-1.2, -0.7, -0.7), (0.4, 0.7, 0.7), TURNED)
    return Case(scene(first, sphere(blue, 0.9, translation(0.4, 0.2, 0.0)), SIDE))


@case
def volume_inside_a_volume() -> Case:
    return Case(scene(box(fog(0.4)), sphere(fog((1.0, 4.0, 8.0)), 0.4, translation(0.2, 0.1, 0.0)), SIDE))


@case
def five_lights() -> Case:
    lights = [
        point((1.6 * np.cos(a), 1.3, 1.6 * np.sin(a)), tuple(np.roll((3.0, 1.0, 0.3), i)), path=f"/Point{i}")
        for i, a in enumerate(np.linspace(0.0, 5.0, 3))
    ]
    return Case(
        scene(box(fog(), local_to_world=TURNED), SIDE, *lights, spot((0.0, -2.5, 0.0), (0, 0, 0), (9, 9, 9))),
        limit=EDGES,
    )


@case
def glow() -> Case:
    medium = fog((0.5, 1.0, 2.0), albedo=(0.2, 0.4, 0.6), emission=(2.0, 1.0, 0.5), emission_scale=0.5)
    return Case(scene(sphere(medium), SIDE))


@case
def mesh_shades_the_medium() -> Case:
    gobo = box_mesh((-0.4, 1.1, -0.3), (0.3, 1.2, 0.4), matrix=rotation((0, 1, 0), 20.0))
    return Case(scene(box(fog(0.7)), gobo, distant((-0.2, -1.0, -0.1), (3.0, 3.0, 3.0))), limit=EDGES)


@case
def mesh_shades_a_point_light() -> Case:
    gobo = box_mesh((-0.4, 1.1, -0.3), (0.3, 1.2, 0.4), matrix=rotation((0, 1, 0), 20.0))
    return Case(scene(box(fog(0.7)), gobo, point((0.2, 2.0, 0.1), (5.0, 5.0, 5.0))), limit=EDGES)


@case
def mesh_shades_a_spot() -> Case:
    gobo = box_mesh((-0.2, 1.1, -0.15), (0.15, 1.2, 0.2), matrix=rotation((0, 1, 0), 20.0))
    light = spot((0.2, 2.0, 0.1), (0.0, 0.0, 0.0), (5.0, 5.0, 5.0), Shaping(35.0))
    return Case(scene(box(fog(0.7)), gobo, light), limit=EDGES)


@case
def mesh_shades_a_spot_evenly_stepped() -> Case:
    return replace(mesh_shades_a_spot(), settings={"projective_steps": False})


@case
def mesh_in_the_medium() -> Case:
    solid = box_mesh((-0.4, -0.3, -0.5), (0.3, 0.4, 0.4), (0.7, 0.4, 0.2), rotation((1, 1, 0), 30.0))
    return Case(scene(box(fog(0.7)), solid, SIDE), limit=EDGES)


@case
def volume_shades_a_mesh() -> Case:
    ground = quad_mesh([(-3, -1.2, -3), (-3, -1.2, 3), (3, -1.2, 3), (3, -1.2, -3)], (0.6, 0.5, 0.4))
    cloud = sphere(fog((1.0, 2.0, 4.0)), 0.7, translation(0.0, 0.4, 0.0))
    return Case(scene(cloud, ground, distant((0.3, -1.0, -0.2), (3.0, 3.0, 3.0))), camera((1.0, 2.5, 5.0)), limit=EDGES)


@case
def surfaces_alone() -> Case:
    ground = quad_mesh([(-3, -1.2, -3), (-3, -1.2, 3), (3, -1.2, 3), (3, -1.2, -3)], (0.6, 0.5, 0.4))
    solid = box_mesh((-0.5, -1.2, -0.5), (0.4, 0.3, 0.5), (0.2, 0.4, 0.7), path="/Box", emissive_color=(0.1, 0.0, 0.2))
    lights = [SIDE, point((-1.0, 1.5, 1.5), (3.0, 1.0, 1.0)), spot((1.0, 2.0, 1.0), (0.0, -1.0, 0.0), (1.0, 4.0, 1.0))]
    return Case(scene(ground, solid, *lights), camera((1.0, 2.5, 5.0)), limit=EDGES)


GRID = smooth_noise((13, 16, 12), seed=3)
ROTATED = scaling(1.1, 0.7, 0.9) @ rotation((0.5, 1.0, -0.3), 50.0)


@case
def grid_rotated_and_stretched() -> Case:
    return Case(scene(volume(GRID, fog(3.0, anisotropy=0.3), ROTATED), SIDE), limit=EDGES)


@case
def grid_sheared() -> Case:
    placed = shear(0.6) @ ROTATED
    return Case(scene(volume(GRID, fog((1.0, 3.0, 6.0)), placed), SIDE), limit=EDGES)


@case
def grid_mirrored() -> Case:
    light = point((1.5, 1.4, 1.0), (6.0, 6.0, 6.0))
    return Case(scene(volume(GRID, fog(3.0), scaling(-1.0, 1.0, 1.0) @ ROTATED), light), limit=EDGES)


@case
def grid_with_light_inside() -> Case:
    light = point((0.1, 0.0, 0.1), (1.0, 1.0, 1.0), radius=0.1)
    return Case(scene(volume(GRID, fog(2.0), ROTATED), light), limit=EDGES)


@case
def grid_around_the_camera() -> Case:
    view = camera((0.1, 0.1, 0.2), (0.5, -0.2, -1.0), 60.0)
    return Case(scene(volume(GRID, fog(1.5, anisotropy=0.4), ROTATED), SIDE), view, limit=EDGES)


@case
def grid_with_background() -> Case:
    cloud = volume(GRID, fog(2.0), ROTATED)
    held = voxels(GRID, background=0.3)
    return Case(scene(replace(cloud, density=held), SIDE), limit=EDGES)


@case
def grid_and_mesh() -> Case:
    solid = box_mesh((-0.3, -0.2, -0.3), (0.2, 0.3, 0.3), (0.7, 0.4, 0.2), rotation((1, 1, 0), 30.0))
    return Case(scene(volume(GRID, fog(2.0), ROTATED), solid, SIDE), limit=EDGES)


@case
def two_grids_overlap() -> Case:
    other = volume(GRID[::-1], fog((4.0, 2.0, 1.0), albedo=(0.4, 0.6, 0.9)), translation(0.5, 0.3, 0.2), "/Other")
    return Case(scene(volume(GRID, fog((1.0, 2.0, 4.0)), ROTATED), other, SIDE), limit=EDGES)


@case
def grid_and_shape() -> Case:
    haze = box(fog(0.3, anisotropy=0.5), (-1.5, -1.0, -1.5), (1.5, 1.0, 1.5))
    return Case(scene(volume(GRID, fog(3.0), ROTATED), haze, SIDE), limit=EDGES)


@case
def grid_with_emission_field() -> Case:
    glow = smooth_noise((8, 8, 8), seed=5)[..., None] * np.array([3.0, 1.0, 0.2])
    medium = fog(2.0, albedo=(0.3, 0.3, 0.3), emission=(1.0, 1.0, 1.0))
    return Case(scene(volume(GRID, medium, ROTATED, emission=glow), SIDE), limit=EDGES)


@case
def grid_with_temperature() -> Case:
    heat = smooth_noise((8, 8, 8), seed=5) * 1.5
    medium = fog(
        2.0,
        albedo=(0.3, 0.3, 0.3),
        emission=(1.0, 1.0, 1.0),
        emission_scale=300.0,
        temperature_scale=1500.0,
        temperature_offset=700.0,
    )
    return Case(scene(volume(GRID, medium, ROTATED, temperature=heat), SIDE), limit=EDGES)

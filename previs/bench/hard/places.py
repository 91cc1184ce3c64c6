"""Hard cases of where things are: camera, lights, meshes, transforms of the volume and of the whole scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...description import SceneDescription
from ..transforms import rotation, scaling, shear, translation
from .media import COARSE
from .records import (
    CLOUD,
    COLUMN,
    FRONT,
    SIDE,
    TURNED,
    box,
    box_mesh,
    camera,
    cloud,
    cube_transform,
    distant,
    fog,
    moved,
    placed_camera,
    point,
    scene,
    sphere,
    volume,
)
from .trial import ANY, MAPS_AND_MARCH, SAME, Trial, case

#: A constant block of voxels in the cube from −1 to 1: its field falls to 0 over the last voxel before the faces.
BLOCK = np.ones((12, 12, 12))


@case("camera inside the medium")
def camera_inside(trial: Trial) -> None:
    """Camera within the cloud, near plane a thousandth of it away."""
    trial.right(scene(cloud(5.0, anisotropy=0.3), SIDE), camera((0.3, 0.2, 0.6), degrees=60.0))


@case("camera inside the medium", methods=(ANY,))
def camera_on_the_boundary(trial: Trial) -> None:
    """Camera on a face of a box, looking in, out and along it; near plane close enough to see the first of it."""
    medium = box(fog(1.5))
    for target in ((0.0, 0.0, 0.0), (0.3, 0.2, 3.0), (3.0, 0.4, 1.0)):
        view = camera((0.2, 0.1, 1.0), target, 60.0)
        if target[2] < 3.0:
            trial.right(scene(medium, SIDE), view)
        else:
            trial.measure(trial.render(scene(medium, SIDE), view).color.max(), 0.0, "light from behind the camera")


@case("no jump as the camera passes a face of the volume", methods=(ANY,))
def camera_through_a_face(trial: Trial) -> None:
    """Nothing jumps as the camera enters, by steps of a few millionths of the volume."""
    for medium in (volume(BLOCK, fog(1.5)), box(fog(1.5))):
        eyes = [(0.2, 0.1, 1.0 + d) for d in (-1e-4, -1e-6, 0.0, 1e-6, 1e-4)]
        images = [trial.render(scene(medium, SIDE), camera(e, degrees=60.0, near=1e-5), **COARSE) for e in eyes]
        trial.continuous(images)


@case("light inside the medium")
def light_inside(trial: Trial) -> None:
    """A point light within the cloud lights it all around."""
    trial.right(scene(cloud(4.0), point((0.21, 0.13, -0.32), 1.0)))


@case("light inside the medium")
def light_inside_a_dense_medium(trial: Trial) -> None:
    """A point light in a cloud of depth 40: from the light the curve begins at 1 and is gone after a voxel or two."""
    trial.right(scene(cloud(40.0), point((0.21, 0.13, 0.5), 1.0)))


@case("light on the boundary of the medium")
def light_on_the_boundary(trial: Trial) -> None:
    """On a face and on a corner of the box that a block of voxels fills."""
    for position in ((1.0, 0.11, 0.07), (1.0, 1.0, 1.0)):
        trial.right(scene(volume(BLOCK, fog(2.0)), point(position)))


@case("no jump as the light passes a face of the volume", coefficients=(6,))
def light_through_a_face(trial: Trial) -> None:
    """The projection of the map changes as the light enters; the picture may not, beyond the error of the method."""
    places = [(1.0 + d, 0.11, 0.07) for d in (-1e-4, -1e-6, 0.0, 1e-6, 1e-4)]
    block = volume(BLOCK, fog(2.0))
    images = [trial.render(scene(block, point(p)), map_size=128) for p in places]
    trial.continuous(images, 0.5 * trial.limits[0] + SAME)


@case("light exactly behind the medium", coefficients=(6,))
def light_exactly_behind(trial: Trial) -> None:
    """Sun and bulb on the camera's axis behind a forward-scattering cloud."""
    view = camera((0.0, 0.0, 5.5))
    for light in (distant((0.0, 0.0, 1.0)), point((0.0, 0.0, -2.5), 20.0)):
        trial.right(scene(cloud(5.0, anisotropy=0.8), light), view)


@case("bounds of zero thickness", methods=(ANY,))
def flat_volumes(trial: Trial) -> None:
    """Volumes that are flat, or made so by a transform, are left out and said to be; the rest of the scene stays."""
    rest = (cloud(3.0), SIDE)
    flat = [
        box(fog(), (-1, 0, -1), (1, 0, 1), path="/Sheet"),
        box(fog(), matrix=scaling(1.0, 0.0, 1.0), path="/Pressed"),
        volume(CLOUD, fog(), scaling(1.0, 0.0, 1.0), "/Voxels"),
    ]
    image = trial.render(scene(*rest, *flat), **COARSE)
    trial.same(image, trial.render(scene(*rest), **COARSE), 0.0)
    for held in flat:
        trial.told(image.stats["notes"], held.path, "no thickness")


@case("a volume of one voxel")
def one_voxel(trial: Trial) -> None:
    """The field of one voxel is a tent over two voxels."""
    trial.right(scene(volume(np.full((1, 1, 1), 2.0), fog(1.5), TURNED), SIDE))


@case("non-uniform scale", "shear", "mirrored transform", coefficients=(6,))
def stretched_sheared_mirrored(trial: Trial) -> None:
    """A cloud five times as wide as it is thick, sheared, and inside out by a mirror."""
    for matrix in (scaling(1.2, 0.25, 0.8), shear(0.7), scaling(-0.9, 1.0, 0.7) @ shear(-0.4)):
        trial.right(scene(cloud(3.0, matrix @ TURNED), SIDE))


@case("mirrored transform", "mirrored scene, mirrored picture", methods=MAPS_AND_MARCH, coefficients=(6,))
def mirrored_scene(trial: Trial) -> None:
    """The whole scene in a mirror, seen by a camera on the other side: the picture flipped."""
    mirror = scaling(-1.0, 1.0, 1.0)
    lit = scene(cloud(4.0), box_mesh((0.3, -1.3, 0.2), (0.7, 0.4, 0.6)), SIDE)
    for held, view in ((lit, FRONT), (scene(cloud(4.0), point((-1.4, 1.2, 0.9))), FRONT)):
        mirrored = camera((-1.2, 0.9, 5.5))
        image = trial.render(held, view, map_size=128, steps=128, light_steps=128)
        other = trial.render(moved(held, mirror), mirrored, map_size=128, steps=128, light_steps=128)
        trial.same(other.color[:, ::-1], image, 2.0 * SAME, "not mirrored by")


def furnished() -> SceneDescription:
    """A cloud and a ball of mist in the shadow of a pillar, under a sun and a bulb."""
    pillar = box_mesh((0.6, -1.2, 0.6), (0.9, 0.6, 0.9))
    ball = sphere(fog(0.7), 0.5, translation(-1.2, 0.3, 0.3))
    return scene(cloud((1.0, 2.0, 3.0)), ball, pillar, SIDE, point((1.5, 1.5, 1.0)))


_FURNISHED = {"steps": 96, "light_steps": 96, "map_size": 64, "shadow_map_size": 1024}


@case("scene 1e5 units from the origin", methods=MAPS_AND_MARCH, coefficients=(6,))
def far_from_the_origin(trial: Trial) -> None:
    """A scene a hundred thousand units away looks as it does at the origin."""
    near = trial.render(furnished(), **_FURNISHED)
    for offset in ((1e5, 0.0, 0.0), (-7e4, 9e4, 3e4)):
        there = translation(*offset)
        far = trial.render(moved(furnished(), there), placed_camera(FRONT, there), **_FURNISHED)
        trial.same(far, near)


@case("scene of size 1e-3", "scene of size 1e5", methods=MAPS_AND_MARCH, coefficients=(6,))
def small_and_large_scenes(trial: Trial) -> None:
    """Lengths times s, extinctions over s and radiant intensities times s²: the same picture."""
    near = trial.render(furnished(), **_FURNISHED)
    for size in (1e-3, 1e5):
        grown = scaling(size, size, size)
        image = trial.render(moved(furnished(), grown, True), placed_camera(FRONT, grown), **_FURNISHED)
        trial.same(image, near)


@case("turned scene and camera, same picture", methods=MAPS_AND_MARCH, coefficients=(6,))
def turned_scene_and_camera(trial: Trial) -> None:
    """Everything turned together: grid, mesh, lights, camera."""
    settings = {"steps": 192, "light_steps": 192, "map_size": 192, "shadow_map_size": 2048}
    straight = trial.render(furnished(), **settings)
    for turn in (rotation((0.0, 1.0, 0.0), 90.0), rotation((0.5, -0.7, 0.2), 77.0)):
        image = trial.render(moved(furnished(), turn), placed_camera(FRONT, turn), **settings)
        # Texels of maps fall elsewhere: of the shadow map a pillar's edge, of the light maps another sampling.
        trial.same(image, straight, 5.0 * SAME)


@case("turned grid, same picture", coefficients=(6,))
def turned_grid(trial: Trial) -> None:
    """Voxels turned in their array and back by their transform: the same field, the same picture."""
    medium, settings = fog(3.0 / COLUMN), {**COARSE, "steps": 256, "light_steps": 256}
    straight = trial.render(scene(volume(CLOUD, medium, TURNED), SIDE), **settings)
    for axes, axis in (((1, 2), (1.0, 0.0, 0.0)), ((0, 1), (0.0, 0.0, 1.0))):
        turned = np.rot90(CLOUD, axes=axes)
        back = cube_transform(turned.shape) @ rotation(axis, -90.0)
        image = trial.render(scene(volume(turned, medium, TURNED, index_to_local=back), SIDE), **settings)
        trial.same(image, straight)


@case("mesh that cuts through the medium", methods=MAPS_AND_MARCH, coefficients=(6,))
def mesh_through_the_medium(trial: Trial) -> None:
    """A slab through the middle of the cloud: it ends view rays and light rays inside, and is shadowed by the cloud."""
    slab = box_mesh((-1.4, -0.12, -0.5), (1.4, 0.08, 0.6))
    trial.right(scene(cloud(4.0), slab, distant((-0.5, -1.0, -0.3))))
    trial.right(scene(cloud(4.0), slab, point((0.4, 1.6, 0.5))))


@case("mesh that touches the boundary of the medium", methods=MAPS_AND_MARCH, coefficients=(6,))
def mesh_on_the_boundary(trial: Trial) -> None:
    """A block of voxels that stands on a floor, its face in the floor's plane; and one whose side is walled."""
    block, sun = volume(BLOCK, fog(1.5)), distant((-0.5, -1.0, -0.3))
    floor, wall = box_mesh((-3, -1.5, -3), (3, -1.0, 3)), box_mesh((1.0, -1, -1), (1.2, 1, 1))
    trial.right(scene(block, floor, sun))
    trial.right(scene(block, wall, sun))


@case("closed mesh around the light", methods=(ANY,))
def closed_mesh_round_the_light(trial: Trial) -> None:
    """A bulb shut in a box in the cloud: outside of it all is dark, but for what a shadow map cannot resolve."""
    texels, half, intensity = 1024, 0.2, 4.0
    bulb = point((0.03, 0.02, -0.04), intensity)
    held = scene(cloud(3.0), box_mesh((-half,) * 3, (half,) * 3), bulb)
    image = trial.render(held, shadow_map_size=texels)
    # Two texels of medium right outside the wall, where the bulb is nearest, lit in full: σs · I/d² · p · thickness.
    layer, nearest = 2.0 * 2.0 * half / texels, half - 0.04
    leak = 0.9 * 3.0 / COLUMN * intensity / nearest**2 / (4.0 * np.pi) * layer
    trial.measure(image.color.max(), leak, "light that leaks")


@case("light inside the medium", "closed mesh around the light", methods=(ANY,))
def light_on_a_mesh(trial: Trial) -> None:
    """A bulb on the surface of a box in a medium: finite, and lit at least on its own side."""
    held = scene(cloud(3.0), box_mesh((-0.2,) * 3, (0.2,) * 3), point((0.2, 0.0, 0.0)))
    image = trial.render(held)
    trial.measure(not image.color.max() > 1e-2, 0.0, "nothing is lit", "flag")


@case("no light gained: never brighter than without shadows", "light inside the medium", coefficients=(6,))
def bulb_never_brighter_than_without_shadows(trial: Trial) -> None:
    """A bulb inside: maps all around it take light away in every pixel."""
    bulb = point((0.21, 0.13, -0.32), 1.0)
    shadowed = trial.render(scene(cloud(20.0), bulb), **COARSE)
    free = trial.render(scene(cloud(20.0), replace(bulb, casts_shadows=False)), **COARSE)
    excess = float((shadowed.color - free.color).max()) / float(free.color.max())
    trial.measure(max(excess, 0.0), 1e-5, "brighter than unshadowed by", "%")

"""The same scene for the reference: `SceneDescription` and `Camera` as `previs.reference` takes them."""

import numpy as np

from .. import blackbody
from .. import reference as ref
from ..description import (
    Box,
    Camera,
    Capsule,
    Field,
    Light,
    Mesh,
    SceneDescription,
    Sphere,
    Volume,
    transform_points,
)
from ..settings import Settings


def reference_camera(camera: Camera, width: int, height: int) -> ref.Camera:
    """The camera with its aspect conformed to an image of that many pixels."""
    conformed = camera.conformed(width / height)
    return ref.Camera(camera.camera_to_world, camera.projection, conformed.window(), camera.clipping_range)


def reference_scene(scene: SceneDescription, settings: Settings | None = None) -> ref.Scene:
    """The scene; of the settings the ambient light counts.

    Raises:
        ValueError: for what the reference does not model: specular surfaces.
    """
    ambient = np.full(3, (settings or Settings()).ambient)
    for light in scene.lights.values():
        if light.kind == "dome":
            ambient = ambient + light.radiance
    return ref.Scene(
        # A density without an active voxel is not there, whatever its background.
        volumes=[_volume(v) for v in scene.volumes.values() if v.density is None or v.density.grid.active_count],
        lights=[_light(x) for x in scene.lights.values() if x.kind != "dome"],
        solids=[_solid(m) for m in scene.meshes.values()],
        ambient=ambient,
    )


def _grid(field: Field, local_to_world: np.ndarray, channel: int | None = None) -> ref.GridMedium:
    # Without an active voxel a field is its background.
    lo, hi = field.grid.bounds or (np.zeros(3, int), np.zeros(3, int))
    values = field.grid.dense(lo, hi)
    background = field.grid.background
    if channel is not None:
        values, background = values[..., channel], 0.0
    first = np.eye(4)
    first[3, :3] = lo
    return ref.GridMedium(values, first @ field.index_to_local @ local_to_world, background)


def _volume(volume: Volume) -> ref.Volume:
    to_world, medium, shape = np.asarray(volume.local_to_world, float), volume.medium, volume.shape
    fields = []
    if volume.temperature is not None:

        def glow(value: np.ndarray) -> np.ndarray:
            kelvin = value * medium.temperature_scale + medium.temperature_offset
            # The renderer's table begins here.
            return np.where(kelvin[:, None] > blackbody.TABLE_RANGE[0], blackbody.radiance(kelvin), 0.0)

        fields.append(ref.EmissionField(_grid(volume.temperature, to_world), glow))
    if volume.emission is not None and volume.emission.grid.leaf_values.ndim == 5:
        for channel in range(3):

            def only(value: np.ndarray, channel: int = channel) -> np.ndarray:
                rgb = np.ones((len(value), 3))
                rgb[:, channel] = value
                return rgb

            fields.append(ref.EmissionField(_grid(volume.emission, to_world, channel), only))
    elif volume.emission is not None:
        fields.append(ref.EmissionField(_grid(volume.emission, to_world)))
    match shape:
        case None:
            density = _grid(volume.density, to_world)
        case Box():
            density = ref.HomogeneousBox(shape.minimum, shape.maximum, to_world)
        case Sphere():
            density = ref.HomogeneousSphere(shape.radius, to_world)
        case Capsule():
            density = ref.HomogeneousCapsule(shape.radius, shape.height, shape.axis, to_world)
    return ref.Volume(
        density,
        ref.Medium(
            extinction=medium.strength,
            albedo=medium.albedo,
            phase=medium.phase,
            anisotropy=medium.anisotropy,
            anisotropy2=medium.anisotropy2,
            lobe_mix=medium.lobe_mix,
            emission=np.multiply(medium.emission, medium.emission_scale),
            emission_fields=fields,
        ),
    )


def _light(light: Light) -> ref.DistantLight | ref.PointLight:
    if light.kind == "distant":
        return ref.DistantLight(light.direction, light.strength, light.casts_shadows)
    radius = light.world_radius if light.kind == "sphere" and not light.treat_as_point else 0.0
    common = {"intensity": light.strength, "radius": radius, "casts_shadows": light.casts_shadows}
    cosine, shaping = light.kind in ("disk", "rect"), light.shaping
    if shaping is None and not cosine:
        return ref.PointLight(light.position, **common)
    if shaping is None:
        return ref.SpotLight(light.position, **common, axis=light.direction, cone_angle=180.0, cosine=True)
    return ref.SpotLight(
        light.position,
        **common,
        axis=light.direction,
        cone_angle=shaping.cone_angle,
        softness=shaping.cone_softness,
        focus=shaping.focus,
        focus_tint=shaping.focus_tint,
        cosine=cosine,
    )


def _solid(mesh: Mesh) -> ref.Triangles:
    if mesh.surface.specular:
        raise ValueError(f"{mesh.path}: the reference has no specular surfaces")
    geometry = mesh.geometry
    corners, normals = [], []
    for matrix in mesh.local_to_world:
        corners.append(transform_points(geometry.points, matrix)[geometry.triangles])
        # Row vectors: normals go with the inverse transpose.
        turned = np.asarray(geometry.normals, float) @ np.linalg.inv(np.asarray(matrix, float)[:3, :3]).T
        turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-300)
        normals.append(turned[geometry.triangles])
    albedo = np.asarray(mesh.surface.diffuse_color, float)
    if geometry.colors is not None:
        albedo = np.tile(albedo * geometry.colors[geometry.triangles], (len(corners), 1, 1))
    return ref.Triangles(np.concatenate(corners), albedo, mesh.surface.emissive_color, np.concatenate(normals))


def reference_image(
    scene: SceneDescription,
    camera: Camera,
    width: int,
    height: int,
    settings: Settings | None = None,
    max_error: float = 1e-4,
) -> ref.ReferenceImage:
    """The reference's picture of a scene."""
    return ref.render(
        reference_scene(scene, settings), reference_camera(camera, width, height), width, height, max_error
    )

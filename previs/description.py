"""What a renderer may know of a scene: plain, immutable records, without GL and without pxr.

The stage reader writes these records, the render index compares them, the passes read them. Every record
with a `parts()` method splits itself into named parts that are compared on their own, so that a change of
one part (an albedo) does not look like a change of another (the voxels).

Conventions, everywhere in previs:

- Matrices are 4×4 float64 and act on row vectors, as in USD: ``world = [x y z 1] @ local_to_world``.
- Colours are linear RGB in the stage's rendering space (linear Rec.709), shape (3,), as tuples of float.
- Lengths are stage units.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

Color = tuple[float, float, float]
PhaseName = Literal["isotropic", "hg", "schlick", "rayleigh", "two_lobe"]
LightKind = Literal["distant", "sphere", "disk", "rect", "cylinder", "dome"]
NoteKind = Literal["approximated", "ignored", "repaired", "missing", "empty"]

PHASES: tuple[PhaseName, ...] = ("isotropic", "hg", "schlick", "rayleigh", "two_lobe")
#: The anisotropy is kept inside ±0.999: at ±1 the Henyey–Greenstein lobe is a Dirac delta.
ANISOTROPY_LIMIT = 0.999


@dataclass(frozen=True)
class Note:
    """Something about the input that the picture does not show as authored, said to the user.

    `path` is the prim (or the file) it is about, `message` one sentence without the path.
    """

    kind: NoteKind
    path: str
    message: str

    def __str__(self) -> str:
        return f"{self.path}: {self.kind}: {self.message}"


class SparseGrid(Protocol):
    """What is asked of a grid of voxels; `previs.vdb.Grid` is one. `bounds` is None when no voxel is active."""

    name: str
    index_to_world: np.ndarray
    background: float | np.ndarray
    active_count: int
    bounds: tuple[np.ndarray, np.ndarray] | None
    leaf_origins: np.ndarray
    leaf_values: np.ndarray
    leaf_active: np.ndarray

    def dense(self, lo: np.ndarray, hi: np.ndarray, limit: int = ...) -> np.ndarray:
        """Values [x, y, z] over an index box, both ends included; refuses more than `limit` voxels."""
        ...


@dataclass(frozen=True, eq=False)
class Field:
    """A sampled field of a volume: voxels, and where they sit in the volume's local space.

    Values sit at integer index coordinates, are trilinear between them and fall to the grid's background over one
    voxel outside the active box. `key` identifies the voxels: two fields with equal keys hold equal voxels.
    `index_to_local` is 4×4, from index space to the space of the volume prim.
    """

    key: Hashable
    grid: SparseGrid
    index_to_local: np.ndarray

    def parts(self) -> Hashable:
        """What identifies the field: its voxels and its placement."""
        return (self.key, matrix_key(self.index_to_local))


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the local space of its prim."""

    minimum: tuple[float, float, float]
    maximum: tuple[float, float, float]

    @property
    def local_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Minimum and maximum corner in local space, (3,) each."""
        return np.array(self.minimum, float), np.array(self.maximum, float)


@dataclass(frozen=True)
class Sphere:
    """A sphere around the local origin."""

    radius: float

    @property
    def local_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Minimum and maximum corner in local space, (3,) each."""
        return np.full(3, -self.radius), np.full(3, self.radius)


@dataclass(frozen=True)
class Capsule:
    """A capsule around the local origin: a segment of length `height` along `axis` (X, Y or Z), swept by a sphere."""

    axis: str
    height: float
    radius: float

    @property
    def local_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Minimum and maximum corner in local space, (3,) each."""
        half = np.full(3, self.radius)
        half["XYZ".index(self.axis)] += 0.5 * self.height
        return -half, half


Shape = Box | Sphere | Capsule


@dataclass(frozen=True)
class Medium:
    """The scattering properties of a volume; the attributes are those of the `PrevisVolume` shader.

    `extinction` is σt per stage unit and per unit of density ([TFM11] eq. 11: σt(x) = D(x)·σt), `albedo` is σs/σt in
    [0, 1]. `anisotropy` is g, positive for forward scattering. `two_lobe` mixes HG(g) and HG(anisotropy2):
    ``lerp(HG(anisotropy), HG(anisotropy2), lobe_mix)``. Emitted radiance is ``emission · emission_scale`` times the
    emission field and the blackbody colour of ``temperature · temperature_scale + temperature_offset`` kelvin
    where the volume has those fields; it is multiplied by σa.
    """

    density_scale: float = 1.0
    extinction: Color = (1.0, 1.0, 1.0)
    albedo: Color = (0.9, 0.9, 0.9)
    anisotropy: float = 0.0
    phase: PhaseName = "hg"
    anisotropy2: float = 0.0
    lobe_mix: float = 0.0
    emission: Color = (0.0, 0.0, 0.0)
    emission_scale: float = 1.0
    temperature_scale: float = 1.0
    temperature_offset: float = 0.0

    @property
    def scattering(self) -> Color:
        """σs = albedo · σt."""
        return tuple(s * a for s, a in zip(self.extinction, self.albedo, strict=True))

    @property
    def absorption(self) -> Color:
        """σa = (1 − albedo) · σt."""
        return tuple(s * (1.0 - a) for s, a in zip(self.extinction, self.albedo, strict=True))

    @cached_property
    def strength(self) -> Color:
        """σt times the density scale: extinction per stage unit where the field's value is 1."""
        return tuple(s * self.density_scale for s in self.extinction)

    @property
    def emits(self) -> bool:
        """Whether any emission can reach the camera: emitted radiance and absorption are both non-zero in a channel."""
        return any(e * self.emission_scale * a != 0.0 for e, a in zip(self.emission, self.absorption, strict=True))


@dataclass(frozen=True, eq=False)
class Volume:
    """A participating medium: either a density field, or a homogeneous shape with density 1 inside.

    Exactly one of `density` and `shape` is set. `path` is the prim path, with ``[i]`` appended for an instance.
    """

    path: str
    local_to_world: np.ndarray
    medium: Medium = Medium()
    density: Field | None = None
    shape: Shape | None = None
    temperature: Field | None = None
    emission: Field | None = None

    def __post_init__(self) -> None:
        if (self.density is None) == (self.shape is None):
            raise ValueError(f"{self.path}: a volume has either a density field or a homogeneous shape")

    def parts(self) -> Mapping[str, Hashable]:
        """`placement`, `density` and `extinction` move light maps, `scattering` and `emission_fields` the march."""
        medium = self.medium
        return {
            "density": self.density and self.density.parts(),
            "emission_fields": tuple(f and f.parts() for f in (self.temperature, self.emission)),
            "placement": (matrix_key(self.local_to_world), self.shape),
            "extinction": medium.strength,
            "scattering": medium,
        }


@dataclass(frozen=True)
class Shaping:
    """UsdLux ShapingAPI: a cone about the light's −Z axis, and a focus that narrows it. Angles in degrees.

    `cone_angle` is the half angle; the factor is ``1 − smoothstep(θ, (1 − softness)·cone, cone)``.
    `focus` multiplies by ``lerp(focus_tint, 1, cosθ^focus)``.
    """

    cone_angle: float = 90.0
    cone_softness: float = 0.0
    focus: float = 0.0
    focus_tint: Color = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Light:
    """A UsdLux light. `radiance` is what its surface emits: every factor of the schema is in it, `normalize` too.

    `strength` is the reduction of that light to its centre: irradiance on a plane across the light's direction for
    a distant light, radiant intensity along the light's axis for the others. It stays meaningful for a light of zero
    size. `angle` (degrees, the full apparent diameter) belongs to distant lights; `radius`, `width`, `height` and
    `length` are the authored sizes in the light's own space. `shaping` is None where no ShapingAPI is applied.
    A dome is a uniform environment of `radiance`.
    """

    path: str
    kind: LightKind
    light_to_world: np.ndarray
    radiance: Color
    strength: Color = (0.0, 0.0, 0.0)
    angle: float = 0.0
    radius: float = 0.0
    width: float = 0.0
    height: float = 0.0
    length: float = 0.0
    treat_as_point: bool = False
    shaping: Shaping | None = None
    casts_shadows: bool = True

    @property
    def position(self) -> np.ndarray:
        """World position of the light's centre, (3,)."""
        return np.asarray(self.light_to_world, float)[3, :3]

    @property
    def direction(self) -> np.ndarray:
        """World direction in which the light travels along its axis: its local −Z, unit length, (3,)."""
        matrix = np.asarray(self.light_to_world, float)
        # A direction is carried as the tangent of the local axis, so a scale along it does not turn it.
        axis = -matrix[2, :3]
        length = np.linalg.norm(axis)
        return axis / length if length > 0.0 else np.array([0.0, 0.0, -1.0])

    @property
    def world_radius(self) -> float:
        """Radius of the sphere light after the mean scale of its transform, stage units."""
        return self.radius * abs(np.linalg.det(np.asarray(self.light_to_world, float)[:3, :3])) ** (1.0 / 3.0)

    def parts(self) -> Mapping[str, Hashable]:
        """`placement` moves the light's maps; `colour` only what is lit."""
        return {
            "placement": (
                self.kind,
                matrix_key(self.light_to_world),
                self.casts_shadows,
                self.shaping and self.shaping.cone_angle,
            ),
            "colour": (self.strength, self.radiance, self.radius, self.treat_as_point, self.shaping),
        }


@dataclass(frozen=True, eq=False)
class Geometry:
    """Triangles. `key` identifies the content: equal keys, equal arrays.

    `points` (V, 3) float32; `normals` (V, 3) float32, unit length; `triangles` (T, 3) uint32, counter-clockwise seen
    from outside; `colors` (V, 3) float32 or None. Vertices are already split where normals or colours differ between
    faces.
    """

    key: Hashable
    points: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray | None = None

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Minimum and maximum of the points, (3,) each; None without points."""
        if len(self.points) == 0:
            return None
        return self.points.min(axis=0), self.points.max(axis=0)


@dataclass(frozen=True)
class Surface:
    """The constants of a UsdPreviewSurface. `diffuse_color` multiplies the geometry's colours where it has them.

    `specular` is False for a mesh without a material: displayColor is shown as a plain Lambertian.
    """

    diffuse_color: Color = (0.18, 0.18, 0.18)
    emissive_color: Color = (0.0, 0.0, 0.0)
    specular: bool = False
    use_specular_workflow: bool = False
    specular_color: Color = (0.0, 0.0, 0.0)
    metallic: float = 0.0
    roughness: float = 0.5
    ior: float = 1.5


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles at one or more places. `local_to_world` is (K, 4, 4): one matrix per instance."""

    path: str
    geometry: Geometry
    local_to_world: np.ndarray
    surface: Surface = Surface()

    def parts(self) -> Mapping[str, Hashable]:
        """`shape` moves shadow maps and the G-buffer, `surface` only the G-buffer."""
        return {
            "shape": (self.geometry.key, matrix_key(self.local_to_world)),
            "surface": self.surface,
        }


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera as in UsdGeomCamera. It looks along its local −Z, +Y up; `camera_to_world` is orthonormal.

    For a perspective camera apertures, offsets and focal length share a unit (tenths of a stage unit), of which only
    ratios matter. For an orthographic one the apertures are widths in tenths of a stage unit.
    """

    path: str
    camera_to_world: np.ndarray
    projection: Literal["perspective", "orthographic"] = "perspective"
    focal_length: float = 50.0
    horizontal_aperture: float = 20.955
    vertical_aperture: float = 15.2908
    horizontal_aperture_offset: float = 0.0
    vertical_aperture_offset: float = 0.0
    clipping_range: tuple[float, float] = (1.0, 1.0e6)

    @property
    def aspect_ratio(self) -> float:
        """Width over height of the aperture."""
        return self.horizontal_aperture / self.vertical_aperture

    def window(self) -> tuple[float, float, float, float]:
        """(left, right, bottom, top): at unit distance for a perspective camera, in stage units for an orthographic
        one."""
        unit = 0.1 if self.projection == "orthographic" else 1.0 / self.focal_length
        half_width, half_height = 0.5 * self.horizontal_aperture, 0.5 * self.vertical_aperture
        x, y = self.horizontal_aperture_offset, self.vertical_aperture_offset
        return (
            (x - half_width) * unit,
            (x + half_width) * unit,
            (y - half_height) * unit,
            (y + half_height) * unit,
        )

    def conformed(self, aspect_ratio: float) -> Camera:
        """This camera with its vertical aperture changed so that pixels of an image of that aspect are square."""
        from dataclasses import replace

        return replace(self, vertical_aperture=self.horizontal_aperture / aspect_ratio)

    def parts(self) -> Mapping[str, Hashable]:
        """`view` moves everything that is drawn per pixel."""
        return {
            "view": (
                matrix_key(self.camera_to_world),
                self.projection,
                self.focal_length,
                self.window(),
                self.clipping_range,
            )
        }


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """Everything in a stage at one time that a renderer may use. Records are keyed by their `path`."""

    volumes: Mapping[str, Volume] = field(default_factory=dict)
    lights: Mapping[str, Light] = field(default_factory=dict)
    meshes: Mapping[str, Mesh] = field(default_factory=dict)
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    up_axis: Literal["Y", "Z"] = "Y"

    def world_bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The world box (minimum, maximum) of volumes and meshes, or None when there are neither; found once."""
        return self._world_bounds

    @cached_property
    def _world_bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        boxes = [volume_world_bounds(v) for v in self.volumes.values()]
        boxes += [b for m in self.meshes.values() if (b := mesh_world_bounds(m)) is not None]
        if not boxes:
            return None
        lo, hi = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
        # Everybody gets the same arrays.
        lo.flags.writeable = hi.flags.writeable = False
        return lo, hi

    def bounds_of(self, path: str) -> tuple[np.ndarray, np.ndarray] | None:
        """The world box of the records at a prim path, its instances and what is below it.

        A light that has a place counts with its size, or with a hundredth of the scene where it has none. None where
        there is nothing with a place.
        """

        def belongs(record: str) -> bool:
            return record == path or record.startswith((f"{path}/", f"{path}["))

        boxes = [volume_world_bounds(v) for p, v in self.volumes.items() if belongs(p)]
        boxes += [b for p, m in self.meshes.items() if belongs(p) and (b := mesh_world_bounds(m)) is not None]
        placed = [light for p, light in self.lights.items() if belongs(p) and light.kind not in ("distant", "dome")]
        if placed:
            world = self.world_bounds()
            least = 0.01 * float(np.linalg.norm(world[1] - world[0])) if world is not None else 1.0
            boxes += [(x.position - (r := max(x.world_radius, least)), x.position + r) for x in placed]
        if not boxes:
            return None
        return np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)


def matrix_key(matrix: np.ndarray) -> bytes:
    """A hashable stand-in for a matrix: equal bytes, equal matrix. Adding 0.0 makes −0 and 0 the same."""
    return (np.asarray(matrix, np.float64) + 0.0).tobytes()


def field_local_bounds(f: Field) -> tuple[np.ndarray, np.ndarray] | None:
    """The corners of the box where a field can be non-zero, in *index* space; None for an empty grid.

    One voxel wider than the active box on every side, where the field falls to the background.
    """
    if f.grid.active_count == 0:
        return None
    lo, hi = f.grid.bounds
    return np.asarray(lo, float) - 1.0, np.asarray(hi, float) + 1.0


#: Which side of a box its corners lie on, along each axis.
_CORNERS = np.array([[(i >> a) & 1 for a in range(3)] for i in range(8)], bool)


def box_corners(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """The eight corners of a box, (8, 3): bit a of a corner's number is its side along axis a."""
    return np.where(_CORNERS, np.asarray(hi, float), np.asarray(lo, float))


def transform_points(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points (N, 3) by a 4×4 affine matrix (row vectors)."""
    matrix = np.asarray(matrix, float)
    return np.asarray(points, float) @ matrix[:3, :3] + matrix[3, :3]


def volume_box(volume: Volume) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(lo, hi, box_to_world): a box around everything a volume can hold, in the space where it is axis-aligned."""
    if volume.density is not None:
        bounds = field_local_bounds(volume.density)
        lo, hi = bounds if bounds is not None else (np.zeros(3), np.zeros(3))
        return (
            lo,
            hi,
            np.asarray(volume.density.index_to_local, float) @ np.asarray(volume.local_to_world, float),
        )
    lo, hi = volume.shape.local_bounds
    return lo, hi, np.asarray(volume.local_to_world, float)


def volume_world_bounds(volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """World box (minimum, maximum) of a volume."""
    lo, hi, to_world = volume_box(volume)
    corners = transform_points(box_corners(lo, hi), to_world)
    return corners.min(axis=0), corners.max(axis=0)


def mesh_world_bounds(mesh: Mesh) -> tuple[np.ndarray, np.ndarray] | None:
    """World box (minimum, maximum) of all instances of a mesh, or None without points."""
    bounds = mesh.geometry.bounds
    if bounds is None or len(mesh.local_to_world) == 0:
        return None
    corners = box_corners(*bounds)
    matrices = np.asarray(mesh.local_to_world, float)
    placed = (corners @ matrices[:, :3, :3] + matrices[:, 3:, :3]).reshape(-1, 3)
    return placed.min(axis=0), placed.max(axis=0)


def framing_camera(scene: SceneDescription, aspect_ratio: float = 16.0 / 9.0) -> Camera:
    """A camera that frames the whole scene: three quarters from the front, slightly above, 50 mm on a 36 mm wide
    film."""
    bounds = scene.world_bounds()
    lo, hi = bounds if bounds is not None else (-np.ones(3), np.ones(3))
    centre, radius = 0.5 * (lo + hi), max(0.5 * float(np.linalg.norm(hi - lo)), 1e-6)
    up = np.array([0.0, 0.0, 1.0]) if scene.up_axis == "Z" else np.array([0.0, 1.0, 0.0])
    front = np.array([0.0, -1.0, 0.0]) if scene.up_axis == "Z" else np.array([0.0, 0.0, 1.0])
    side = np.cross(up, front)
    back = front + 0.4 * side + 0.3 * up
    back /= np.linalg.norm(back)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    true_up = np.cross(back, right)
    # Just far enough for every corner of the bounds to be inside the film, with a margin.
    corners = box_corners(lo, hi) - centre
    tangents = np.array([18.0, 18.0 / aspect_ratio]) / 50.0 / 1.08
    across = np.abs(corners @ np.stack([right, true_up], axis=1))
    distance = max(float((across / tangents + (corners @ back)[:, None]).max()), 1e-6)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3] = right, true_up, back
    matrix[3, :3] = centre + back * distance
    return Camera(
        path="",
        camera_to_world=matrix,
        focal_length=50.0,
        horizontal_aperture=36.0,
        vertical_aperture=36.0 / aspect_ratio,
        clipping_range=(max(distance - 4.0 * radius, 1e-3 * radius), distance + 4.0 * radius),
    )

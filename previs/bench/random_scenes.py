"""Random small scenes: one builder for property tests, which shrink what fails, and for benches, which sample.

A scene is built from choices (`Choices`): numbers in ranges, whole numbers, options. Hypothesis can make them, and so
can a random generator (`RandomChoices`). What the shaders are compiled for is apart from them, in a `Structure`: a few
structures give endlessly many scenes without compiling for each.

Two tiers. `GENTLE` is what somebody would build, and accuracy may be asked of it: optical depths from 0.1 to 50,
a few voxels per feature, lights and cameras at a distance or well inside. `WILD` is whatever the records can hold:
finite pictures and bounds may be asked of it.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from ..description import (
    ANISOTROPY_LIMIT,
    PHASES,
    Box,
    Camera,
    Capsule,
    Color,
    Field,
    Geometry,
    Light,
    Medium,
    Mesh,
    SceneDescription,
    Shaping,
    Sphere,
    Surface,
    Volume,
)
from ..stage.field import cleaned
from ..vdb import Grid
from .transforms import rotation, scaling, shear, translation

T = TypeVar("T")

VOLUME_KINDS = ("grid", "box", "sphere", "capsule")
LIGHT_KINDS = ("distant", "point", "sphere", "spot", "disk", "rect")
EMISSIONS = ("none", "constant", "field", "temperature")
OCCLUDERS = ("box", "quad")


class Choices(Protocol):
    """What a scene is built from."""

    def number(self, lo: float, hi: float) -> float:
        """A number in [lo, hi]."""
        ...

    def integer(self, lo: int, hi: int) -> int:
        """A whole number in [lo, hi]."""
        ...

    def pick(self, options: Sequence[T]) -> T:
        """One of the options, of which the first is the simplest."""
        ...


class RandomChoices:
    """Choices by a random generator, all evenly distributed."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def number(self, lo: float, hi: float) -> float:
        """A number in [lo, hi]."""
        return float(self._random.uniform(lo, hi))

    def integer(self, lo: int, hi: int) -> int:
        """A whole number in [lo, hi]."""
        return int(self._random.integers(lo, hi + 1))

    def pick(self, options: Sequence[T]) -> T:
        """One of the options."""
        return options[int(self._random.integers(len(options)))]


@dataclass(frozen=True)
class Tier:
    """Ranges of a scene's numbers; lengths are those of a scene about two units wide, before `size` is applied.

    `depth` is the optical depth of a volume's strongest channel across its mean width, `spread` the most that channels
    differ by, `size` and `distance` (from the origin, in sizes) powers of ten. `wild` adds what only wild scenes have.
    """

    wild: bool
    depth: tuple[float, float]
    spread: float
    anisotropy: float
    voxels: tuple[int, int]
    stretch: tuple[float, float]
    size: tuple[float, float]
    distance: tuple[float, float]


GENTLE = Tier(
    wild=False,
    depth=(0.1, 50.0),
    spread=8.0,
    anisotropy=0.9,
    voxels=(8, 14),
    stretch=(0.5, 1.3),
    size=(-1.0, 2.0),
    distance=(0.0, 4.0),
)
WILD = Tier(
    wild=True,
    depth=(1e-6, 1e6),
    spread=100.0,
    anisotropy=ANISOTROPY_LIMIT,
    voxels=(1, 8),
    stretch=(1e-3, 1.5),
    size=(-3.0, 5.0),
    distance=(0.0, 5.0),
)


@dataclass(frozen=True)
class Structure:
    """What a scene is made of; its numbers are free.

    `volumes`, `lights` and `occluders` name kinds of `VOLUME_KINDS`, `LIGHT_KINDS` and `OCCLUDERS`; `phases` has one
    name per volume; `emission` one of `EMISSIONS`, of the first volume, whose fields only grids have. `dome` adds
    a uniform environment.
    """

    volumes: tuple[str, ...]
    lights: tuple[str, ...]
    phases: tuple[str, ...]
    chromatic: bool = False
    emission: str = "none"
    occluders: tuple[str, ...] = ()
    dome: bool = False

    def __str__(self) -> str:
        parts = [
            " ".join(f"{v}:{p}" for v, p in zip(self.volumes, self.phases, strict=True)),
            " ".join(self.lights),
            " ".join((*self.occluders, *(("dome",) if self.dome else ()), *(("coloured",) if self.chromatic else ()))),
            f"emission {self.emission}" if self.emission != "none" else "",
        ]
        return ", ".join(p for p in parts if p)


def random_structure(choose: Choices, volumes: int = 3, lights: int = 3) -> Structure:
    """Any structure of at most that many volumes and lights."""
    kinds = tuple(choose.pick(VOLUME_KINDS) for _ in range(choose.integer(1, volumes)))
    return Structure(
        volumes=kinds,
        lights=tuple(choose.pick(LIGHT_KINDS) for _ in range(choose.integer(1, lights))),
        phases=tuple(choose.pick(PHASES) for _ in kinds),
        chromatic=choose.pick((False, True)),
        emission=choose.pick(EMISSIONS if kinds[0] == "grid" else EMISSIONS[:2]),
        occluders=tuple(choose.pick(OCCLUDERS) for _ in range(choose.integer(0, 2))),
        dome=choose.pick((False, False, True)),
    )


class RandomScene:
    """A scene, a camera that sees it, `text`, one line that says what it is, and its structure."""

    def __init__(self, description: SceneDescription, camera: Camera, text: str, structure: Structure) -> None:
        self.description, self.camera, self.text, self.structure = description, camera, text, structure

    def __repr__(self) -> str:
        # The line alone: hypothesis would print every voxel of a record.
        return f"<{self.text}>"


def random_scene(choose: Choices, tier: Tier = GENTLE, structure: Structure | None = None) -> RandomScene:
    """A scene of a tier: of the given structure, or of any."""
    return _Builder(choose, tier).scene(structure or random_structure(choose))


def property_scenes(count: int = 20, seed: int = 2012) -> list[tuple[str, SceneDescription, Camera]]:
    """Gentle scenes that hold a grid and a light that it attenuates: (name, description, camera) each.

    The same seed gives the same scenes, and fewer of them are the first of more.
    """
    tier = replace(GENTLE, voxels=(16, 32))
    found = []
    for number in range(count):
        choose = RandomChoices(np.random.default_rng((seed, number)))
        structure = random_structure(choose)
        while "grid" not in structure.volumes:
            structure = random_structure(choose)
        made = random_scene(choose, tier, structure)
        # At least one light is attenuated: the first.
        first = next(iter(made.description.lights))
        lights = {
            p: replace(x, casts_shadows=x.casts_shadows or p == first) for p, x in made.description.lights.items()
        }
        found.append((f"random {number:02}", replace(made.description, lights=lights), made.camera))
    return found


class _Builder:
    """Makes the records of one scene, one choice after the other."""

    def __init__(self, choose: Choices, tier: Tier) -> None:
        self.choose, self.tier = choose, tier
        self.texts: list[str] = []
        #: Whether a light or the camera stands in the middle of the scene.
        self.occupied = False
        # Simple numbers make faces, rays and lights coincide, where a rounding decides: gentle scenes lie askew.
        self.askew = 0.0 if tier.wild else 1.0

    def scene(self, structure: Structure) -> RandomScene:
        choose, tier = self.choose, self.tier
        volumes = [self.volume(i, structure) for i in range(len(structure.volumes))]
        lights = [self.light(i, kind) for i, kind in enumerate(structure.lights)]
        if structure.dome:
            radiance = self.color(0.0, 1.0)
            lights.append(Light("/Dome", "dome", np.eye(4), radiance))
        camera = self.camera()
        meshes = [self.occluder(i, kind) for i, kind in enumerate(structure.occluders)]
        size = 10.0 ** choose.number(*tier.size)
        far = 0.0
        if choose.pick((False, True)):
            far = size * 10.0 ** choose.number(*tier.distance)
        placing = scaling(size, size, size) @ translation(*(far * np.array(self.direction())))
        description = SceneDescription(
            {v.path: v for v in volumes}, {x.path: x for x in lights}, {m.path: m for m in meshes}
        )
        description, camera = placed(description, camera, placing)
        self.texts.append(f"size {size:.3g}, {far:.3g} away")
        return RandomScene(description, camera, "; ".join(self.texts), structure)

    # Small choices.

    def power(self, lo: float, hi: float) -> float:
        """A number in [lo, hi] whose logarithm is chosen."""
        return 10.0 ** self.choose.number(math.log10(lo), math.log10(hi))

    def color(self, lo: float, hi: float) -> Color:
        return tuple(self.choose.number(lo, hi) for _ in range(3))

    def point(self, reach: float) -> tuple[float, float, float]:
        return tuple(self.choose.number(-reach, reach) for _ in range(3))

    def direction(self) -> tuple[float, float, float]:
        around = math.radians(self.choose.number(-180.0, 180.0) + 31.7 * self.askew)
        above = math.radians(self.choose.number(-80.0, 80.0) + 7.3 * self.askew)
        return (math.cos(above) * math.sin(around), math.sin(above), math.cos(above) * math.cos(around))

    def place(self, number: int) -> np.ndarray:
        """Stretched, sheared, turned, maybe mirrored, and moved unless it is the first."""
        choose, tier = self.choose, self.tier
        if tier.wild:
            stretch = [self.power(*tier.stretch) for _ in range(3)]
            if choose.integer(0, 20) == 20:
                stretch[choose.integer(0, 2)] = 0.0
        else:
            stretch = [choose.number(*tier.stretch) for _ in range(3)]
        if choose.pick((False, True)):
            stretch[0] *= -1.0
        moved = translation(*self.point(0.7)) if number else np.eye(4)
        return scaling(*stretch) @ shear(choose.number(-0.6, 0.6)) @ self.turned() @ moved

    def turned(self) -> np.ndarray:
        x, y = (self.choose.number(-180.0, 180.0) for _ in range(2))
        first = rotation((1.0, 0.0, 0.0), x + 23.1 * self.askew)
        return first @ rotation((0.0, 1.0, 0.0), y + 41.9 * self.askew)

    # Volumes.

    def volume(self, number: int, structure: Structure) -> Volume:
        choose, kind = self.choose, structure.volumes[number]
        matrix = self.place(number)
        emission = structure.emission if number == 0 else "none"
        # The mean width of what a stretched cube from −1 to 1 becomes.
        width = 2.0 * max(abs(float(np.linalg.det(matrix[:3, :3]))) ** (1.0 / 3.0), 1e-6)
        medium, text = self.medium(structure, number, width, emission)
        path = f"/Volume{number}"
        if kind == "grid":
            values, what = self.voxels()
            self.texts.append(f"grid {what} {text}")
            background = choose.pick((0.0, 0.0, 0.0, 0.2))
            fields: dict[str, Any] = {"density": field(values, background)}
            if emission == "field":
                color = np.array(self.color(0.2, 3.0))
                fields["emission"] = field(smooth_noise(self.dims(), self.seed())[..., None] * color)
            elif emission == "temperature":
                fields["temperature"] = field(smooth_noise(self.dims(), self.seed()))
            return Volume(path, matrix, medium, **fields)
        self.texts.append(f"{kind} {text}")
        if kind == "box":
            lo, hi = np.array(self.point(0.3)) - 0.7, np.array(self.point(0.3)) + 0.7
            shape = Box(tuple(lo.tolist()), tuple(hi.tolist()))
        elif kind == "sphere":
            shape = Sphere(choose.number(0.5, 1.0))
        else:
            shape = Capsule(choose.pick(("X", "Y", "Z")), choose.number(0.2, 1.2), choose.number(0.2, 0.7))
        return Volume(path, matrix, medium, shape=shape)

    def medium(self, structure: Structure, number: int, width: float, emission: str) -> tuple[Medium, str]:
        choose, tier = self.choose, self.tier
        depth = self.power(*tier.depth)
        extinction = [depth / width] * 3
        if structure.chromatic:
            strongest = choose.integer(0, 2)
            weaker = [1.0 if c == strongest else tier.spread ** choose.number(-1.0, 0.0) for c in range(3)]
            extinction = [e * w for e, w in zip(extinction, weaker, strict=True)]
            if tier.wild and choose.integer(0, 10) == 10:
                extinction[(strongest + 1) % 3] = 0.0
        albedo = self.color(0.1, 1.0)
        if tier.wild:
            albedo = choose.pick((albedo, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
        phase = structure.phases[number]
        values: dict[str, Any] = {"phase": phase}
        if phase in ("hg", "schlick", "two_lobe"):
            values["anisotropy"] = self.anisotropy()
        if phase == "two_lobe":
            values |= {"anisotropy2": self.anisotropy(), "lobe_mix": choose.number(0.0, 1.0)}
        if emission != "none":
            values["emission"] = self.color(0.1, 2.0)
        if emission == "temperature":
            values |= {"emission_scale": 300.0, "temperature_scale": 1500.0, "temperature_offset": 700.0}
        text = f"depth {depth:.3g} {phase}" + (f" g {values['anisotropy']:.3g}" if "anisotropy" in values else "")
        return Medium(extinction=tuple(extinction), albedo=albedo, **values), text

    def anisotropy(self) -> float:
        most = self.tier.anisotropy
        g = self.choose.number(-most, most)
        return self.choose.pick((g, g, most, -most)) if self.tier.wild else g

    def dims(self) -> tuple[int, int, int]:
        return tuple(self.choose.integer(*self.tier.voxels) for _ in range(3))

    def seed(self) -> int:
        return self.choose.integer(0, 1000)

    def voxels(self) -> tuple[np.ndarray, str]:
        """Voxels and what they are."""
        choose, dims = self.choose, self.dims()
        name = "×".join(map(str, dims))
        if not self.tier.wild:
            # At least four voxels to a half wave.
            modes = choose.integer(1, max(min(dims) // 4, 1))
            return smooth_noise(dims, self.seed(), modes), f"{name} smooth({modes})"
        kind = choose.pick(("smooth", "constant", "noise", "sparse", "broken"))
        random = np.random.default_rng(self.seed())
        if kind == "smooth":
            values = smooth_noise(dims, self.seed())
        elif kind == "constant":
            values = np.ones(dims)
        else:
            values = random.uniform(0.0, 1.0, dims)
            if kind == "sparse":
                values *= random.uniform(0.0, 1.0, dims) > 0.8
        values = values * 10.0 ** choose.pick((0.0, 0.0, -20.0, 20.0))
        if kind == "broken":
            for bad in (np.nan, np.inf, -np.inf, -1.0, 0.0):
                values[random.uniform(0.0, 1.0, dims) > 0.9] = bad
        return values, f"{name} {kind}"

    # Lights.

    def light(self, number: int, kind: str) -> Light:
        """Outside all media, or well inside; in wild scenes also on faces and corners of the first volume's box."""
        choose, tier = self.choose, self.tier
        path = f"/Light{number}"
        tint = self.color(0.2, 1.0)
        casts = choose.pick((True, True, True, True, True, False))
        if kind == "distant":
            strength = _times(tint, 3.0)
            matrix = look_at(self.direction(), (0.0, 0.0, 0.0))
            self.texts.append("distant" + ("" if casts else " unshadowed"))
            return Light(path, "distant", matrix, strength, strength, casts_shadows=casts)
        where = choose.pick(("outside", "inside") if kind in ("sphere", "spot") or tier.wild else ("outside",))
        if tier.wild:
            where = choose.pick((where, "face"))
        position, target = self.position(where), self.point(0.5)
        radius = 0.0
        if kind == "sphere" or (kind == "spot" and where == "inside" and not tier.wild):
            # Without a radius the radiance of a ray through a light inside a medium is infinite.
            radius = choose.number(0.1, 0.3)
        distance = np.linalg.norm(position) if where == "outside" else 1.0
        power = choose.number(0.5, 3.0) if not tier.wild else self.power(1e-6, 1e6)
        strength = _times(tint, power * distance * distance)
        shaping = None
        if kind == "spot" or (kind in ("disk", "rect") and choose.pick((False, True))):
            shaping = Shaping(
                cone_angle=choose.number(1.0 if tier.wild else 20.0, 110.0),
                cone_softness=choose.number(0.0, 1.0),
                focus=choose.pick((0.0, choose.number(0.0, 12.0))),
                focus_tint=self.color(0.0, 0.5),
            )
        matrix = look_at(position, target)
        if tier.wild and choose.integer(0, 10) == 10:
            matrix = scaling(0.0, 0.0, 0.0) @ matrix
        self.texts.append(f"{kind} {where}" + ("" if casts else " unshadowed"))
        record = "sphere" if kind in ("point", "sphere", "spot") else kind
        sizes = {"radius": radius} if record != "rect" else {"width": 0.2, "height": 0.2}
        return Light(path, record, matrix, strength, strength, shaping=shaping, casts_shadows=casts, **sizes)

    def position(self, where: str) -> tuple[float, float, float]:
        if where == "inside":
            self.occupied = True
            return self.point(0.3)
        if where == "outside":
            return _times(self.direction(), self.choose.number(3.2, 6.0))
        return tuple(self.choose.pick((0.0, 1.0, -1.0)) for _ in range(3))

    # Meshes.

    def occluder(self, number: int, kind: str) -> Mesh:
        choose = self.choose
        path = f"/Mesh{number}"
        # A gentle mesh keeps clear of what stands in the middle.
        nearest, largest = (1.0, 0.4) if self.occupied and not self.tier.wild else (0.0, 0.8)
        centre = np.array(self.direction()) * choose.number(nearest, 1.8)
        extent = [choose.number(0.1, largest) for _ in range(3)]
        if self.tier.wild:
            extent = [choose.pick((e, 0.0, 1.0)) for e in extent]
        surface = Surface(diffuse_color=self.color(0.0, 0.9))
        if kind == "quad":
            extent[1] = 0.0
        placing = scaling(*extent) @ self.turned() @ translation(*centre)
        self.texts.append(f"{kind} mesh")
        # The corners are placed, not the prim: a flat one then has triangles without area and a sound transform.
        points = _CUBE @ placing[:3, :3] + placing[3, :3]
        faces = _CUBE_FACES if kind == "box" else _CUBE_FACES[3:4]
        return Mesh(path, polygons(points, faces), np.eye(4)[None], surface)

    # Cameras.

    def camera(self) -> Camera:
        choose, tier = self.choose, self.tier
        where = choose.pick(("outside", "inside"))
        projection = choose.pick(("perspective", "orthographic"))
        if tier.wild:
            where = choose.pick((where, "face", "far"))
        if where == "inside":
            eye, degrees, width = self.position(where), choose.number(40.0, 80.0), choose.number(0.5, 1.5)
            target = tuple(np.add(eye, self.direction()).tolist())
        else:
            distance = choose.number(4.5, 7.0)
            if where == "far":
                distance = self.power(10.0, 1e5)
            eye = _times(self.direction(), distance) if where != "face" else self.position("face")
            target = self.point(0.4)
            degrees, width = choose.number(20.0, 40.0), choose.number(2.0, 3.5)
            if where == "far":
                degrees = math.degrees(2.0 * math.atan(1.5 / distance))
        self.texts.append(f"{projection} camera {where}")
        if np.linalg.norm(np.subtract(target, eye)) < 1e-3:
            target = tuple(np.add(eye, (0.3, -0.2, -1.0)).tolist())
        aperture = 10.0 * width
        if projection == "perspective":
            aperture = 2.0 * 50.0 * math.tan(math.radians(0.5 * degrees))
        return Camera(
            "/Camera",
            look_at(eye, target),
            projection=projection,
            focal_length=50.0,
            horizontal_aperture=aperture,
            vertical_aperture=aperture * 0.75,
            horizontal_aperture_offset=choose.number(-0.1, 0.1) * aperture,
            vertical_aperture_offset=choose.number(-0.1, 0.1) * aperture,
            clipping_range=(1e-3, 1e6),
        )


def unshadowed(description: SceneDescription) -> SceneDescription:
    """The scene whose lights reach everything undiminished: nothing in the scene itself is brighter."""
    return replace(description, lights={p: replace(x, casts_shadows=False) for p, x in description.lights.items()})


# Records by hand.


def _times(color: Sequence[float], factor: float) -> tuple[float, float, float]:
    return tuple(float(c * factor) for c in color)


def look_at(eye: Sequence[float], target: Sequence[float]) -> np.ndarray:
    """A camera's or light's transform: its −Z towards the target, +Y up or, seen from above, towards +X."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = eye - target
    length = np.linalg.norm(back)
    back = back / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    right = np.cross((0.0, 1.0, 0.0) if abs(back[1]) < 0.99 else (1.0, 0.0, 0.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[0, :3], matrix[1, :3], matrix[2, :3], matrix[3, :3] = right, np.cross(back, right), back, eye
    return matrix


def smooth_noise(dims: tuple[int, int, int], seed: int, modes: int = 2) -> np.ndarray:
    """A smooth random density in [0, 1] that is low at the faces of the block, of at most `modes` half waves."""
    random = np.random.default_rng(seed)
    axes = [np.linspace(0.0, 1.0, n) if n > 1 else np.full(1, 0.5) for n in dims]
    total = np.zeros(dims)
    for _ in range(8):
        waves = [
            np.cos(np.pi * k * a + phase)
            for k, phase, a in zip(
                random.integers(0, modes + 1, 3), random.uniform(0.0, 2.0 * np.pi, 3), axes, strict=True
            )
        ]
        total += random.uniform(0.5, 1.0) * np.einsum("i,j,k->ijk", *waves)
    total = (total - total.min()) / max(float(np.ptp(total)), 1e-9)
    return (0.15 + 0.85 * total) * np.einsum("i,j,k->ijk", *(np.sin(np.pi * (0.1 + 0.8 * a)) for a in axes))


def field(values: np.ndarray, background: float = 0.0) -> Field:
    """A field of the given voxels, cleaned as a file's are; with a voxel of margin they fill the cube from −1 to 1."""
    values = np.asarray(values, np.float32)
    cells = np.array(values.shape[:3], float) + 1.0
    matrix = np.diag([*(2.0 / cells), 1.0])
    matrix[3, :3] = 2.0 / cells - 1.0
    grid, _ = cleaned(Grid.from_dense("density", values, background=background))
    key = hashlib.blake2b(values.tobytes() + str((values.shape, background)).encode()).hexdigest()
    return Field(key, grid, matrix)


# Bit a of a corner's number is its side along axis a; counter-clockwise from outside.
_CUBE = np.array([[((i >> a) & 1) - 0.5 for a in range(3)] for i in range(8)])
_CUBE_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))


def polygons(points: np.ndarray, faces: Sequence[Sequence[int]]) -> Geometry:
    """Flat-shaded convex polygons: every face has vertices of its own. A face without area has the normal +Y."""
    vertices, normals, triangles = [], [], []
    for face in faces:
        corners = np.asarray(points, float)[list(face)]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        length = np.linalg.norm(normal)
        first = len(vertices)
        vertices += list(corners)
        normals += [normal / length if length > 0.0 else np.array([0.0, 1.0, 0.0])] * len(face)
        triangles += [(first, first + i, first + i + 1) for i in range(1, len(face) - 1)]
    held = np.array(vertices, np.float32)
    key = hashlib.blake2b(held.tobytes() + str(tuple(faces)).encode()).hexdigest()
    return Geometry(key, held, np.array(normals, np.float32), np.array(triangles, np.uint32))


def placed(description: SceneDescription, camera: Camera, matrix: np.ndarray) -> tuple[SceneDescription, Camera]:
    """The scene and its camera under a uniform scale and a translation, looking the same.

    Extinctions are divided by the scale, intensities multiplied by its square.
    """
    size = float(matrix[0, 0])
    volumes = {
        p: replace(v, local_to_world=v.local_to_world @ matrix, medium=replace(v.medium, density_scale=1.0 / size))
        for p, v in description.volumes.items()
    }
    lights = {}
    for path, light in description.lights.items():
        strength = light.strength if light.kind in ("distant", "dome") else _times(light.strength, size * size)
        lights[path] = replace(light, light_to_world=light.light_to_world @ matrix, strength=strength)
    meshes = {p: replace(m, local_to_world=m.local_to_world @ matrix) for p, m in description.meshes.items()}
    seen_from = np.array(camera.camera_to_world)
    seen_from[3, :3] = seen_from[3, :3] @ matrix[:3, :3] + matrix[3, :3]
    changes: dict[str, Any] = {}
    if camera.projection == "orthographic":
        changes = {
            name: getattr(camera, name) * size
            for name in (
                "horizontal_aperture",
                "vertical_aperture",
                "horizontal_aperture_offset",
                "vertical_aperture_offset",
            )
        }
    near, far = camera.clipping_range
    camera = replace(camera, camera_to_world=seen_from, clipping_range=(near * size, far * size), **changes)
    return replace(description, volumes=volumes, lights=lights, meshes=meshes), camera

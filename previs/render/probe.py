"""The probe: what the renderer knows of one ray of a light, beside the truth.

The curve of transmittance along a light's ray through a point is what transmittance maps are about: the probe gives the
marched curve, and the ones that maps of 6 and of 14 values, and those of the current settings, reconstruct, with the
ranges they were stored over. All come from one draw each of a row of pixels by the GLSL that
lights media, so that they show what the renderer does and not what it should do. Of each map only the texels around the
ray are filled.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from ..description import Camera, Light, SceneDescription, Volume, transform_points, volume_box
from ..errors import PrevisError
from ..index import RenderIndex
from ..settings import Settings
from .context import check_errors
from .draws import LOOP_BUDGET, fine_steps_across
from .frame import Frame
from .method import BEST_MAP, METHODS, method_of
from .passes import RUNNERS
from .planned import PassKind, Plan, PlannedPass
from .projection import LightMap
from .renderer import Renderer

#: Numbers of values that are always compared, of the `BEST_MAP`: interactive and high quality.
COMPARED = (6, 14)
#: Points of a curve.
SAMPLES = 1024
#: Steps of the marched curve's light rays, per voxel.
FINENESS = 4
#: What is drawn before the ray.
_PASSES: tuple[PassKind, ...] = ("fields", "shadow_map", "transmittance_map")
#: Part of its length by which the ray is followed beyond the media.
_MARGIN = 0.05
#: Texels filled around the ray besides those it looks at: rounding may move it across an edge.
_GUARD = 1


@dataclass(frozen=True, eq=False)
class ProbeCurve:
    """One way to find the transmittance along the ray.

    `transmittance` (N, 3) in [0, 1] at the distances of the probe, through all volumes, without meshes. `k_min` and
    `k_max` are the distances between which the map of the probe's volume holds the curve; both NaN for a march, for
    media in closed form, and where the ray meets nothing that the map would hold. `coefficients` is 0 for a method
    without any; of `slices` there are so many, 0 for other methods.
    """

    method: str
    coefficients: int
    transmittance: np.ndarray
    k_min: float = math.nan
    k_max: float = math.nan
    slices: int = 0

    @property
    def name(self) -> str:
        """The method in a few words."""
        if self.slices:
            return f"{self.slices} {self.method}"
        values = METHODS[self.method].values
        return f"{self.method}, {self.coefficients} {values}" if values else self.method


@dataclass(frozen=True, eq=False)
class TransmittanceProbe:
    """What happens to one light on its way through a point.

    Distances are world lengths along the ray, in the direction in which the light travels: from the light's centre, or
    for a distant light from where the ray first enters the bounds of a volume.

    Attributes:
        light: path of the light.
        point: the picked point, world, (3,).
        volume: path of the volume of voxels that the point is in or nearest to, whose map `k_min` and `k_max` of the
            curves belong to; empty where there is none.
        origin, direction: of the ray, world, (3,) each; ``origin + distance · direction`` is a point of it.
        distance: of the samples, rising, (N,).
        picked: distance of the point.
        march: the curve by a fine march, the truth.
        curves: the curves that maps reconstruct, of 6 and 14 values of the `BEST_MAP`, then of the settings where they
            ask for another map, or for slices.
        visibility: how much of the light gets past the meshes to a sample, in [0, 1], (N,); media are not in it.
        threshold: the transmittance below which the ranges end that the first curve's map of the probe's volume was
            stored over; that of the settings, 0 for automatic, where there is no map.
    """

    light: str
    point: np.ndarray
    volume: str
    origin: np.ndarray
    direction: np.ndarray
    distance: np.ndarray
    picked: float
    march: ProbeCurve
    curves: tuple[ProbeCurve, ...]
    visibility: np.ndarray
    threshold: float

    def at_point(self, values: np.ndarray) -> np.ndarray:
        """A curve's values, or the visibility, at the picked point."""
        columns = np.asarray(values).reshape(len(self.distance), -1)
        found = np.array([np.interp(self.picked, self.distance, c) for c in columns.T])
        return found if np.ndim(values) > 1 else found[0]


def probe(
    renderer: Renderer,
    index: RenderIndex,
    settings: Settings,
    light_path: str,
    point: np.ndarray,
    samples: int = SAMPLES,
) -> TransmittanceProbe:
    """Follow a light's ray through a point.

    Args:
        renderer: whose context, fields and shaders to use; what it has drawn stays current.
        index: the scene.
        settings: the knobs; of `transmittance` and `coefficients` others are probed beside them.
        light_path: a light of the scene, not a dome. That its intensity is 0 does not matter.
        point: world position, (3,).
        samples: points of the curves, at least 2.

    Raises:
        PrevisError: when there is no such light, it is a dome, the point is not finite, or the scene cannot be
            rendered.
    """
    if light_path not in index.lights:
        raise PrevisError(f"{light_path}: no such light")
    light = index.lights[light_path].record
    if light.kind == "dome":
        raise PrevisError(f"{light_path}: a dome lights every point evenly, along no ray")
    point = np.asarray(point, float)
    if not np.isfinite(point).all():
        raise PrevisError(f"{light_path}: no ray goes through {point}")
    direction = _direction(light, point)
    alone = RenderIndex()
    # Its strength does not matter to what gets through, and a light of no strength would be left out.
    scene = replace(index.scene, lights={light_path: replace(light, strength=(1.0, 1.0, 1.0))})
    alone.update(scene)
    first, last, zero = _range(scene, light, point, direction)
    spacing = (last - first) / samples
    ends = (first + 0.5 * spacing, last - 0.5 * spacing)

    # Where one of four texels is taken at random, their blend is the mean.
    if settings.map_filter == "stochastic":
        settings = settings.replace(map_filter="blend")
    compared = [settings.replace(transmittance=BEST_MAP, coefficients=n) for n in COMPARED]
    if method_of(settings).has_maps and settings not in compared:
        compared.append(settings)
    with _beside(renderer) as other:
        ray = _Ray(other, index, alone, point, direction, (first, last), samples)
        march = ray.evaluate(settings.replace(transmittance="march", light_steps=_fine_steps(scene)))
        curves = [ray.evaluate(s) for s in compared]
    return TransmittanceProbe(
        light=light_path,
        point=point,
        volume=ray.volume,
        origin=point + zero * direction,
        direction=direction,
        distance=np.linspace(*ends, samples) - zero,
        picked=-zero,
        march=ProbeCurve("march", 0, march.transmittance),
        curves=tuple(
            ProbeCurve(
                s.transmittance,
                s.coefficients if method_of(s).values else 0,
                c.transmittance,
                c.k_min - zero,
                c.k_max - zero,
                c.slices,
            )
            for s, c in zip(compared, curves, strict=True)
        ),
        visibility=march.visibility,
        threshold=curves[0].threshold or settings.threshold,
    )


@contextlib.contextmanager
def _beside(renderer: Renderer) -> Iterator[Renderer]:
    """A renderer that shares with another, for as long as the block lasts; the bound framebuffer is the same after
    it."""
    with renderer.context as context:
        before = context.detect_framebuffer()
    other = Renderer(share=renderer)
    try:
        yield other
    finally:
        other.release()
        with renderer.context:
            before.use()


def _direction(light: Light, point: np.ndarray) -> np.ndarray:
    """The way the light travels at a point."""
    if light.kind == "distant":
        return light.direction
    offset = point - light.position
    distance = float(np.linalg.norm(offset))
    return offset / distance if distance > 0.0 else light.direction


def _range(
    scene: SceneDescription, light: Light, point: np.ndarray, direction: np.ndarray
) -> tuple[float, float, float]:
    """(first, last) of the part of the ray to sample and the zero of its distances, all counted from the point."""
    spans = [s for v in scene.volumes.values() if (s := _interval(v, point, direction)) is not None]
    at_light = -math.inf if light.kind == "distant" else -float(np.linalg.norm(point - light.position))
    spans = [(max(a, at_light), b) for a, b in spans if b > at_light]
    entry = min((a for a, _ in spans), default=0.0)
    first = min(entry, 0.0)
    last = max(max((b for _, b in spans), default=0.0), 0.0)
    length = last - first
    if length <= 0.0:
        bounds = scene.world_bounds()
        size = float(np.linalg.norm(bounds[1] - bounds[0])) if bounds is not None else 0.0
        length = size if size > 0.0 and math.isfinite(size) else 1.0
    first, last = first - _MARGIN * length, last + _MARGIN * length
    return max(first, at_light), last, entry if math.isinf(at_light) else at_light


def _interval(volume: Volume, point: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
    """Distances from the point at which the ray enters and leaves the box of a volume; None where it misses it."""
    lo, hi, to_world = volume_box(volume)
    if abs(np.linalg.det(to_world[:3, :3])) < 1e-300:
        return None
    inverse = np.linalg.inv(to_world)
    o, d = point @ inverse[:3, :3] + inverse[3, :3], direction @ inverse[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (lo - o) / d, (hi - o) / d
    inside = (o >= lo) & (o <= hi)
    first = np.where(d != 0.0, np.fmin(a, b), np.where(inside, -np.inf, np.inf)).max()
    last = np.where(d != 0.0, np.fmax(a, b), np.where(inside, np.inf, -np.inf)).min()
    return (float(first), float(last)) if first < last else None


def _fine_steps(scene: SceneDescription) -> int:
    """Steps of a light ray across a volume for the true curve, whatever the settings say."""
    grids = [v for v in scene.volumes.values() if v.density is not None]
    wanted = max((FINENESS * fine_steps_across(v) for v in grids), default=1)
    # A march through all volumes is one draw; the plan refuses what does not fit.
    return max(min(wanted, 16384, (LOOP_BUDGET - 2 * len(scene.volumes) - 100) // max(len(grids), 1) - 2), 1)


@dataclass(frozen=True, eq=False)
class _Found:
    transmittance: np.ndarray
    visibility: np.ndarray
    k_min: float
    k_max: float
    #: Of the map of the probe's volume; 0 without one.
    threshold: float
    #: How many there are of the light; 0 for other methods.
    slices: int


class _Ray:
    """One ray of one light, evaluated by any settings; distances count from the picked point."""

    def __init__(
        self,
        renderer: Renderer,
        index: RenderIndex,
        alone: RenderIndex,
        point: np.ndarray,
        direction: np.ndarray,
        ends: tuple[float, float],
        samples: int,
    ) -> None:
        self._renderer, self._index, self._alone = renderer, index, alone
        self._point, self._direction, self._ends, self._samples = point, direction, ends, samples
        self.volume = _nearest_volume(alone.scene, point)

    def evaluate(self, settings: Settings) -> _Found:
        """Draw the ray.

        Raises:
            PrevisError: when the scene cannot be planned or drawn.
        """
        try:
            return self._drawn(self._plan(settings))
        except (RuntimeError, moderngl.Error, MemoryError) as error:
            raise PrevisError(f"probe: {type(error).__name__}: {error}") from error

    def _plan(self, settings: Settings) -> Plan:
        """The plan of the light alone, with the maps of the size that they have among all lights."""
        camera = Camera("", np.eye(4))
        whole = self._renderer.plan(self._index, camera, 1, 1, settings)
        if whole.maps:
            settings = settings.replace(map_size=whole.map_size, slices=whole.map_slices)
        if whole.shadow_tiles:
            settings = settings.replace(shadow_map_size=whole.shadow_size)
        return self._renderer.plan(self._alone, camera, 1, 1, settings)

    def _drawn(self, plan: Plan) -> _Found:
        frame = self._renderer._frame
        with frame.context as context:
            frame.plan = plan
            frame.release_unused()
            if plan.maps:
                frame.light_atlas(plan).update(plan)
            # The shadow map of the light is the same for all curves.
            shadows_stale = bool(plan.shadow_tiles) and frame.shadows.update(plan)
            for p in plan.passes:
                if p.kind in _PASSES and (p.kind != "shadow_map" or shadows_stale):
                    self._run(frame, p)
            target = frame.targets.get("probe", (self._samples, 1), ("f4", "f4"))
            target.use()
            self._draw(frame, plan)
            transmittance, ends = (
                np.frombuffer(target.read(components=4, attachment=i, dtype="f4"), np.float32).reshape(-1, 4)
                for i in range(2)
            )
            frame.rest()
            check_errors(context, "probe")
        # The whole ray looks at one place of the map; ask where the picked point does.
        first, last = self._ends
        row = ends[min(max(int((0.0 - first) / (last - first) * self._samples), 0), self._samples - 1)]
        k_min, k_max = (float(row[0]), float(row[1])) if row[2] > 0.5 else (math.nan, math.nan)
        ended = [m.threshold for m in plan.maps if plan.volumes[m.volume].path == self.volume]
        values, visibility = transmittance[:, :3].astype(float), transmittance[:, 3].astype(float)
        return _Found(values, visibility, k_min, k_max, ended[0] if ended else 0.0, plan.map_slices)

    def _run(self, frame: Frame, planned: PlannedPass) -> None:
        """Run a pass at once; of a transmittance map only the texels around the ray."""
        box = None
        if planned.kind == "transmittance_map":
            box = _texels(planned.payload.fit, planned.payload.extent, self._point)
        frame.pace = _Window(box)
        for _ in RUNNERS[planned.kind](frame, planned):
            pass

    def _draw(self, frame: Frame, plan: Plan) -> None:
        program = frame.fullscreen("probe.frag")
        frame.bind_lighting(program, plan.batches[0])
        paths = [v.path for v in plan.volumes]
        program.set(
            ray_anchor=tuple(self._point - plan.origin),
            ray_direction=tuple(self._direction),
            ray_range=self._ends,
            map_volume=paths.index(self.volume) if plan.maps and self.volume in paths else -1,
        )
        frame.context.enable_only(moderngl.NOTHING)
        frame.draw_fullscreen(program)


def _nearest_volume(scene: SceneDescription, point: np.ndarray) -> str:
    """The path of the volume of voxels whose box a point is in or nearest to; the smaller of two it is in."""
    best, found = (math.inf, math.inf), ""
    for path, volume in scene.volumes.items():
        lo, hi, to_world = volume_box(volume)
        determinant = abs(np.linalg.det(to_world[:3, :3]))
        if volume.density is None or determinant < 1e-300:
            continue
        local = transform_points(point[None], np.linalg.inv(to_world))[0]
        nearest = transform_points(np.clip(local, lo, hi)[None], to_world)[0]
        outside = float(np.linalg.norm(nearest - point)) if ((local < lo) | (local > hi)).any() else 0.0
        rank = (outside, float(np.prod(np.asarray(hi) - lo)) * determinant)
        if rank < best:
            best, found = rank, path
    return found


Box = tuple[int, int, int, int]


def _texels(fit: LightMap, size: tuple[int, int], point: np.ndarray) -> Box | None:
    """The texels that a lookup along the ray through a point may read: (x, y, width, height); None for all."""
    u, v, _, w = np.append(point - fit.centre, 1.0) @ fit.to_map
    if fit.kind == "octahedral":
        direction = np.array([u, v, _])
        length = np.abs(direction).sum()
        if length == 0.0:
            return None
        x, y, z = direction / length
        if z < 0.0:
            x, y = (1.0 - abs(y)) * math.copysign(1.0, x), (1.0 - abs(x)) * math.copysign(1.0, y)
        u, v = 0.5 * x + 0.5, 0.5 * y + 0.5
    elif w <= 0.0:
        return (0, 0, 1, 1)
    else:
        u, v = u / w, v / w
    first = [math.floor(c * n - 0.5) - _GUARD for c, n in zip((u, v), size, strict=True)]
    last = [f + 1 + 2 * _GUARD for f in first]
    if fit.kind == "octahedral" and (min(first) < 0 or max(last) >= min(size)):
        # Beyond an edge of the square lies another edge of it.
        return None
    first = [min(max(f, 0), n - 1) for f, n in zip(first, size, strict=True)]
    last = [min(max(b, 0), n - 1) for b, n in zip(last, size, strict=True)]
    return (first[0], first[1], last[0] - first[0] + 1, last[1] - first[1] + 1)


class _Window:
    """Stands in for `Pace`: every pass is one piece, cut to a box of its target where one is given."""

    done = 1.0

    def __init__(self, box: Box | None) -> None:
        self.scissor = box
        self.seconds = None

    def pieces(self, kind: Hashable, size: tuple[int, int], first: float = 0.0, last: float = 1.0) -> Iterator[_Window]:
        """The one piece."""
        yield self

    def __enter__(self) -> _Window:
        return self

    def __exit__(self, *_: object) -> None:
        return None

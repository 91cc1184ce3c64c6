"""The single-scattering integral over every pixel: cuts rays into smooth pieces and hands them to the quadrature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from previs.reference import checks
from previs.reference.camera import Camera
from previs.reference.lights import Light
from previs.reference.quadrature import Pieces, Warp, integrate
from previs.reference.scene import Scene, Volume
from previs.reference.shadows import volume_shadow_breakpoints
from previs.reference.solids import SolidSet

# Behind this optical depth (in the clearest channel) nothing is left: e⁻⁵⁰ = 2e-22.
_OPAQUE = 50.0
# No piece is longer than this part of the diagonal of all volumes: a shadow that falls into a homogeneous shape from
# elsewhere is then seen by the first round of nodes.
_LONGEST_PIECE = 1.0 / 24.0


@dataclass(frozen=True, eq=False)
class ReferenceImage:
    """A rendered reference. All arrays are float64, row 0 on top.

    - `color` (H, W, 3): radiance over black, `volume` + `transmittance` · surface
    - `volume` (H, W, 3): radiance scattered and emitted by the media towards the camera
    - `transmittance` (H, W, 3): from the camera to the surface, or to the far clip distance where there is none
    - `depth` (H, W): distance of the surface along the camera's axis, stage units, inf where there is none
    - `alpha` (H, W): 1 − mean of `transmittance` over the background, 1 on surfaces
    - `error` (H, W): the quadrature's own estimate of the absolute error of `volume`, the largest channel
    """

    color: np.ndarray
    volume: np.ndarray
    transmittance: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    error: np.ndarray


@dataclass
class _Rays:
    origins: np.ndarray
    directions: np.ndarray
    start: np.ndarray
    end: np.ndarray


def render(scene: Scene, camera: Camera, width: int, height: int, max_error: float = 1e-5) -> ReferenceImage:
    """Render a `width` × `height` image of single scattering at the pixel centres.

    `max_error` (in (0, 0.1], default 1e-5) bounds the relative quadrature error of each pixel, as estimated; the actual
    error is usually far below. The cost grows like pixels × lights × cells along a view ray × cells along a light ray:
    meant for images up to about 128 × 72 and grids up to about 64³.

    Raises ValueError for an empty image or a `max_error` outside its range.
    """
    if width < 1 or height < 1:
        raise ValueError(f"An image of {width} × {height} pixels is empty.")
    checks.number(max_error, "max_error", 1e-15, 0.1)
    solids = SolidSet(scene.solids)
    origins, directions, cosine = camera.rays(width, height)
    near, far = (distance / cosine for distance in camera.clip)
    hit_distance, hit = solids.nearest(origins, directions, near, far)
    rays = _Rays(origins, directions, near, np.minimum(hit_distance, far))

    transmittance = transmittance_along(scene, *_shifted(rays))
    volume, error = _scattered(scene, solids, rays, max_error)
    surface = np.zeros((len(origins), 3))
    on = np.flatnonzero(hit >= 0)
    points = origins[on] + hit_distance[on, None] * directions[on]
    surface[on] = _surface_radiance(scene, solids, points, directions[on], hit[on])

    alpha = np.where(hit >= 0, 1.0, 1.0 - transmittance.mean(axis=1))
    rgb, gray = (height, width, 3), (height, width)
    return ReferenceImage(
        color=(volume + transmittance * surface).reshape(rgb),
        volume=volume.reshape(rgb),
        transmittance=transmittance.reshape(rgb),
        depth=(hit_distance * cosine).reshape(gray),
        alpha=alpha.reshape(gray),
        error=error.max(axis=1).reshape(gray),
    )


def optical_depth(
    scene: Scene, origins: np.ndarray, directions: np.ndarray, distances: np.ndarray | float = np.inf
) -> np.ndarray:
    """∫ σt dt through every volume, from `origins` (N, 3) along `directions` (N, 3) for `distances` (N,) stage units.

    The result (N, 3) is unitless, one column per colour channel, and exact to rounding: lengths inside the shapes,
    cubics inside grid cells. Directions need not be unit vectors, distances (default infinite) are in stage units all
    the same. Solids are ignored. Raises ValueError for shapes that do not fit or a direction of length 0.
    """
    origins, directions = np.atleast_2d(np.asarray(origins, float)), np.atleast_2d(np.asarray(directions, float))
    if origins.shape != directions.shape or origins.shape[1:] != (3,):
        raise ValueError(f"origins {origins.shape} and directions {directions.shape} must both be (N, 3).")
    length = np.linalg.norm(directions, axis=1)
    if np.any(length == 0.0):
        raise ValueError(f"{np.count_nonzero(length == 0.0)} directions are the zero vector.")
    return _optical_depth(scene, origins, directions / length[:, None], np.broadcast_to(distances, len(origins)))


def transmittance_along(
    scene: Scene, origins: np.ndarray, directions: np.ndarray, distances: np.ndarray | float = np.inf
) -> np.ndarray:
    """Transmittance e^(−τ), (N, 3) in [0, 1], of `optical_depth` with the same arguments."""
    return np.exp(-optical_depth(scene, origins, directions, distances))


def light_transmittance(scene: Scene, light: Light, points: np.ndarray, solids: bool = False) -> np.ndarray:
    """Transmittance (N, 3) from `light` to `points` (N, 3) through every volume; with `solids`, 0 in their shadow.

    1 everywhere for a light that casts no shadows.
    """
    points = np.atleast_2d(np.asarray(points, float))
    return _reaching(scene, SolidSet(scene.solids if solids else ()), light, points)


def _optical_depth(scene: Scene, origins: np.ndarray, directions: np.ndarray, distances: np.ndarray) -> np.ndarray:
    total, zero = np.zeros((len(origins), 3)), np.zeros(len(origins))
    for volume in scene.volumes:
        total += volume.density.column(origins, directions, zero, distances)[:, None] * volume.medium.extinction
    return total


def _shifted(rays: _Rays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins on the near clip plane, directions and the lengths from there."""
    return rays.origins + rays.start[:, None] * rays.directions, rays.directions, rays.end - rays.start


def _reaching(scene: Scene, solids: SolidSet, light: Light, points: np.ndarray) -> np.ndarray:
    """Visibility times transmittance from a light to points, (M, 3)."""
    result = np.ones((len(points), 3))
    if not light.casts_shadows:
        return result
    irradiance, travel, distance = light.illuminate(points)
    towards = -travel
    clear = np.any(irradiance > 0.0, axis=1)
    clear[clear] = solids.visible(points[clear], towards[clear], distance[clear])
    result[~clear] = 0.0
    result[clear] = np.exp(-_optical_depth(scene, points[clear], towards[clear], distance[clear]))
    return result


def _surface_radiance(
    scene: Scene, solids: SolidSet, points: np.ndarray, directions: np.ndarray, triangle: np.ndarray
) -> np.ndarray:
    """Radiance (M, 3) that Lambertian surfaces send against the camera rays."""
    albedo, normal = solids.surface_at(points, triangle)
    radiance = solids.emission[triangle].copy()
    radiance += albedo * scene.ambient
    if not np.any(albedo > 0.0):
        return radiance
    normal = normal * -np.sign(np.einsum("ij,ij->i", normal, directions))[:, None]
    for light in scene.lights:
        irradiance, travel, _ = light.illuminate(points)
        cosine = np.maximum(-np.einsum("ij,ij->i", travel, normal), 0.0)
        lit = np.flatnonzero(cosine > 0.0)
        incoming = np.zeros_like(radiance)
        incoming[lit] = irradiance[lit] * cosine[lit, None] * _reaching(scene, solids, light, points[lit])
        radiance += albedo / np.pi * incoming
    return radiance


def _scattered(scene: Scene, solids: SolidSet, rays: _Rays, max_error: float) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (R, 3) that media scatter and emit, and its estimated error (R, 3)."""
    total, error = np.zeros((len(rays.origins), 3)), np.zeros((len(rays.origins), 3))
    volumes = scene.volumes
    if not volumes:
        return total, error
    extinction = np.array([v.medium.extinction for v in volumes])
    faces = [v.density.breakpoints(rays.origins, rays.directions) for v in volumes]

    def column_to(pieces: Pieces, t: np.ndarray) -> np.ndarray:
        return pieces.column + _local_columns(volumes, rays, pieces.ray, pieces.start, t)

    def view(pieces: Pieces, t: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """Points, the density of every volume there, and the transmittance to the camera."""
        points = rays.origins[pieces.ray] + t[:, None] * rays.directions[pieces.ray]
        return points, [v.density.density(points) for v in volumes], np.exp(-column_to(pieces, t) @ extinction)

    def unlit(pieces: Pieces, t: np.ndarray) -> np.ndarray:
        points, densities, transmittance = view(pieces, t)
        source = np.zeros((len(t), 3))
        for volume, density in zip(volumes, densities, strict=True):
            medium = volume.medium
            emitted = medium.absorption * medium.emission * np.ones((len(t), 1))
            for emission_field in medium.emission_fields:
                emitted = emitted * emission_field.factor(points)
            source += density[:, None] * (emitted + medium.scattering * scene.ambient)
        return transmittance * source

    scatters = any(np.any(v.medium.scattering > 0.0) for v in volumes)
    emits = any(np.any(v.medium.absorption * v.medium.emission > 0.0) for v in volumes)
    if emits or (scatters and np.any(scene.ambient > 0.0)):
        fields = [f.grid for v in volumes for f in v.medium.emission_fields]
        cuts = faces + [f.breakpoints(rays.origins, rays.directions) for f in fields]
        part, spread = integrate(_pieces(volumes, rays, cuts), len(total), unlit, column_to, None, max_error)
        total, error = total + part, error + spread

    for light in scene.lights if scatters else ():
        if not np.any(light.irradiance if not hasattr(light, "intensity") else light.intensity):
            continue

        def lit(pieces: Pieces, t: np.ndarray, light: Light = light) -> np.ndarray:
            points, densities, transmittance = view(pieces, t)
            irradiance, travel, _ = light.illuminate(points)
            cos_theta = -np.einsum("ij,ij->i", travel, rays.directions[pieces.ray])
            source = np.zeros((len(t), 3))
            for volume, density in zip(volumes, densities, strict=True):
                medium = volume.medium
                source += (density * medium.phase_value(cos_theta))[:, None] * medium.scattering
            return transmittance * source * irradiance * _reaching(scene, solids, light, points)

        cuts = [
            *faces,
            light.breakpoints(rays.origins, rays.directions),
            solids.shadow_breakpoints(light, rays.origins, rays.directions),
            *(volume_shadow_breakpoints(v.density, light, rays.origins, rays.directions) for v in volumes),
        ]
        peak = light.peak(rays.origins, rays.directions)
        pieces = _pieces(volumes, rays, cuts)
        warp = None
        if peak is not None and len(pieces):
            # A floor under the width: through the light itself the substitution would be singular.
            width = np.maximum(
                peak[1], 1e-7 * np.max(np.abs([pieces.end - peak[0][pieces.ray], pieces.start - peak[0][pieces.ray]]))
            )
            warp = Warp(peak[0], width)
        part, spread = integrate(pieces, len(total), lit, column_to, warp, max_error)
        total, error = total + part, error + spread
    return total, error


def _local_columns(
    volumes: Sequence[Volume], rays: _Rays, ray: np.ndarray, t0: np.ndarray, t1: np.ndarray
) -> np.ndarray:
    """Column density of every volume over segments that cross no cell face, (I, V)."""
    origins, directions = rays.origins[ray], rays.directions[ray]
    return np.stack([v.density.local_column(origins, directions, t0, t1) for v in volumes], axis=-1)


def _pieces(volumes: Sequence[Volume], rays: _Rays, cuts: Sequence[np.ndarray]) -> Pieces:
    """Cut rays at all `cuts`, (R, K) each with NaN for none, into pieces on which the integrand is smooth and resolved.

    Pieces without any medium, and those behind an opaque one, are left out.
    """
    spans = [v.density.span(rays.origins, rays.directions) for v in volumes]
    first = np.clip(np.minimum.reduce([s[0] for s in spans]), rays.start, rays.end)
    last = np.clip(np.maximum.reduce([s[1] for s in spans]), rays.start, rays.end)
    missed = ~(first < last)
    first, last = np.where(missed, 0.0, first), np.where(missed, 0.0, last)
    t = np.concatenate([*cuts, first[:, None], last[:, None]], axis=1)
    t = np.sort(np.fmin(np.fmax(t, first[:, None]), last[:, None]), axis=1)
    ray, k = np.nonzero(np.diff(t, axis=1) > 1e-14 * np.abs(t[:, 1:]))
    start, end = t[ray, k], t[ray, k + 1]

    corners = np.concatenate([v.density.corners() for v in volumes])
    longest = _LONGEST_PIECE * max(float(np.linalg.norm(np.ptp(corners, axis=0))), 1e-300)
    parts = np.maximum(np.ceil((end - start) / longest), 1.0).astype(int)
    ray, start, end = _divide(
        ray, start, end, [np.linspace(0.0, 1.0, n + 1) for n in range(1, parts.max(initial=0) + 1)], parts - 1
    )

    extinction = np.array([v.medium.extinction for v in volumes])
    depth = (_local_columns(volumes, rays, ray, start, end) @ extinction).max(axis=1)
    used = depth > 0.0
    ray, start, end, depth = ray[used], start[used], end[used], depth[used]
    # In an optically thick piece all light is near an end: grade it geometrically towards both, so that every decay
    # length, of the eye's ray and of the light's, is met by nodes of its own scale.
    levels = np.ceil(np.log2(np.maximum(depth, 0.5) / 0.5)).astype(int)
    graded = []
    for n in range(levels.max(initial=0) + 1):
        steps = 0.5 ** np.arange(n, 0, -1.0)
        graded.append(np.unique(np.concatenate([[0.0], steps, 1.0 - steps, [1.0]])))
    ray, start, end = _divide(ray, start, end, graded, levels)

    columns = _local_columns(volumes, rays, ray, start, end)
    before = _exclusive_sum(ray, columns)
    visible = ((before @ extinction).min(axis=1, initial=np.inf) < _OPAQUE) & np.any(columns > 0.0, axis=1)
    return Pieces(ray[visible], start[visible], end[visible], before[visible])


def _divide(
    ray: np.ndarray, start: np.ndarray, end: np.ndarray, fractions: list[np.ndarray], kind: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divide each piece at ``fractions[kind]`` of its length, in order along the rays."""
    counts = np.array([len(f) - 1 for f in fractions] or [0])[kind] if len(kind) else np.zeros(0, int)
    owner = np.repeat(np.arange(len(ray)), counts)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    offset = np.cumsum([0] + [len(f) for f in fractions])[:-1]
    table = np.concatenate([*fractions, np.zeros(1)])
    at = offset[kind[owner]] + within if len(owner) else np.zeros(0, int)
    length = (end - start)[owner]
    low, high = start[owner] + length * table[at], start[owner] + length * table[np.minimum(at + 1, len(table) - 1)]
    high = np.where(table[np.minimum(at + 1, len(table) - 1)] == 1.0, end[owner], high)
    return ray[owner], low, high


def _exclusive_sum(ray: np.ndarray, values: np.ndarray) -> np.ndarray:
    """For each row the sum of the earlier rows (I, V) of the same ray; rows are ordered by ray."""
    if len(ray) == 0:
        return values.copy()
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    position = np.arange(len(ray)) - np.repeat(first, np.diff(np.append(first, len(ray))))
    # One row per ray: a running sum over all rays would carry the rounding of dense ones into thin ones.
    row = np.cumsum(position == 0) - 1
    table = np.zeros((len(first), position.max() + 2, values.shape[1]))
    table[row, position + 1] = values
    return np.cumsum(table, axis=1)[row, position]

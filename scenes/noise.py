"""Noise and shapes for the example scenes: gradient noise, fractals, curl, clusters of spheres. NumPy only, seeded."""

from __future__ import annotations

import numpy as np


def smoothstep(a: float, b: float, x: np.ndarray) -> np.ndarray:
    """The cubic that is 0 at `a` and below, 1 at `b` and above; `a` may exceed `b`."""
    t = np.clip((x - a) / (b - a), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def lattice(lo, hi, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates X, Y, Z (each [x, y, z], float32) of points `spacing` apart that cover the box from `lo` to `hi`."""
    counts = [round((b - a) / spacing) + 1 for a, b in zip(lo, hi, strict=True)]
    axes = [np.arange(n, dtype=np.float32) * spacing + a for n, a in zip(counts, lo, strict=True)]
    return tuple(a.astype(np.float32) for a in np.meshgrid(*axes, indexing="ij"))


def gradient_noise(x: np.ndarray, y: np.ndarray, z: np.ndarray, seed: int) -> np.ndarray:
    """Perlin's gradient noise of unit wavelength, about −1…1, with period 64 on every axis."""
    rng = np.random.default_rng(seed)
    gradients = rng.normal(size=(64, 64, 64, 3)).astype(np.float32)
    gradients /= np.linalg.norm(gradients, axis=-1, keepdims=True)
    gradients = gradients.reshape(-1, 3)
    shape = x.shape
    out = np.empty(x.size, np.float32)
    x, y, z = (np.ravel(c).astype(np.float32) for c in np.broadcast_arrays(x, y, z))
    for start in range(0, x.size, 1 << 17):  # in pieces that fit the cache
        part = slice(start, start + (1 << 17))
        cells, fractions, fades = [], [], []
        for c in (x[part], y[part], z[part]):
            cell = np.floor(c)
            f = c - cell
            cells.append(cell.astype(np.int32))
            fractions.append(f)
            fades.append(f * f * f * (f * (f * 6.0 - 15.0) + 10.0))
        total = 0.0
        for corner in range(8):
            d = [(corner >> a) & 1 for a in range(3)]
            i, j, k = ((cells[a] + d[a]) & 63 for a in range(3))
            g = gradients[(i * 64 + j) * 64 + k]
            w = 1.0
            for a in range(3):
                w = w * (fades[a] if d[a] else 1.0 - fades[a])
            total = total + w * sum(g[:, a] * (fractions[a] - d[a]) for a in range(3))
        out[part] = 1.5 * total
    return out.reshape(shape)


def fbm(x, y, z, seed: int, octaves: int = 4, gain: float = 0.5, billow: bool = False) -> np.ndarray:
    """Fractal sum of gradient noise, about −1…1; `billow` sums |noise| instead: round tops, sharp valleys, 0…1."""
    total, amplitude, weight, frequency = 0.0, 1.0, 0.0, 1.0
    for octave in range(octaves):
        shift = 11.3 * octave  # so that the zeros of the octaves do not coincide at the origin
        n = gradient_noise(x * frequency + shift, y * frequency + shift, z * frequency - shift, seed + octave)
        total = total + amplitude * (np.abs(n) if billow else n)
        weight += amplitude
        amplitude *= gain
        frequency *= 2.03
    return total / weight


def warp(x, y, z, seed: int, frequency: float, amount: float, octaves: int = 3) -> tuple[np.ndarray, ...]:
    """Coordinates displaced by a fractal vector field: what breaks up the regularity of any noise or shape."""
    args = (x * frequency, y * frequency, z * frequency)
    return tuple(c + amount * fbm(*args, seed + 100 * a, octaves) for a, c in enumerate((x, y, z)))


def sphere_cluster(
    seeds: list[tuple[float, float, float, float]],
    levels: list[tuple[float, float]],
    seed: int,
    keep=None,
) -> list[np.ndarray]:
    """Spheres on spheres, the way a cauliflower or a cumulus tower is built.

    `seeds` are the first spheres (x, y, z, radius). Each level (ratio, spacing) covers every sphere of the level before
    with spheres `ratio` times as big, centred near its surface, `spacing` of their radii apart. Those that lie deep
    inside another sphere of the level before are left out: they would not show. `keep(points)` may refuse centres.
    Returns one (N, 4) array per level, the first included.
    """
    rng = np.random.default_rng(seed)
    result = [np.array(seeds, float)]
    for ratio, spacing in levels:
        parents = result[-1]
        children = []
        for x, y, z, r in parents:
            count = max(4, int(4.0 / (ratio * spacing) ** 2))
            # A Fibonacci spiral spreads the directions evenly; a random turn and jitter hide the spiral.
            i = np.arange(count) + 0.5
            polar, azimuth = 1.0 - 2.0 * i / count, np.pi * (1.0 + 5.0**0.5) * i + rng.uniform(0, 7)
            ring = np.sqrt(1.0 - polar**2)
            d = np.stack([ring * np.cos(azimuth), polar, ring * np.sin(azimuth)], 1)
            d = d @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + rng.normal(size=(count, 3)) * ratio * 0.35
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            size = r * ratio * np.exp(rng.normal(size=count) * 0.28)
            centres = np.array([x, y, z]) + d * (r - 0.25 * size)[:, None]
            children.append(np.column_stack([centres, size]))
        children = np.concatenate(children)
        distance = np.linalg.norm(children[:, None, :3] - parents[None, :, :3], axis=2) - parents[None, :, 3]
        visible = (distance > -0.8 * children[:, 3:4]).all(axis=1)
        if keep is not None:
            visible &= keep(children[:, :3])
        result.append(children[visible])
    return result


def spheres_distance(x, y, z, spheres: np.ndarray, lo, spacing: float, reach: float) -> np.ndarray:
    """Signed distance to a union of spheres, negative inside, at most `reach`.

    The points x, y, z may be warped; `lo` and `spacing` say where the unwarped lattice sits. Every sphere is drawn into
    its own box of the lattice only, widened by `reach`, which must cover the warp too.
    """
    out = np.full(x.shape, reach, np.float32)
    lo = np.asarray(lo, float)
    for cx, cy, cz, r in spheres:
        c = np.array([cx, cy, cz])
        first = np.maximum(np.floor((c - r - reach - lo) / spacing).astype(int), 0)
        last = np.ceil((c + r + reach - lo) / spacing).astype(int) + 1
        if (last <= 0).any() or (first >= x.shape).any():
            continue
        box = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        d = np.sqrt((x[box] - cx) ** 2 + (y[box] - cy) ** 2 + (z[box] - cz) ** 2) - r
        np.minimum(out[box], d, out=out[box])
    return out


def binomial(a: np.ndarray, passes: int = 1) -> np.ndarray:
    """[1 2 1]/4 along every axis, `passes` times: removes what a trilinear lookup would show as voxels."""
    for _ in range(passes):
        for axis in range(a.ndim):
            p = np.pad(a, [(1, 1) if i == axis else (0, 0) for i in range(a.ndim)], mode="edge")
            n = a.shape[axis]
            p = np.moveaxis(p, axis, 0)
            a = np.moveaxis(0.25 * p[:n] + 0.5 * p[1 : n + 1] + 0.25 * p[2 : n + 2], 0, axis)
    return a


def edge_fade(shape: tuple[int, int, int], width: int = 6, empty: int = 3) -> np.ndarray:
    """1 inside, falling smoothly to 0 towards the six sides of a grid, whose outer `empty` layers are exactly 0."""
    fades = []
    for n in shape:
        i = np.arange(n)
        fades.append(smoothstep(empty - 1.0, empty + width, np.minimum(i, n - 1 - i).astype(np.float32)))
    return fades[0][:, None, None] * fades[1][None, :, None] * fades[2][None, None, :]

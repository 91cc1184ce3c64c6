"""Where a medium is, and how dense: homogeneous shapes and trilinear grids, and their column densities along rays.

Every kind answers the same questions for world-space rays with unit directions, parametrised by distance:

- ``density(points)``: D at points (M, 3) → (M,), unitless
- ``span(origins, directions)``: where each ray enters and leaves (entry > exit: it misses)
- ``breakpoints(origins, directions)``: every distance (R, K) where D has a kink or a jump along the ray (NaN: none)
- ``column(origins, directions, t0, t1)``: ∫ D dt over [t0, t1] (M,), exact to rounding; t1 may be infinite
- ``local_column``: the same, for segments that cross no breakpoint
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from previs.reference import checks

# Two-point Gauss–Legendre on [0, 1]: exact for cubics, and a trilinear field is a cubic along a ray inside a cell.
_GAUSS2 = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
# Segments × cell faces handled at once: the temporary arrays stay in the processor's cache.
_CHUNK = 100_000


def _slabs(
    origins: np.ndarray, directions: np.ndarray, lo: np.ndarray, hi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Entry and exit distance of rays through an axis-aligned box; (inf, −inf) for a ray that misses."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (lo - origins) / directions, (hi - origins) / directions
    still = directions == 0.0
    outside = still & ((origins < lo) | (origins > hi))
    near = np.where(still, -np.inf, np.minimum(a, b)).max(axis=-1)
    far = np.where(still, np.inf, np.maximum(a, b)).min(axis=-1)
    miss = (near >= far) | outside.any(axis=-1)
    return np.where(miss, np.inf, near), np.where(miss, -np.inf, far)


def _ball(origins: np.ndarray, directions: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Entry and exit distance of rays through |x| ≤ radius, in any dimension; (inf, −inf) for a ray that misses."""
    a = np.einsum("ij,ij->i", directions, directions)
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = -np.einsum("ij,ij->i", origins, directions) / a
        # From the nearest point: b² − ac would lose its digits for a ray that starts far away.
        nearest = origins + middle[:, None] * directions
        half = np.sqrt((radius * radius - np.einsum("ij,ij->i", nearest, nearest)) / a)
    inside = np.einsum("ij,ij->i", origins, origins) < radius * radius
    still = a == 0.0
    miss = np.where(still, ~inside, ~(half > 0.0))
    near, far = np.where(still, -np.inf, middle - half), np.where(still, np.inf, middle + half)
    return np.where(miss, np.inf, near), np.where(miss, -np.inf, far)


class _Homogeneous:
    """Density 1 inside a convex shape given in local space, 0 outside."""

    to_world: np.ndarray | None

    def __post_init__(self) -> None:
        matrix = checks.affine(self.to_world, "to_world")
        object.__setattr__(self, "to_world", matrix)
        object.__setattr__(self, "_to_local", np.linalg.inv(matrix))

    def _span_local(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def _bounds_local(self) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def _inside_local(self, points: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def span(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Entry and exit distance of each ray (R,), (inf, −inf) for a miss."""
        # Local directions keep their length: the ray's parameter is then still the world distance.
        inverse = self._to_local
        return self._span_local(origins @ inverse[:3, :3] + inverse[3, :3], directions @ inverse[:3, :3])

    def breakpoints(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Entry and exit, (R, 2), NaN for a miss."""
        ends = np.stack(self.span(origins, directions), axis=-1)
        return np.where(ends[:, :1] < ends[:, 1:], ends, np.nan)

    def density(self, points: np.ndarray) -> np.ndarray:
        """1 inside, 0 outside (M,)."""
        inverse = self._to_local
        return self._inside_local(points @ inverse[:3, :3] + inverse[3, :3]).astype(float)

    def column(self, origins: np.ndarray, directions: np.ndarray, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """Length inside the shape, between the distances t0 and t1 (M,)."""
        entry, exit_ = self.span(origins, directions)
        return np.maximum(np.minimum(t1, exit_) - np.maximum(t0, entry), 0.0)

    local_column = column

    def corners(self) -> np.ndarray:
        """Corners (8, 3) of a world-space parallelepiped around the shape."""
        return _corners(*self._bounds_local(), self.to_world)


@dataclass(frozen=True, eq=False)
class HomogeneousBox(_Homogeneous):
    """Density 1 between the corners `lo` and `hi` of an axis-aligned box in local space.

    `to_world` is any invertible affine 4×4 matrix for row vectors (default identity). A box of zero thickness is
    legal and empty. Raises ValueError for a corner that is not finite, lo > hi, or a singular matrix.
    """

    lo: Sequence[float]
    hi: Sequence[float]
    to_world: np.ndarray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        lo, hi = checks.vector(self.lo, "lo"), checks.vector(self.hi, "hi")
        if np.any(lo > hi):
            raise ValueError(f"The box is inside out: lo {lo.tolist()} is above hi {hi.tolist()}.")
        object.__setattr__(self, "lo", lo)
        object.__setattr__(self, "hi", hi)

    def _bounds_local(self) -> tuple[np.ndarray, np.ndarray]:
        return self.lo, self.hi

    def _span_local(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _slabs(origins, directions, self.lo, self.hi)

    def _inside_local(self, points: np.ndarray) -> np.ndarray:
        return np.all((points > self.lo) & (points < self.hi), axis=-1)


@dataclass(frozen=True, eq=False)
class HomogeneousSphere(_Homogeneous):
    """Density 1 inside a sphere around the local origin; `radius` ≥ 0 in local units, `to_world` as for the box."""

    radius: float = 1.0
    to_world: np.ndarray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.number(self.radius, "radius", 0.0)

    def _bounds_local(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full(3, -self.radius), np.full(3, self.radius)

    def _span_local(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _ball(origins, directions, self.radius)

    def _inside_local(self, points: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ij->i", points, points) < self.radius**2


@dataclass(frozen=True, eq=False)
class HomogeneousCapsule(_Homogeneous):
    """Density 1 within `radius` of a segment of length `height` along a local `axis`, centred on the origin.

    `radius` and `height` ≥ 0 in local units, `axis` is "X", "Y" or "Z" (default "Z"), `to_world` as for the box.
    """

    radius: float = 0.5
    height: float = 1.0
    axis: Literal["X", "Y", "Z"] = "Z"
    to_world: np.ndarray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.number(self.radius, "radius", 0.0)
        checks.number(self.height, "height", 0.0)
        if self.axis not in ("X", "Y", "Z"):
            raise ValueError(f"The axis of a capsule is X, Y or Z, not {self.axis!r}.")

    def _bounds_local(self) -> tuple[np.ndarray, np.ndarray]:
        half = np.full(3, float(self.radius))
        half["XYZ".index(self.axis)] += 0.5 * self.height
        return -half, half

    def _span_local(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along = "XYZ".index(self.axis)
        across = [i for i in range(3) if i != along]
        half = 0.5 * self.height
        near, far = _slabs(origins[:, [along]], directions[:, [along]], np.array([-half]), np.array([half]))
        wall = _ball(origins[:, across], directions[:, across], self.radius)
        near, far = np.maximum(near, wall[0]), np.minimum(far, wall[1])
        spans = [(np.where(near < far, near, np.inf), np.where(near < far, far, -np.inf))]
        for end in (-half, half):
            centre = np.zeros(3)
            centre[along] = end
            spans.append(_ball(origins - centre, directions, self.radius))
        # A capsule is convex: the union of the three intervals has no gap.
        return np.minimum.reduce([s[0] for s in spans]), np.maximum.reduce([s[1] for s in spans])

    def _inside_local(self, points: np.ndarray) -> np.ndarray:
        offset = points.copy()
        along, half = "XYZ".index(self.axis), 0.5 * self.height
        offset[:, along] -= np.clip(offset[:, along], -half, half)
        return np.einsum("ij,ij->i", offset, offset) < self.radius**2


@dataclass(frozen=True, eq=False)
class GridMedium:
    """A field sampled on a grid: `values` (Nx, Ny, Nz) sit at integer index coordinates 0..N−1.

    It is trilinear between them, falls to `background` (default 0) over one voxel outside the array, and is 0 outside
    index −1..N. `index_to_world` is any invertible affine 4×4 matrix for row vectors (default identity).

    Raises ValueError for an array that is not three-dimensional, for a negative or non-finite value (the message says
    how many) and for a singular matrix.
    """

    values: np.ndarray
    index_to_world: np.ndarray | None = None
    background: float = 0.0

    def __post_init__(self) -> None:
        values = np.asarray(self.values, float)
        if values.ndim != 3 or values.size == 0:
            raise ValueError(f"A grid needs a three-dimensional array, not one of shape {values.shape}.")
        bad = np.count_nonzero(~(np.isfinite(values) & (values >= 0.0)))
        if bad:
            raise ValueError(f"{bad} of {values.size} grid values are negative or not finite.")
        checks.number(self.background, "background", 0.0, np.finfo(float).max)
        matrix = checks.affine(self.index_to_world, "index_to_world")
        padded = np.pad(values, 1, constant_values=float(self.background))
        occupied = np.zeros(np.array(padded.shape) - 1, bool)
        for i in range(8):
            window = tuple(slice((i >> a) & 1, n - 1 + ((i >> a) & 1)) for a, n in enumerate(padded.shape))
            occupied |= padded[window] > 0.0
        # The padded array is indexed from 0: shift by the one voxel of padding.
        to_padded = np.linalg.inv(matrix)
        to_padded[3, :3] += 1.0
        for name, value in (
            ("values", values),
            ("index_to_world", matrix),
            ("_padded", padded),
            ("_occupied", occupied),
            ("_polynomials", _cell_polynomials(padded)),
            ("_to_padded", to_padded),
        ):
            object.__setattr__(self, name, value)

    def _to_index(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inverse = self._to_padded
        return origins @ inverse[:3, :3] + inverse[3, :3], directions @ inverse[:3, :3]

    def _cells(self, points: np.ndarray) -> np.ndarray:
        """Flat index of the lower corner of the cell of each padded index-space point, clamped to the array."""
        nx, ny, nz = self._padded.shape
        cell = np.clip(points.astype(np.int64), 0, (nx - 2, ny - 2, nz - 2))
        return cell

    def _trilinear(self, points: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """The field at padded index-space points (M, 3) inside the given cells."""
        _, ny, nz = self._padded.shape
        flat = self._padded.ravel()
        x, y, z = (points - cell).T
        base = (cell[:, 0] * ny + cell[:, 1]) * nz + cell[:, 2]
        row, plane = nz, ny * nz
        c00 = flat[base] * (1.0 - z) + flat[base + 1] * z
        c01 = flat[base + row] * (1.0 - z) + flat[base + row + 1] * z
        c10 = flat[base + plane] * (1.0 - z) + flat[base + plane + 1] * z
        c11 = flat[base + plane + row] * (1.0 - z) + flat[base + plane + row + 1] * z
        return (c00 * (1.0 - y) + c01 * y) * (1.0 - x) + (c10 * (1.0 - y) + c11 * y) * x

    def sample(self, points: np.ndarray, outside: float) -> np.ndarray:
        """The field at world points (M, 3) → (M,); `outside` where the field has no value."""
        p = points @ self._to_padded[:3, :3] + self._to_padded[3, :3]
        inside = np.all((p >= 0.0) & (p <= np.array(self._padded.shape) - 1.0), axis=-1)
        result = np.full(len(points), float(outside))
        p = p[inside]
        result[inside] = self._trilinear(p, self._cells(p))
        return result

    def density(self, points: np.ndarray) -> np.ndarray:
        """The field at world points (M, 3) → (M,), 0 outside."""
        return self.sample(points, 0.0)

    def span(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Entry and exit distance of each ray (R,), (inf, −inf) for a miss."""
        o, d = self._to_index(origins, directions)
        return _slabs(o, d, np.zeros(3), np.array(self._padded.shape) - 1.0)

    def breakpoints(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Crossings of the cell faces, (R, Nx+Ny+Nz+6), NaN outside the grid."""
        o, d = self._to_index(origins, directions)
        entry, exit_ = _slabs(o, d, np.zeros(3), np.array(self._padded.shape) - 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.concatenate(
                [(np.arange(n) - o[:, [a]]) / d[:, [a]] for a, n in enumerate(self._padded.shape)], axis=1
            )
        return np.where((t >= entry[:, None]) & (t <= exit_[:, None]), t, np.nan)

    def local_column(self, origins: np.ndarray, directions: np.ndarray, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """∫ D dt over [t0, t1] for segments that stay inside one cell, or outside the grid (M,)."""
        total = np.zeros(len(origins))
        for node in _GAUSS2:
            total += self.density(origins + directions * (t0 + (t1 - t0) * node)[:, None])
        return 0.5 * (t1 - t0) * total

    def column(self, origins: np.ndarray, directions: np.ndarray, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """∫ D dt over [t0, t1] (M,), exact cell by cell; t1 may be infinite."""
        o, d = self._to_index(origins, directions)
        entry, exit_ = _slabs(o, d, np.zeros(3), np.array(self._padded.shape) - 1.0)
        entry, exit_ = np.maximum(entry, t0), np.minimum(exit_, t1)
        total = np.zeros(len(o))
        hit = np.flatnonzero(entry < exit_)
        step = max(_CHUNK // (sum(self._padded.shape) + 2), 1)
        for i in range(0, len(hit), step):
            rows = hit[i : i + step]
            total[rows] = self._column_inside(o[rows], d[rows], entry[rows], exit_[rows])
        return total

    def _column_inside(self, o: np.ndarray, d: np.ndarray, entry: np.ndarray, exit_: np.ndarray) -> np.ndarray:
        faces = [entry[:, None], exit_[:, None]]
        with np.errstate(divide="ignore", invalid="ignore"):
            for a, n in enumerate(self._padded.shape):
                # fmax and fmin let NaN (a ray inside a face plane) fall on the entry, where it cuts nothing.
                t = (np.arange(n) - o[:, [a]]) / d[:, [a]]
                faces.append(np.fmin(np.fmax(t, entry[:, None]), exit_[:, None]))
        t = np.sort(np.concatenate(faces, axis=1), axis=1)
        length = np.diff(t, axis=1)
        ray, k = np.nonzero(length > 0.0)
        middle, length = 0.5 * (t[ray, k] + t[ray, k + 1]), length[ray, k]
        flat, centre = 0, []
        for a, n in enumerate(self._padded.shape):
            x = o[ray, a] + middle * d[ray, a]
            low = np.clip(x.astype(np.int64), 0, n - 2)
            flat = flat * (n - 1) + low
            centre.append(x - low)
        keep = self._occupied.ravel()[flat]
        ray, length, flat = ray[keep], length[keep], flat[keep]
        x, y, z = (c[keep] for c in centre)
        dx, dy, dz = (length * d[ray, a] for a in range(3))
        # The mean of a trilinear polynomial over a segment, from its middle and its extent: E[xy] = x̄ȳ + ΔxΔy/12, and
        # so on; third central moments of a uniform distribution vanish.
        c = self._polynomials[flat]
        xy, xz, yz = x * y + dx * dy / 12.0, x * z + dx * dz / 12.0, y * z + dy * dz / 12.0
        xyz = x * y * z + (x * dy * dz + y * dx * dz + z * dx * dy) / 12.0
        mean = c[:, 0] + c[:, 1] * x + c[:, 2] * y + c[:, 3] * z
        mean += c[:, 4] * xy + c[:, 5] * xz + c[:, 6] * yz + c[:, 7] * xyz
        return np.bincount(ray, length * mean, len(entry))

    def corners(self) -> np.ndarray:
        """Corners (8, 3) of the grid's domain, index −1..N, in world space."""
        return _corners(np.full(3, -1.0), np.array(self.values.shape, float), self.index_to_world)


def _cell_polynomials(values: np.ndarray) -> np.ndarray:
    """For every cell the coefficients of 1, x, y, z, xy, xz, yz, xyz, with x, y, z in [0, 1]: (cells, 8)."""
    table = values[..., None]
    # One axis after the other: (a, b) at its two ends becomes a + (b − a)·x.
    for axis in range(3):
        low = np.take(table, range(table.shape[axis] - 1), axis)
        table = np.concatenate([low, np.diff(table, axis=axis)], axis=-1)
    # The order is now 1, x, y, xy, z, xz, yz, xyz.
    return np.ascontiguousarray(table.reshape(-1, 8)[:, [0, 1, 2, 4, 3, 5, 6, 7]])


def _corners(lo: np.ndarray, hi: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    points = np.array([[(lo, hi)[(i >> a) & 1][a] for a in range(3)] for i in range(8)], float)
    return points @ to_world[:3, :3] + to_world[3, :3]


Density = HomogeneousBox | HomogeneousSphere | HomogeneousCapsule | GridMedium

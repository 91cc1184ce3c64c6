"""A small smoke solver for the example scenes: incompressible flow with buoyancy on a uniform grid, NumPy only.

Velocities and scalars sit at the voxels' centres. The pressure projection is exact, by FFT, so the box is periodic; the
scenes keep the smoke away from its sides. Advection is MacCormack's (Selle et al. 2008, "An unconditionally stable
MacCormack method"), which keeps fronts sharp, and vorticity confinement (Fedkiw et al. 2001, "Visual simulation of
smoke") returns the small whirls that the grid loses. Unit of length: a voxel; of time: a step.
"""

from __future__ import annotations

import numpy as np


class SmokeSolver:
    """State (velocity, heat, densities) of the flow in a box of voxels [x, y, z]; y is up."""

    def __init__(self, shape: tuple[int, int, int], densities: int = 1):
        self.shape = shape
        #: (x, y, z, 3 + 1 + densities): velocity, heat, densities, side by side so that one lookup fetches all.
        self.state = np.zeros((*shape, 4 + densities), np.float32)
        self.buoyancy = 0.1
        self.confinement = 0.2
        self.cooling = 0.99
        self.wind = np.zeros(3, np.float32)
        k = [np.fft.fftfreq(n) for n in shape[:2]] + [np.fft.rfftfreq(shape[2])]
        self._k = [a.astype(np.float32).reshape([-1 if i == j else 1 for j in range(3)]) for i, a in enumerate(k)]
        k2 = sum(a * a for a in self._k)
        k2[0, 0, 0] = 1.0
        self._inverse_k2 = 1.0 / k2
        # Takes only the last quarter of the spectrum away: the product terms of the advection would alias there.
        self._filter = np.exp(-0.25 * (np.sqrt(k2) / 0.45) ** 8).astype(np.float32)
        y = np.arange(shape[1], dtype=np.float32)
        # A layer that slows the flow at the floor and at the ceiling, so that it does not enter again from below.
        self._damping = (np.clip(y / 4.0, 0, 1) * np.clip((shape[1] - 1 - y) / 12.0, 0, 1))[None, :, None, None]

    @property
    def velocity(self) -> np.ndarray:
        return self.state[..., :3]

    @property
    def heat(self) -> np.ndarray:
        return self.state[..., 3]

    def density(self, i: int = 0) -> np.ndarray:
        return self.state[..., 4 + i]

    def step(self) -> None:
        """One step: forces, projection, advection."""
        self._forces()
        self._project()
        self._advect()
        self.heat[...] *= self.cooling

    def _forces(self) -> None:
        v = self.velocity
        v[..., 1] += self.buoyancy * self.heat
        d = [[0.5 * (np.roll(v[..., i], -1, j) - np.roll(v[..., i], 1, j)) for j in range(3)] for i in range(3)]
        w = [d[2][1] - d[1][2], d[0][2] - d[2][0], d[1][0] - d[0][1]]
        size = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
        n = [0.5 * (np.roll(size, -1, j) - np.roll(size, 1, j)) for j in range(3)]
        length = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2) + 1e-5
        # Only where there is smoke: elsewhere it would feed on rounding errors.
        strength = self.confinement * np.clip(4.0 * self.state[..., 3:].max(axis=-1), 0.0, 1.0) / length
        v[..., 0] += strength * (n[1] * w[2] - n[2] * w[1])
        v[..., 1] += strength * (n[2] * w[0] - n[0] * w[2])
        v[..., 2] += strength * (n[0] * w[1] - n[1] * w[0])
        v *= self._damping

    def _project(self) -> None:
        f = [np.fft.rfftn(self.state[..., a]) for a in range(3)]
        pressure = sum(k * c for k, c in zip(self._k, f, strict=True)) * self._inverse_k2
        for a in range(3):
            solenoidal = (f[a] - self._k[a] * pressure) * self._filter
            self.state[..., a] = np.fft.irfftn(solenoidal, s=self.shape, axes=(0, 1, 2))

    def _advect(self) -> None:
        # Nothing happens far above the smoke: only the slab that it has reached is moved.
        reached = np.flatnonzero((self.state[..., 3:].max(axis=-1) > 1e-3).any(axis=(0, 2)))
        top = min(self.shape[1], (int(reached[-1]) if len(reached) else 0) + 16)
        slab = self.state[:, :top]
        displacement = self.velocity[:, :top] + self.wind
        ahead, low, high = self._lookup(slab, -displacement, limits=True)
        back, _, _ = self._lookup(ahead, displacement, limits=False)
        ahead += 0.5 * (slab - back)
        self.state[:, :top] = np.clip(ahead, low, high)

    def _lookup(self, values: np.ndarray, displacement: np.ndarray, limits: bool):
        """Trilinear `values` at every voxel + displacement; with `limits`, also the range of the 8 voxels around."""
        nx, ny, nz, channels = values.shape
        flat = values.reshape(-1, channels)
        out = np.empty_like(values)
        low, high = (np.empty_like(values), np.empty_like(values)) if limits else (None, None)
        y, z = (a.astype(np.float32) for a in np.meshgrid(np.arange(ny), np.arange(nz), indexing="ij"))
        for x in range(nx):  # one slice at a time, so that the temporaries stay in the cache
            p = [x + displacement[x, ..., 0], y + displacement[x, ..., 1], z + displacement[x, ..., 2]]
            p[1] = np.clip(p[1], 0.0, ny - 1.001)
            cell = [np.floor(a) for a in p]
            f = [(a - c)[..., None] for a, c in zip(p, cell, strict=True)]
            i, j, k = (c.astype(np.int64) for c in cell)
            rows = [(i % nx) * ny, ((i + 1) % nx) * ny]
            columns = [k % nz, (k + 1) % nz]
            total = lowest = highest = None
            for corner in range(8):
                a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
                v = flat.take((rows[a] + j + b) * nz + columns[c], axis=0)
                w = (f[0] if a else 1 - f[0]) * (f[1] if b else 1 - f[1]) * (f[2] if c else 1 - f[2])
                if total is None:
                    total = v * w
                    lowest, highest = v, v.copy()
                    continue
                total += v * w
                if limits:
                    lowest, highest = np.minimum(lowest, v), np.maximum(highest, v)
            out[x] = total
            if limits:
                low[x], high[x] = lowest, highest
        return out, low, high

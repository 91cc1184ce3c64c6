"""Make the .vdb files of the example scenes.

    python scenes/make_scenes.py [--output DIR] [NAME …]

Without names, all of them. The .usda files beside this script are written by hand; this script makes the grids that
they refer to. Every grid comes out the same on every run: all randomness is seeded. NumPy only.

What all grids have in common: densities between 0 and 1, the strength is in the materials; values are rounded and faint
ones are dropped, so that the files stay small; nothing varies faster than about two voxels, so that trilinear lookups
look smooth; the outermost layers are empty, so that nothing ends at the box.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parent.parent)]

# The imports need the path above: this script also runs in a clone where previs is not installed.
from flow import SmokeSolver  # noqa: E402
from noise import (  # noqa: E402
    binomial,
    edge_fade,
    fbm,
    gradient_noise,
    lattice,
    smoothstep,
    sphere_cluster,
    spheres_distance,
    warp,
)

from previs import vdb  # noqa: E402

DIRECTORY = Path(__file__).resolve().parent


def quantised(values: np.ndarray, step: float = 1.0 / 256.0, least: int = 2) -> np.ndarray:
    """`values` rounded to multiples of `step`; below `least` steps, 0."""
    n = np.rint(np.maximum(values, 0.0) / step)
    n[n < least] = 0.0
    return (n * step).astype(np.float32)


def rounded(values: np.ndarray, least: float, bits: int = 6) -> np.ndarray:
    """`values` rounded to `bits` significant bits; below `least`, 0. For fields whose faint end matters."""
    mantissa, exponent = np.frexp(np.maximum(values, 0.0))
    values = np.ldexp(np.rint(mantissa * 2.0**bits) / 2.0**bits, exponent)
    return np.where(values < least, 0.0, values).astype(np.float32)


def grid(name: str, values: np.ndarray, voxel: float, corner) -> vdb.Grid:
    """A grid of cubic voxels whose value [0, 0, 0] sits at `corner`, in stage units."""
    transform = np.diag([voxel, voxel, voxel, 1.0])
    transform[3, :3] = corner
    return vdb.Grid.from_dense(name, values, transform)


def gaussian_blur(values: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian of `sigma` voxels, periodic."""
    k = [np.fft.fftfreq(n) for n in values.shape[:2]] + [np.fft.rfftfreq(values.shape[2])]
    for axis, a in enumerate(k):
        g = np.exp(-2.0 * (np.pi * sigma * a) ** 2).astype(np.float32)
        k[axis] = g.reshape([-1 if i == axis else 1 for i in range(3)])
    return np.fft.irfftn(np.fft.rfftn(values) * k[0] * k[1] * k[2], s=values.shape, axes=(0, 1, 2)).astype(np.float32)


def plume() -> dict[str, list[vdb.Grid]]:
    """A fire's smoke column in a light wind: the buoyant flow itself, 124 steps of it."""
    shape, voxel, radius = (128, 176, 112), 0.05, 7.5
    solver = SmokeSolver(shape)
    solver.buoyancy, solver.confinement, solver.cooling = 0.15, 0.22, 0.988
    solver.wind = np.array([0.14, 0.0, 0.0], np.float32)
    foot = (0.36 * shape[0], 0.0, 0.5 * shape[2])
    height = 18  # the layers that the fire's mouth reaches into
    x, y, z = lattice((0, 0, 0), (shape[0] - 1, height - 1, shape[2] - 1), 1.0)
    x, z = x - foot[0], z - foot[2]
    distance = np.sqrt(x * x + z * z + ((y - 0.55 * radius - 4.0) * 1.3) ** 2)
    for n in range(124):
        # Flames lick: the source's outline and strength change all the time, or the column would be a laminar tube.
        lick = gradient_noise(x / 4.1 + 0.05 * n, y / 4.1 - 0.11 * n, z / 4.1 + 3.0, seed=1)
        source = smoothstep(1.1, 0.6, distance / radius + 0.35 * lick)
        pulse = 1.0 + 0.35 * np.sin(0.37 * n) + 0.2 * np.sin(0.15 * n + 1.0)
        for field, strength in ((solver.heat, pulse), (solver.density(), 0.9)):
            np.maximum(field[:, :height], source * strength, out=field[:, :height])
        solver.step()
    density = binomial(solver.density()) * edge_fade(shape)
    corner = -voxel * np.array([foot[0], 3.0, foot[2]])
    return {"plume.vdb": [grid("density", quantised(density), voxel, corner)]}


def pyroclastic() -> dict[str, list[vdb.Grid]]:
    """A ball of ash: spheres on spheres on spheres, hot inside and in the clefts between them."""
    voxel, lo = 0.018, np.full(3, -1.296)
    x, y, z = lattice(lo, -lo, voxel)
    levels = sphere_cluster([(0.0, 0.0, 0.0, 0.66)], [(0.36, 1.15), (0.42, 1.0), (0.42, 1.1)], seed=7)
    spheres = np.concatenate(levels)
    warped = warp(x, y, z, seed=20, frequency=3.0, amount=0.05)
    distance = spheres_distance(*warped, spheres, lo, voxel, reach=0.12)
    distance += 0.03 * fbm(x * 9.0, y * 9.0, z * 9.0, seed=40, octaves=3)
    # Towards the outside the ash thins out by e every 0.7 voxels. In a medium as strong as this one a grazing ray sees
    # densities of a hundredth; if they rose from 0 within one voxel, the outline would be a staircase.
    skin = 1.0 / (1.0 + np.exp(distance / (0.7 * voxel) + 3.5))
    density = skin * (0.9 + 0.1 * fbm(x * 4.0, y * 4.0, z * 4.0, seed=50)) * edge_fade(x.shape)
    # How much ash surrounds a point within a tenth of the radius: 1 inside, 1/2 at a plane surface, more in a cleft.
    depth = gaussian_blur((distance < 0.0).astype(np.float32), 5.0)
    patches = smoothstep(-0.25, 0.35, fbm(x * 1.6, y * 1.6, z * 1.6, seed=60, octaves=3))
    heat = smoothstep(0.56, 0.86, depth - 0.14 + 0.2 * patches) * smoothstep(1.5 * voxel, -1.5 * voxel, distance)
    temperature = 1900.0 * binomial(heat) * edge_fade(x.shape)
    return {
        "pyroclastic.vdb": [
            grid("density", rounded(density, least=0.001), voxel, lo),
            grid("temperature", quantised(temperature, step=8.0, least=12), voxel, lo),
        ]
    }


def sandstorm() -> dict[str, list[vdb.Grid]]:
    """A wall of dust: the billowing head of a heavy current, with a veil running ahead of it on the ground."""
    voxel, lo, hi = 1.0, np.array([-84.0, -12.0, -76.0]), np.array([84.0, 65.0, 51.0])
    x, y, z = lattice(lo, hi, voxel)
    rng = np.random.default_rng(3)
    seeds = []
    # Rows of spheres, from the foot of the front to the back: how far back, how high, how big.
    rows = [(0.0, 6.0, 15.0), (9.0, 20.0, 16.0), (26.0, 30.0, 17.0), (38.0, 14.0, 22.0)]
    for row, (back, base, size) in enumerate(rows):
        for across in np.arange(-60.0 + 4.0 * row, 61.0 - 4.0 * row, 13.0):
            # The front is an arc with lobes and clefts; towards the ends it falls back and is lower.
            end = abs(across) / 66.0
            arc = 20.0 * end**2 + 7.0 * np.sin(across * 0.11 + 1.0)
            r = size * (1.0 - 0.45 * end**2) * rng.uniform(0.75, 1.15)
            height = base * (1.0 - 0.5 * end**2) + rng.uniform(-3, 4)
            seeds.append((across + rng.uniform(-4, 4), height, -back - arc, r))
    levels = sphere_cluster(seeds, [(0.4, 1.15), (0.42, 1.1), (0.45, 1.3)], seed=5, keep=lambda p: p[:, 1] > -4.0)
    warped = warp(x, y, z, seed=70, frequency=0.05, amount=3.5)
    distance = spheres_distance(*warped, np.concatenate(levels), lo, voxel, reach=12.0)
    distance += 2.2 * fbm(x * 0.16, y * 0.16, z * 0.16, seed=80, octaves=3)
    density = smoothstep(0.9, -2.6, distance)
    # A dense rolling skin around thinner air: crisp billows, although one can still see some way in.
    density *= 1.0 - 0.88 * smoothstep(-2.5, -9.0, distance)
    density *= (0.6 + 0.4 * smoothstep(55.0, 0.0, y)) * (0.8 + 0.35 * fbm(x * 0.06, y * 0.06, z * 0.06, seed=90))
    # The veil: streaks drawn out along the storm's way (z), hugging the ground in front of the wall.
    streaks = fbm(x * 0.11, y * 0.22, z * 0.035, seed=95, octaves=4)
    ahead = smoothstep(46.0 - 0.006 * x**2, -8.0, z + 10.0 * streaks) * smoothstep(80.0, 52.0, np.abs(x))
    veil = 0.3 * ahead * smoothstep(10.0, 0.0, y + 6.0 * streaks) * smoothstep(-0.35, 0.5, streaks)
    density = binomial(np.maximum(density, veil)) * edge_fade(x.shape)
    return {"sandstorm.vdb": [grid("density", quantised(density, step=1.0 / 128.0, least=1), voxel, lo)]}


def cloud() -> dict[str, list[vdb.Grid]]:
    """A fair-weather cumulus: towers of spheres over a flat base, frayed where the air dries it."""
    voxel, lo, hi = 4.0, np.array([-320.0, -40.0, -216.0]), np.array([316.0, 376.0, 212.0])
    x, y, z = lattice(lo, hi, voxel)
    # A broad low base; a tall tower right of the middle, its head wider than its neck; a lower one to the left.
    towers = [
        (-215, 22, 0, 46),
        (-150, 40, 20, 62),
        (-75, 48, -10, 74),
        (5, 55, 15, 84),
        (90, 55, 0, 82),
        (165, 38, -15, 60),
        (228, 20, 10, 40),
        (-40, 35, 80, 58),
        (70, 35, 85, 60),
        (30, 40, -90, 64),
        (-110, 118, -5, 58),
        (-130, 165, 0, 42),
        (60, 140, 0, 68),
        (40, 205, -10, 74),
        (95, 235, 10, 60),
        (55, 275, 0, 48),
        (5, 190, 30, 44),
        (185, 85, 5, 38),
    ]
    levels = sphere_cluster(towers, [(0.4, 1.15), (0.42, 1.05), (0.45, 1.2)], seed=11, keep=lambda p: p[:, 1] > -8.0)
    warped = warp(x, y, z, seed=110, frequency=0.014, amount=16.0)
    distance = spheres_distance(*warped, np.concatenate(levels), lo, voxel, reach=36.0)
    fray = fbm(x * 0.03, y * 0.03, z * 0.03, seed=120, octaves=4)
    base = y + 8.0 * fbm(x * 0.02, x * 0.0, z * 0.02, seed=130, octaves=3)
    distance += (7.0 + 16.0 * smoothstep(140.0, 0.0, y)) * fray
    density = smoothstep(4.0, -11.0, distance) * smoothstep(-6.0, 30.0, base)
    # Water content grows with the height above the base.
    density *= 0.5 + 0.5 * smoothstep(0.0, 220.0, y)
    density = binomial(density) * edge_fade(x.shape)
    return {"cloud.vdb": [grid("density", quantised(density), voxel, lo)]}


def duo() -> dict[str, list[vdb.Grid]]:
    """Two jets of different smoke that meet and mingle: two densities carried by one flow."""
    shape, voxel = (128, 112, 80), 0.02
    solver = SmokeSolver(shape, densities=2)
    solver.buoyancy, solver.confinement, solver.cooling = 0.02, 0.22, 0.985
    x, y, z = lattice((0, 0, 0), np.array(shape) - 1, 1.0)
    mouths = [((22.0, 22.0, 37.0), (1.5, 0.95, 0.05)), ((106.0, 22.0, 43.0), (-1.5, 0.95, -0.05))]
    for n in range(84):
        for i, (centre, speed) in enumerate(mouths):
            d = np.sqrt(sum((c - p) ** 2 for c, p in zip((x, y, z), centre, strict=True)))
            near = tuple(slice(int(p) - 12, int(p) + 13) for p in centre)
            lick = gradient_noise(*(c[near] / 4.0 + 0.2 * n for c in (x, y, z)), seed=140 + i)
            source = smoothstep(1.1, 0.6, d[near] / 7.0 + 0.3 * lick)
            state = solver.state[near]
            aim = np.array(speed, np.float32) * (1.0 + 0.3 * np.sin(0.4 * n + 2.0 * i))
            state[..., :3] += source[..., None] * (aim - state[..., :3])
            state[..., 3] = np.maximum(state[..., 3], source)
            state[..., 4 + i] = np.maximum(state[..., 4 + i], source)
        solver.step()
    corner = [-0.5 * voxel * shape[0], 0.0, -0.5 * voxel * shape[2]]
    fade = edge_fade(shape)
    return {
        f"duo_{name}.vdb": [grid("density", quantised(binomial(solver.density(i)) * fade), voxel, corner)]
        for i, name in enumerate(("cool", "warm"))
    }


#: What is made for every scene: file name → grids. The fog of `shaft` is homogeneous: it has no file.
SCENES: dict[str, Callable[[], dict[str, list[vdb.Grid]]]] = {
    "plume": plume,
    "pyroclastic": pyroclastic,
    "sandstorm": sandstorm,
    "cloud": cloud,
    "shaft": dict,
    "duo": duo,
}


def make(name: str, directory: Path = DIRECTORY) -> list[Path]:
    """Make the .vdb files of one scene; returns their paths."""
    paths = []
    for file_name, grids in SCENES[name]().items():
        paths.append(directory / file_name)
        vdb.write(paths[-1], grids, compression="zip")
    return paths


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the .vdb files of the example scenes.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SCENES)}; without, all")
    parser.add_argument("--output", type=Path, default=DIRECTORY, metavar="DIR", help="where to write them")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(SCENES):
        parser.error(f"no scene is called {', '.join(sorted(unknown))}; there are {', '.join(SCENES)}")
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or SCENES:
        start = time.perf_counter()
        paths = make(name, arguments.output)
        size = sum(p.stat().st_size for p in paths)
        print(f"{name}: {len(paths)} files, {size / 1e6:.2f} MB, {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()

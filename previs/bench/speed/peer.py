"""The same scene in VTK, where it is installed: what a frame takes there, and how far it is off.

VTK has no spectra, lobes or units that previs would share, so the scene is reduced to what both can draw: one volume of
voxels, grey, under one distant light.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...description import Light, SceneDescription, Volume
from ...index import RenderIndex
from ...meter import ErrorPart
from ...render.renderer import Renderer
from ...scene.arguments import looking
from ..records import plain
from ..report import names_of
from ..run import Progress, Subject, opened
from . import vtk_frame
from .accuracy import Truth
from .clock import Stopwatch, main_light
from .scenes import Options

#: Seconds that VTK may take for all of its frames of a scene.
TIME_LIMIT = 900.0
#: Where the light comes from in a stage without one.
FROM_ABOVE = (0.4, -0.8, -0.4)


@dataclass(frozen=True)
class PeerResult:
    """A frame of a renderer: its times in seconds, and its errors. `failure` says in a line why there is none."""

    scene: str
    name: str
    wall: float = 0.0
    process: float = 0.0
    mean_relative_error: float = 0.0
    relative_rmse: float = 0.0
    scale: float = 1.0
    failure: str = ""

    def record(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {name: plain(value) for name, value in vars(self).items()}


def is_there() -> bool:
    """Whether VTK can be imported."""
    return importlib.util.find_spec("vtk") is not None


def common_scene(description: SceneDescription) -> tuple[SceneDescription, Volume, np.ndarray] | None:
    """What of a scene both can draw, its volume, and the direction in which its light travels; None without voxels."""
    volume = next(
        (v for v in description.volumes.values() if v.density is not None and v.density.grid.active_count), None
    )
    if volume is None:
        return None
    medium = replace(
        volume.medium,
        extinction=(float(np.mean(volume.medium.extinction)),) * 3,
        albedo=(float(np.mean(volume.medium.albedo)),) * 3,
        emission=(0.0, 0.0, 0.0),
        phase="hg",
    )
    volume = replace(volume, medium=medium, temperature=None, emission=None)
    light = main_light(description)
    if light is None:
        direction = np.array(FROM_ABOVE)
    elif light.kind == "distant":
        direction = np.asarray(light.direction, float)
    else:
        lo, hi = (np.asarray(end, float) for end in volume.density.grid.bounds)
        to_world = np.asarray(volume.density.index_to_local, float) @ np.asarray(volume.local_to_world, float)
        direction = (np.append(0.5 * (lo + hi), 1.0) @ to_world)[:3] - np.asarray(light.position, float)
    direction = direction / np.linalg.norm(direction)
    white = (3.0, 3.0, 3.0)
    sun = Light("/Sun", "distant", looking((0.0, 0.0, 0.0), direction), white, white)
    scene = replace(description, volumes={volume.path: volume}, lights={sun.path: sun}, meshes={}, notes=())
    return scene, volume, direction


def best_scale(found: np.ndarray, truth: np.ndarray, weight: np.ndarray) -> float:
    """The factor that brings pixels (N, 3) nearest to the truth in the mean square, each with its weight (N,)."""
    square = float(weight @ np.sum(found * found, axis=1))
    return float(weight @ np.sum(found * truth, axis=1)) / square if square > 0.0 else 0.0


def compare(
    renderer: Renderer, stages: Sequence[str | Path], options: Options, progress: Progress | None = None
) -> list[PeerResult]:
    """VTK and previs on what of every stage both can draw; stages without voxels are left out.

    Raises:
        PrevisError: when a stage cannot be opened, or rendered by previs.
    """
    found = []
    for number, (stage, name) in enumerate(zip(stages, names_of(stages), strict=True)):
        with opened(stage, options.width, options.camera, name) as subject:
            if (reduced := common_scene(subject.index.scene)) is None:
                continue
            if progress is not None:
                progress(f"{name}: previs beside VTK", number, len(stages))
            scene, volume, direction = reduced
            index = RenderIndex()
            index.update(scene)
            common = Subject(name, subject.file, index, subject.camera, subject.size, subject.settings)
            renderer.forget_scene()
            with Stopwatch(renderer, common) as watch, watch.meter() as meter:
                settings = watch.settings({"ambient": 0.0})
                image = watch.picture(settings)
                truth = Truth(meter, replace(common, settings=settings), image, options.pixels)
                taken = [watch.whole(settings) for _ in range(options.repeats)]
                wall, process = (float(np.median([getattr(t, c) for t in taken])) for c in ("wall", "process"))
                found.append(_result(name, "previs", wall, process, truth.of_image(image)))
                if progress is not None:
                    progress(f"{name}: VTK", number, len(stages))
                found.append(_vtk(common, volume, direction, truth, options))
    return found


def _result(scene: str, name: str, wall: float, process: float, error: ErrorPart, scale: float = 1.0) -> PeerResult:
    return PeerResult(
        scene, name, wall, process, float(error.mean_relative_error.value), float(error.relative_rmse.value), scale
    )


def _vtk(subject: Subject, volume: Volume, direction: np.ndarray, truth: Truth, options: Options) -> PeerResult:
    grid = volume.density.grid
    to_world = np.asarray(volume.density.index_to_local, float) @ np.asarray(volume.local_to_world, float)
    spacing = np.diag(to_world)[:3]
    if np.any(spacing <= 0.0) or not np.allclose(to_world[:3, :3], np.diag(spacing), atol=1e-6 * abs(spacing).max()):
        return PeerResult(subject.name, "VTK", failure="its images are neither turned nor mirrored, and the volume is")
    # Beyond the outermost voxels the field falls to its background.
    lo, hi = (np.asarray(end, int) for end in grid.bounds)
    density = np.maximum(np.asarray(grid.dense(lo - 1, hi + 1), np.float32), 0.0)
    width, height = subject.size
    camera = subject.camera.conformed(width / height)
    origin = (lo - 1) @ to_world[:3, :3] + to_world[3, :3]
    given = {
        "density": density,
        "spacing": spacing,
        "origin": origin,
        "middle": origin + 0.5 * spacing * (np.array(density.shape) - 1.0),
        "extinction": float(np.mean(volume.medium.strength)),
        "anisotropy": volume.medium.anisotropy,
        "light": direction * float(np.linalg.norm(spacing * density.shape)),
        "camera_to_world": np.asarray(camera.camera_to_world, float),
        "window": camera.window(),
        "parallel": camera.projection == "orthographic",
        "size": (width, height),
        "repeats": min(options.repeats, 2),
    }
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder) / "given.npz", Path(folder) / "drawn.npz"
        np.savez(files[0], **given)
        try:
            done = subprocess.run(
                [sys.executable, vtk_frame.__file__, *map(str, files)],
                capture_output=True,
                text=True,
                timeout=TIME_LIMIT,
                check=False,
                stdin=subprocess.DEVNULL,
            )
        except subprocess.TimeoutExpired:
            return PeerResult(subject.name, "VTK", failure=f"not done after {TIME_LIMIT:g} s")
        if done.returncode or not files[1].is_file():
            lines = [line for line in done.stderr.splitlines() if line.strip()]
            return PeerResult(subject.name, "VTK", failure=lines[-1][:200] if lines else f"status {done.returncode}")
        drawn = dict(np.load(files[1]))
    sample = truth.sample
    pixels = np.asarray(drawn["picture"], float)[sample.rows, sample.columns]
    scale = best_scale(pixels, truth.values, 1.0 / sample.probability)
    error = truth.of_pixels(scale * pixels)
    wall, process = (float(np.median(drawn[clock])) for clock in ("wall", "process"))
    return _result(subject.name, f"VTK {drawn['version']} ({drawn['window']})", wall, process, error, scale)

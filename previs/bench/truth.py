"""End to end against the float64 reference: how far default pictures are from the truth, by every method of maps.

Pictures are small, for the reference is slow, and sampled at pixel centres in linear radiance. Surfaces are matte, as
the reference has no specular lobe, and lights of finite size are points, as previs takes them; nothing else of a scene
is changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .. import metrics
from ..api import choose_camera
from ..description import Camera, SceneDescription
from ..index import RenderIndex
from ..render.method import METHODS
from ..render.renderer import Renderer
from ..scene import Scene
from ..settings import BY_NAME, Settings
from .random_scenes import property_scenes
from .reference_scene import reference_image
from .run import shipped_stages

#: Width of the pictures; the height follows the camera.
WIDTH = 64
#: Relative error that the reference's quadrature is held to.
REFERENCE_ERROR = 1e-3
#: Largest mean error and least PSNR by the number of values; 0 for slices and the march.
TARGETS = {0: (0.01, 45.0), 6: (0.03, 40.0), 14: (0.01, 45.0)}


@dataclass(frozen=True)
class Accuracy:
    """One picture against the reference: `mean_error` relative to the mean of the lit pixels, `psnr` in dB."""

    scene: str
    method: str
    coefficients: int
    mean_error: float
    psnr: float

    @property
    def meets(self) -> bool:
        """Whether it meets the targets for its number of values."""
        mean, least = TARGETS[self.coefficients]
        return self.mean_error <= mean and self.psnr >= least


def subjects(stages: Iterable[str | Path] | None, random: int) -> Iterable[tuple[str, SceneDescription, Camera, float]]:
    """(name, description, camera, width over height) of the stages, None for the shipped ones, and of random scenes."""
    for stage in shipped_stages() if stages is None else stages:
        with Scene.open(stage) as scene:
            description = scene.describe()
            camera = choose_camera(scene, description, None, None)
            yield Path(stage).stem, description, camera, camera.aspect_ratio
    for name, description, camera in property_scenes(random):
        yield name, description, camera, camera.aspect_ratio


def matte(description: SceneDescription) -> SceneDescription:
    """The scene without specular lobes."""
    meshes = {p: replace(m, surface=replace(m.surface, specular=False)) for p, m in description.meshes.items()}
    return replace(description, meshes=meshes)


def measure(
    renderer: Renderer,
    stages: Iterable[str | Path] | None = None,
    random: int = 20,
    methods: Sequence[str] | None = None,
    width: int = WIDTH,
    progress: Callable[[str], None] | None = None,
) -> list[Accuracy]:
    """Render scenes with every method, maps with 6 and 14 values, and compare with the reference.

    Args:
        renderer: draws the pictures.
        stages: None takes the shipped scenes.
        random: number of random scenes besides.
        methods: values of the knob `transmittance`; None takes all.
        width: of the pictures in pixels; random scenes take half of it.
        progress: called with the name of every scene before it is rendered.
    """
    found = []
    for name, given, camera, aspect in subjects(stages, random):
        if progress is not None:
            progress(name)
        description = matte(given)
        across = width // 2 if name.startswith("random ") else width
        size = across, max(round(across / aspect), 1)
        truth = reference_image(description, camera, *size, max_error=REFERENCE_ERROR).color
        if not np.any(truth):
            continue
        index = RenderIndex()
        index.update(description)
        for method in methods or BY_NAME["transmittance"].choices:
            for count in (6, 14) if METHODS[method].has_coefficients else (0,):
                values = {"transmittance": method, **({"coefficients": count} if count else {})}
                color = renderer.render(index, camera, size, Settings(**values)).color
                error, psnr = metrics.mean_relative_error(color, truth), metrics.psnr(color, truth)
                found.append(Accuracy(name, method, count, error, psnr))
    return found


def table(found: Sequence[Accuracy]) -> str:
    """Markdown: a row per scene, a column per method, "mean error, PSNR"; bold where a target is missed."""
    columns = list(dict.fromkeys((a.method, a.coefficients) for a in found))
    scenes = list(dict.fromkeys(a.scene for a in found))
    by = {(a.scene, a.method, a.coefficients): a for a in found}
    lines = ["| scene | " + " | ".join(f"`{m}` {n}" if n else f"`{m}`" for m, n in columns) + " |"]
    lines.append("|---" * (len(columns) + 1) + "|")

    def cell(accuracy: Accuracy) -> str:
        text = f"{100 * accuracy.mean_error:.2f} %, {accuracy.psnr:.1f} dB"
        return text if accuracy.meets else f"**{text}**"

    shown = [s for s in scenes if not s.startswith("random ")]
    for scene in shown:
        lines.append(f"| {scene} | " + " | ".join(cell(by[scene, *c]) for c in columns) + " |")
    if count := len(scenes) - len(shown):
        worst = []
        for method, n in columns:
            part = [a for a in found if (a.method, a.coefficients) == (method, n) and a.scene.startswith("random ")]
            low = Accuracy("", method, n, max(a.mean_error for a in part), min(a.psnr for a in part))
            worst.append(cell(low) + f" ({sum(a.meets for a in part)} of {len(part)})")
        lines.append(f"| {count} random scenes, worst (how many meet the targets) | " + " | ".join(worst) + " |")
    return "\n".join(lines)

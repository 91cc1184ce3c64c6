"""The two functions that most programs need: open a scene, render it.

`render` keeps one renderer for the process, so that a loop over frames or edits compiles its shaders once and draws
again only what changed. A program that wants renderers of its own makes them with `previs.Renderer`.
"""

from __future__ import annotations

import atexit
import threading
import weakref
from collections.abc import Callable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

from .errors import PrevisError

# The functions load what they need: `import previs` alone takes neither USD nor numpy.
if TYPE_CHECKING:
    from .description import Camera, SceneDescription
    from .image import Image
    from .index import RenderIndex
    from .render.renderer import Renderer
    from .scene import Scene

DEFAULT_WIDTH = 960


def open(path: str | PathLike[str], session_layer: str | PathLike[str] | None = None) -> Scene:
    """Open a USD stage (.usd, .usda, .usdc, .usdz) for rendering and editing, or a .vdb file on a default stage.

    Args:
        path: the stage.
        session_layer: a layer composed over it, as a session layer.

    Raises:
        PrevisError: one line that names the file and what is wrong.
    """
    from .scene import Scene

    return Scene.open(path, session_layer=session_layer)


class _Shared:
    """The renderer of the process, and the scene that it holds the resources of."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self._renderer: Renderer | None = None
        self._scene: weakref.ref[Scene] | None = None
        self._index: RenderIndex | None = None

    def take(self, scene: Scene) -> tuple[Renderer, RenderIndex]:
        from .index import RenderIndex
        from .render.renderer import Renderer

        if self._renderer is None:
            self._renderer = Renderer()
        if self._index is None or self._scene is None or self._scene() is not scene:
            self._renderer.forget_scene()
            self._scene, self._index = weakref.ref(scene), RenderIndex()
        return self._renderer, self._index

    def release(self) -> None:
        if self._renderer is not None:
            self._renderer.release()
        self._renderer, self._scene = None, None


_shared = _Shared()
atexit.register(_shared.release)


def choose_camera(
    scene: Scene, description: SceneDescription, camera: str | Camera | None, time: float | None
) -> Camera:
    """The camera asked for, else the stage's own choice, else one that frames the stage.

    Raises:
        PrevisError: when the stage has no camera of that name; the message lists those it has.
    """
    from .description import Camera, framing_camera

    if isinstance(camera, Camera):
        return camera
    return scene.camera(camera, time) or framing_camera(description)


def choose_size(camera: Camera, size: Sequence[int] | int | None) -> tuple[int, int]:
    """(width, height): as given, or a width (960 by default) and the height of the camera's aspect.

    Raises:
        ValueError: when it is neither.
    """
    import numpy as np

    pixels = np.asarray(DEFAULT_WIDTH if size is None else size)
    if pixels.dtype.kind not in "iu" or pixels.shape not in ((), (2,)):
        raise ValueError(f"size: {size!r} is neither (width, height) nor a width, in whole pixels")
    if pixels.shape == (2,):
        return int(pixels[0]), int(pixels[1])
    return int(pixels), max(round(int(pixels) / camera.aspect_ratio), 1)


def render(
    scene: Scene | str | PathLike[str],
    camera: str | Camera | None = None,
    size: Sequence[int] | int | None = None,
    time: float | None = None,
    progress: Callable[[float], None] | None = None,
    measure_error: bool = False,
    max_error: float | None = None,
    quality: str | None = None,
    **settings: Any,
) -> Image:
    """Render a scene.

    Args:
        scene: a `Scene`, or the path of a stage.
        camera: a camera's prim path or name, a `Camera`, or None for the stage's own, else one that frames everything.
        size: (width, height) in pixels, or a width; None is 960 pixels wide with the camera's aspect.
        time: time code; None is the earliest time of the stage.
        progress: called with the done part of the frame in [0, 1].
        measure_error: whether to estimate how far the picture is from the truth, from `error_pixels` of its pixels: the
            `error` of the picture.
        max_error: choose the cheapest settings whose mean relative error, the upper end of its 95 % interval, is no
            more than this; knobs that are given keep their values. The picture's stats say under ``choice`` what was
            chosen and whether the limit was met; where it was not, the picture is the best that was found.
        quality: a preset of knobs, ``"draft"``, ``"preview"`` or ``"final"``; see `previs.quality`. It overrides what
            the stage says; None leaves the knobs to the stage.
        **settings: any knob of `previs.settings.TABLE`, e.g. ``coefficients=14``; they override the preset, and the
            others are as the stage says.

    Returns:
        The picture, linear.

    Raises:
        PrevisError: one line that says what cannot be rendered and why.
        ValueError: for an unknown setting or an illegal value.
    """
    from .quality import preset
    from .scene import Scene
    from .settings import Settings

    # Said before anything is opened.
    Settings(**settings)
    chosen_preset = preset(quality) if quality is not None else {}
    if max_error is not None and not max_error > 0.0:
        raise ValueError(f"max_error: {max_error!r} is not a number above 0")
    if not isinstance(scene, Scene):
        with open(scene) as opened:
            return render(opened, camera, size, time, progress, measure_error, max_error, quality, **settings)
    with _shared.lock:
        values = Settings(**scene.settings({**chosen_preset, **settings}))
        description = scene.describe(time)
        chosen = choose_camera(scene, description, camera, time)
        pixels = choose_size(chosen, size)
        if min(pixels) < 1:
            raise PrevisError(f"image of {pixels[0]}×{pixels[1]} pixels: both must be 1 or more")
        renderer, index = _shared.take(scene)
        index.update(description)
        if max_error is not None:
            from .render.choosing import render_within

            image, _ = render_within(
                renderer, index, chosen, pixels, values, max_error, fixed=settings, progress=progress
            )
            return image
        image = renderer.render(index, chosen, pixels, values, progress)
        if not measure_error:
            return image
        from .render.measure import ErrorMeter

        with ErrorMeter(renderer) as meter:
            return image.with_error(meter.measure(index, chosen, image, values))

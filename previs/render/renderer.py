"""The renderer: runs the passes of a plan that are out of date, and reads the picture back."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Hashable

import moderngl
import numpy as np

from ..description import Camera
from ..errors import PrevisError
from ..image import Image
from ..index import RenderIndex
from ..settings import Settings
from .context import check_errors, create_context, is_software
from .frame import BACKGROUND_DISTANCE, Frame
from .passes import RUNNERS
from .plan import DeviceLimits, Plan, make_plan
from .shader import ShaderError

#: Planes that are averaged over the samples of a pixel. Depth takes the nearest, the others the first sample: the mean
#: of a surface's normal and the background's is no normal.
AVERAGED = ("color", "alpha", "transmittance", "volume", "emission")


class Renderer:
    """Renders scenes in one OpenGL context and keeps what the next frame can use again.

    Use it as a context manager, or call `release`. One renderer follows one scene at a time: give it the same index
    and only the passes whose input changed run again.

    Args:
        context: an OpenGL 3.3 context to draw in; None makes one without a window, which the renderer then owns.

    Raises:
        ContextError: when no context can be made.
    """

    def __init__(self, context: moderngl.Context | None = None) -> None:
        self._owns_context = context is None
        self.context = context or create_context()
        with self.context:
            # Asked once: outside a frame the context is not current, and a query would return nothing.
            info = self.context.info
            self._frame = Frame(self.context)
            self.is_software: bool = is_software(self.context)
        self.device: str = info["GL_RENDERER"]
        texture_size = min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"][:2])
        self.limits = DeviceLimits(texture_size, info["GL_MAX_3D_TEXTURE_SIZE"], info["GL_MAX_UNIFORM_BLOCK_SIZE"])
        self._states: dict[str, tuple[Hashable, int]] = {}
        self._serial = itertools.count(1)
        #: Names of the passes that ran in the last frame, in order.
        self.executed: list[str] = []

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def plan(self, index: RenderIndex, camera: Camera, width: int, height: int, settings: Settings) -> Plan:
        """The plan of a frame on this device; see `make_plan`."""
        return make_plan(index, camera, width, height, settings, limits=self.limits)

    def render(
        self,
        index: RenderIndex,
        camera: Camera,
        size: tuple[int, int],
        settings: Settings | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Image:
        """Render a frame.

        Args:
            index: the scene.
            camera: its aspect is conformed to the image by its vertical aperture.
            size: (width, height) in pixels.
            settings: the knobs; None takes the defaults.
            progress: called with the part of the frame that is done, in [0, 1]; an exception it raises stops the frame.

        Returns:
            The picture. Its `stats` hold ``plan`` (passes with why, resolution and memory), ``executed`` (names of the
            passes that ran), ``times`` (seconds per pass name), ``seconds``, ``memory`` (bytes of textures),
            ``device``, ``settings``.

        Raises:
            PrevisError: when the scene cannot be rendered.
        """
        settings = settings or Settings()
        width, height = size
        limit = self.limits.texture_size
        if not (0 < width <= limit and 0 < height <= limit):
            raise PrevisError(f"image of {width}×{height} pixels: this device draws from 1×1 to {limit}×{limit}")
        started = time.perf_counter()
        times: dict[str, float] = {}
        self.executed = []
        count = settings.antialias
        shifts = [((i + 0.5) / count - 0.5, (j + 0.5) / count - 0.5) for j in range(count) for i in range(count)]
        total: dict[str, np.ndarray] = {}
        for number, shift in enumerate(shifts):

            def report(fraction: float, number: int = number) -> None:
                if progress is not None:
                    progress((number + fraction) / len(shifts))

            plan = make_plan(index, camera, width, height, settings, shift, self.limits)
            self.draw(plan, report, times)
            planes = self._read(plan)
            if not total:
                total = planes
            else:
                for name, plane in planes.items():
                    if name == "depth":
                        total[name] = np.minimum(total[name], plane)
                    elif name in AVERAGED:
                        total[name] = total[name] + plane
        if len(shifts) > 1:
            total = {name: plane / len(shifts) if name in AVERAGED else plane for name, plane in total.items()}
        report(1.0)
        stats = {
            "plan": [
                {"pass": p.name, "why": p.why, "resolution": list(p.resolution), "bytes": p.memory} for p in plan.passes
            ],
            "executed": list(self.executed),
            "times": times,
            "seconds": time.perf_counter() - started,
            "memory": sum(p.memory for p in plan.passes),
            "device": self.device,
            "settings": dict(settings),
            "notes": [str(n) for n in (*index.notes, *plan.notes)],
        }
        color, alpha, depth = total.pop("color"), total.pop("alpha"), total.pop("depth")
        return Image(color, alpha, depth, total, stats)

    def draw(
        self,
        plan: Plan,
        progress: Callable[[float], None] | None = None,
        times: dict[str, float] | None = None,
    ) -> None:
        """Run the passes of a plan that are out of date; the picture stays in the target named "composite".

        Args:
            plan: made by `plan`.
            progress: as for `render`.
            times: seconds per pass name are added to it; timing waits for every pass to end.
        """
        frame = self._frame
        frame.plan = plan
        with self.context:
            frame.rest()
            frame.release_unused()
            if plan.maps and frame.maps.update(plan):
                self._forget("transmittance_map")
            if plan.shadow_tiles and frame.shadows.update(plan):
                self._forget("shadow_map")
            for path in set(self._states) - {p.name for p in plan.passes}:
                del self._states[path]
            pending = [p for p in plan.passes if p.kind == "march"]
            for p in plan.passes:
                state = (p.depends, tuple(self._states[i][1] for i in p.inputs))
                held = self._states.get(p.name)
                if held is not None and held[0] == state:
                    continue
                frame.progress = progress if p in pending else None
                begin = time.perf_counter()
                # A pass that fails halfway must run again.
                self._states.pop(p.name, None)
                try:
                    RUNNERS[p.kind](frame, p)
                    if times is not None:
                        self.context.finish()
                        times[p.name] = times.get(p.name, 0.0) + time.perf_counter() - begin
                    check_errors(self.context, p.name)
                except (ShaderError, moderngl.Error, MemoryError, RuntimeError) as error:
                    raise PrevisError(f"{p.name}: {type(error).__name__}: {error}") from error
                self._states[p.name] = (state, next(self._serial))
                self.executed.append(p.name)
            frame.rest()

    def forget_scene(self) -> None:
        """Free what belongs to the scene last rendered; compiled shaders stay."""
        with self.context:
            self._frame.release_scene()
        self._states.clear()

    def _forget(self, kind: str) -> None:
        for name in [n for n in self._states if n.startswith(kind)]:
            del self._states[name]

    def _read(self, plan: Plan) -> dict[str, np.ndarray]:
        """All planes of the picture, rows from the top."""
        targets = self._frame.targets
        shape = (plan.height, plan.width)

        def plane(name: str, attachment: int) -> np.ndarray:
            with self.context:
                data = targets[name].read(components=4, attachment=attachment, dtype="f4")
            return np.frombuffer(data, np.float32).reshape(*shape, 4)[::-1]

        composite = plane("composite", 0)
        planes = {"color": composite[..., :3].copy(), "alpha": composite[..., 3].copy()}
        planes["depth"] = np.full(shape, np.inf, np.float32)
        if plan.meshes:
            geometry = plane("gbuffer", 0)
            covered = geometry[..., 3] < 0.5 * BACKGROUND_DISTANCE
            planes["depth"][covered] = (geometry[..., 3] / _per_depth(plan) + plan.rays.anchor_depth)[covered]
            planes["normal"] = np.where(covered[..., None], geometry[..., :3], 0.0)
            planes["albedo"] = plane("gbuffer", 1)[..., :3].copy()
        if plan.volumes:
            planes["volume"] = plane("march", 0)[..., :3].copy()
            planes["transmittance"] = plane("march", 1)[..., :3].copy()
            if plan.defines["HAS_EMISSION"]:
                planes["emission"] = plane("march", 2)[..., :3].copy()
        return planes

    def release(self) -> None:
        """Free all resources, and the context if the renderer made it."""
        if self.context is None:
            return
        with self.context:
            self._frame.release()
        if self._owns_context:
            self.context.release()
        self.context = None


def _per_depth(plan: Plan) -> np.ndarray:
    """Distance along each pixel's ray per unit of depth along the camera's axis, rows from the top."""
    u = (np.arange(plan.width) + 0.5) / plan.width
    v = (np.arange(plan.height)[::-1] + 0.5) / plan.height
    d0, du, dv = plan.rays.direction
    direction = d0 + u[None, :, None] * du + v[:, None, None] * dv
    return np.linalg.norm(direction, axis=-1)

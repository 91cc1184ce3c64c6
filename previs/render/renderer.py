"""The renderer: runs the passes of a plan that are out of date, and reads the picture back."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Generator, Hashable, Iterable, Mapping
from contextlib import closing

import moderngl
import numpy as np

from ..description import Camera, Field, Note, SceneDescription
from ..errors import PrevisError
from ..image import Image
from ..index import RenderIndex
from ..settings import Settings
from .context import check_errors, create_context, is_software
from .fields import SPARSE_ROLES, field_dims
from .frame import BACKGROUND_DISTANCE, Frame
from .passes import RUNNERS
from .plan import make_plan
from .planned import Atlases, DeviceLimits, Plan, PlannedPass
from .precision import density_range
from .scattered import ScatteredPixels
from .shader import ShaderError
from .versioned import FITS

#: Components of a texel by what a field is used for.
FIELD_COMPONENTS = {"density": 1, "temperature": 1, "emission": 4}
#: Planes that are averaged over the samples of a pixel. Depth takes the nearest, the others the first sample: the mean
#: of a surface's normal and the background's is no normal.
AVERAGED = ("color", "alpha", "transmittance", "volume", "emission")


def sample_shifts(count: int) -> list[tuple[float, float]]:
    """Where the samples of a pixel lie off its centre, in pixels: a grid of `count` by `count`."""
    places = [(i + 0.5) / count - 0.5 for i in range(count)]
    return [(x, y) for y in places for x in places]


class Samples:
    """The planes of a picture of several samples per pixel."""

    def __init__(self) -> None:
        self._total: dict[str, np.ndarray] = {}
        self._count = 0

    def add(self, planes: Mapping[str, np.ndarray]) -> None:
        """Take in one sample of every pixel."""
        self._count += 1
        if self._count == 1:
            self._total = dict(planes)
            return
        for name, plane in planes.items():
            if name == "depth":
                self._total[name] = np.minimum(self._total[name], plane)
            elif name in AVERAGED:
                self._total[name] = self._total[name] + plane

    def planes(self) -> dict[str, np.ndarray]:
        """The planes of all samples together."""
        if self._count == 1:
            return dict(self._total)
        return {name: plane / self._count if name in AVERAGED else plane for name, plane in self._total.items()}


class Renderer:
    """Renders scenes in one OpenGL context and keeps what the next frame can use again.

    Use it as a context manager, or call `release`. One renderer follows one scene at a time: give it the same index
    and only the passes whose input changed run again.

    Args:
        context: an OpenGL 3.3 context to draw in; None makes one without a window, which the renderer then owns.
        share: another renderer, whose context, compiled shaders, voxels and meshes this one uses too. Maps, images and
            what is out of date stay apart, so that each keeps its own for its plans: two sizes, two qualities. They may
            be released in any order; a context that the first one made goes with the last.

    Raises:
        ContextError: when no context can be made.
        ValueError: when the renderer to share with was released, or has another context.
    """

    def __init__(self, context: moderngl.Context | None = None, share: Renderer | None = None) -> None:
        if share is not None:
            if share.context is None:
                raise ValueError("the renderer to share with was released")
            if context is not None and context is not share.context:
                raise ValueError("renderers share in one context only")
            context = share.context
        self._owns_context = context is None if share is None else share._owns_context
        self.context = context or create_context()
        with self.context:
            # Asked once: outside a frame the context is not current, and a query would return nothing.
            info = self.context.info
            self._frame = Frame(self.context, share and share._frame)
            self.is_software: bool = is_software(self.context)
        self.device: str = info["GL_RENDERER"]
        texture_size = min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"][:2])
        self.limits = DeviceLimits(texture_size, info["GL_MAX_3D_TEXTURE_SIZE"], info["GL_MAX_UNIFORM_BLOCK_SIZE"])
        self._states: dict[str, tuple[Hashable, int]] = {}
        self._serial = itertools.count(1)
        self._atlases: Atlases = (None, None)
        self._finished: Plan | None = None
        self._drawing: Generator[float, None, None] | None = None
        # Seconds that a pass of a kind took last: its share of the progress.
        self._weights: dict[str, float] = {}
        #: Names of the passes that ran in the last frame, in order.
        self.executed: list[str] = []

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def plan(
        self,
        index: RenderIndex,
        camera: Camera,
        width: int,
        height: int,
        settings: Settings,
        shift: tuple[float, float] = (0.0, 0.0),
        pixels: ScatteredPixels | None = None,
    ) -> Plan:
        """The plan of a frame on this device, of one sample per pixel; see `make_plan`, and `sample_shifts`."""
        return make_plan(index, camera, width, height, settings, shift, self.limits, self._atlases, pixels)

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
        executed: list[str] = []
        shifts = sample_shifts(settings.antialias)
        samples = Samples()
        for number, shift in enumerate(shifts):

            def report(fraction: float, number: int = number) -> None:
                if progress is not None:
                    progress((number + fraction) / len(shifts))

            plan = self.plan(index, camera, width, height, settings, shift)
            try:
                self.draw(plan, report, times)
            finally:
                executed += self.executed
                self.executed = list(executed)
            samples.add(self._read(plan))
        report(1.0)
        return self._image(plan, samples.planes(), times, time.perf_counter() - started, (*index.notes, *plan.notes))

    def draw(
        self,
        plan: Plan,
        progress: Callable[[float], None] | None = None,
        times: dict[str, float] | None = None,
    ) -> None:
        """Run the passes of a plan that are out of date; the picture stays in the texture named "composite".

        Args:
            plan: made by `plan`.
            progress: as for `render`.
            times: seconds per pass name are added to it; timing waits for every pass to end.

        Raises:
            PrevisError: when a pass fails.
        """
        with closing(self.drawing(plan, None, times)) as drawing:
            for fraction in drawing:
                if progress is not None:
                    progress(fraction)

    def drawing(
        self, plan: Plan, piece_seconds: float | None = None, times: dict[str, float] | None = None
    ) -> Generator[float, None, None]:
        """Run the passes of a plan that are out of date, a piece of work at a time.

        Between two pieces the caller may draw anything in the same context, also with a renderer that shares with this
        one, and may drop the generator: the pass under way then runs again when it is needed, and nothing else is
        lost. A drawing that is begun ends the one before it; no framebuffer of the renderer is left bound.

        Args:
            plan: made by `plan`.
            piece_seconds: how long a piece should take. Marches, surface lighting and transmittance maps are cut into
                rectangles by how long earlier ones took; other passes are a piece each. None takes whole passes, and
                for long marches the slices of the plan.
            times: as for `draw`; what others do between pieces is not in it.

        Yields:
            The part of the work that is done, in [0, 1], never falling; 1 at the end.

        Raises:
            PrevisError: when a pass fails.
            RuntimeError: when another drawing was begun meanwhile.
        """
        frame = self._frame
        self._stop()
        work = self._drawing = self._work(plan, times)
        self.executed = []
        self._finished = None
        try:
            while True:
                if self._drawing is not work:
                    raise RuntimeError("another drawing of this renderer was begun")
                with self.context:
                    # An error that others left behind is not one of ours.
                    _ = self.context.error
                    frame.plan, frame.pace.seconds = plan, piece_seconds
                    try:
                        fraction = next(work, None)
                    finally:
                        frame.rest()
                if fraction is None:
                    self._finished = plan
                    break
                yield fraction
        finally:
            work.close()
            if self._drawing is work:
                self._drawing = None

    def _work(self, plan: Plan, times: dict[str, float] | None) -> Generator[float, None, None]:
        """Run what is out of date; anything may happen in the context at a yield."""
        frame = self._frame
        frame.rest()
        frame.release_unused()
        if plan.maps:
            frame.light_atlas(plan).update(plan)
        if plan.shadow_tiles:
            frame.shadows.update(plan)
        self._atlases = (plan.map_atlas, plan.shadow_atlas)
        # Maps of lights that are not in this plan may be wanted again while nobody else takes their tiles.
        held = {*frame.light_atlas(plan).owners.values(), *frame.shadows.owners.values()}
        for name in set(self._states) - held - {p.name for p in plan.passes}:
            del self._states[name]
        weights = {p.name: self._weights.get(p.kind, 1e-3) for p in plan.passes}
        pending = self.stale(plan)
        whole = sum(weights[name] for name in pending)
        finished = reached = 0.0
        again = True
        while again:
            again = False
            for p in plan.passes:
                if self._is_current(p, plan):
                    continue
                # A pass that does not come to its end must run again.
                self._states.pop(p.name, None)
                seconds, begin = 0.0, time.perf_counter()
                try:
                    for part in RUNNERS[p.kind](frame, p):
                        check_errors(self.context, p.name)
                        seconds += time.perf_counter() - begin
                        if part < 1.0:
                            reached = max(reached, min((finished + part * weights[p.name]) / whole, 1.0))
                            yield reached
                            if again := not self._has_fields(plan):
                                break
                        begin = time.perf_counter()
                    if times is not None:
                        frame.pace.wait()
                        seconds += time.perf_counter() - begin
                        times[p.name] = times.get(p.name, 0.0) + seconds
                except (ShaderError, moderngl.Error, MemoryError, RuntimeError) as error:
                    raise PrevisError(f"{p.name}: {type(error).__name__}: {error}") from error
                if again:
                    break
                self._states[p.name] = (self._wanted(p, plan), next(self._serial))
                self._weights[p.kind] = seconds
                self.executed.append(p.name)
                finished += weights[p.name]
                if p is not plan.passes[-1]:
                    reached = max(reached, min(finished / whole, 1.0))
                    yield reached
                    if again := not self._has_fields(plan):
                        break
        yield 1.0

    def _has_fields(self, plan: Plan) -> bool:
        """Whether the voxels are still there after a yield: a renderer that shares them may have put others there."""
        uploads = [p for p in plan.passes if p.kind == "fields" and p.name in self._states]
        return all(self._is_current(p, plan) for p in uploads)

    def _wanted(self, p: PlannedPass, plan: Plan) -> Hashable:
        """What a pass depends on, and where its output is, as it is now."""
        frame, output = self._frame, ()
        if p.kind == "fields":
            output = frame.field_serials()
        elif p.kind == "transmittance_map":
            output = (frame.light_atlas(plan).owner(plan, p.payload.tile),)
        elif p.kind == "shadow_map":
            first = p.payload.first_tile
            output = tuple(frame.shadows.owner(plan, first + i) for i in range(len(p.payload.shadow.matrices)))
        return p.depends, tuple(self._states[i][1] for i in p.inputs), output

    def _is_current(self, p: PlannedPass, plan: Plan) -> bool:
        held = self._states.get(p.name)
        return held is not None and held[0] == self._wanted(p, plan)

    def stale(self, plan: Plan) -> tuple[str, ...]:
        """Names of the passes that `draw` would run for a plan, in order; changes nothing."""
        names: dict[str, None] = {}
        for p in plan.passes:
            if any(i in names for i in p.inputs) or not self._is_current(p, plan):
                names[p.name] = None
        return tuple(names)

    def texture(self, name: str = "composite") -> moderngl.Texture:
        """The finished picture of the last plan drawn: RGBA float, premultiplied colour and alpha, bottom row first.

        It is valid until another plan is drawn, and filled again in place by a plan of the same size.

        Args:
            name: "composite"; or another pass that fills a target of the image's size, whose first texture it gives.

        Raises:
            PrevisError: when nothing of that name was drawn.
        """
        if name not in self._frame.targets or name not in self._states:
            raise PrevisError(f"{name}: not drawn yet")
        return self._frame.targets[name].color_attachments[0]

    def planes(self, plan: Plan) -> dict[str, np.ndarray]:
        """Read back what was drawn for a plan: one sample, for `Samples`.

        Args:
            plan: the plan that was drawn last, to its end.

        Returns:
            Colour (H, W, 3), alpha and depth (H, W) and the other planes of an `Image` by name, rows from the top.

        Raises:
            PrevisError: when the plan is not what was drawn.
        """
        # What the plan was drawn from may have moved on since; what was drawn is still there.
        if plan is not self._finished and (stale := self.stale(plan)):
            raise PrevisError(f"{stale[0]}: not drawn yet")
        return self._read(plan)

    def scattered(self, plan: Plan) -> np.ndarray:
        """Read back the scattered pixels that were drawn for a plan: colour and alpha, (N, 4) float32.

        Args:
            plan: the plan that was drawn last, to its end; it has `pixels`.

        Raises:
            PrevisError: when the plan is not what was drawn.
        """
        if plan.pixels is None or plan is not self._finished:
            raise PrevisError("scattered pixels: not drawn yet")
        width, height = plan.target_size
        with self.context:
            data = self._frame.targets["composite"].read(components=4, dtype="f4")
        return np.frombuffer(data, np.float32).reshape(height, width, 4)[plan.pixels.places]

    def image(self, plan: Plan, times: Mapping[str, float] | None = None, samples: Samples | None = None) -> Image:
        """The picture that was drawn for a plan.

        Args:
            plan: the plan that was drawn last, to its end.
            times: seconds per pass name, for `stats`.
            samples: the planes of all samples, where there are more than that of the plan.

        Returns:
            As for `render`; the notes in its `stats` are the plan's alone.

        Raises:
            PrevisError: when the plan is not what was drawn, and no samples are given.
        """
        times = dict(times or {})
        planes = samples.planes() if samples is not None else self.planes(plan)
        return self._image(plan, planes, times, sum(times.values()), plan.notes)

    def _image(
        self, plan: Plan, planes: dict[str, np.ndarray], times: dict[str, float], seconds: float, notes: Iterable[Note]
    ) -> Image:
        stats = {
            "plan": [
                {"pass": p.name, "why": p.why, "resolution": list(p.resolution), "bytes": p.memory} for p in plan.passes
            ],
            "executed": list(self.executed),
            "times": times,
            "seconds": seconds,
            "memory": sum(p.memory for p in plan.passes),
            "device": self.device,
            "settings": dict(plan.settings),
            "notes": [str(n) for n in notes],
        }
        planes = dict(planes)
        color, alpha, depth = planes.pop("color"), planes.pop("alpha"), planes.pop("depth")
        return Image(color, alpha, depth, planes, stats)

    def prepare(
        self,
        description: SceneDescription,
        settings: Settings | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Pack the voxels of a scene for the GPU, without OpenGL and from any thread; later draws, also of renderers
        that share with this one, find them and only upload. What was packed of other scenes is dropped.

        Args:
            description: the scene at one time.
            settings: the knobs that it will be drawn with; None takes the defaults.
            progress: called with the part that is done, in [0, 1]; an exception it raises stops the work.
        """
        settings = settings or Settings()
        wanted = [
            (f, role)
            for volume in description.volumes.values()
            if any(s > 0.0 for s in volume.medium.strength)
            for role in FIELD_COMPONENTS
            if (f := getattr(volume, role)) is not None and f.grid.active_count
        ]
        sizes = [max(int(field_dims(f).prod()), 1) for f, _ in wanted]
        for number, (f, role) in enumerate(wanted):
            if progress is not None:
                progress(sum(sizes[:number]) / sum(sizes))
            self._pack(f, settings, role)
        self._frame.shared.packed.keep(f for f, _ in wanted)
        if progress is not None:
            progress(1.0)

    def prepare_field(self, f: Field, settings: Settings, role: str) -> None:
        """Pack one field as `prepare` does; `role` is what a volume uses it for: density, temperature or emission."""
        if f.grid.active_count:
            self._pack(f, settings, role)

    def _pack(self, f: Field, settings: Settings, role: str) -> None:
        memory, limit = settings.field_memory * 2**20, self.limits.texture_3d_size
        sparse = settings.sparse if role in SPARSE_ROLES else "off"
        self._frame.shared.packed.prepare(f, memory, limit, FIELD_COMPONENTS.get(role, 1), sparse)
        if role == "density":
            # Plans ask for it, and it takes a look at every voxel.
            FITS.get(("densities", f.key), lambda: density_range(f.grid))

    def forget_drawn(self) -> None:
        """Let the next draw run every pass again but the upload of the voxels, which stay."""
        self._stop()
        self._states = {name: state for name, state in self._states.items() if name == "fields"}
        self._finished = None

    def forget_scene(self) -> None:
        """Free what belongs to the scene last rendered; compiled shaders stay."""
        self._stop()
        with self.context:
            self._frame.release_scene()
        self._states.clear()
        self._finished = None
        self._atlases = (None, None)

    def _stop(self) -> None:
        """End a drawing that is under way."""
        if self._drawing is not None:
            self._drawing.close()
            self._drawing = None

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
            planes["volume"] = plane(plan.media_target, 0)[..., :3].copy()
            planes["transmittance"] = plane(plan.media_target, 1)[..., :3].copy()
            if plan.defines["HAS_EMISSION"]:
                planes["emission"] = plane(plan.media_target, 2)[..., :3].copy()
        return planes

    def release(self) -> None:
        """Free all resources but those that others share, and the context if a renderer made it."""
        if self.context is None:
            return
        self._stop()
        with self.context:
            self._frame.release()
        if self._owns_context and not self._frame.shared.users:
            self.context.release()
        self.context = None


def _per_depth(plan: Plan) -> np.ndarray:
    """Distance along each pixel's ray per unit of depth along the camera's axis, rows from the top."""
    u = (np.arange(plan.width) + 0.5) / plan.width
    v = (np.arange(plan.height)[::-1] + 0.5) / plan.height
    d0, du, dv = plan.rays.direction
    direction = d0 + u[None, :, None] * du + v[:, None, None] * dv
    return np.linalg.norm(direction, axis=-1)

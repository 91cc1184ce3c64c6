"""A picture that refines itself: drafts while something moves, the full quality when nothing does.

`Picture` is given a request for every frame of the window and works on it for as long as it is told to. What it shows
is always a whole picture: the last one that was finished, kept in a texture of its own.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Hashable
from contextlib import closing
from dataclasses import dataclass

import moderngl
import numpy as np

from ..description import Camera
from ..errors import PrevisError
from ..image import Image
from ..index import RenderIndex
from ..render.planned import Plan
from ..render.renderer import Renderer, Samples, sample_shifts
from ..settings import Settings
from .refinement import FINER_METHOD, FINISHED, Level, LevelName, Pace, SliceCounts, finer_levels

#: Length of the pieces that a picture at rest is drawn in, so that the window can be drawn in between.
PIECE_SECONDS = 0.008
#: The first picture of a request is drawn to its end without a frame of the window in between, unless it takes longer.
FIRST_PATIENCE = 0.15


@dataclass(frozen=True)
class Request:
    """What is to be seen. Requests with equal keys show the same picture."""

    key: Hashable
    index: RenderIndex
    camera: Camera
    size: tuple[int, int]
    settings: Settings


@dataclass
class _Drawing:
    request: Request
    level: Level
    renderer: Renderer
    plan: Plan
    pieces: Generator[float, None, None]
    times: dict[str, float]
    arrived: float
    #: Whether it is the first picture of its request.
    first: bool
    #: The planes of all samples, where there are several per pixel.
    samples: Samples | None = None
    seconds: float = 0.0


class Picture:
    """One picture of the view, refined step by step.

    Args:
        context: the window's OpenGL context.
        share: a picture whose compiled shaders and voxels are used too.

    Attributes:
        level: name of the level shown, "" before the first picture.
        executed: names of the passes that ran for the first picture of the present request, which is what an edit cost.
        times: seconds per pass of the picture shown.
        plan: the plan of the picture shown.
        error: why the present request cannot be drawn; the last good picture stays.
        serial: moves with every picture shown.
        progress: done part of the picture being drawn, in [0, 1].
        latency: seconds from the arrival of the request shown to its first picture.
        converging: whether levels beyond the final one are wanted; see `refine`.
        refusal: why the levels beyond the final one end before the truth; "" where they do not.
    """

    def __init__(self, context: moderngl.Context, share: Picture | None = None) -> None:
        self.context = context
        self._draft = Renderer(context, share=share.renderer if share else None)
        # Levels of different sizes have maps and targets of their own, or every edit would make them anew.
        self._final = Renderer(context, share=self._draft)
        self.pace = Pace(self._draft.is_software)
        self.level: LevelName | str = ""
        self.executed: tuple[str, ...] = ()
        self.times: dict[str, float] = {}
        self.plan: Plan | None = None
        self.error = ""
        self.serial = 0
        self.progress = 0.0
        self.latency = 0.0
        self.converging = False
        self.refusal = ""
        self._wanted: Request | None = None
        self._arrived = 0.0
        self._shown: tuple[Request, Level] | None = None
        self._failed: Hashable = None
        self._drawing: _Drawing | None = None
        self._samples: Samples | None = None
        self._image: Image | None = None
        self._finer: tuple[Level, ...] = ()
        self._copy: moderngl.Framebuffer | None = None

    @property
    def renderer(self) -> Renderer:
        """The renderer that others may share with."""
        return self._draft

    @property
    def texture(self) -> moderngl.Texture | None:
        """The picture shown: linear, premultiplied, bottom row first; None before the first."""
        return self._copy.color_attachments[0] if self._copy is not None else None

    @property
    def finished(self) -> bool:
        """Whether what is shown is the present request as its settings ask for it, or better where that is wanted."""
        return self._is_shown() and (self.level == "final" or (self.converging and self.level in FINISHED))

    @property
    def current(self) -> bool:
        """Whether what is shown belongs to the present request, at whatever level."""
        return self._is_shown()

    @property
    def shown_settings(self) -> Settings | None:
        """What the picture shown was drawn with; None before the first."""
        return self._shown[1].settings if self._shown is not None else None

    @property
    def shown_request(self) -> Request | None:
        """What the picture shown was asked for by; None before the first."""
        return self._shown[0] if self._shown is not None else None

    @property
    def finer(self) -> tuple[int, int]:
        """How many levels beyond the final one are shown, and how many there are."""
        return (self._shown[1].number if self._shown is not None else 0), len(self._finer)

    @property
    def refining(self) -> bool:
        """Whether a level beyond the final one is being drawn."""
        return self._drawing is not None and self._drawing.level.number > 0

    @property
    def can_refine(self) -> bool:
        """Whether `refine` would begin another level."""
        if not (self.converging and self.finished) or self._drawing is not None or self.refusal:
            return False
        return self._failed is None and self.finer[0] < self.finer[1]

    def refine(self) -> bool:
        """Begin the next level beyond the final one, which `work` goes on with; returns whether there is one."""
        return self.can_refine and self._start(self._finer[self.finer[0]])

    def drop_refinement(self) -> None:
        """Give up the level beyond the final one that is being drawn; `refine` begins it anew."""
        if self.refining:
            self._drop()

    def _is_shown(self) -> bool:
        return self._shown is not None and self._wanted is not None and self._shown[0].key == self._wanted.key

    def show(self, request: Request) -> None:
        """Ask for a picture; the same key again changes nothing."""
        if self._wanted is None or self._wanted.key != request.key:
            self._wanted, self._arrived = request, time.perf_counter()
            self.error, self._failed, self.refusal = "", None, ""

    def pending(self, moving: bool) -> bool:
        """Whether `work` has anything to do; while something moves a draft is enough."""
        if self._wanted is None or self._failed == self._wanted.key:
            return False
        # The first picture of a request that was taken back is still to come, and then this one again.
        if not self._is_shown() or (self._drawing is not None and self._drawing.first):
            return True
        return not moving and not self.finished

    def work(self, seconds: float, moving: bool) -> bool:
        """Draw for about so long; returns whether another picture is shown now.

        The first picture of a request is finished even when the request has changed meanwhile, or a hand that never
        rests would see nothing. Two pictures that share and want different voxels are worked on one after the other:
        by turns, each would take the other's voxels out of the atlas.
        """
        with self.context:
            # What the window itself drew is not paid from the picture's time.
            self.context.finish()
        begin = time.perf_counter()
        changed = False
        while True:
            if self._drawing is not None and not self._drawing.first:
                unwanted = self.refining and not self.converging
                if moving or unwanted or self._wanted is None or self._drawing.request.key != self._wanted.key:
                    self._drop()
            if self._drawing is None and not (self.pending(moving) and self._start()):
                return changed
            drawing = self._drawing
            assert drawing is not None
            if self._piece(drawing):
                changed = True
                if not self.pending(moving):
                    return changed
            spent = time.perf_counter() - begin
            patience = FIRST_PATIENCE if self._drawing is not None and drawing.first else seconds
            # Another piece that ends too late would hold up the window.
            if spent + PIECE_SECONDS > patience:
                return changed

    def _start(self, level: Level | None = None) -> bool:
        """Begin a level of the request, the next one by default; False when it cannot be drawn."""
        request = self._wanted
        assert request is not None
        width, height = request.size
        first = not self._is_shown()
        if first:
            level = self.pace.first(width, height, request.settings)
        elif level is None:
            # From beyond the final level, which is no longer wanted, the way is back to it.
            reached = "preview" if self.level in FINISHED else self.level
            level = self.pace.next(reached, width, height, request.settings)
        if level is None:
            return False
        renderer = self._draft if level.name == "draft" else self._final
        times: dict[str, float] = {}
        try:
            plan = renderer.plan(request.index, request.camera, *level.size(width, height), level.settings)
        except PrevisError as error:
            self._fail(request, level, error)
            return False
        pieces = renderer.drawing(plan, PIECE_SECONDS, times)
        self._drawing = _Drawing(request, level, renderer, plan, pieces, times, self._arrived, first)
        if level.settings.antialias > 1:
            self._drawing.samples = Samples()
            self._drawing.pieces = _sampled(self._drawing, self._drawing.samples)
        self.progress = 0.0
        return True

    def _piece(self, drawing: _Drawing) -> bool:
        """Draw one piece; True when it was the last and the picture is shown."""
        begin = time.perf_counter()
        try:
            self.progress = next(drawing.pieces)
            drawing.seconds += time.perf_counter() - begin
            return False
        except StopIteration:
            pass
        except PrevisError as error:
            self._drawing = None
            self._fail(drawing.request, drawing.level, error)
            return False
        except BaseException:
            # Asked again, the pieces would be at their end, and nothing was drawn.
            self._drawing = None
            raise
        self._drawing = None
        self._keep(drawing)
        drawing.seconds += time.perf_counter() - begin
        # Pictures that reuse most of their passes say nothing of the pace.
        if drawing.level.number == 0 and any(name == "march" for name in drawing.renderer.executed):
            samples = drawing.level.settings.antialias**2
            self.pace.measured(drawing.level, drawing.plan.width * drawing.plan.height * samples, drawing.seconds)
        if drawing.first:
            self.executed = tuple(drawing.renderer.executed)
            self.latency = time.perf_counter() - drawing.arrived
        self._shown, self._samples = (drawing.request, drawing.level), drawing.samples
        self.level, self.times, self.plan = drawing.level.name, drawing.times, drawing.plan
        self._image = None
        if self.level == "final":
            self._finer = self._levels_beyond(drawing.request, drawing.plan)
        elif not drawing.level.number:
            self._finer = ()
        self.progress = 1.0
        self.serial += 1
        return True

    def _levels_beyond(self, request: Request, plan: Plan) -> tuple[Level, ...]:
        """The levels after the final one, which was drawn by that plan."""
        if plan.maps and not plan.map_slices:
            settings = request.settings.replace(transmittance=FINER_METHOD)
            plan = self._final.plan(request.index, request.camera, plan.width, plan.height, settings)
        counts = SliceCounts(plan.map_size, plan.map_slices, len(plan.maps))
        return finer_levels(request.settings, plan.volumes, counts)

    def _fail(self, request: Request, level: Level, error: PrevisError) -> None:
        if level.number:
            # The picture has what was asked for, and keeps it.
            self.refusal = str(error)
            return
        # What is wrong with a request of the past is nothing to the present one, which is tried next.
        if self._wanted is not None and self._wanted.key == request.key:
            self.error, self._failed = str(error), request.key

    def _keep(self, drawing: _Drawing) -> None:
        """Copy the finished picture, whose target the next level may make anew."""
        texture = drawing.renderer.texture()
        with self.context:
            if self._copy is None or self._copy.size != texture.size:
                self._free_copy()
                held = self.context.texture(texture.size, 4, dtype="f4")
                held.repeat_x = held.repeat_y = False
                self._copy = self.context.framebuffer([held])
            if drawing.samples is not None:
                planes = drawing.samples.planes()
                rows = np.concatenate([planes["color"], planes["alpha"][..., None]], axis=-1, dtype=np.float32)[::-1]
                self._copy.color_attachments[0].write(np.ascontiguousarray(rows))
                return
            source = self.context.framebuffer([texture])
            self.context.copy_framebuffer(self._copy, source)
            source.release()

    def _drop(self) -> None:
        if self._drawing is not None:
            self._drawing.pieces.close()
            self._drawing = None
            self.progress = 0.0

    def give_up(self) -> None:
        """Do not try the present request again; the last good picture stays."""
        self._drop()
        if self._wanted is not None:
            self._failed = self._wanted.key

    def read(self) -> np.ndarray:
        """Linear radiance of the picture shown, (H, W, 3) float32, rows from the top.

        Raises:
            ValueError: when nothing is shown yet.
        """
        if self._copy is None:
            raise ValueError("there is no picture yet")
        width, height = self._copy.size
        with self.context:
            data = self._copy.read(components=3, dtype="f4", alignment=1)
        return np.frombuffer(data, np.float32).reshape(height, width, 3)[::-1].copy()

    def image(self) -> Image | None:
        """The finished picture with all its planes, read back; None while it is not finished.

        It is kept: a level beyond it that is being drawn may have taken the place of its planes, and where they were
        not read before, there is no picture until that level is finished.
        """
        if not self.finished or self.plan is None:
            return None
        if self._image is None and self._drawing is None:
            self._image = self._final.image(self.plan, self.times, self._samples)
        return self._image

    def forget(self) -> None:
        """Let go of the scene: nothing is shown until the next request."""
        self._drop()
        self._wanted = self._shown = self._failed = self._samples = self._image = None
        self._finer = ()
        self.level, self.plan, self.error = "", None, ""
        for renderer in (self._final, self._draft):
            renderer.forget_scene()
        with self.context:
            self._free_copy()

    def _free_copy(self) -> None:
        if self._copy is not None:
            held = self._copy.color_attachments[0]
            self._copy.release()
            held.release()
            self._copy = None

    def release(self) -> None:
        """Free everything."""
        self._drop()
        with self.context:
            self._free_copy()
        self._final.release()
        self._draft.release()


def _sampled(drawing: _Drawing, samples: Samples) -> Generator[float, None, None]:
    """Draw all samples of a picture, a piece at a time; yields the done part, in [0, 1]."""
    request, level, renderer = drawing.request, drawing.level, drawing.renderer
    shifts = sample_shifts(level.settings.antialias)
    width, height = level.size(*request.size)
    for number, shift in enumerate(shifts):
        drawing.plan = renderer.plan(request.index, request.camera, width, height, level.settings, shift)
        with closing(renderer.drawing(drawing.plan, PIECE_SECONDS, drawing.times)) as pieces:
            for fraction in pieces:
                yield (number + fraction) / len(shifts)
        samples.add(renderer.planes(drawing.plan))

"""Pictures as a window shows them: exposure, the display transform, and two pictures compared.

A finished picture stays on the GPU: `DisplayPass` turns its linear radiance into 8-bit display values as
`previs.io.display` does for files, in the context in which it was drawn. A view of OpenColorIO is looked up in a
lattice that `previs.io.bake_lut` makes. It knows nothing of scenes and plans, and nothing of a window either: it draws
into a texture of its own.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import moderngl
import numpy as np

from .. import io
from .context import check_errors
from .shader import ShaderCache

UNITS = {"picture_a": 0, "picture_b": 1, "lut": 2, "colormap": 3, "mean_level": 4}
VIEW_NUMBERS = {"disabled": 0, "sRGB": 1, "openColorIO": 2}
COMPARE_NUMBERS = {"off": 0, "wipe": 1, "error": 2}

#: Shown where a compared picture holds NaN or an infinity: a display colour that the table does not hold.
ALARM = (0.0, 1.0, 0.0)
#: Part of the mean of all values above 0 beyond which a pixel counts as lit.
LIT_PART = 1e-3
#: Blocks along a side that a picture's values are summed in.
_BLOCKS = 64
#: Views whose lattice stays on the GPU.
_KEPT_VIEWS = 3


@dataclass(frozen=True)
class DisplayTransform:
    """How linear radiance becomes display values; names and ranges as for `previs.io.display`.

    `exposure` is in stops, a number. `display` and `view` are names of the OpenColorIO config, None or empty its
    defaults; only the correction "openColorIO" reads them. `dither` adds up to half a step of 8 bits, so that slow
    gradients show no contours.

    Raises:
        ValueError: for another exposure or color_correction.
    """

    exposure: float = 0.0
    color_correction: str = "sRGB"
    display: str | None = None
    view: str | None = None
    dither: bool = True

    def __post_init__(self) -> None:
        if self.color_correction not in VIEW_NUMBERS:
            raise ValueError(f"color_correction: {self.color_correction!r} is not one of {', '.join(VIEW_NUMBERS)}")
        if isinstance(self.exposure, str) or not abs(self.exposure) <= io.EXPOSURE_LIMIT:
            limit = f"{io.EXPOSURE_LIMIT:g}"
            raise ValueError(f"exposure: {self.exposure!r} is not a number of stops from -{limit} to {limit}")


@dataclass(frozen=True)
class Compare:
    """How a second picture is shown: not at all, right of a divider, or the error of the first against it.

    `divider` is in [0, 1] of the width. The error is the largest difference of a channel over the mean of the second
    picture's lit values; `error_range` are the two errors at the ends of `error_colormap`, on a logarithmic scale.

    Raises:
        ValueError: for another mode, or an error range that does not rise from above 0.
    """

    mode: Literal["off", "wipe", "error"] = "off"
    divider: float = 0.5
    error_range: tuple[float, float] = (1e-3, 1.0)

    def __post_init__(self) -> None:
        if self.mode not in COMPARE_NUMBERS:
            raise ValueError(f"mode: {self.mode!r} is not one of {', '.join(COMPARE_NUMBERS)}")
        low, high = self.error_range
        if not 0.0 < low < high < math.inf:
            raise ValueError(f"error_range: {self.error_range!r} does not rise from above 0")


OFF = Compare()


class DisplayPass:
    """Shows pictures: one draw of the screen's size, and three small ones more for the error view.

    Make one for every window that shows a picture of its own: the texture that `draw` returns is drawn over by the next
    call. The context's bound framebuffer is the same after a draw as before it, with blending, depth test, culling and
    scissor off.

    Args:
        context: the one in which the pictures are.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shaders = ShaderCache(context, UNITS)
        self._target: moderngl.Framebuffer | None = None
        self._luts: OrderedDict[tuple, tuple[moderngl.Texture3D, tuple[float, float]]] = OrderedDict()
        self._colormap: moderngl.Texture | None = None
        self._sums: moderngl.Framebuffer | None = None
        self._levels: list[moderngl.Framebuffer] = []

    def draw(
        self,
        a: moderngl.Texture,
        size: tuple[int, int],
        transform: DisplayTransform | None = None,
        b: moderngl.Texture | None = None,
        compare: Compare = OFF,
    ) -> moderngl.Texture:
        """Draw a picture for the display.

        Args:
            a: linear radiance in its first three components, bottom row first. A picture of another size than `size` is
                interpolated.
            size: (width, height) of the result.
            transform: None takes the defaults.
            b: the picture to compare with; needed by the modes "wipe" and "error".
            compare: how.

        Returns:
            RGBA of 8 bits, opaque, bottom row first; owned by this pass, valid until it draws at another size or is
            released.

        Raises:
            PrevisError: when the OpenColorIO config cannot be used, or has no such display or view.
            ValueError: when there is no `b` to compare with.
        """
        transform = transform or DisplayTransform()
        if compare.mode != "off" and b is None:
            raise ValueError(f"mode {compare.mode!r} compares two pictures, and there is one")
        with self._context:
            before = self._context.detect_framebuffer()
            try:
                target = self._sized_target(size)
                program = self._shaders.get(
                    "fullscreen.vert",
                    "display.frag",
                    VIEW=VIEW_NUMBERS[transform.color_correction],
                    COMPARE=COMPARE_NUMBERS[compare.mode],
                    DITHER=transform.dither,
                )
                program.set(
                    target_size=size,
                    gain=2.0**transform.exposure,
                    divider=compare.divider * size[0],
                    error_range=compare.error_range,
                    alarm=ALARM,
                )
                self._context.enable_only(moderngl.NOTHING)
                if compare.mode == "error":
                    self._measure_level(b)
                    self._levels[1].color_attachments[0].use(UNITS["mean_level"])
                    self._colormap_texture().use(UNITS["colormap"])
                elif transform.color_correction == "openColorIO":
                    lut, shaper = self._lut(transform.display, transform.view)
                    lut.use(UNITS["lut"])
                    program.set(lut_shaper=shaper)
                a.use(UNITS["picture_a"])
                if b is not None:
                    b.use(UNITS["picture_b"])
                target.use()
                self._fill(program)
                check_errors(self._context, "display")
            finally:
                before.use()
        return target.color_attachments[0]

    def _fill(self, program) -> None:
        vertex_array = self._context.vertex_array(program.program, [])
        vertex_array.render(moderngl.TRIANGLES, vertices=3)
        vertex_array.release()

    def _measure_level(self, picture: moderngl.Texture) -> None:
        """Leave the mean of the picture's lit values in the second of the level targets."""
        if self._sums is None:
            self._sums = self._framebuffer((_BLOCKS, _BLOCKS), "f4")
            self._levels = [self._framebuffer((1, 1), "f4") for _ in range(2)]
        sums = self._shaders.get("fullscreen.vert", "mean_level.frag", SUMS=True)
        ratio = self._shaders.get("fullscreen.vert", "mean_level.frag", SUMS=False)
        for program in (sums, ratio):
            program.set(blocks=_BLOCKS)
        # First all that is above 0, then what is above a part of their mean: a faint haze does not make a pixel lit.
        for level, part in zip(self._levels, (0.0, LIT_PART), strict=True):
            sums.set(lit_part=part)
            picture.use(UNITS["picture_b"])
            self._levels[0].color_attachments[0].use(UNITS["mean_level"])
            self._sums.use()
            self._fill(sums)
            self._sums.color_attachments[0].use(UNITS["picture_b"])
            level.use()
            self._fill(ratio)

    def _framebuffer(self, size: tuple[int, int], dtype: str) -> moderngl.Framebuffer:
        return self._context.framebuffer([self._context.texture(size, 4, dtype=dtype)])

    def _sized_target(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        if self._target is None or self._target.size != size:
            old, self._target = self._target, self._framebuffer(size, "f1")
            texture = self._target.color_attachments[0]
            texture.repeat_x = texture.repeat_y = False
            # After the new one is made, as moderngl binds the last used framebuffer again then.
            _free(old)
        return self._target

    def _lut(self, display: str | None, view: str | None) -> tuple[moderngl.Texture3D, tuple[float, float]]:
        views = io.color_views()
        key = (views.config, *views.chosen(display, view))
        if key not in self._luts:
            baked = io.bake_lut(*key[1:])
            size = baked.values.shape[2::-1]
            texture = self._context.texture3d(
                size, 3, baked.values.astype(np.float16).tobytes(), alignment=2, dtype="f2"
            )
            self._luts[key] = (texture, (baked.offset, baked.maximum))
            while len(self._luts) > _KEPT_VIEWS:
                self._luts.popitem(last=False)[1][0].release()
        self._luts.move_to_end(key)
        return self._luts[key]

    def _colormap_texture(self) -> moderngl.Texture:
        if self._colormap is None:
            table = (error_colormap() * 255.0 + 0.5).astype(np.uint8)
            self._colormap = self._context.texture((len(table), 1), 3, table.tobytes(), alignment=1)
        return self._colormap

    def release(self) -> None:
        """Free everything."""
        with self._context:
            for framebuffer in (self._target, self._sums, *self._levels):
                _free(framebuffer)
            for texture, _ in self._luts.values():
                texture.release()
            if self._colormap is not None:
                self._colormap.release()
            self._shaders.release()
        self._target = self._sums = self._colormap = None
        self._levels = []
        self._luts.clear()


def _free(framebuffer: moderngl.Framebuffer | None) -> None:
    if framebuffer is None:
        return
    attachments = framebuffer.color_attachments
    framebuffer.release()
    for texture in attachments:
        texture.release()


#: Lightness and hue (degrees) of the table's ends in OKLCh: from a dark blue by red to a light yellow.
_COLORMAP_LIGHTNESS, _COLORMAP_HUE = (0.26, 0.96), (-95.0, 105.0)


@cache
def error_colormap() -> np.ndarray:
    """The colours of the error view from the lowest error to the highest: (256, 3) float32 sRGB values in [0, 1].

    Lightness and hue run evenly in OKLab, as colourful as sRGB can be there, so that equal steps look equal and the
    order shows without colour vision.
    """
    position = np.linspace(0.0, 1.0, 256)
    lightness = np.interp(position, (0.0, 1.0), _COLORMAP_LIGHTNESS)
    hue = np.radians(np.interp(position, (0.0, 1.0), _COLORMAP_HUE))
    direction = np.stack([np.cos(hue), np.sin(hue)], axis=-1)
    low, high = np.zeros(256), np.full(256, 0.4)
    for _ in range(24):
        middle = 0.5 * (low + high)
        inside = _linear_from_oklab(lightness, middle[:, None] * direction)
        fits = ((inside >= 0.0) & (inside <= 1.0)).all(axis=-1)
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    # The gamut's corners would show as rings: a running mean rounds them off, and its minimum with the limit stays
    # inside.
    smooth = np.convolve(np.pad(low, 32, mode="edge"), np.full(65, 1.0 / 65.0), mode="valid")
    linear = _linear_from_oklab(lightness, (np.minimum(smooth, low) * 0.95)[:, None] * direction).clip(0.0, 1.0)
    curved = 1.055 * np.maximum(linear, 1e-9) ** (1.0 / 2.4) - 0.055
    table = np.where(linear <= 0.0031308, 12.92 * linear, curved).astype(np.float32)
    table.flags.writeable = False
    return table


def _linear_from_oklab(lightness: np.ndarray, ab: np.ndarray) -> np.ndarray:
    """Linear Rec.709 of OKLab colours (Ottosson 2020)."""
    a, b = ab[..., 0], ab[..., 1]
    cone_roots = np.stack(
        [
            lightness + 0.3963377774 * a + 0.2158037573 * b,
            lightness - 0.1055613458 * a - 0.0638541728 * b,
            lightness - 0.0894841775 * a - 1.2914855480 * b,
        ],
        axis=-1,
    )
    matrix = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    return cone_roots**3 @ matrix.T


def error_scale(error_range: Sequence[float] = OFF.error_range) -> tuple[tuple[float, str], ...]:
    """Where the whole decades lie on the error view's scale: (position in [0, 1], label in percent), rising."""
    low, high = (math.log10(e) for e in error_range)
    decades = range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1)
    return tuple(((d - low) / (high - low), f"{100.0 * 10.0**d:g} %") for d in decades)

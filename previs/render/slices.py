"""The light-space grids of all pairs of light and volume: optical depth at even distances along every light ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable

import moderngl

from .method import SLICES_PER_DRAW
from .planned import Plan

#: Textures of four slices each that a draw fills.
LAYERS = SLICES_PER_DRAW // 4


class SliceAtlas:
    """One 3D texture with a tile per pair: slices along x, the map's rays along y and z.

    `owners` are the names of the passes that filled its tiles last.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shape: Hashable = None
        self.texture: moderngl.Texture3D | None = None
        self.owners: dict[int, str] = {}

    @staticmethod
    def _shape_of(plan: Plan) -> Hashable:
        return plan.map_atlas.size, plan.map_atlas.columns, plan.map_slices

    def update(self, plan: Plan) -> None:
        """Make the texture for a plan, unless the one that is held does; a larger one keeps what the tiles hold."""
        shape, wanted = self._shape_of(plan), (plan.map_slices, *plan.map_atlas.extent)
        held = self.texture if shape == self._shape else None
        if held is not None and _fits(held.size, wanted):
            return
        texture = self._context.texture3d(wanted, 1, dtype="f2")
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = texture.repeat_z = False
        owners = {}
        if held is not None and held.width <= wanted[0] and held.height <= wanted[1] and held.depth <= wanted[2]:
            copied = self._context.buffer(reserve=2 * held.width * held.height * held.depth)
            held.read_into(copied, alignment=1)
            texture.write(copied, viewport=(0, 0, 0, *held.size), alignment=1)
            copied.release()
            owners = self.owners
        self.release()
        self.texture, self._shape, self.owners = texture, shape, owners

    def owner(self, plan: Plan, tile: int) -> str | None:
        """The name of the pass whose map is in a tile of the plan; None where there is none that fits the plan."""
        return self.owners.get(tile) if self._shape == self._shape_of(plan) else None

    def release(self) -> None:
        """Free the texture."""
        if self.texture is not None:
            self.texture.release()
        self.texture, self._shape = None, None
        self.owners = {}


def _fits(held: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether a texture is large enough for what is wanted, and not far too large."""
    large_enough = all(h >= w for h, w in zip(held, wanted, strict=True))
    return large_enough and math.prod(held) <= 4 * math.prod(wanted)


class SliceTargets:
    """What the slices of one tile are drawn into, a draw at a time, before they are copied; a context that frees it.

    Args:
        context: to make it in.
        extent: texels of the tile, across and up.
        leave: called before it is freed; binds another framebuffer. moderngl binds again what was bound last whenever
            it makes one, and that may be gone by then.
    """

    def __init__(self, context: moderngl.Context, extent: tuple[int, int], leave: Callable[[], None]) -> None:
        self._extent, self._leave = extent, leave
        self._layers = [context.texture(extent, 4, dtype="f2") for _ in range(LAYERS)]
        # The depth that one draw came to is read by the next: two take turns.
        self._reached = [context.texture(extent, 1, dtype="f4") for _ in range(2)]
        for texture in self._reached:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._framebuffers = [context.framebuffer([*self._layers, texture]) for texture in self._reached]
        self._copied = context.buffer(reserve=extent[0] * extent[1] * 8)

    def __enter__(self) -> SliceTargets:
        return self

    def __exit__(self, *_: object) -> None:
        self._leave()
        for resource in (*self._framebuffers, *self._layers, *self._reached, self._copied):
            resource.release()

    def framebuffer(self, number: int) -> moderngl.Framebuffer:
        """What the draw of that number goes into."""
        return self._framebuffers[number % 2]

    def previous(self, number: int) -> moderngl.Texture:
        """The optical depth that the draw before that number came to."""
        return self._reached[(number + 1) % 2]

    def copy(self, number: int, texture: moderngl.Texture3D, corner: tuple[int, int]) -> None:
        """Copy the slices of a draw to where their tile begins. In memory the four of a texel lie side by side, as
        texels along x do."""
        framebuffer = self.framebuffer(number)
        for layer in range(LAYERS):
            framebuffer.read_into(self._copied, components=4, attachment=layer, dtype="f2", alignment=1)
            place = (number * SLICES_PER_DRAW + 4 * layer, *corner, 4, *self._extent)
            texture.write(self._copied, viewport=place, alignment=1)

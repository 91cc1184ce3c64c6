"""The light-space grids of all pairs of light and volume: optical depth at even distances along every light ray."""

from __future__ import annotations

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
        layout = plan.map_atlas
        return layout.size, layout.columns, layout.capacity, plan.map_slices

    def update(self, plan: Plan) -> None:
        """Make the texture for a plan; where it is new every tile has to be filled again."""
        shape = self._shape_of(plan)
        if shape == self._shape:
            return
        self.release()
        size = (plan.map_slices, *plan.map_atlas.extent)
        self.texture = self._context.texture3d(size, 1, dtype="f2")
        self.texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self.texture.repeat_x = self.texture.repeat_y = self.texture.repeat_z = False
        self._shape = shape

    def owner(self, plan: Plan, tile: int) -> str | None:
        """The name of the pass whose map is in a tile of the plan; None where there is none that fits the plan."""
        return self.owners.get(tile) if self._shape == self._shape_of(plan) else None

    def release(self) -> None:
        """Free the texture."""
        if self.texture is not None:
            self.texture.release()
        self.texture, self._shape = None, None
        self.owners = {}


class SliceTargets:
    """What the slices of one tile are drawn into, a draw at a time, before they are copied; a context that frees it.

    Args:
        context: to make it in.
        size: texels along the side of the tile.
        leave: called before it is freed; binds another framebuffer. moderngl binds again what was bound last whenever
            it makes one, and that may be gone by then.
    """

    def __init__(self, context: moderngl.Context, size: int, leave: Callable[[], None]) -> None:
        self._size, self._leave = size, leave
        self._layers = [context.texture((size, size), 4, dtype="f2") for _ in range(LAYERS)]
        # The depth that one draw came to is read by the next: two take turns.
        self._reached = [context.texture((size, size), 1, dtype="f4") for _ in range(2)]
        for texture in self._reached:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._framebuffers = [context.framebuffer([*self._layers, texture]) for texture in self._reached]
        self._copied = context.buffer(reserve=size * size * 8)

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
            place = (number * SLICES_PER_DRAW + 4 * layer, *corner, 4, self._size, self._size)
            texture.write(self._copied, viewport=place, alignment=1)

"""Which tiles of an atlas belong to whom: plain data, handed from one plan to the next.

An owner keeps its tiles as long as it can: a light that is hidden, dimmed to nothing or added moves no map of another
light, and one that is shown again finds its own where it was.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

#: Idle owners that keep their tiles, at the least; beyond it as many as there are owners in use.
IDLE_OWNERS = 16


@dataclass(frozen=True)
class AtlasLayout:
    """Square tiles of `size` texels, numbered along rows of `columns`; there are `capacity` of them.

    `spans` gives the tiles of every owner, those in use last and the idle ones before them, longest unused first.
    """

    size: int = 0
    columns: int = 1
    capacity: int = 0
    spans: Mapping[Hashable, range] = field(default_factory=dict)

    @property
    def extent(self) -> tuple[int, int]:
        """(width, height) of the atlas in texels."""
        return min(self.capacity, self.columns) * self.size, -(-self.capacity // self.columns) * self.size

    def corner(self, tile: int) -> tuple[int, int]:
        """Lower left texel of a tile."""
        return tile % self.columns * self.size, tile // self.columns * self.size


def lay_out(
    previous: AtlasLayout | None,
    wanted: Sequence[tuple[Hashable, int]],
    size: int,
    tile_bytes: int,
    texture_size: int,
    memory: int,
) -> AtlasLayout:
    """A layout that has tiles for all that are wanted, and as many as possible where they were.

    Args:
        previous: the layout before; None begins anew.
        wanted: owners, and how many tiles side by side each needs. All together fit the texture.
        size: texels along the side of a tile.
        tile_bytes: of one tile, in all textures of the atlas.
        texture_size: largest edge of a texture.
        memory: bytes up to which the atlas may have room to spare.
    """
    columns = max(texture_size // max(size, 1), 1)
    kept: dict[Hashable, range] = {}
    capacity = 0
    if previous is not None and (previous.size, previous.columns) == (size, columns):
        kept, capacity = dict(previous.spans), previous.capacity
    counts = dict(wanted)
    in_use = {k: kept[k] for k, n in counts.items() if k in kept and len(kept[k]) == n}
    idle = {k: r for k, r in kept.items() if k not in counts}
    while len(idle) > max(IDLE_OWNERS, len(counts)):
        del idle[next(iter(idle))]
    for owner, count in counts.items():
        if owner in in_use:
            continue
        # A gap, else the place of the longest unused, else behind all.
        first = _gap([*in_use.values(), *idle.values()], count, capacity)
        while first is None and idle:
            del idle[next(iter(idle))]
            first = _gap([*in_use.values(), *idle.values()], count, capacity)
        if first is None:
            first = _gap(in_use.values(), count, columns * columns)
        if first is None:
            # Enough tiles, but not side by side.
            return lay_out(None, wanted, size, tile_bytes, texture_size, memory)
        in_use[owner] = range(first, first + count)
        capacity = max(capacity, first + count)
    spans = {**idle, **{k: in_use[k] for k in counts}}
    needed = max((r.stop for r in spans.values()), default=0)
    roomy = _with_room(needed, columns)
    if roomy * tile_bytes > memory:
        roomy = needed
    # It shrinks only where that is worth the copying.
    if not needed <= capacity <= 4 * roomy or capacity * tile_bytes > memory:
        if idle and roomy * tile_bytes > memory:
            return lay_out(None, wanted, size, tile_bytes, texture_size, memory)
        capacity = roomy
    return AtlasLayout(size, columns, max(capacity, roomy), spans)


def _gap(spans, count: int, capacity: int) -> int | None:
    """The first of `count` free tiles in a row among `capacity`."""
    begin = 0
    for span in sorted(spans, key=lambda r: r.start):
        if span.start - begin >= count:
            return begin
        begin = max(begin, span.stop)
    return begin if capacity - begin >= count else None


def _with_room(needed: int, columns: int) -> int:
    """Tiles of an atlas that grows seldom: a power of two in the first row, then whole rows."""
    if needed <= columns:
        return min(1 << max(needed - 1, 0).bit_length(), columns) if needed else 0
    return -(-needed // columns) * columns

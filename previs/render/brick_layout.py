"""Where bricks lie in the block of voxels that holds them.

Neighbouring bricks share the layer of texels between them when they are stored side by side. So bricks are joined to
bars along x, of a cross-section of 4×4, 2×2 or one brick, and bars are laid end to end in lines of one length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Choices of the cross-sections of bars, in bricks along their side, widest first. Wide bars share more layers, and
#: leave more room unused where bricks are few.
SECTIONS = ((1,), (2, 1), (4, 2, 1))
#: Bricks along a bar at the most.
LONGEST = 8
#: A block of more texels is a multiple of so many along x and y: textures are held in tiles, and what is left of one is
#: lost.
LARGE, TILE = 2**25, 64
#: Texels along x, y, z of a block at the most: where a brick begins has so many bits.
MOST_TEXELS = (2047, 2047, 1023)


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each of the bricks begins in the block, (n, 3) int16, texels along x, y, z, and the size of the block.

    No brick lies across one of the `cuts` along z, which begin with 0 and end with the depth of the block.
    """

    origins: np.ndarray
    size: tuple[int, int, int]
    cuts: tuple[int, ...]

    @property
    def texels(self) -> int:
        """Texels of the block."""
        return self.size[0] * self.size[1] * self.size[2]


@dataclass(frozen=True, eq=False)
class _Bars:
    """Bars of one cross-section: `members` (n, section²) are the bricks of the slices of all bars in order, `lengths`
    the slices of each."""

    section: int
    members: np.ndarray
    lengths: np.ndarray


def lay_out(bricks: np.ndarray, edge: int, texture_limit: int) -> Layout | None:
    """Lay bricks out compactly.

    Args:
        bricks: (n, 3) whole numbers along x, y, z, all different, 0 or more.
        edge: intervals along a brick, which takes a texel more.
        texture_limit: texels along an edge at the most.

    Returns:
        None where no block of that size holds them.
    """
    if not len(bricks):
        return Layout(np.zeros((0, 3), np.int16), (1, 1, 1), (0, 1))
    # One after the other, as each takes memory.
    found = (_lay_out(_join(bricks, sections), edge, texture_limit, len(bricks)) for sections in SECTIONS)
    return min((f for f in found if f is not None), key=lambda f: f.texels, default=None)


def _lay_out(bars: list[_Bars], edge: int, texture_limit: int, count: int) -> Layout | None:
    """Lay bars of so many bricks in lines, lines in rows and rows in shelves."""
    most = np.minimum(MOST_TEXELS, texture_limit)
    longest = max(int(b.lengths.max()) for b in bars if len(b.lengths)) * edge + 1
    sides = np.array([b.section * edge + 1 for b in bars])
    best = None
    unit = TILE if count * edge**3 > LARGE else 1
    widths = range(-(-longest // unit) * unit, 1024, unit)
    if unit == 1:
        widths = range(longest, longest + 16 * (edge + 1) + 1, edge + 1)
    for width in widths:
        if width > most[0]:
            break
        lines = [_lines(np.bincount(b.lengths, minlength=1), edge, width) for b in bars]
        counts = np.array([sum(n for n, _ in found) for found in lines])
        lowest = -(-int(sides[counts > 0].max()) // unit) * unit
        heights = np.arange(lowest, most[1] + 1, unit)
        rows = heights[:, None] // sides
        shelves = np.where(counts > 0, -(-counts // np.maximum(rows, 1)), 0)
        depths = shelves @ sides
        cost = np.where(
            depths <= most[2], (heights * depths * width).astype(float) + np.maximum(heights, depths), np.inf
        )
        i = int(np.argmin(cost))
        if np.isfinite(cost[i]) and (best is None or cost[i] < best[0]):
            best = (cost[i], width, int(heights[i]), int(depths[i]), lines)
    if best is None:
        return None
    _, width, height, depth, lines = best
    origins = np.zeros((count, 3), np.int16)
    shelf, cuts = 0, [0]
    for group, found in zip(bars, lines, strict=True):
        if not found:
            continue
        side = group.section * edge + 1
        begins = np.concatenate([[0], np.cumsum(group.lengths)])
        by_length = {n: np.flatnonzero(group.lengths == n) for n in np.unique(group.lengths)}
        used = dict.fromkeys(by_length, 0)
        line = 0
        per_shelf = height // side
        for repeated, pattern in found:
            at = line + np.arange(repeated)
            corner = np.stack([np.zeros_like(at), at % per_shelf * side, shelf + at // per_shelf * side], axis=1)
            x = 0
            for length in pattern:
                taken = by_length[length][used[length] : used[length] + repeated]
                used[length] += repeated
                for slice_ in range(length):
                    members = group.members[begins[taken] + slice_]
                    inside = np.arange(group.section**2)
                    place = corner[:, None, :] + np.stack(
                        [
                            np.full_like(inside, x + slice_ * edge),
                            inside % group.section * edge,
                            inside // group.section * edge,
                        ],
                        axis=1,
                    )
                    origins[members.reshape(-1)] = place.reshape(-1, 3)
                x += length * edge + 1
            line += repeated
        shelf += -(-line // per_shelf) * side
        cuts += range(cuts[-1] + side, shelf + 1, side)
    return Layout(origins, (width, height, depth), tuple(cuts))


def _join(bricks: np.ndarray, sections: tuple[int, ...]) -> list[_Bars]:
    """All bricks as bars, of the widest sections that they fill."""
    bricks = np.asarray(bricks, np.int64)
    left = np.arange(len(bricks))
    span = bricks.max(axis=0) + 1
    bars = []
    for section in sections:
        x, y, z = bricks[left].T
        slices = ((z // section) * (span[1] // section + 1) + y // section) * (span[0] + 1) + x
        # The order inside a section is that of its places.
        order = np.lexsort((z % section * section + y % section, slices))
        sorted_slices = slices[order]
        first = np.flatnonzero(np.diff(sorted_slices, prepend=-1))
        full = first[np.diff(first, append=len(order)) == section**2]
        # Along x a slice's number counts up by one, and a place is left free at the end of each row.
        numbers = sorted_slices[full]
        bar = np.flatnonzero(np.diff(numbers, prepend=-2) != 1)
        runs = np.diff(bar, append=len(full))
        members = left[order[full[:, None] + np.arange(section**2)]]
        # Long runs are cut.
        pieces = -(-runs // LONGEST)
        lengths = np.full(int(pieces.sum()), LONGEST)
        if len(runs):
            ends = np.cumsum(pieces) - 1
            lengths[ends] = runs - (pieces - 1) * LONGEST
        bars.append(_Bars(section, members, lengths))
        left = np.setdiff1d(left, members.reshape(-1), assume_unique=True)
    return bars


def _lines(counts: np.ndarray, edge: int, width: int) -> list[tuple[int, list[int]]]:
    """Bars end to end, the longest that fits first: lines of so many texels as (how often, lengths in bricks).

    `counts` tells the bars of each length.
    """
    left = {n: int(counts[n]) for n in range(len(counts) - 1, 0, -1) if counts[n]}
    found = []
    while left:
        pattern: list[int] = []
        room = width
        for length, count in left.items():
            fitting = min(room // (length * edge + 1), count)
            pattern += [length] * fitting
            room -= fitting * (length * edge + 1)
        repeated = min(left[n] // pattern.count(n) for n in set(pattern))
        found.append((repeated, pattern))
        for n in set(pattern):
            left[n] -= repeated * pattern.count(n)
            if not left[n]:
                del left[n]
    return found

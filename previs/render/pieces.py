"""How a long pass is cut into pieces, so that other things can be drawn in the same context in between.

A piece is a rectangle of the target, cut out by the scissor test: the same triangle, the same interpolation, and so the
same bits as in one draw. Its size follows from what the pixels there cost before.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Hashable, Iterator

import moderngl
import numpy as np

from .context import finisher

#: Side of the bins that Mesa's llvmpipe hands to its threads, in pixels. A piece of two bins or more keeps two busy.
BIN = 64
#: Pixels that the first piece of a picture may have, divided by GROWTH, whatever earlier pictures cost.
FIRST_AREA = 2 * BIN * BIN
#: Pixels of the first piece of a kind of work that was never drawn: each may take a thousand times what others take.
UNKNOWN_AREA = 2 * BIN * 4
#: A piece has at most so many times the pixels of the one before it: what is remembered of costs may be wrong.
GROWTH = 4.0
#: Costs are remembered on a grid of so many cells along both sides of a picture, for so many kinds of work.
CELLS = 32
MOST_KINDS = 256
#: Rows that a piece has at least; rasterisers work on blocks of pixels.
LEAST_ROWS = 4

Box = tuple[int, int, int, int]
#: A kind of work: its name, and the settings that its cost follows.
Kind = tuple[Hashable, Hashable]


class Piece:
    """One rectangle to draw, as a context: `scissor` is (x, y, width, height), or None for the whole target.

    Leaving the context waits for the drawing to end where pieces are timed. `done` is the part of the pass that is
    finished then.
    """

    def __init__(self, pace: Pace, costs: CostMap | None, box: Box, done: float) -> None:
        self._pace, self._costs, self._box, self._started = pace, costs, box, 0.0
        self.scissor: Box | None = None if costs is None else box
        self.done = done

    def __enter__(self) -> Piece:
        if self._costs is not None:
            # What others drew since the last piece is not this one's.
            self._pace.wait()
        self._started = time.perf_counter()
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        if failed is None and self._costs is not None:
            self._pace.finish(self._costs, self._box, self._started)


class Pace:
    """Cuts passes into pieces of about `seconds` each; None draws them whole.

    What a pixel costs is remembered by kind of work and place in the picture, from frame to frame and whatever the
    picture's size: a cloud before an empty sky costs a hundred times what the sky does, and the next frame shows it in
    nearly the same place.
    """

    def __init__(self, context: moderngl.Context) -> None:
        #: Waits until all that was drawn so far is finished.
        self.wait = finisher(context)
        self.seconds: float | None = None
        self._maps: dict[Kind, CostMap] = {}
        self._latest: dict[Hashable, CostMap] = {}

    def pieces(self, kind: Kind, size: tuple[int, int], first: float = 0.0, last: float = 1.0) -> Iterator[Piece]:
        """Pieces that cover a target of that size once; the pass is `first` done before them and `last` after."""
        width, height = size
        if self.seconds is None:
            yield Piece(self, None, (0, 0, width, height), last)
            return
        costs = self._maps.pop(kind, None)
        if costs is None:
            # Other settings of the same work: the picture is slow in the same places.
            costs = copy.deepcopy(self._latest.get(kind[0], CostMap()))
        for held in (self._maps, self._latest):
            while len(held) >= MOST_KINDS:
                held.pop(next(iter(held)))
        self._maps[kind] = self._latest[kind[0]] = costs
        costs.begin(size)
        drawn = 0
        for box in self._boxes(costs, width, height):
            drawn += box[2] * box[3]
            yield Piece(self, costs, box, first + (last - first) * drawn / (width * height))

    def finish(self, costs: CostMap, box: Box, started: float) -> None:
        """Wait for a piece and take its time."""
        self.wait()
        costs.learn(box, time.perf_counter() - started)

    def _boxes(self, costs: CostMap, width: int, height: int) -> Iterator[Box]:
        y = 0
        while y < height:
            # Strips over the full width: the more bins, the more evenly they keep the threads busy.
            rows = self._longest(costs, height - y, LEAST_ROWS, lambda n, y=y: (0, y, width, n))
            if rows:
                yield 0, y, width, rows
                y += rows
                continue
            # Where that is too much at once, a strip is cut across.
            rows = min(LEAST_ROWS, height - y)
            x = 0
            while x < width:
                columns = self._longest(costs, width - x, 2 * BIN, lambda n, x=x, y=y, rows=rows: (x, y, n, rows))
                columns = columns or min(2 * BIN, width - x)
                yield x, y, columns, rows
                x += columns
            y += rows

    def _longest(self, costs: CostMap, most: int, unit: int, box: Callable[[int], Box]) -> int:
        """The largest multiple of the unit, or the whole of `most`, for which a box fits a piece; 0 where none does."""
        assert self.seconds is not None
        if costs.fits(box(most), self.seconds):
            return most
        low, high = 0, -(-most // unit)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if costs.fits(box(middle * unit), self.seconds) else (low, middle)
        return low * unit


class CostMap:
    """What a pixel of one kind of work costs, in seconds, by its place in the picture."""

    def __init__(self) -> None:
        self._cells = np.full((CELLS, CELLS), np.nan)
        self._size = (1, 1)
        self._area = FIRST_AREA
        self._last = np.nan
        #: What pieces of this frame cost against what was expected: other settings, another scene.
        self._trend = 1.0

    def begin(self, size: tuple[int, int]) -> None:
        """A frame of that size begins."""
        self._size, self._area, self._trend = size, FIRST_AREA, 1.0

    def _overlap(self, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """The share of every row and every column of cells that a box takes up."""
        edges = np.arange(CELLS + 1) / CELLS
        shares = []
        for first, length, whole in ((box[1], box[3], self._size[1]), (box[0], box[2], self._size[0])):
            begin, end = first / whole, (first + length) / whole
            shares.append(np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], begin), 0.0, None) * CELLS)
        return shares[0], shares[1]

    def _expected(self, box: Box) -> float:
        """Seconds that a box should take; NaN where nothing is known of a part of it."""
        rows, columns = self._overlap(box)
        r, c = rows > 0.0, columns > 0.0
        cells = self._cells[np.ix_(r, c)]
        pixels = self._size[0] * self._size[1] / CELLS**2
        return float(rows[r] @ np.where(np.isnan(cells), self._last, cells) @ columns[c]) * pixels

    def fits(self, box: Box, seconds: float) -> bool:
        """Whether a box will take at most that long, as far as is known."""
        area = box[2] * box[3]
        if area > GROWTH * self._area:
            return False
        expected = self._expected(box) * self._trend
        return expected <= seconds if expected == expected else area <= UNKNOWN_AREA

    def learn(self, box: Box, seconds: float) -> None:
        """A box took that long."""
        area = box[2] * box[3]
        cost = seconds / area
        expected = self._expected(box)
        rows, columns = self._overlap(box)
        where = np.ix_(rows > 0.0, columns > 0.0)
        if expected == expected and expected > 0.0:
            ratio = seconds / expected
            # Up faster than down: a piece that is too small costs less than one that is too long.
            share = 0.7 if ratio > self._trend else 0.4
            self._trend = float(np.clip(self._trend ** (1.0 - share) * ratio**share, 0.1, 1e3))
            # What is known of the differences inside the box is kept, but may be wrong.
            known = np.where(np.isnan(self._cells[where]), cost, self._cells[where])
            self._cells[where] = 0.5 * (cost + np.clip(known * ratio, 0.0, 4.0 * cost))
        else:
            self._cells[where] = cost
        self._last, self._area = cost, max(area, FIRST_AREA // 4)

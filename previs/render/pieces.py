"""How a long pass is cut into pieces, so that other things can be drawn in the same context in between.

A piece is a rectangle of the target, cut out by the scissor test: the same triangle, the same interpolation, and so the
same bits as in one draw. Its size follows from how long earlier pieces took.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterator

import moderngl

#: Side of the bins that Mesa's llvmpipe hands to its threads, in pixels. A piece of two bins or more keeps two busy.
BIN = 64
#: Pixels of the first piece, before anything was measured.
FIRST_AREA = 2 * BIN * BIN
#: A piece has at most so many times the pixels of the one before it: its neighbour may cost more.
GROWTH = 2.0
#: Rows that a piece has at least; rasterisers work on blocks of pixels.
LEAST_ROWS = 4

Box = tuple[int, int, int, int]


class Piece:
    """One rectangle to draw, as a context: `scissor` is (x, y, width, height), or None for the whole target.

    Leaving the context waits for the drawing to end where pieces are timed. `done` is the part of the pass that is
    finished then.
    """

    def __init__(self, pace: Pace, kind: Hashable, box: Box, done: float) -> None:
        self._pace, self._kind, self._box, self._started = pace, kind, box, 0.0
        self.scissor: Box | None = None if pace.seconds is None else box
        self.done = done

    def __enter__(self) -> Piece:
        self._started = time.perf_counter()
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        if failed is None:
            self._pace.finish(self._kind, self._box, self._started)


class Pace:
    """Cuts passes into pieces of about `seconds` each; None draws them whole.

    Costs per pixel are kept by kind of work, from piece to piece and from frame to frame.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self.seconds: float | None = None
        self._costs: dict[Hashable, float] = {}
        self._areas: dict[Hashable, int] = {}

    def pieces(self, kind: Hashable, size: tuple[int, int], first: float = 0.0, last: float = 1.0) -> Iterator[Piece]:
        """Pieces that cover a target of that size once; the pass is `first` done before them and `last` after."""
        width, height = size
        drawn = 0
        for box in self._boxes(kind, width, height) if self.seconds is not None else [(0, 0, width, height)]:
            drawn += box[2] * box[3]
            yield Piece(self, kind, box, first + (last - first) * drawn / (width * height))

    def finish(self, kind: Hashable, box: Box, started: float) -> None:
        """Take the time of a piece."""
        if self.seconds is None:
            return
        self._context.finish()
        area = box[2] * box[3]
        self._costs[kind] = (time.perf_counter() - started) / area
        self._areas[kind] = area

    def _area(self, kind: Hashable) -> int:
        """Pixels that the next piece should have."""
        assert self.seconds is not None
        if kind not in self._costs:
            return FIRST_AREA
        wanted = self.seconds / max(self._costs[kind], 1e-12)
        return max(int(min(wanted, GROWTH * max(self._areas[kind], FIRST_AREA // 4))), 1)

    def _boxes(self, kind: Hashable, width: int, height: int) -> Iterator[Box]:
        y = 0
        while y < height:
            rows = self._area(kind) // width
            if rows >= BIN:
                rows = min(rows // BIN * BIN, height - y)
                yield 0, y, width, rows
                y += rows
                continue
            top = min(y + BIN, height)
            x = 0
            while x < width:
                columns = max(self._area(kind) // ((top - y) * BIN), 2) * BIN
                if width - x - columns < BIN:
                    columns = width - x
                row = y
                while row < top:
                    rows = max(self._area(kind) // columns // LEAST_ROWS * LEAST_ROWS, LEAST_ROWS)
                    rows = min(rows, top - row)
                    yield x, row, columns, rows
                    row += rows
                x += columns
            y = top

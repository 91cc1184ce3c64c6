"""Scattered pixels: single pixels of a picture, drawn without the rest of it.

Their values are those of the whole picture: the same rays, the same lights and maps. They lie in a small target, whose
texels look up in a texture which pixel of the picture they are.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

#: Pixels lie in square blocks of that side, which rasterisers shade together.
BLOCK = 4
#: Blocks are dealt to so many bins in a row, of that many texels: Mesa's llvmpipe gives each to one of its threads.
BINS, BIN = 16, 64


@dataclass(frozen=True, eq=False)
class ScatteredPixels:
    """Pixels of a picture to draw: `rows` from the top and `columns`, (N,) each, N of 1 or more.

    Neighbours in the order given are shaded together: pixels near each other should follow each other.
    """

    rows: np.ndarray
    columns: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def key(self) -> str:
        """Equal for equal pixels in the same order."""
        data = np.stack([self.rows, self.columns]).astype(np.int64)
        return hashlib.sha256(np.ascontiguousarray(data).tobytes()).hexdigest()

    @property
    def target_size(self) -> tuple[int, int]:
        """(width, height) of the target in texels."""
        blocks = -(-len(self) // BLOCK**2)
        return BINS * BIN, BLOCK * -(-blocks // (BINS * BIN // BLOCK))

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Row (from the bottom) and column in the target of every pixel, (N,) each."""
        number = np.arange(len(self))
        block, inside = np.divmod(number, BLOCK**2)
        turn, bin_number = np.divmod(block, BINS)
        line, across = np.divmod(turn, BIN // BLOCK)
        row = line * BLOCK + inside // BLOCK
        column = bin_number * BIN + across * BLOCK + inside % BLOCK
        return row, column

    def texels(self, height: int) -> np.ndarray:
        """(H, W, 2) float32, rows from the bottom: centre of the pixel in a picture of that height, counted from its
        lower left; −1 where a texel is none."""
        width, rows = self.target_size
        found = np.full((rows, width, 2), -1.0, np.float32)
        found[self.places] = np.stack([self.columns + 0.5, height - 0.5 - self.rows], axis=-1)
        return found

"""Bricks hold what the dense block holds, and lie apart or share what they have in common."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from previs.description import Field
from previs.render.brick_layout import lay_out
from previs.render.bricks import EDGES, NO_BRICK, PAGE, Occupancy
from previs.render.fields import pack
from previs.vdb.grid import Grid, Tiles

LIMIT = 2048


def grid(seed: int, background: float, tiles: bool) -> Grid:
    random = np.random.default_rng(seed)
    values = np.full(random.integers(5, 60, 3), background)
    for _ in range(random.integers(1, 12)):
        corner = random.integers(0, values.shape)
        values[tuple(slice(c, c + random.integers(1, 9)) for c in corner)] = random.uniform(-1.0, 3.0)
    values[0, 0, 0] = 3.5
    made = Grid.from_dense("d", values, background=background, origin=tuple(map(int, random.integers(-40, 40, 3))))
    if not tiles:
        return made
    return replace(
        made,
        tiles=Tiles(
            np.array([[128, 0, -128], [264, 8, 16]], np.int32), np.array([128, 8], np.int32), np.float32([1.5, 0.5])
        ),
        inactive_tiles=Tiles(
            np.array([[128, 0, 0], [8, 104, 0]], np.int32), np.array([128, 8], np.int32), np.float32([-0.7, 4.5])
        ),
    )


def texel(entry: int) -> np.ndarray:
    return np.array([entry & 2047, entry >> 11 & 2047, entry >> 22])


@pytest.mark.parametrize("tiles", [False, True])
@pytest.mark.parametrize("background", [0.0, 0.25])
@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("seed", range(3))
def test_a_brick_holds_its_part_of_the_block(seed: int, edge: int, background: float, tiles: bool) -> None:
    """With a layer of the next brick on each axis; one that is not stored is all background. Bounds of cells hold."""
    held = grid(seed, background, tiles)
    dense = pack(Field("k", held, np.eye(4)), 2**33)
    found = Occupancy(held)
    bricks, (cells, cell_edge) = found.find(held, edge, LIMIT)
    values = found.block(held, edge, LIMIT)
    assert found.scale == dense.scale
    np.testing.assert_array_equal(bricks.intervals, np.array(dense.size) - 1.0)
    first = np.round(-bricks.shift * edge).astype(int)
    assert np.all((first <= 0) & (first > -edge))
    for place in np.ndindex(*(-(-(bricks.intervals - first) // edge)).astype(int)):
        begin = np.array(place) * edge + first
        low, high = np.maximum(begin, 0), np.minimum(begin + edge + 1, dense.size)
        expected = dense.values[tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))]
        page = entry = int(bricks.table[tuple(np.array(place[::-1]) // PAGE)])
        if page != NO_BRICK:
            entry = int(bricks.table[tuple((texel(page) + np.array(place) % PAGE)[::-1])])
        if entry == NO_BRICK:
            assert (expected == np.float16(bricks.background)).all()
            continue
        ends = texel(entry) + low - begin, texel(entry) + high - begin
        box = tuple(slice(a, b) for a, b in zip(ends[0][::-1], ends[1][::-1], strict=True))
        np.testing.assert_array_equal(values[box], expected)
    exact, exact_edge = dense.cells
    assert (cells.shape, cell_edge) == (exact.shape, exact_edge)
    assert (np.maximum(cells, 0) >= np.maximum(exact, 0)).all()
    slabs = list(found.slabs(held, edge, LIMIT, values.nbytes // 4))
    assert [first for first, _ in slabs] == list(np.cumsum([0, *(len(s) for _, s in slabs)])[:-1])
    np.testing.assert_array_equal(np.concatenate([s for _, s in slabs]), values)
    assert found.nbytes(edge, LIMIT) == values.nbytes + bricks.table.nbytes


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4))
def test_only_neighbours_share_texels_in_a_layout(seed: int, edge: int) -> None:
    """Every texel of the block belongs to one voxel, and every brick lies inside."""
    random = np.random.default_rng(seed)
    bricks = np.argwhere(random.random(random.integers(1, 12, 3)) < random.random())
    layout = lay_out(bricks, edge, LIMIT)
    owner = np.full((*layout.size, 3), -1)
    for brick, origin in zip(bricks, layout.origins, strict=True):
        voxels = np.stack(np.meshgrid(*[np.arange(edge + 1)] * 3, indexing="ij"), axis=-1) + brick * edge
        part = owner[tuple(slice(o, o + edge + 1) for o in origin)]
        assert part.shape == voxels.shape
        assert ((part == -1) | (part == voxels)).all()
        part[...] = voxels
    assert layout.texels <= 2 * max(len(bricks), 1) * (edge + 1) ** 3


def test_full_boxes_take_little_more_than_their_voxels() -> None:
    bricks = np.argwhere(np.ones((32, 32, 32)))
    assert lay_out(bricks, 8, LIMIT).texels < 1.1 * len(bricks) * 8**3


def test_a_layout_beyond_the_largest_texture_is_none() -> None:
    assert lay_out(np.argwhere(np.ones((9, 9, 9))), 8, 40) is None

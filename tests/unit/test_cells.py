"""Cells bound what they hold, and leaping over empty ones passes nothing."""

import numpy as np
import pytest
from building import field
from hypothesis import given
from hypothesis import strategies as st

from previs.render.cells import MOST_CELLS_OF_LARGE_BLOCK, MOST_DISTANCE, cell_counts, cell_edge, cells_of, distances
from previs.render.fields import pack

SHAPES = st.tuples(*[st.integers(1, 37)] * 3)


def sparse_block(shape: tuple[int, int, int], seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    values = np.zeros(shape, np.float16)
    for _ in range(random.integers(0, 6)):
        corner = random.integers(0, shape)
        part = tuple(slice(int(c), int(c) + int(random.integers(1, 4))) for c in corner)
        values[part] = random.uniform(-1.0, 1.0) * 10.0 ** random.integers(-9, 1)
    return values


def trilinear(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Samples at points (N, 3), in intervals from the first texel along the array's axes."""
    low = np.clip(np.floor(points).astype(int), 0, np.maximum(np.array(values.shape) - 2, 0))
    part = points - low
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        at = np.minimum(low + corner, np.array(values.shape) - 1)
        weight = np.where(corner, part, 1.0 - part).prod(axis=1)
        total += weight * values[tuple(at.T)].astype(float)
    return total


@given(SHAPES, st.integers(0, 10**6))
def test_a_majorant_bounds_its_cell_and_is_reached(shape, seed: int) -> None:
    """No sample is larger; some texel of the cell is as large."""
    values = sparse_block(shape, seed)
    cells, edge = cells_of(values)
    assert cells.shape == cell_counts(shape, edge)
    for cell in np.ndindex(*cells.shape):
        part = values[tuple(slice(c * edge, (c + 1) * edge + 1) for c in cell)]
        assert max(float(cells[cell]), 0.0) == np.abs(part.astype(float)).max()
    points = np.random.default_rng(seed).uniform(0.0, 1.0, (500, 3)) * (np.array(shape) - 1)
    found = cells[tuple((points // edge).astype(int).T)].astype(float)
    assert (np.abs(trilinear(values, points)) <= np.maximum(found, 0.0) * (1.0 + 1e-12)).all()


@given(SHAPES, st.integers(0, 10**6))
def test_leaps_pass_no_density(shape, seed: int) -> None:
    """A distance is that to the nearest cell that is not empty, by brute force; no cell holds 0."""
    cells, _ = cells_of(sparse_block(shape, seed))
    assert (cells != 0).all()
    full = np.argwhere(cells > 0)
    for cell in np.argwhere(cells < 0):
        nearest = np.abs(full - cell).max(axis=1).min() if len(full) else MOST_DISTANCE
        assert -cells[tuple(cell)] == min(nearest, MOST_DISTANCE)


def test_distances_are_followed_to_a_limit() -> None:
    empty = np.ones(200, bool)
    empty[0] = False
    np.testing.assert_array_equal(distances(empty), np.minimum(np.arange(200), MOST_DISTANCE))


@pytest.mark.parametrize("value", [6e-8, -6e-8, 1.0])
def test_the_smallest_half_float_is_something(value: float) -> None:
    values = np.zeros((9, 9, 9), np.float16)
    values[4, 4, 4] = value
    assert (cells_of(values)[0] > 0).all(), "the texel is an end of every cell"


@pytest.mark.parametrize("longest", [2, 129, 130, 257, 258, 512, 513, 2000, 2048])
def test_edges_are_powers_of_two_and_cells_not_too_many(longest: int) -> None:
    edge = cell_edge((longest, 3, 9))
    assert edge >= 4
    assert edge & (edge - 1) == 0
    assert max(cell_counts((longest, 3, 9), edge)) <= MOST_CELLS_OF_LARGE_BLOCK


def test_cells_of_a_field_with_a_background() -> None:
    """The margin of a packed block holds the background, so nothing of it is empty."""
    packed = pack(field(np.zeros((20, 9, 14)) + 0.5, background=0.25), 2**20)
    cells, edge = packed.cells
    assert cells.shape == cell_counts(packed.size[::-1], edge)
    assert (cells == 1.0).all()

"""Sparse grids from arrays and back: no files here."""

from dataclasses import replace

import numpy as np
import pytest

from previs.vdb import Grid, Tiles


def _random(shape, seed=0):
    values = np.random.default_rng(seed).random(shape, dtype=np.float32)
    values[values < 0.6] = 0
    return values


@pytest.mark.parametrize("origin", [(0, 0, 0), (8, -16, 64), (-13, 130, -4099), (3, 5, 7)])
@pytest.mark.parametrize("shape", [(16, 8, 24), (1, 1, 1), (9, 17, 30)])
def test_dense_gives_the_array_back(shape, origin):
    array = _random(shape)
    grid = Grid.from_dense("density", array, origin=origin)
    low = np.array(origin)
    assert np.array_equal(grid.dense(low, low + shape - 1), array)
    assert grid.active_count == np.count_nonzero(array)
    assert (grid.leaf_origins % 8 == 0).all()
    assert grid.leaf_values.shape == grid.leaf_active.shape == (len(grid.leaf_origins), 8, 8, 8)


def test_every_box_is_a_window_of_the_whole():
    array = _random((30, 21, 26))
    grid = Grid.from_dense("density", array, origin=(-11, 4, 2), background=0)
    around = np.pad(array, 20)
    corner = np.array((-11, 4, 2)) - 20
    rng = np.random.default_rng(1)
    for _ in range(200):
        a, b = np.sort(rng.integers(0, around.shape, (2, 3)), axis=0)
        window = around[a[0] : b[0] + 1, a[1] : b[1] + 1, a[2] : b[2] + 1]
        assert np.array_equal(grid.dense(corner + a, corner + b), window)


def test_bounds_are_those_of_the_active_voxels():
    array = np.zeros((40, 40, 40))
    array[3, 9, 30] = 1
    array[20, 11, 7] = -1
    grid = Grid.from_dense("density", array, origin=(-100, 0, 0))
    low, high = grid.bounds
    assert low.tolist() == [-97, 9, 7]
    assert high.tolist() == [-80, 11, 30]
    assert len(grid.leaf_origins) == 2


def test_a_background_is_what_lies_outside_and_what_is_not_active():
    array = np.full((4, 4, 4), 0.1)
    array[1, 2, 3] = 0.0
    grid = Grid.from_dense("density", array, background=0.1)
    assert grid.active_count == 1
    assert grid.background == np.float32(0.1)
    outside = grid.dense((-20, -20, -20), (-10, -10, -10))
    assert (outside == np.float32(0.1)).all()
    assert grid.dense((1, 2, 3), (1, 2, 3)) == 0


@pytest.mark.parametrize("array", [np.zeros((3, 4, 5)), np.zeros((0, 4, 5))])
def test_an_empty_grid_has_no_bounds(array):
    grid = Grid.from_dense("density", array)
    assert grid.bounds is None
    assert grid.active_count == 0
    assert not grid.dense((0, 0, 0), (3, 3, 3)).any()


def test_vectors_are_active_where_a_component_differs():
    array = np.zeros((5, 6, 7, 3))
    array[1, 2, 3] = (0, 0, 4)
    grid = Grid.from_dense("velocity", array)
    assert grid.value_type == "vec3s"
    assert grid.leaf_values.shape == (1, 8, 8, 8, 3)
    assert grid.active_count == 1
    assert np.array_equal(grid.dense((0, 0, 0), (4, 5, 6)), array)


def test_tiles_count_as_voxels_and_are_painted():
    tiles = Tiles(
        np.array([[128, 0, 0], [8, 8, 8]], np.int32), np.array([128, 8], np.int32), np.array([2, 3], np.float32)
    )
    inactive = Tiles(np.array([[4096, 0, 0]], np.int32), np.array([4096], np.int32), np.array([-1], np.float32))
    none = np.zeros((0, 8, 8, 8))
    grid = Grid(
        "t", np.eye(4), np.zeros((0, 3), np.int32), none.astype(np.float32), none.astype(bool), 0.5, tiles, inactive
    )
    assert grid.active_count == 128**3 + 8**3
    assert [corner.tolist() for corner in grid.bounds] == [[0 + 8, 0, 0], [255, 127, 127]]
    line = grid.dense((7, 8, 8), (4200, 8, 8))[:, 0, 0]
    expected = np.full(4194, 0.5)
    expected[1:9], expected[121:249], expected[4089:] = 3, 2, -1
    assert np.array_equal(line, expected)


def test_a_huge_box_is_refused_in_words():
    grid = Grid.from_dense("density", np.ones((2, 2, 2)))
    with pytest.raises(ValueError, match=r"'density'.*4096×4096×4096.*limit"):
        grid.dense((0, 0, 0), (4095, 4095, 4095))
    with pytest.raises(ValueError, match="limit of 7"):
        grid.dense((0, 0, 0), (1, 1, 1), limit=7)
    with pytest.raises(ValueError, match="empty"):
        grid.dense((0, 0, 0), (1, -1, 1))
    with pytest.raises(ValueError, match="three integers"):
        grid.dense((0, 0, 0.5), (1, 1, 1))


@pytest.mark.parametrize(
    ("array", "matrix", "words"),
    [
        (np.zeros((2, 2)), np.eye(4), r"\(X, Y, Z\)"),
        (np.zeros((2, 2, 2), complex), np.eye(4), "real"),
        (np.zeros((2, 2, 2)), np.eye(3), "4×4"),
        (np.zeros((2, 2, 2)), np.diag([1, 1, 0, 1]), "singular"),
        (np.zeros((2, 2, 2)), np.full((4, 4), np.nan), "finite"),
        (np.zeros((2, 2, 2)), np.eye(4)[:, [0, 1, 3, 2]], "affine"),
    ],
)
def test_what_is_no_grid_is_refused_in_words(array, matrix, words):
    with pytest.raises(ValueError, match=words):
        Grid.from_dense("density", array, matrix)


@pytest.mark.parametrize("order", ["C", "F"])
def test_dense_converts_what_it_spreads(order):
    array = np.random.default_rng(3).random((9, 12, 17)).astype(np.float32) * 40.0
    grid = Grid.from_dense("density", array, background=2.5, origin=(3, -5, 0))
    low, high = (-2, -8, -3), (14, 9, 20)
    expected = (grid.dense(low, high) / np.float32(40.0)).astype(np.float16)
    half = grid.dense(low, high, dtype=np.float16, divisor=40.0, order=order)
    assert half.dtype == np.float16 and np.array_equal(half, expected)
    assert half.flags[f"{order}_CONTIGUOUS"]


def test_which_voxels_are_active_is_held_as_bits():
    active = np.random.default_rng(2).random((3, 8, 8, 8)) < 0.2
    origins = np.array([[0, 0, 0], [8, 0, 0], [-16, 8, 0]], np.int32)
    grid = Grid("density", np.eye(4), origins, np.zeros((3, 8, 8, 8), np.float32), active)
    np.testing.assert_array_equal(grid.leaf_active, active)
    assert grid.leaf_masks.nbytes == active.size // 8
    for i, x, y, z in np.argwhere(active):
        assert grid.leaf_masks[i, 8 * x + y] >> z & 1
    assert grid.active_count == np.count_nonzero(active)
    places = (np.argwhere(active)[:, 1:] + origins[np.nonzero(active)[0]]).astype(int)
    np.testing.assert_array_equal(grid.bounds, [places.min(axis=0), places.max(axis=0)])
    for same in (replace(grid, name="b"), replace(grid, leaf_active=grid.leaf_masks)):
        np.testing.assert_array_equal(same.leaf_active, active)
    np.testing.assert_array_equal(replace(grid, leaf_active=~active).leaf_active, ~active)
    with pytest.raises(ValueError, match="read-only"):
        grid.leaf_active[0] = True
    with pytest.raises(TypeError, match="leaf_active"):
        Grid("density", np.eye(4), origins, np.zeros((3, 8, 8, 8), np.float32))

"""What our writer writes, our reader reads back equal."""

import mmap
import os
from dataclasses import replace

import numpy as np
import pytest

from previs import vdb
from previs.vdb import Grid, Tiles, reader, tree

SHEARED = np.array([[0.1, 0.02, 0, 0], [0, -0.2, 0.03, 0], [-0.05, 0, 0.3, 0], [4, 5, 6, 1]])
FILES = [("zip", True), ("zip", False), ("none", True), ("none", False)]


def _sparse(shape, density, seed=0):
    rng = np.random.default_rng(seed)
    return np.where(rng.random(shape) < density, rng.normal(size=shape), 0).astype(np.float32)


def _same(a: Grid, b: Grid) -> None:
    assert (a.name, a.index, a.value_type, a.grid_class) == (b.name, b.index, b.value_type, b.grid_class)
    assert np.array_equal(a.index_to_world, b.index_to_world)
    assert np.array_equal(a.background, b.background, equal_nan=True)
    assert a.active_count == b.active_count
    for box_a, box_b in zip(a.bounds or (), b.bounds or (), strict=True):
        assert np.array_equal(box_a, box_b)
    in_a, in_b = (np.lexsort(grid.leaf_origins.T) for grid in (a, b))
    for part in ("leaf_origins", "leaf_active", "leaf_values"):
        left, right = getattr(a, part)[in_a], getattr(b, part)[in_b]
        assert left.dtype == right.dtype
        assert left.tobytes() == right.tobytes()
    for part in ("tiles", "inactive_tiles"):
        left, right = getattr(a, part), getattr(b, part)
        in_a, in_b = (np.lexsort(tiles.origin.T) for tiles in (left, right))
        assert np.array_equal(left.origin[in_a], right.origin[in_b])
        assert np.array_equal(left.size[in_a], right.size[in_b])
        assert np.array_equal(left.value[in_a], right.value[in_b])


def _with_oddities() -> Grid:
    """Leaves of no, one and many inactive values, far apart, with tiles of every size, active and not."""
    grid = Grid.from_dense("odd", _sparse((40, 20, 30), 0.2), SHEARED, origin=(-13, 130, -4099))
    rng = np.random.default_rng(3)
    values = grid.leaf_values.copy()
    values[0][~grid.leaf_active[0]] = 5
    values[1][~grid.leaf_active[1]] = rng.random(np.count_nonzero(~grid.leaf_active[1]))
    values[2][~grid.leaf_active[2]] = np.nan
    values[3][~grid.leaf_active[3]] = -0.0
    tiles = Tiles(
        np.array([[6400, 0, 0], [8, 8, 8], [12288, 0, -4096], [-8192, 4096, 0]], np.int32),
        np.array([128, 8, 4096, 4096], np.int32),
        np.array([2, 3, 4, 5], np.float32),
    )
    inactive = Tiles(
        np.array([[6528, 0, 0], [16, 8, 8], [20480, 0, 0]], np.int32),
        np.array([128, 8, 4096], np.int32),
        np.array([-7, 8, 9], np.float32),
    )
    return replace(grid, leaf_values=values, tiles=tiles, inactive_tiles=inactive)


@pytest.mark.parametrize(("compression", "active_mask"), FILES)
@pytest.mark.parametrize(
    "grid",
    [
        Grid.from_dense("dense", np.random.default_rng(0).random((40, 33, 50))),
        Grid.from_dense("sparse", _sparse((150, 140, 130), 0.0005), SHEARED, origin=(-70, -4100, 4000)),
        Grid.from_dense("empty", np.zeros((4, 4, 4)), SHEARED),
        Grid.from_dense("background", _sparse((20, 20, 20), 0.1), background=0.125),
        Grid.from_dense("half range", np.array([6e-8, 6e-5, 1e-3, 65504, -65504, 0.1]).reshape(6, 1, 1)),
        Grid.from_dense("no number", np.array([np.nan, np.inf, -np.inf, 1e30]).reshape(1, 4, 1)),
        Grid.from_dense("vectors", _sparse((20, 20, 20, 3), 0.1), background=0),
        Grid.from_dense("дым ☁ \N{SMILING FACE WITH SUNGLASSES}", np.ones((3, 3, 3)), grid_class="level set"),
        Grid.from_dense("", np.ones((3, 3, 3))),
        _with_oddities(),
        replace(_with_oddities(), background=0.25),
        replace(_with_oddities(), background=float("nan")),
    ],
    ids=lambda grid: grid.name,
)
def test_grids_come_back(tmp_path, grid, compression, active_mask):
    path = tmp_path / "file.vdb"
    vdb.write(path, [grid], compression, active_mask=active_mask)
    [back] = vdb.read(path)
    _same(grid, back)
    [info] = vdb.read_metadata(path)
    assert (info.name, info.value_type, info.unsupported) == (grid.name, grid.value_type, None)
    assert info.active_count == grid.active_count
    assert np.array_equal(info.index_to_world, grid.index_to_world)
    assert (info.bounds is None) == (grid.bounds is None)
    assert info.bounds is None or np.array_equal(info.bounds, grid.bounds)


@pytest.mark.parametrize(
    ("value_type", "dtype", "trailing"),
    [
        ("double", np.float64, ()),
        ("int32", np.int32, ()),
        ("int64", np.int64, ()),
        ("vec3d", np.float64, (3,)),
        ("vec3i", np.int32, (3,)),
    ],
)
@pytest.mark.parametrize(("compression", "active_mask"), FILES)
def test_other_types_come_back(tmp_path, value_type, dtype, trailing, compression, active_mask):
    rng = np.random.default_rng(0)
    grid = Grid(
        "other",
        SHEARED,
        np.array([[0, 0, 0], [8, 0, -8]], np.int32),
        (rng.normal(size=(2, 8, 8, 8, *trailing)) * 1000).astype(dtype),
        rng.random((2, 8, 8, 8)) < 0.3,
        background=(0, 0, 0) if trailing else 0,
        value_type=value_type,
    )
    vdb.write(tmp_path / "file.vdb", [grid], compression, active_mask=active_mask)
    _same(grid, vdb.read(tmp_path / "file.vdb")[0])


def test_an_array_of_doubles_becomes_a_float_grid(tmp_path):
    array = np.random.default_rng(0).random((9, 9, 9))
    vdb.write(tmp_path / "file.vdb", [Grid.from_dense("density", array)])
    [grid] = vdb.read(tmp_path / "file.vdb")
    assert grid.value_type == "float"
    assert np.array_equal(grid.dense((0, 0, 0), (8, 8, 8)), array.astype(np.float32))


def test_same_named_grids_are_told_apart_by_index(tmp_path):
    path = tmp_path / "file.vdb"
    grids = [Grid.from_dense("density", np.full((2, 2, 2), value)) for value in (1, 2, 3)]
    vdb.write(path, [grids[0], Grid.from_dense("heat", np.ones((1, 1, 1))), *grids[1:]])
    back = vdb.read(path, names=["density"])
    assert [(g.name, g.index, g.dense((0, 0, 0), (0, 0, 0)).item()) for g in back] == [
        ("density", 0, 1),
        ("density", 1, 2),
        ("density", 2, 3),
    ]
    # Houdini's own numbers may run another way than the file.
    vdb.write(path, [replace(grid, index=index) for grid, index in zip(grids, (2, 1, 0), strict=True)])
    back = {grid.index: grid.dense((0, 0, 0), (0, 0, 0)).item() for grid in vdb.read(path)}
    assert back == {2: 1, 1: 2, 0: 3}
    assert [info.index for info in vdb.read_metadata(path)] == [2, 1, 0]


def test_names_pick_grids(tmp_path):
    path = tmp_path / "file.vdb"
    vdb.write(path, [Grid.from_dense(name, np.ones((2, 2, 2))) for name in ("a", "b", "c")])
    assert [g.name for g in vdb.read(path, names={"c", "a"})] == ["a", "c"]
    assert [g.name for g in vdb.read(path, names="b")] == ["b"]
    assert vdb.read(path, names=["absent"]) == []
    assert vdb.read(path, names=[]) == []


def test_grids_that_are_not_asked_for_are_not_decoded(tmp_path):
    path = tmp_path / "file.vdb"
    vdb.write(path, [Grid.from_dense("a", np.ones((9, 9, 9))), Grid.from_dense("b", np.ones((9, 9, 9)))])
    whole = path.read_bytes()
    start = whole.index(b"AffineMap") + 9 + 128
    path.write_bytes(whole[:start] + b"\xff" * 900 + whole[start + 900 :])
    assert [g.name for g in vdb.read(path, names=["b"])] == ["b"]
    with pytest.raises(ValueError, match=r"file\.vdb"):
        vdb.read(path, names=["a"])


def test_metadata_of_plain_values_comes_back(tmp_path):
    metadata = {
        "creator": "naïve",
        "frame": 12,
        "big": 1 << 40,
        "scale": 0.5,
        "fine": 0.1,
        "local": True,
        "box": (1, -2, 3),
        "point": (0.1, 0.2, 0.3),
        "file_voxel_count": 99,
        "thing": object(),
    }
    grid = Grid.from_dense("density", np.ones((2, 2, 2)), metadata=metadata)
    vdb.write(tmp_path / "file.vdb", [grid])
    back = vdb.read(tmp_path / "file.vdb")[0].metadata
    for key in ("creator", "frame", "big", "scale", "fine", "local", "box", "point"):
        assert back[key] == metadata[key]
        assert type(back[key]) is type(metadata[key])
    assert back["file_voxel_count"] == 8
    assert "thing" not in back


def test_a_file_without_grids(tmp_path):
    vdb.write(tmp_path / "file.vdb", [])
    assert vdb.read(tmp_path / "file.vdb") == []
    assert vdb.read_metadata(tmp_path / "file.vdb") == []


def test_the_same_grids_give_the_same_bytes(tmp_path):
    for name in ("a.vdb", "b.vdb"):
        vdb.write(tmp_path / name, [_with_oddities()])
    assert (tmp_path / "a.vdb").read_bytes() == (tmp_path / "b.vdb").read_bytes()


def test_a_failed_write_leaves_the_old_file_and_nothing_beside(tmp_path, monkeypatch):
    path = tmp_path / "file.vdb"
    path.write_bytes(b"the old one")

    def fail(*_):
        raise OSError("the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", fail)
        with pytest.raises(OSError, match="full"):
            vdb.write(path, [_with_oddities()])
    assert path.read_bytes() == b"the old one"
    assert os.listdir(tmp_path) == ["file.vdb"]


def test_what_cannot_be_written_is_refused_in_words(tmp_path):
    path = tmp_path / "file.vdb"
    grid = Grid.from_dense("density", np.ones((9, 9, 9)))
    refused = {
        "multiples of 8": replace(grid, leaf_origins=grid.leaf_origins + 1),
        "overlap": replace(grid, leaf_origins=np.zeros_like(grid.leaf_origins)),
        "must be": replace(grid, leaf_values=grid.leaf_values[:1]),
        "booleans": replace(grid, leaf_active=grid.leaf_active.astype(int)),
        "affine": replace(grid, index_to_world=np.eye(4)[:, [0, 1, 3, 2]]),
        "8, 128 or 4096": replace(
            grid, tiles=Tiles(np.zeros((1, 3), np.int32), np.array([16], np.int32), np.ones(1, np.float32))
        ),
    }
    for words, bad in refused.items():
        with pytest.raises(ValueError, match=words):
            vdb.write(path, [bad])
    with pytest.raises(ValueError, match="compression"):
        vdb.write(path, [grid], "lzma")
    with pytest.raises(OSError):
        vdb.write(tmp_path / "absent" / "file.vdb", [grid])
    assert os.listdir(tmp_path) == []


def test_a_single_grid_needs_no_list(tmp_path):
    grid = Grid.from_dense("density", _sparse((9, 9, 9), 0.5))
    vdb.write(tmp_path / "one.vdb", grid)
    vdb.write(tmp_path / "list.vdb", [grid])
    assert (tmp_path / "one.vdb").read_bytes() == (tmp_path / "list.vdb").read_bytes()


@pytest.mark.parametrize("compression", ["zip", "none"])
def test_bytes_are_let_go_when_they_are_decoded(tmp_path, monkeypatch, compression):
    """What is read does not lie in the memory that is given back on the way."""
    path = tmp_path / "file.vdb"
    grids = [
        _with_oddities(),
        Grid.from_dense("background", _sparse((40, 64, 48), 0.1), background=0.125),
        Grid.from_dense("vectors", _sparse((20, 40, 20, 3), 0.1)),
    ]
    vdb.write(path, grids, compression)
    released = []
    with monkeypatch.context() as patched:
        patched.setattr(reader, "_LARGE_TREE", 1)
        patched.setattr(tree, "_BATCH", 16)
        patched.setattr(mmap, "mmap", _counting(mmap.mmap, released))
        found = vdb.read(path)
    assert sum(released) > 0.5 * path.stat().st_size
    for again, grid in zip(found, vdb.read(path), strict=True):
        _same(again, grid)


def _counting(mapping, released):
    class Counting(mapping):
        def madvise(self, advice, start, length):
            released.append(length)
            super().madvise(advice, start, length)

    return Counting

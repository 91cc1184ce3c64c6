"""Files of OpenVDB and of applications built on it, voxel by voxel against what OpenVDB reads from them.

They are not ours to hand out: set PREVIS_TEST_DATA to a folder with `vdb_cases/*.vdb` and `vdb_cases/truth/*.npz`.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from previs import vdb

DATA = Path(os.environ.get("PREVIS_TEST_DATA") or "/nonexistent")
CASES = sorted((DATA / "vdb_cases").glob("*.vdb"))
UNSUPPORTED = {"type_bool", "type_mask", "xf_frustum"}

pytestmark = pytest.mark.skipif(not CASES, reason="PREVIS_TEST_DATA is not set or holds no vdb_cases")


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_every_voxel_is_openvdbs(path):
    truth = np.load(path.parent / "truth" / f"{path.stem}.npz")
    if path.stem in UNSUPPORTED:
        with pytest.raises(NotImplementedError, match=path.name):
            vdb.read(path)
        assert vdb.read_metadata(path)[0].unsupported
        return
    grids = vdb.read(path)
    assert len(grids) == int(truth["n"])
    for i in range(int(truth["n"])):
        said = json.loads(str(truth[f"g{i}_meta"]))
        grid = next(grid for grid in grids if grid.name == said["name"])
        grids.remove(grid)
        assert grid.active_count == said["active"]
        assert len(grid.leaf_origins) == said["leafs"]
        assert grid.grid_class == said["gclass"]
        np.testing.assert_array_equal(np.float32(grid.background), np.float32(said["background"]))
        np.testing.assert_allclose(grid.index_to_world, said["matrix"], rtol=1e-15, atol=1e-15)
        if said["bbox"] is None:
            assert grid.bounds is None
        else:
            np.testing.assert_array_equal(grid.bounds, said["bbox"])
        if f"g{i}_dense" in truth:
            dense = grid.dense(*grid.bounds)
            assert dense.dtype == truth[f"g{i}_dense"].dtype
            np.testing.assert_array_equal(dense, truth[f"g{i}_dense"])


@pytest.mark.parametrize("name", ["tile_root_4096", "sparse_far"])
def test_a_small_file_that_spans_thousands_stays_sparse(name):
    [grid] = vdb.read(DATA / "vdb_cases" / f"{name}.vdb")
    assert grid.leaf_values.nbytes + grid.leaf_active.nbytes + grid.tiles.value.nbytes < 1 << 20
    with pytest.raises(ValueError, match="limit"):
        grid.dense(*grid.bounds)


@pytest.mark.parametrize("folder", ["arnold_usd", "openusd_vdb"])
def test_files_of_applications(folder):
    paths = sorted((DATA / folder).glob("*.vdb"))
    if not paths:
        pytest.skip(f"no {folder} in PREVIS_TEST_DATA")
    for path in paths:
        # The writers noted counts and boxes in the metadata; they were right.
        for info, grid in zip(vdb.read_metadata(path), vdb.read(path), strict=True):
            assert (info.name, info.index) == (grid.name, grid.index)
            assert info.active_count == grid.active_count
            assert (info.bounds is None) == (grid.bounds is None)
            if grid.bounds is not None:
                np.testing.assert_array_equal(info.bounds, grid.bounds)


def test_houdinis_own_index_is_honoured():
    path = DATA / "arnold_usd" / "grids.vdb"
    if not path.exists():
        pytest.skip("no grids.vdb in PREVIS_TEST_DATA")
    counts = {(grid.name, grid.index): grid.active_count for grid in vdb.read(path)}
    assert counts == {("density", 2): 491, ("density", 1): 2222, ("density", 0): 803}

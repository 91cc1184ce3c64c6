"""OpenVDB itself as a judge: it reads what we write and we read what it writes, voxel by voxel.

Runs Debian's python3-openvdb in the system's Python, never in ours; skips where that is missing.
"""

import json
import subprocess

import numpy as np
import pytest

from previs import vdb
from previs.vdb import Grid, Tiles

ORACLE = "/usr/bin/python3"


def _oracle_is_there():
    try:
        return (
            subprocess.run([ORACLE, "-c", "import pyopenvdb, numpy"], capture_output=True, timeout=60).returncode == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False


pytestmark = pytest.mark.skipif(not _oracle_is_there(), reason="python3-openvdb is not installed")

DESCRIBE = """
import json, sys
import numpy as np, pyopenvdb
path, out, boxes = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
said, arrays = [], {}
for i, grid in enumerate(pyopenvdb.readAll(path)[0]):
    low, high = boxes[str(grid.metadata["tag"]) if "tag" in grid.metadata else grid.name]
    shape = [b - a + 1 for a, b in zip(low, high)] + [3] * isinstance(grid.background, tuple)
    array = np.zeros(shape, np.float32)
    grid.copyToArray(array, ijk=tuple(low))
    arrays[str(i)] = array
    corners = [grid.transform.indexToWorld(c) for c in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]
    box = grid.evalActiveVoxelBoundingBox() if grid.activeVoxelCount() else None
    said.append(dict(name=grid.name, key=str(grid.metadata.get("tag", grid.name)), count=grid.activeVoxelCount(),
                     background=grid.background, corners=corners, box=box, gridClass=grid.gridClass))
np.savez(out, **arrays)
print(json.dumps(said))
"""


def _ask(tmp_path, path, boxes):
    boxes = json.dumps({key: np.array(box).tolist() for key, box in boxes.items()})
    command = [ORACLE, "-c", DESCRIBE, str(path), str(tmp_path / "said.npz"), boxes]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    arrays = np.load(tmp_path / "said.npz")
    return [(said, arrays[str(i)]) for i, said in enumerate(json.loads(done.stdout))]


def _agree(said, array, grid, box):
    assert said["name"] == grid.name
    assert said["count"] == grid.active_count
    assert said["gridClass"] == grid.grid_class
    assert np.array_equal(np.float32(said["background"]), np.float32(grid.background))
    assert (said["box"] is None) == (grid.bounds is None)
    assert said["box"] is None or np.array_equal(said["box"], grid.bounds)
    corners = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]]) @ grid.index_to_world
    np.testing.assert_allclose(corners[:, :3], said["corners"], rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(array, grid.dense(*box))


def _grids():
    rng = np.random.default_rng(0)
    sheared = np.array([[0.1, 0.02, 0, 0], [0, -0.2, 0.03, 0], [-0.05, 0, 0.3, 0], [4, 5, 6, 1]])
    noise = np.where(rng.random((40, 30, 50)) < 0.3, rng.normal(size=(40, 30, 50)), 0)
    tiles = Tiles(
        np.array([[128, 0, 0], [64, 0, 0], [4096, 0, 0]], np.int32),
        np.array([128, 8, 4096], np.int32),
        np.array([2, 3, 4], np.float32),
    )
    inactive = Tiles(np.array([[0, 128, 0]], np.int32), np.array([128], np.int32), np.array([-7], np.float32))
    base = Grid.from_dense("tiles", noise, sheared, background=0.5)
    values = base.leaf_values.copy()
    values[::2][~base.leaf_active[::2]] = rng.normal(size=np.count_nonzero(~base.leaf_active[::2]))
    values[1][~base.leaf_active[1]] = 9
    parts = (base.leaf_origins, values, base.leaf_active)
    return [
        Grid.from_dense("дым ☁", noise, sheared, origin=(-13, 130, -4099), metadata={"tag": "unicode"}),
        Grid.from_dense("density", noise[:9], metadata={"tag": "first"}),
        Grid.from_dense("density", noise[9:], np.diag([2, 3, 4, 1.0]), metadata={"tag": "second"}),
        Grid.from_dense("empty", np.zeros((3, 3, 3))),
        Grid.from_dense("background", noise, background=0.125),
        Grid.from_dense("velocity", np.stack([noise, noise, -noise], axis=-1), grid_class="staggered"),
        Grid("tiles", sheared, *parts, 0.5, tiles, inactive, "level set"),
    ]


@pytest.mark.parametrize("compression", ["zip", "none"])
@pytest.mark.parametrize("active_mask", [True, False])
def test_openvdb_reads_what_we_write(tmp_path, compression, active_mask):
    grids = {str(grid.metadata.get("tag", grid.name)): grid for grid in _grids()}
    vdb.write(tmp_path / "ours.vdb", grids.values(), compression, active_mask=active_mask)
    boxes = {}
    for key, grid in grids.items():
        low, high = grid.bounds or (np.zeros(3, int), np.full(3, 3))
        boxes[key] = (low - 10, np.minimum(high, low + 200) + 10)
    said = _ask(tmp_path, tmp_path / "ours.vdb", boxes)
    assert sorted(s["key"] for s, _ in said) == sorted(grids)
    for entry, array in said:
        _agree(entry, array, grids[entry["key"]], boxes[entry["key"]])


WRITE = """
import sys
import pyopenvdb as v
ball = v.createLevelSetSphere(radius=12.0, center=(5, 6, 7), voxelSize=0.5, halfWidth=3)
ball.name = "ball"
boxes = v.FloatGrid(background=0.3)
boxes.name = "boxes"
boxes.fill((0, 0, 0), (300, 140, 130), 0.7)
boxes.fill((100, 0, 0), (150, 50, 50), 0.1, False)
boxes.fill((-12288, 0, 0), (-8193, 4095, 4095), 1.7)
vectors = v.Vec3SGrid(background=(1, 2, 3))
vectors.name = "vectors"
vectors.fill((-3, 0, 0), (140, 20, 30), (0.1, 0.2, 0.3))
fog = v.FloatGrid()
fog.name = "fog"
fog.gridClass = v.GridClass.FOG_VOLUME
for i in range(300):
    fog.getAccessor().setValueOn((i * 37 % 101, i * 17 % 53, -i), i / 7)
grids = [ball, boxes, vectors, fog]
for grid in grids:
    grid.saveFloatAsHalf = sys.argv[2] == "half"
v.write(sys.argv[1], grids)
"""


@pytest.mark.parametrize("precision", ["float", "half"])
def test_we_read_what_openvdb_writes(tmp_path, precision):
    path = tmp_path / "theirs.vdb"
    subprocess.run([ORACLE, "-c", WRITE, str(path), precision], check=True, timeout=120)
    grids = {grid.name: grid for grid in vdb.read(path)}
    assert sorted(grids) == ["ball", "boxes", "fog", "vectors"]
    boxes = {name: (grid.bounds[0] - 10, grid.bounds[1] + 10) for name, grid in grids.items()}
    boxes["boxes"] = ((-20, -20, -20), (320, 160, 150))
    for said, array in _ask(tmp_path, path, boxes):
        _agree(said, array, grids[said["name"]], boxes[said["name"]])

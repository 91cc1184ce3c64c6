"""Damaged and hostile files: a sentence that names the file or a grid, whatever the bytes say."""

import os
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from previs import vdb
from previs.vdb import Grid, Tiles

resource = pytest.importorskip("resource", reason="memory limits are set with POSIX rlimits")

MEMORY = 2 << 30
SECONDS = 60

# Runs in a process of its own, so that a crash, a hang or a flood of memory is a failed test and not the end of all.
VICTIM = """
import resource, sys
import numpy as np
from previs import vdb
resource.setrlimit(resource.RLIMIT_AS, ({memory}, {memory}))
scratch, flips, cuts, *sources = sys.argv[1:]
rng = np.random.default_rng(2013)
outcomes = {{"grids": 0, "refused": 0}}
def check():
    try:
        vdb.read_metadata(scratch)
        for grid in vdb.read(scratch):
            box, _ = grid.bounds, grid.active_count
            if box:
                grid.dense(box[0], np.minimum(box[1], box[0] + 63))
        outcomes["grids"] += 1
    except (ValueError, OSError, NotImplementedError) as error:
        assert scratch in str(error), error
        outcomes["refused"] += 1
for source in sources:
    whole = open(source, "rb").read()
    for i in range(int(flips) + int(cuts)):
        damaged = bytearray(whole)
        if i >= int(flips):
            del damaged[int(rng.integers(len(whole))):]
        else:
            # Half of the damage goes where the structure is: headers, offsets and the first nodes.
            reach = min(len(whole), 1200) if i % 2 else len(whole)
            for _ in range(1 + i % 3):
                damaged[int(rng.integers(reach))] = int(rng.integers(256))
        with open(scratch, "wb") as file:
            file.write(damaged)
        check()
print(outcomes["grids"], outcomes["refused"])
"""


def _batter(tmp_path, sources, flips, cuts):
    """Damage files many times over in a process of its own; (grids, refusals)."""
    arguments = [str(tmp_path / "damaged.vdb"), str(flips), str(cuts), *(str(s) for s in sources)]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", VICTIM.format(memory=MEMORY), *arguments],
        capture_output=True,
        text=True,
        timeout=SECONDS,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    grids, refusals = (int(n) for n in done.stdout.split())
    assert grids + refusals == len(sources) * (flips + cuts)
    return grids, refusals


@pytest.mark.parametrize("compression", ["zip", "none"])
def test_damage_to_our_own_files(tmp_path, compression):
    rng = np.random.default_rng(0)
    array = np.where(rng.random((40, 40, 40)) < 0.1, rng.random((40, 40, 40)), 0)
    grids = [Grid.from_dense("density", array), Grid.from_dense("heat", array[:9], origin=(-9, 4090, 120))]
    vdb.write(tmp_path / "good.vdb", grids, compression)
    _, refusals = _batter(tmp_path, [tmp_path / "good.vdb"], 400, 100)
    assert refusals >= 100  # every cut at least


def test_damage_to_files_of_others(tmp_path):
    folder = os.environ.get("PREVIS_TEST_DATA")
    if not folder:
        pytest.skip("PREVIS_TEST_DATA is not set")
    small = [path for path in sorted(Path(folder).glob("*/*.vdb")) if path.stat().st_size < 700_000]
    if not small:
        pytest.skip("PREVIS_TEST_DATA holds no .vdb files")
    _batter(tmp_path, small, 30, 10)
    blosc = [path for path in small if path.name in ("float_blosc_am.vdb", "smoke_000002.vdb", "half_blosc_am.vdb")]
    if blosc:
        _batter(tmp_path, blosc, 400, 100)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not an OpenVDB file"),
        (b" BDV", "not an OpenVDB file"),
        (b"#usda 1.0 and so on", "not an OpenVDB file"),
        (struct.pack("<q", 0x56444220) + b"\xe0\0\0\0", "ends too early"),
    ],
)
def test_what_is_no_vdb_is_refused_in_words(tmp_path, content, words):
    path = tmp_path / "file.vdb"
    path.write_bytes(content)
    for function in (vdb.read, vdb.read_metadata):
        with pytest.raises(ValueError, match=rf"file\.vdb.*{words}"):
            function(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="absent"):
        vdb.read(tmp_path / "absent.vdb")
    with pytest.raises(OSError, match=tmp_path.name):
        vdb.read(tmp_path)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.vdb")
    with pytest.raises(OSError, match="pipe"):
        vdb.read(tmp_path / "pipe.vdb")


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "file.vdb"
    array = np.where(np.random.default_rng(0).random((24, 24, 24)) < 0.2, 1.5, 0)
    vdb.write(path, [Grid.from_dense("density", array)])
    return path


def _patch(path, marker, skip, new):
    content = bytearray(path.read_bytes())
    at = content.index(marker) + len(marker) + skip
    content[at : at + len(new)] = new
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("marker", "skip", "new"),
    [
        (b"Tree_float_5_4_3", 4, struct.pack("<q", 1 << 60)),  # where the grid begins
        (b"Tree_float_5_4_3", 4, struct.pack("<q", -5)),
        (b"Tree_float_5_4_3", 20, struct.pack("<q", 1 << 62)),  # where it ends
        (b"Tree_float_5_4_3", 28, struct.pack("<I", 0xFFFFFFF0)),  # compression flags
        (b"Tree_float_5_4_3", 32, struct.pack("<I", 0xFFFFFFFF)),  # entries of metadata
        (b"previs", 0, struct.pack("<i", 0x7FFFFFFF)),  # grids
        (b"previs", 0, struct.pack("<i", -1)),
        (b"AffineMap", 0, struct.pack("<d", float("nan"))),
        (b"AffineMap", 0, bytes(8)),  # a singular matrix
        (b"AffineMap", 128, struct.pack("<i", 2)),  # buffers a leaf
        (b"AffineMap", 136, struct.pack("<I", 0xFFFFFFFF)),  # tiles of the root
        (b"AffineMap", 140, struct.pack("<I", 0xFFFFFFFF)),  # children of the root
        (b"AffineMap", 144, struct.pack("<i", 12)),  # a node off its lattice
        (b"AffineMap", 156, b"\xff" * 4096),  # all children of a 32³ node
    ],
)
def test_lies_about_sizes_are_found_out(good, marker, skip, new):
    _patch(good, marker, skip, new)
    with pytest.raises(ValueError, match=r"file\.vdb"):
        vdb.read(good)


def test_tiles_are_bounded(tmp_path):
    # A 32³ node whose tiles are all alike packs to some bytes: a few megabytes of them would take gigabytes.
    cells = np.stack(np.meshgrid(*[np.arange(0, 4096, 128, dtype=np.int32)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    tiles = Tiles(cells, np.full(32768, 128, np.int32), np.full(32768, 0.5, np.float32))
    empty = Grid.from_dense("density", np.zeros((1, 1, 1)))
    grid, count = replace(empty, tiles=tiles), 520
    path = tmp_path / "file.vdb"
    vdb.write(path, [grid])
    assert vdb.read(path)[0].active_count == 4096**3
    content = path.read_bytes()
    start = content.index(b"AffineMap") + 9 + 128 + 4 + 4
    node = content[start + 8 + 12 :]
    nodes = b"".join(struct.pack("<3i", 0, 0, 4096 * i) + node for i in range(count))
    descriptor = content.index(b"Tree_float_5_4_3") + 16 + 4
    hostile = bytearray(content[:start] + struct.pack("<II", 0, count) + nodes)
    struct.pack_into("<q", hostile, descriptor + 16, len(hostile))
    path.write_bytes(hostile)
    with pytest.raises(ValueError, match=r"file\.vdb.*tiles"):
        vdb.read(path)


def test_a_zip_block_cannot_swell(tmp_path):
    path = tmp_path / "file.vdb"
    vdb.write(path, [Grid.from_dense("density", np.arange(512).reshape(8, 8, 8))])
    content = path.read_bytes()
    bomb = zlib.compress(bytes(200_000_000), 9)
    offsets = content.index(b"Tree_float_5_4_3") + 16 + 4
    (leaf,) = struct.unpack_from("<q", content, offsets + 8)
    hostile = bytearray(content[: leaf + 65] + struct.pack("<q", len(bomb)) + bomb)
    struct.pack_into("<q", hostile, offsets + 16, len(hostile))
    path.write_bytes(hostile)
    with pytest.raises(ValueError, match=r"file\.vdb.*unpack"):
        vdb.read(path)

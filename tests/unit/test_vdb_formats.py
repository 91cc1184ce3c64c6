"""Files that our writer never makes: old versions, streams, instances, half floats, Blosc, every inactive code.

The bytes are laid out here by hand, one leaf in one branch, so that these tests know the format on their own account.
"""

import struct
import zlib

import blosc
import numpy as np
import pytest

from previs import vdb

ZIP, MASK, BLOSC = 1, 2, 4
ORIGIN = (4096 + 3 * 128 + 5 * 8, 7 * 128, -4096 + 15 * 8)
RNG = np.random.default_rng(0)
ACTIVE = RNG.random(512) < 0.4
VALUES = RNG.normal(size=512).astype("<f4")


def text(value):
    encoded = value.encode()
    return struct.pack("<I", len(encoded)) + encoded


def bits(*places, count):
    mask = np.zeros(count, bool)
    mask[list(places)] = True
    return np.packbits(mask, bitorder="little").tobytes()


def block(raw, flags):
    if flags & BLOSC:
        packed = blosc.compress(raw, typesize=4, cname="lz4")
        return struct.pack("<q", len(packed)) + packed
    if flags & ZIP:
        packed = zlib.compress(raw)
        if len(packed) < len(raw):
            return struct.pack("<q", len(packed)) + packed
        return struct.pack("<q", -len(raw)) + raw
    return raw


def scale_map(*numbers):
    scale = np.array(numbers[-3:], float)
    return np.concatenate([numbers[:-3], scale, abs(scale), 1 / scale, scale**-2, 0.5 / scale]).astype("<f8").tobytes()


IDENTITY = text("UniformScaleMap") + scale_map(1, 1, 1)


def one_leaf(version=224, flags=0, background=0.0, code=None, extra=b"", half=False, type_char="<f4"):
    """A tree of one leaf at ORIGIN, and what the file holds of its values and of two tiles beside it."""
    stored = "<f2" if half else type_char
    code = (0 if flags & MASK else 6) if code is None else code
    drops = bool(flags & MASK) and code != 6 and version >= 222

    def node(log2, child, tile, tile_value):
        count = 1 << 3 * log2
        values = np.full(count, background, stored)
        values[tile] = tile_value
        head = bits(child, count=count) + bits(tile, count=count)
        if version < 222:
            return head + block(np.delete(values, child).tobytes(), flags)
        kept = values[tile : tile + 1] if flags & MASK else values
        return head + bytes([0 if flags & MASK else 6]) + block(kept.tobytes(), flags)

    topology = struct.pack("<i", 1) + np.array(background, type_char).tobytes()
    topology += struct.pack("<II3i", 0, 1, 4096, 0, -4096)
    topology += node(5, 3 * 1024 + 7 * 32, 5, 2) + node(4, 5 * 256 + 15, 9, 3)
    mask = bits(*np.flatnonzero(ACTIVE), count=512)
    kept = (VALUES[ACTIVE] if drops else VALUES).astype(stored)
    buffer = mask
    buffer += bytes([code]) + extra if version >= 222 else struct.pack("<3ib", *ORIGIN, 1)
    return topology + mask + buffer + block(kept.tobytes(), flags)


def metadata(**entries):
    encoded = b"".join(text(key) + kind_and_bytes for key, kind_and_bytes in entries.items())
    return struct.pack("<I", len(entries)) + encoded


HALF = text("bool") + struct.pack("<I?", 1, True)


def archive(grids, version=224, offsets=True, zip_flag=0):
    """A file of grids given as (unique name, type, parent, body after the compression flags, flags)."""
    out = struct.pack("<qIIIB", 0x56444220, version, 5, 1, offsets)
    if version < 222:
        out += bytes([zip_flag])
    out += b"0" * 36 + metadata() + struct.pack("<i", len(grids))
    for name, kind, parent, body, flags in grids:
        out += text(name) + text(kind) + text(parent)
        if version >= 222:
            body = struct.pack("<I", flags) + body
        start = len(out) + 24
        out += struct.pack("<qqq", *((start, start, start + len(body)) if offsets else (0, 0, 0))) + body
    return out


FLOAT = "Tree_float_5_4_3"


def simple(name="density", flags=0, kind=FLOAT, entries=b"\0\0\0\0", transform=IDENTITY, **options):
    return (name, kind, "", entries + transform + one_leaf(flags=flags, **options), flags)


def read_bytes(tmp_path, content, names=None):
    path = tmp_path / "hand.vdb"
    path.write_bytes(content)
    return vdb.read(path, names)


def check(grid, inactive=0.0, values=VALUES):
    expected = np.where(ACTIVE, values, inactive).astype(np.float32)
    assert grid.leaf_origins.tolist() == [list(ORIGIN)]
    assert np.array_equal(grid.leaf_active.ravel(), ACTIVE)
    assert np.array_equal(grid.leaf_values.ravel(), expected)
    at = [tuple(origin) for origin in grid.tiles.origin.tolist()]
    tiles = dict(zip(at, zip(grid.tiles.size, grid.tiles.value, strict=True), strict=True))
    assert tiles == {(4096, 0, -4096 + 5 * 128): (128, 2), (4480, 896, -4096 + 9 * 8): (8, 3)}
    assert grid.active_count == ACTIVE.sum() + 128**3 + 8**3
    assert len(grid.inactive_tiles) == 0


@pytest.mark.parametrize("packing", [0, ZIP, BLOSC])
@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("offsets", [True, False])
def test_every_compression(tmp_path, packing, half, offsets):
    values = VALUES.astype("<f2").astype("<f4") if half else VALUES
    options = {"half": half, "entries": metadata(is_saved_as_half_float=HALF) if half else metadata()}
    kind = FLOAT + "_HalfFloat" * half
    grids = [
        simple("all", packing, kind, code=6, **options),
        simple("masked", packing | MASK, kind, background=0.5, **options),
    ]
    whole, masked = read_bytes(tmp_path, archive(grids, offsets=offsets))
    check(whole, values, values)
    check(masked, 0.5, values)
    assert masked.background == 0.5
    infos = vdb.read_metadata(tmp_path / "hand.vdb")
    assert [(i.name, i.half, i.type) for i in infos] == [("all", half, FLOAT), ("masked", half, FLOAT)]


SELECTED = RNG.random(512) < 0.5
SELECTION = np.packbits(SELECTED, bitorder="little").tobytes()


@pytest.mark.parametrize(
    ("code", "extra", "inactive"),
    [
        (0, b"", 0.5),
        (1, b"", -0.5),
        (2, struct.pack("<f", 7), 7),
        (3, SELECTION, np.where(SELECTED, 0.5, -0.5)),
        (4, struct.pack("<f", 7) + SELECTION, np.where(SELECTED, 0.5, 7)),
        (5, struct.pack("<ff", 7, 8) + SELECTION, np.where(SELECTED, 8, 7)),
        (6, b"", VALUES),
    ],
)
@pytest.mark.parametrize("offsets", [True, False])
def test_every_way_to_drop_inactive_values(tmp_path, code, extra, inactive, offsets):
    grid = simple(flags=ZIP | MASK, background=0.5, code=code, extra=extra)
    check(read_bytes(tmp_path, archive([grid, simple("after")], offsets=offsets), ["density"])[0], inactive)


@pytest.mark.parametrize("version", [220, 221])
@pytest.mark.parametrize("zip_flag", [0, 1])
def test_files_from_before_mask_compression(tmp_path, version, zip_flag):
    grid = simple(version=version, flags=zip_flag)
    [back] = read_bytes(tmp_path, archive([grid], version, zip_flag=zip_flag))
    check(back, VALUES)


def test_older_files_are_refused_in_words(tmp_path):
    with pytest.raises(NotImplementedError, match=r"hand\.vdb.*version is 219"):
        read_bytes(tmp_path, archive([], 219))


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        (text("ScaleMap") + scale_map(1, -2, 3), [[1, 0, 0], [0, -2, 0], [0, 0, 3], [0, 0, 0]]),
        (text("UniformScaleMap") + scale_map(2, 2, 2), [[2, 0, 0], [0, 2, 0], [0, 0, 2], [0, 0, 0]]),
        (text("TranslationMap") + struct.pack("<3d", 4, 5, 6), [[1, 0, 0], [0, 1, 0], [0, 0, 1], [4, 5, 6]]),
        (text("ScaleTranslateMap") + scale_map(4, 5, 6, 1, 2, 3), [[1, 0, 0], [0, 2, 0], [0, 0, 3], [4, 5, 6]]),
        (text("UniformScaleTranslateMap") + scale_map(4, 5, 6, 2, 2, 2), [[2, 0, 0], [0, 2, 0], [0, 0, 2], [4, 5, 6]]),
        (
            text("AffineMap") + struct.pack("<16d", 1, 2, 0, 0, 0, 1, 3, 0, 4, 0, 1, 0, 7, 8, 9, 1),
            [[1, 2, 0], [0, 1, 3], [4, 0, 1], [7, 8, 9]],
        ),
        (
            text("UnitaryMap") + struct.pack("<16d", 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1),
            [[0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 0, 0]],
        ),
    ],
)
def test_every_affine_transform(tmp_path, transform, expected):
    [grid] = read_bytes(tmp_path, archive([simple(transform=transform)]))
    assert grid.index_to_world.dtype == np.float64
    assert np.array_equal(grid.index_to_world[:, :3], expected)
    assert grid.index_to_world[:, 3].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("offsets", [True, False])
def test_an_instance_shares_the_tree_of_its_parent(tmp_path, offsets):
    moved = text("TranslationMap") + struct.pack("<3d", 9, 0, 0)
    grids = [simple("smoke"), ("copy", FLOAT, "smoke", metadata() + moved, 0), simple("after")]
    smoke, copy, after = read_bytes(tmp_path, archive(grids, offsets=offsets))
    check(copy, VALUES)
    check(after, VALUES)
    assert copy.leaf_values is smoke.leaf_values
    assert copy.index_to_world[3, 0] == 9
    [alone] = read_bytes(tmp_path, archive(grids, offsets=offsets), names=["copy"])
    check(alone, VALUES)


def test_an_instance_of_a_grid_with_another_transform_is_readable(tmp_path):
    grids = [simple("smoke", transform=FRUSTUM), ("copy", FLOAT, "smoke", metadata() + IDENTITY, 0)]
    [copy] = read_bytes(tmp_path, archive(grids))
    check(copy, VALUES)


def test_two_grids_of_one_unique_name_are_two_grids(tmp_path):
    grids = read_bytes(tmp_path, archive([simple("smoke"), simple("smoke", flags=MASK)]))
    assert [(g.name, g.index) for g in grids] == [("smoke", 0), ("smoke", 1)]
    check(grids[0], VALUES)
    check(grids[1], 0)


@pytest.mark.parametrize("parent", ["absent", "copy", "copy of copy"])
def test_an_instance_of_nothing_is_refused_in_words(tmp_path, parent):
    grids = [
        ("copy", FLOAT, parent, metadata() + IDENTITY, 0),
        ("copy of copy", FLOAT, "copy", metadata() + IDENTITY, 0),
    ]
    with pytest.raises(ValueError, match=r"hand\.vdb.*instance"):
        read_bytes(tmp_path, archive(grids))


FRUSTUM = text("NonlinearFrustumMap") + struct.pack("<8d", 0, 0, 0, 9, 9, 9, 1, 2) + IDENTITY
POINTS = ("points", "Tree_ptdataidx32_5_4_3", "", metadata() + IDENTITY + b"\0" * 99, 0)


def byte_tree(leaf_tail):
    """A bool or mask tree of one leaf."""
    topology = struct.pack("<i?II3i", 1, False, 0, 1, 0, 0, 0)
    for log2 in (5, 4):
        count = 1 << 3 * log2
        topology += bits(0, count=count) + bits(count=count) + b"\6" + b"\0" * count
    return topology + bytes(64) + bytes(64 + 12 + leaf_tail)


BOOL = ("flags", "Tree_bool_5_4_3", "", metadata() + IDENTITY + byte_tree(64), 0)
TOPOLOGY = ("mask", "Tree_mask_5_4_3", "", metadata() + IDENTITY + byte_tree(0), 0)
FROM_CAMERA = simple("frustum", transform=FRUSTUM)


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        (BOOL, "'flags' is a bool grid"),
        (TOPOLOGY, "'mask' is a mask grid"),
        (POINTS, "'points' is a point grid"),
        (FROM_CAMERA, "'frustum'.*NonlinearFrustumMap"),
        (("cut", "Tree_float_4_3_3", "", metadata() + IDENTITY, 0), "'cut'.*shape.*Tree_float_4_3_3"),
        (simple("strange", transform=text("SpiralMap")), "'strange'.*SpiralMap"),
    ],
)
@pytest.mark.parametrize("offsets", [True, False])
def test_unsupported_grids_are_named_and_spare_the_others(tmp_path, grid, words, offsets):
    content = archive([simple("before"), grid, simple("after")], offsets=offsets)
    # In a stream nothing says where a tree of another kind ends.
    lost = not offsets and grid[0] in ("points", "cut", "strange")
    check(read_bytes(tmp_path, content, ["before"])[0], VALUES)
    assert [g.name for g in read_bytes(tmp_path, content)] == ["before", "after"][: 1 if lost else 2]
    with pytest.raises(NotImplementedError, match=r"hand\.vdb.*" + words):
        read_bytes(tmp_path, content, [grid[0]])
    with pytest.raises(NotImplementedError, match=words):
        read_bytes(tmp_path, archive([grid], offsets=offsets))
    if lost:
        with pytest.raises(NotImplementedError, match=r"stream cannot be found"):
            read_bytes(tmp_path, content, ["after"])
    else:
        check(read_bytes(tmp_path, content, ["after"])[0], VALUES)
    path = tmp_path / "hand.vdb"
    path.write_bytes(content)
    infos = vdb.read_metadata(path)
    assert [i.unsupported is None for i in infos] == [True, False, True][: 2 if lost else 3]


def test_index_metadata_tells_same_named_grids_apart(tmp_path):
    def number(n):
        return metadata(index=text("int32") + struct.pack("<Ii", 4, n))

    numbered = [simple(f"density\x1e{i}", entries=number(5 - i)) for i in range(3)]
    grids = read_bytes(tmp_path, archive(numbered))
    assert [(g.name, g.index) for g in grids] == [("density", 5), ("density", 4), ("density", 3)]
    plain = [simple(f"density\x1e{i}") for i in range(3)]
    assert [g.index for g in read_bytes(tmp_path, archive(plain))] == [0, 1, 2]
    twice = [simple(f"density\x1e{i}", entries=number(1)) for i in range(2)]
    assert [g.index for g in read_bytes(tmp_path, archive(twice))] == [0, 1]


def test_grid_class_and_metadata(tmp_path):
    entries = metadata(
        **{
            "class": text("string") + text("staggered"),
            "roi": text("vec3i") + struct.pack("<I3i", 12, 1, 2, 3),
            "file_delayed_load": text("__delayedload") + struct.pack("<I", 3) + b"abc",
            "unheard of": text("plugin") + struct.pack("<I", 2) + b"xy",
        }
    )
    [grid] = read_bytes(tmp_path, archive([simple(entries=entries)]))
    assert grid.grid_class == "staggered"
    assert grid.metadata == {"class": "staggered", "roi": (1, 2, 3), "unheard of": b"xy"}

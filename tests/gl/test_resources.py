"""Atlases, packed fields, and memory that does not grow."""

import gc
import itertools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building import (
    box,
    box_mesh,
    camera,
    distant,
    field,
    index_of,
    point,
    scene,
    smooth_noise,
    translation,
    unit_cube_transform,
    volume,
)
from hypothesis import given, settings
from hypothesis import strategies as st

import previs
from previs import Medium, Settings, metrics
from previs.description import Field
from previs.render.fields import pack, reduction_factor
from previs.render.resources import pack_boxes
from previs.vdb.grid import Grid, Tiles

SIZES = st.lists(st.tuples(*[st.integers(1, 40)] * 3), min_size=1, max_size=25)


@given(SIZES)
def test_boxes_never_overlap(sizes) -> None:
    """Every box lies inside the large one and apart from every other."""
    large, corners = pack_boxes(sizes, 4096)
    assert max(large) <= 4096
    ends = (np.array(corners) + sizes).tolist()
    for corner, end in zip(corners, ends, strict=True):
        assert min(corner) >= 0
        assert all(e <= n for e, n in zip(end, large, strict=True))
    for i, j in itertools.combinations(range(len(sizes)), 2):
        apart = [corners[i][a] >= ends[j][a] or corners[j][a] >= ends[i][a] for a in range(3)]
        assert any(apart), (i, j)


@given(SIZES)
def test_boxes_respect_the_limit(sizes) -> None:
    """A limit that the boxes can fit only tightly is kept, or refused in words; never broken."""
    limit = max(max(s) for s in sizes) + 5
    try:
        large, corners = pack_boxes(sizes, limit)
    except MemoryError as error:
        assert str(limit) in str(error)
        return
    assert max(large) <= limit
    for corner, size in zip(corners, sizes, strict=True):
        assert all(c + s <= n for c, s, n in zip(corner, size, large, strict=True))


def test_equal_boxes_waste_nothing() -> None:
    large, _ = pack_boxes([(10, 10, 10)] * 8, 4096)
    assert np.prod(large) == 8000


def test_a_packed_field_is_the_dense_grid() -> None:
    """With one voxel of background around it, x fastest, within half-float rounding; corners where they belong."""
    values = np.random.default_rng(0).uniform(0.1, 7.0, (5, 9, 12)).astype(np.float32)
    grid = Grid.from_dense("density", values, background=0.25, origin=(-3, 4, 100))
    packed = pack(Field("k", grid, np.eye(4)), 2**30)
    assert packed.reduction == 1
    assert packed.size == (7, 11, 14)
    dense = grid.dense((-4, 3, 99), (2, 13, 112))
    np.testing.assert_allclose(packed.values.transpose(2, 1, 0).astype(float) * packed.scale, dense, rtol=5e-4)
    ends = np.array([[0.0, 0.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]]) @ packed.box_to_index
    np.testing.assert_allclose(ends[:, :3], [[-4, 3, 99], [2, 13, 112]])


def test_a_packed_vector_field() -> None:
    values = np.random.default_rng(0).uniform(0.1, 7.0, (3, 4, 5, 3)).astype(np.float32)
    grid = Grid.from_dense("emission", values)
    packed = pack(Field("k", grid, np.eye(4)), 2**30)
    dense = grid.dense((-1, -1, -1), (3, 4, 5))
    found = packed.values[..., :3].transpose(2, 1, 0, 3).astype(float) * packed.scale
    np.testing.assert_allclose(found, dense, rtol=5e-4, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_packed_values_keep_their_precision(scale: float) -> None:
    """Densities far outside a half float are stored relative to their peak."""
    values = np.linspace(0.01, 1.0, 64).reshape(4, 4, 4) * scale
    packed = pack(field(values), 2**30)
    found = packed.values[1:-1, 1:-1, 1:-1].transpose(2, 1, 0).astype(float) * packed.scale
    np.testing.assert_allclose(found, values, rtol=1e-3)


@pytest.mark.parametrize("factor", [2, 4, 8, 16])
@pytest.mark.parametrize("origin", [(0, 0, 0), (-13, 5, 3)])
def test_reduced_fields_are_means_of_cubes(factor: int, origin) -> None:
    """Brute force over aligned cubes of the dense grid, background and tiles included."""
    values = np.random.default_rng(factor).uniform(0.0, 1.0, (30, 21, 37)).astype(np.float32)
    values[values < 0.3] = 0.1
    grid = Grid.from_dense("density", values, background=0.1, origin=origin)
    dims = np.array(values.shape)
    memory = int(np.prod(-(-dims // factor) + 3)) * 2
    packed = pack(Field("k", grid, np.eye(4)), memory)
    assert packed.reduction == factor == reduction_factor(dims, 2, memory, 2048)
    lo, hi = (np.asarray(b) for b in grid.bounds)
    first, last = lo // factor - 1, hi // factor + 1
    dense = grid.dense(first * factor, (last + 1) * factor - 1).astype(float)
    cells = last - first + 1
    means = dense.reshape(cells[0], factor, cells[1], factor, cells[2], factor).mean(axis=(1, 3, 5))
    found = packed.values.transpose(2, 1, 0).astype(float) * packed.scale
    np.testing.assert_allclose(found, means, atol=1e-3)
    # The centre of a cube of voxels 0 to f − 1 is at (f − 1) / 2.
    corner = np.array([0.0, 0.0, 0.0, 1.0]) @ packed.box_to_index
    np.testing.assert_allclose(corner[:3], first * factor + 0.5 * (factor - 1))


def test_reduced_tiles() -> None:
    """Active tiles count with the share that a cube has of them."""
    base = Grid.from_dense("density", np.ones((8, 8, 8)))
    tile = Tiles(np.array([[8, 0, 0]], np.int32), np.array([8], np.int32), np.array([3.0], np.float32))
    for factor, expected in ((4, [0, 1, 1, 3, 3, 0]), (8, [0, 1, 3, 0])):
        memory = int(np.prod(-(-np.array([16, 8, 8]) // factor) + 3)) * 2
        packed = pack(Field("k", replace(base, tiles=tile), np.eye(4)), memory)
        assert packed.reduction == factor
        found = packed.values.transpose(2, 1, 0).astype(float) * packed.scale
        np.testing.assert_allclose(found[:, 1, 1], expected, atol=1e-3)
    packed = pack(Field("k", replace(base, tiles=tile), np.eye(4)), 2 * 4 * 4 * 4)
    assert packed.reduction == 16
    found = packed.values.transpose(2, 1, 0).astype(float) * packed.scale
    np.testing.assert_allclose(found[1, 1, 1], (512 + 3 * 512) / 4096, atol=1e-3)


@given(st.tuples(*[st.integers(1, 60)] * 3), st.tuples(*[st.integers(-40, 40)] * 3), st.integers(10, 17))
@settings(max_examples=40, deadline=None)
def test_reduction_keeps_the_limits_wherever_the_grid_lies(shape, origin, bits: int) -> None:
    """Memory and the largest edge, for blocks that are aligned to nothing; the sum of all density stays."""
    values = np.random.default_rng(bits).uniform(0.1, 1.0, shape).astype(np.float32)
    packed = pack(Field("k", Grid.from_dense("density", values, origin=origin), np.eye(4)), 2**bits, 40)
    assert packed.values.nbytes <= 2**bits
    assert max(packed.size) <= 40
    total = packed.values.astype(float).sum() * packed.scale * packed.reduction**3
    assert total == pytest.approx(values.sum(dtype=float), rel=2e-3)


def test_the_memory_that_is_asked_for_is_kept() -> None:
    """Also by the margin that packing adds."""
    for size in (2**16, 2**18, 2**20):
        packed = pack(field(np.ones((90, 33, 71))), size)
        assert packed.values.nbytes <= size


@pytest.mark.gl
def test_a_reduced_field_still_looks_like_itself(renderer: previs.Renderer) -> None:
    """A smooth cloud at half resolution: the same picture but for the detail."""
    cloud = scene(volume(smooth_noise((90, 90, 90)), Medium(extinction=(3, 3, 3))), distant((-1, -1, 0.2), (3, 3, 3)))
    view = camera((1, 1, 5.5))
    full, small = (
        renderer.render(index_of(cloud), view, (48, 27), Settings(field_memory=memory, steps=64)) for memory in (512, 1)
    )
    assert not full.stats["notes"]
    assert any("averaged" in note for note in small.stats["notes"])
    assert metrics.mean_relative_error(small.color, full.color) <= 0.02


@pytest.mark.gl
def test_equal_fields_are_uploaded_once(renderer: previs.Renderer) -> None:
    """Instances of a cloud share one block of voxels."""
    noise = smooth_noise((8, 8, 8))
    copies = [volume(noise, Medium(), translation(i, 0, 0), f"/Cloud{i}") for i in range(4)]
    renderer.render(index_of(scene(*copies)), camera((0, 0, 9)), (4, 4), Settings(steps=4))
    atlas = renderer._frame.density
    assert atlas.texture.size == (10, 10, 10)
    assert len(atlas.placements) == 4


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


needs_proc = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")


@pytest.mark.gl
@needs_proc
def test_two_hundred_renders_do_not_grow_memory(renderer: previs.Renderer) -> None:
    """Every frame with other voxels, another mesh, another light and now and then another size of picture."""
    noise = smooth_noise((24, 24, 24))
    index = previs.RenderIndex()
    knobs = Settings(steps=4, light_steps=4, map_size=32, shadow_map_size=128)

    def frame(number: int) -> None:
        lit = point((0.0, 3.0, 0.01 * number))
        solid = box_mesh((-0.5, -2.0, -0.5), (0.5, -1.5 + 0.001 * number, 0.5))
        description = scene(volume(noise + 0.001 * number, Medium()), solid, distant((0.1, -1, 0)), lit)
        index.update(description)
        renderer.render(index, camera((0, 0, 6)), (64 + number % 3, 36), knobs)

    for number in range(30):
        frame(number)
    gc.collect()
    before = resident_bytes()
    for number in range(30, 230):
        frame(number)
    gc.collect()
    # A frame's textures and buffers are about a megabyte: a leak of any of them shows.
    assert resident_bytes() - before < 30 * 2**20


@pytest.mark.gl
@needs_proc
def test_released_renderers_give_their_memory_back() -> None:
    """Twenty renderers one after another; releasing twice does no harm."""

    few = Settings(steps=2)

    def use() -> None:
        with previs.Renderer() as mine:
            mine.render(index_of(scene(box(Medium()), distant((0, -1, 0)))), camera((0, 0, 6)), (512, 288), few)
        mine.release()

    for _ in range(4):
        use()
    gc.collect()
    before = resident_bytes()
    for _ in range(20):
        use()
    gc.collect()
    assert resident_bytes() - before < 60 * 2**20


@pytest.mark.gl
def test_a_scene_can_be_forgotten(renderer: previs.Renderer) -> None:
    """Its textures go, and the next frame makes everything again."""
    index = index_of(scene(volume(smooth_noise((8, 8, 8)), Medium()), distant((0, -1, 0))))
    first = renderer.render(index, camera((0, 0, 6)), (8, 8), Settings(steps=8))
    renderer.forget_scene()
    assert renderer._frame.density.texture is None
    again = renderer.render(index, camera((0, 0, 6)), (8, 8), Settings(steps=8))
    assert renderer.executed == ["fields", "transmittance_map /Sun > /Volume", "march", "composite"]
    assert np.array_equal(first.color, again.color)


def test_a_unit_cube_transform_places_the_margin_on_the_faces() -> None:
    """The tests' own helper: index −1 is at −1, index N at 1."""
    matrix = unit_cube_transform((4, 6, 8))
    ends = np.array([[-1, -1, -1, 1], [4, 6, 8, 1]]) @ matrix
    np.testing.assert_allclose(ends[:, :3], [[-1] * 3, [1] * 3])

"""Density fields in bricks give the picture that dense ones give."""

import weakref
from dataclasses import replace

import numpy as np
import pytest
from building import camera, distant, field, index_of, point, rotation, scene, smooth_noise, translation, volume

from previs import Medium, Settings
from previs.description import Field, SceneDescription, Volume
from previs.render import fields
from previs.render.bricks import EDGES, least_bytes, occupancy
from previs.render.plan import make_plan
from previs.render.resources import _hollow
from previs.vdb.grid import Grid, Tiles

pytestmark = pytest.mark.gl

MEDIUM = Medium(extinction=(3.0, 3.0, 3.0), albedo=(0.9, 0.7, 0.5), anisotropy=0.3)
METHODS = ("slices", "quantile", "tfm-plain", "march")
SIZE = (48, 27)


def patches(shape: tuple[int, int, int], background: float = 0.0, seed: int = 0) -> np.ndarray:
    """Smooth noise in some places, the background elsewhere."""
    values = smooth_noise(shape, seed)
    return np.where(smooth_noise(shape, seed + 1, 4) > 0.45, values, background)


def with_tiles(f: Field) -> Field:
    """The field with tiles beside it, as large as a leaf and larger, active and not."""
    tiles = Tiles(
        np.array([[128, 0, 0], [256, 8, 16]], np.int32), np.array([128, 8], np.int32), np.array([0.3, 0.8], np.float32)
    )
    inactive = Tiles(np.array([[256, 64, 64]], np.int32), np.array([8], np.int32), np.array([0.5], np.float32))
    grid = replace(f.grid, tiles=tiles, inactive_tiles=inactive)
    matrix = np.diag([0.01, 0.01, 0.01, 1.0])
    matrix[3, :3] = (-1.2, -0.5, -0.5)
    return Field(f"{f.key} with tiles", grid, matrix)


def scenes() -> dict[str, SceneDescription]:
    sun, lamp = distant((1, -1, 0.3)), point((0.0, 2.0, 0.5), strength=(9.0, 6.0, 3.0))
    plain = volume(patches((60, 40, 50)), MEDIUM)
    ground = Volume("/Volume", np.eye(4), MEDIUM, density=field(patches((40, 33, 50), 0.25), background=0.25))
    tiles = Volume("/Volume", np.eye(4), MEDIUM, density=with_tiles(field(patches((60, 40, 50)))))
    other = volume(
        patches((17, 70, 31), seed=5), MEDIUM, rotation((0, 1, 0), 40.0) @ translation(0.5, 0.2, -0.4), "/Other"
    )
    instance = Volume("/Instance", translation(-0.9, 0.4, 0.3), MEDIUM, density=plain.density)
    return {
        "patches": scene(plain, sun),
        "lit from inside": scene(plain, point((0.1, 0.1, 0.1))),
        "background": scene(ground, sun, lamp),
        "tiles": scene(tiles, sun),
        "several": scene(plain, other, instance, sun, lamp),
    }


def drawn(renderer, description: SceneDescription, **knobs) -> np.ndarray:
    image = renderer.render(index_of(description), camera((2.5, 1.5, 3.0)), SIZE, Settings(**knobs))
    return np.concatenate([image.color, image.alpha[..., None]], axis=-1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", scenes())
def test_bricks_draw_what_a_block_draws(renderer, name: str, method: str) -> None:
    """Positions are rounded where a texel lies, which differs, and so does what is known to be empty: the leaps over
    it, and with them where steps begin. Without leaps nothing but rounding does."""
    description = scenes()[name]
    for skip_empty, most, mean in ((False, 4e-5, 2e-7), (True, 2e-3, 1e-5)):
        knobs = {"transmittance": method, "skip_empty": skip_empty, "steps": 256}
        dense = drawn(renderer, description, sparse="off", **knobs)
        bricks = drawn(renderer, description, sparse="on", **knobs)
        assert renderer._frame.density.bricks is not None
        assert dense.max() > 0.01
        difference = np.abs(bricks - dense)
        assert difference.max() < most * dense.max()
        assert difference.mean() < mean * dense.max()


def of_leaves(places: np.ndarray) -> Field:
    """A field that is 1 in the leaves at (n, 3), counted in leaves, and 0 elsewhere."""
    values = np.broadcast_to(np.float32(1.0), (len(places), 8, 8, 8))
    grid = Grid("density", np.eye(4), (places * 8).astype(np.int32), values, values > 0.0)
    return Field(f"leaves {places.shape} up to {places.max()}", grid, np.eye(4))


def corners(n: int) -> Field:
    """Eight full leaves in the corners of a cube of n leaves along an edge."""
    return of_leaves(np.argwhere(np.ones((2, 2, 2))) * (n - 1))


def test_only_what_takes_less_is_in_bricks() -> None:
    """`auto` leaves fields as they are where bricks take hardly less; the plan says what it does, and how much that
    takes."""

    def fields_pass(f: Field, **knobs):
        index = index_of(scene(Volume("/Volume", np.eye(4), MEDIUM, density=f), distant((1, -1, 0))))
        plan = make_plan(index, camera((0, 0, 5)), 8, 8, Settings(**knobs))
        return plan, next(p for p in plan.passes if p.kind == "fields")

    full, empty = of_leaves(np.argwhere(np.ones((36, 36, 36)))), corners(36)
    half = of_leaves(np.argwhere(np.ones((40, 40, 40)))[::2])
    for f, bricks in ((corners(20), False), (corners(30), False), (full, False), (half, False), (empty, True)):
        plan, upload = fields_pass(f)
        assert plan.defines["HAS_SPARSE"] == bricks
        assert ("1 in bricks of" in upload.why) == bricks
    _, dense = fields_pass(empty, sparse="off")
    assert dense.memory >= 290**3 * 2
    assert upload.memory < dense.memory - 2**25
    assert fields_pass(corners(20), sparse="on")[0].defines["HAS_SPARSE"]
    assert not fields_pass(empty, sparse="off")[0].defines["HAS_SPARSE"]


def test_dense_fields_are_not_searched_for_bricks(monkeypatch) -> None:
    """Where bricks cannot take less by enough nobody finds out where they would lie."""

    def refuse(grid):
        raise AssertionError("looked for bricks")

    monkeypatch.setattr(fields, "occupancy", refuse)
    full = of_leaves(np.argwhere(np.ones((36, 36, 36))))
    assert [fields.storage(f, 2**29, sparse="auto").edge for f in (corners(30), full)] == [0, 0]
    with pytest.raises(AssertionError, match="looked"):
        fields.storage(corners(36), 2**29, sparse="auto")


def test_least_bytes_are_no_more_than_bricks_take() -> None:
    for f in (with_tiles(field(patches((60, 40, 50)))), field(patches((40, 33, 50), 0.25), background=0.25)):
        nbytes, _ = occupancy(f.grid).best(2048)
        assert 0 < least_bytes(f.grid) <= nbytes
    leafless = replace(f.grid, leaf_origins=np.zeros((0, 3), np.int32), leaf_values=np.zeros((0, 8, 8, 8), np.float32))
    assert least_bytes(leafless) == 0


def test_a_block_in_slabs_is_the_block() -> None:
    """Whatever the cuts: leaves that reach into several parts are in all of them."""
    for f in (with_tiles(field(patches((60, 40, 50)))), field(patches((70, 33, 50), 0.25), background=0.25)):
        found = occupancy(f.grid)
        for edge in EDGES:
            block = found.block(f.grid, edge, 256)
            for memory in (1, block.nbytes // 2, 2**30):
                slabs = list(found.slabs(f.grid, edge, 256, memory))
                assert [first for first, _ in slabs] == np.cumsum([0, *(len(s) for _, s in slabs)])[:-1].tolist()
                np.testing.assert_array_equal(np.concatenate([s for _, s in slabs]), block)
            assert edge > 8 or len(list(found.slabs(f.grid, edge, 256, 1))) > 1


def test_bricks_are_taken_before_a_field_is_reduced() -> None:
    """One that fits the memory in bricks keeps its voxels; one that does not is averaged, and that is said."""
    values = np.zeros((200, 200, 200), np.float32)
    values[::199, ::199, ::199] = 1.0
    values[:40, :40, :40] = 0.5
    index = index_of(scene(volume(values, MEDIUM), distant((1, -1, 0))))

    def plan(**knobs):
        return make_plan(index, camera((0, 0, 5)), 8, 8, Settings(field_memory=1, **knobs))

    assert plan().defines["HAS_SPARSE"]
    assert not any("averaged" in n.message for n in plan().notes)
    assert any("averaged" in n.message for n in plan(sparse="off").notes)
    index = index_of(scene(volume(np.ones((200, 200, 200)), MEDIUM), distant((1, -1, 0))))
    assert any("averaged over cubes of 4³" in n.message for n in plan().notes)


@pytest.mark.parametrize("sparse", ["on", "off"])
def test_a_large_block_is_let_go_when_it_is_uploaded(sparse: str) -> None:
    """What stays of it tells its shape, and holds none of its memory."""

    def owner(array: np.ndarray) -> np.ndarray:
        return array if array.base is None else owner(array.base)

    packed = fields.pack(field(patches((60, 40, 50))), 2**29, sparse=sparse)
    assert packed.cells[0].max() > 0
    arrays = [packed.values] + ([packed.bricks.table] if packed.bricks is not None else [])
    held, size, nbytes = [weakref.ref(owner(a)) for a in arrays], packed.size, packed.nbytes
    hollow = _hollow(packed)
    del packed, arrays
    assert [array() for array in held] == [None] * len(held)
    assert (hollow.size, hollow.nbytes) == (size, nbytes)
    assert hollow.cells[0].max() > 0


def test_the_planned_memory_is_that_of_the_textures(renderer) -> None:
    description = scenes()["tiles"]
    drawn(renderer, description, sparse="on")
    atlas = renderer._frame.density
    held = 2 * np.prod(atlas.texture.size) + 4 * np.prod(atlas.bricks.size) + 2 * np.prod(atlas.cells.size)
    plan = renderer.plan(index_of(description), camera((2.5, 1.5, 3.0)), *SIZE, Settings(sparse="on"))
    assert next(p.memory for p in plan.passes if p.kind == "fields") == held

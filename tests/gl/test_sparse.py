"""Density fields in bricks give the picture that dense ones give."""

from dataclasses import replace

import numpy as np
import pytest
from building import camera, distant, field, index_of, point, rotation, scene, smooth_noise, translation, volume

from previs import Medium, Settings
from previs.description import Field, SceneDescription, Volume
from previs.render.plan import make_plan
from previs.vdb.grid import Tiles

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


def test_only_what_takes_less_is_in_bricks() -> None:
    """`auto` leaves small fields and filled ones as they are; the plan says what it does, and how much that takes."""

    def fields_pass(values: np.ndarray, **knobs):
        index = index_of(scene(volume(values, MEDIUM), distant((1, -1, 0))))
        plan = make_plan(index, camera((0, 0, 5)), 8, 8, Settings(**knobs))
        return plan, next(p for p in plan.passes if p.kind == "fields")

    small, full, empty = patches((40, 40, 40)), np.ones((160, 160, 160)), np.zeros((160, 160, 160))
    empty[::159, ::159, ::159] = 1.0
    for values, bricks in ((small, False), (full, False), (empty, True)):
        plan, upload = fields_pass(values)
        assert plan.defines["HAS_SPARSE"] == bricks
        assert ("1 in bricks of" in upload.why) == bricks
    _, dense = fields_pass(empty, sparse="off")
    assert dense.memory >= 162**3 * 2
    assert upload.memory < 0.1 * dense.memory
    assert fields_pass(small, sparse="on")[0].defines["HAS_SPARSE"]
    assert not fields_pass(empty, sparse="off")[0].defines["HAS_SPARSE"]


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


def test_the_planned_memory_is_that_of_the_textures(renderer) -> None:
    description = scenes()["tiles"]
    drawn(renderer, description, sparse="on")
    atlas = renderer._frame.density
    held = 2 * np.prod(atlas.texture.size) + 4 * np.prod(atlas.bricks.size) + 2 * np.prod(atlas.cells.size)
    plan = renderer.plan(index_of(description), camera((2.5, 1.5, 3.0)), *SIZE, Settings(sparse="on"))
    assert next(p.memory for p in plan.passes if p.kind == "fields") == held

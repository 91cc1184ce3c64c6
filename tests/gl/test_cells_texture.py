"""The cells of density fields as shaders read them."""

import os
from pathlib import Path

import numpy as np
import pytest
from building import camera, distant, field, index_of, scene, translation, volume

from previs import Medium, Settings
from previs.description import Volume
from previs.render import shader
from previs.render.frame import UNITS
from previs.render.shader import Program

pytestmark = pytest.mark.gl

READ = """
#include "include/medium.glsl"
uniform int number;
uniform int row;
uniform int layer;
layout(location = 0) out float value;
void main() { value = density_cell(number, vec3(gl_FragCoord.x - 1.0, float(row) + 0.25, float(layer) + 0.75)); }
"""


@pytest.fixture
def read_cells(renderer, tmp_path: Path, monkeypatch):
    """A function from the number of a volume in the renderer's plan to its cells [z, y, x], with one more on both
    sides along x."""
    for file in shader.shader_folder().iterdir():
        os.symlink(file, tmp_path / file.name)
    (tmp_path / "read.frag").write_text(READ)
    monkeypatch.setattr(shader, "shader_folder", lambda: tmp_path)
    frame = renderer._frame

    def read(number: int, count: tuple[int, int, int]) -> np.ndarray:
        layers, rows, columns = count
        found = np.zeros((layers, rows, columns + 2), np.float32)
        with renderer.context as context:
            program = Program(context, "fullscreen.vert", "read.frag", frame.plan.defines)
            program.set(**UNITS)
            frame.bind_lighting(program, range(0))
            texture = context.texture((columns + 2, 1), 1, dtype="f4")
            target = context.framebuffer([texture])
            for layer in range(layers):
                for row in range(rows):
                    program.set(number=number, row=row, layer=layer)
                    target.use()
                    frame.draw_fullscreen(program)
                    found[layer, row] = np.frombuffer(target.read(components=1, dtype="f4"), np.float32)
            frame.rest()
            target.release()
            texture.release()
            program.program.release()
        return found

    return read


def test_cells_are_read_in_the_units_of_the_density(renderer, read_cells) -> None:
    """Of several fields in one texture, and of an instance; beyond the ends the outermost cell is read."""
    random = np.random.default_rng(5)
    arrays = []
    for shape in ((30, 9, 17), (8, 41, 5), (60, 20, 33)):
        values = np.zeros(shape)
        values[-1, -1, -1] = 3.0
        values[1:4, 2:3, 1:4] = random.uniform(0.0, 40.0, (3, 1, 3))
        arrays.append(values)
    fields = [field(a) for a in arrays]
    fields.append(fields[0])
    volumes = [Volume(f"/V{i}", translation(3.0 * i, 0, 0), Medium(), density=f) for i, f in enumerate(fields)]
    renderer.render(index_of(scene(*volumes, distant((1, -1, 0)))), camera((20, 0, 0)), (8, 8), Settings())
    atlas = renderer._frame.density
    for number, v in enumerate(volumes):
        packed = atlas._voxels.blocks[next(k for k in atlas._voxels.blocks if k[0] == v.density.key)]
        expected = packed.cells[0].astype(np.float32)
        assert (expected < 0).any() and (expected > 0).any()
        expected = np.where(expected > 0, expected * np.float32(packed.scale), expected)
        found = read_cells(number, expected.shape)
        np.testing.assert_allclose(found[:, :, 1:-1], expected, rtol=1e-6)
        np.testing.assert_array_equal(found[:, :, 0], found[:, :, 1])
        np.testing.assert_array_equal(found[:, :, -1], found[:, :, -2])


def test_the_box_spans_the_cells(renderer) -> None:
    """Box coordinate 1 is the centre of the last texel, which may lie inside the last cell."""
    v = volume(np.ones((30, 9, 17)), Medium())
    renderer.render(index_of(scene(v, distant((1, -1, 0)))), camera((20, 0, 0)), (8, 8), Settings())
    placement = renderer._frame.density.placements["/Volume"]
    np.testing.assert_allclose(placement.cells_scale, (31 / 4, 10 / 4, 18 / 4))

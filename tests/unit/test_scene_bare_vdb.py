"""A .vdb file without a stage: seen at once, on a stage that can be edited and saved."""

import os

import numpy as np
import pytest
from pxr import Sdf

from previs import vdb
from previs.description import volume_world_bounds
from previs.errors import PrevisError
from previs.scene import Scene
from previs.scene.bare_vdb import OPTICAL_DEPTH, typical_column


def grid(name, value=0.5, size=16, voxel=0.25, **options):
    matrix = np.diag([voxel, voxel, voxel, 1.0])
    matrix[3, :3] = 10, 20, 30
    return vdb.Grid.from_dense(name, np.full((size,) * 3, value, np.float32), matrix, **options)


@pytest.fixture
def file(tmp_path):
    def write(*grids, name="x.vdb"):
        vdb.write(tmp_path / name, list(grids))
        return tmp_path / name

    return write


def test_a_bare_file_is_seen_at_once(file):
    path = file(grid("density"))
    with Scene.open(path) as scene:
        described = scene.describe()
        [volume] = described.volumes.values()
        # A cube of 16 voxels of 0.25 with the value 0.5 is a column of 2.
        assert volume.medium.extinction == pytest.approx((OPTICAL_DEPTH / 2,) * 3)
        assert not volume.medium.emits
        assert [light.kind for light in described.lights.values()] == ["distant"]
        assert scene.camera().path == "/Camera"
        [note] = described.notes
        assert note.path == str(path) and "grid density is the density, its extinction 3 per unit" in note.message
        assert not scene.has_overrides
        assert scene.reader.counters["grids"] == 1


def test_what_is_around_it_follows_its_size(file):
    for voxel in (0.001, 100.0):
        with Scene.open(file(grid("density", voxel=voxel))) as scene:
            described = scene.describe()
            lo, hi = volume_world_bounds(described.volumes["/Volume"])
            ground = described.meshes["/Ground"].geometry.points
            diagonal = np.linalg.norm(hi - lo)
            assert lo[1] - 0.05 * diagonal < ground[:, 1].max() < lo[1]
            assert (ground.min(axis=0)[[0, 2]] < lo[[0, 2]]).all() and (ground.max(axis=0)[[0, 2]] > hi[[0, 2]]).all()
            camera = described.cameras["/Camera"]
            towards = 0.5 * (lo + hi) - camera.camera_to_world[3, :3]
            assert np.linalg.norm(towards) < 5 * diagonal
            assert np.cross(towards, camera.camera_to_world[2, :3]) == pytest.approx(np.zeros(3), abs=1e-6 * diagonal)
            near, far = camera.clipping_range
            assert near < np.linalg.norm(towards) - diagonal and far > 10 * diagonal


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (("vel_x", "Density"), "Density"),
        (("temperature", "smoke"), "smoke"),
        (("flame", "other"), "other"),
        (("temperature",), "temperature"),
        (("",), ""),
    ],
)
def test_which_grid_is_the_density(file, names, chosen):
    with Scene.open(file(*map(grid, names))) as scene:
        assert scene.describe().volumes["/Volume"].density.grid.name == chosen


def test_a_flame_glows(file):
    with Scene.open(file(grid("density"), grid("flame", 3.0))) as scene:
        volume = scene.describe().volumes["/Volume"]
        assert volume.emission.grid.name == "flame" and volume.medium.emits
        assert volume.medium.emission_scale * 3.0 == pytest.approx(20, rel=0.01)


@pytest.mark.parametrize(("kelvin", "glows"), [(1500.0, True), (2.0, False)])
def test_a_temperature_glows_when_it_is_hot(file, kelvin, glows):
    with Scene.open(file(grid("density"), grid("temperature", kelvin))) as scene:
        described = scene.describe()
        volume = described.volumes["/Volume"]
        assert (volume.temperature is not None, volume.medium.emits) == (glows, glows)
        assert ("temperature is left out" in described.notes[0].message) is not glows


def test_grids_of_one_name(file):
    with Scene.open(file(grid("density", 1.0), grid("density", 2.0))) as scene:
        described = scene.describe()
        assert described.volumes["/Volume"].density.grid.leaf_values.max() == 1.0
        assert len(described.notes) == 1


def test_an_empty_grid(file):
    with Scene.open(file(grid("density", 0.0))) as scene:
        described = scene.describe()
        assert not described.volumes and described.meshes
        assert any(note.kind == "empty" for note in described.notes)


def test_files_that_cannot_be_shown(file, tmp_path):
    with pytest.raises(PrevisError, match=r"none\.vdb: no such file"):
        Scene.open(tmp_path / "none.vdb")
    (tmp_path / "bad.vdb").write_bytes(b"nonsense")
    with pytest.raises(PrevisError, match=r"bad\.vdb: not a readable \.vdb file"):
        Scene.open(tmp_path / "bad.vdb")
    (tmp_path / "folder.vdb").mkdir()
    with pytest.raises(PrevisError, match=r"folder\.vdb: "):
        Scene.open(tmp_path / "folder.vdb")
    vectors = vdb.Grid.from_dense("velocity", np.ones((4, 4, 4, 3), np.float32))
    with pytest.raises(PrevisError, match=r"x\.vdb: holds no grid of numbers to show; its grids: velocity"):
        Scene.open(file(vectors))
    whole = file(grid("density", 1.0, 32), name="whole.vdb").read_bytes()
    (tmp_path / "cut.vdb").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PrevisError) as caught:
        Scene.open(tmp_path / "cut.vdb")
    assert str(caught.value).startswith(f"{tmp_path}/cut.vdb: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("save", ["save", "save_overrides"])
def test_what_is_saved_is_a_stage(file, tmp_path, save):
    (tmp_path / "out").mkdir()
    with Scene.open(file(grid("density"))) as scene:
        scene.set_medium("/Volume", albedo=0.25)
        assert scene.has_overrides and scene.authored_medium("/Volume").albedo == pytest.approx((0.9,) * 3)
        scene.set_setting("coefficients", 14)
        getattr(scene, save)(tmp_path / "out" / "stage.usda")
        described = scene.describe()
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "out" / "stage.usda"))
    assert layer.GetAttributeAtPath("/Volume/density.filePath").default.path == "../x.vdb"
    with Scene.open(tmp_path / "out" / "stage.usda") as scene:
        again = scene.describe()
        assert again.volumes["/Volume"].parts() == described.volumes["/Volume"].parts()
        assert again.lights["/Sun"].parts() == described.lights["/Sun"].parts()
        assert again.cameras["/Camera"].parts() == described.cameras["/Camera"].parts()
        assert scene.settings()["coefficients"] == 14


def test_a_relative_path_and_a_layer_over_it(file, tmp_path, monkeypatch):
    file(grid("density"))
    (tmp_path / "look.usda").write_text('#usda 1.0\nover "Sun"\n{\n float inputs:intensity = 7\n}\n')
    (tmp_path / "gone.usda").write_text('#usda 1.0\nover "Volume" (active = false)\n{\n}\n')
    monkeypatch.chdir(tmp_path)
    with Scene.open("x.vdb", "look.usda") as scene:
        assert scene.light_values("/Sun").intensity == 7
        monkeypatch.chdir(os.path.dirname(tmp_path))
        assert set(scene.describe().volumes) == {"/Volume"}
        assert {os.path.basename(f) for f in scene.files()} == {"x.vdb", "look.usda"}
    with Scene.open(tmp_path / "x.vdb", tmp_path / "gone.usda") as scene:
        assert not scene.describe().volumes


def test_a_file_that_changes_is_read_again(file):
    path = file(grid("density"))
    with Scene.open(path) as scene:
        scene.describe()
        file(grid("density", 2.0))
        os.utime(path, ns=(1, 10**18))
        scene.reload()
        assert scene.describe().volumes["/Volume"].density.grid.leaf_values.max() == 2.0


def test_columns_of_a_grid_with_leaves_and_tiles():
    whole = np.zeros((64, 16, 16), np.float32)
    whole[:32] = 2.0
    assert typical_column(vdb.Grid.from_dense("d", whole)) == pytest.approx(32.0)
    tiles = vdb.Tiles(np.zeros((1, 3), np.int32), np.array([128], np.int32), np.array([0.5], np.float32))
    none = np.zeros((0, 8, 8, 8), np.float32)
    tiled = vdb.Grid("d", np.eye(4), np.zeros((0, 3), np.int32), none, none.astype(bool), tiles=tiles)
    assert typical_column(tiled) == pytest.approx(64.0)

"""The window, driven by the test engine on a platform without a display: one process for every scenario."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdVol

import previs
from previs import io, vdb

SCENES = Path(__file__).resolve().parents[2] / "scenes"

pytestmark = pytest.mark.window


@pytest.mark.parametrize(
    "scenario",
    [
        "opens_and_refines",
        "coefficients",
        "drags_albedo",
        "types_values",
        "wipes",
        "compares_with_before",
        "picks",
        "moves_the_camera",
        "lights",
        "inspects",
        "survives_bad_files",
        "survives_shader_errors",
        "asks_before_leaving",
        "rests",
    ],
)
def test_plume(drive, scenario):
    drive(scenario)


@pytest.mark.parametrize("scenario", ["drags_albedo"])
def test_a_stage_without_meshes(drive, scenario):
    drive(scenario, SCENES / "pyroclastic.usda")


def test_saved_overrides_give_the_same_picture(drive, tmp_path):
    folder = drive("saves_overrides")
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    stage.GetRootLayer().subLayerPaths[:] = ["./look.usda", str(SCENES / "plume.usda")]
    stage.GetRootLayer().Save()
    view = json.loads((folder / "view.json").read_text())
    size = tuple(view["size"])
    with previs.open(tmp_path / "shot.usda") as scene:
        authored = scene.camera(view["camera"] or None)
        from previs.ui.gate import fitted

        image = previs.render(scene, fitted(authored, size[0] / size[1])[0], size)
        assert image.stats["settings"]["coefficients"] == 14
    window = np.load(folder / "shown.npy")
    np.testing.assert_array_equal(normal(image.color), normal(window))
    exported, linear = io.load_color(folder / "shown.exr")
    assert linear
    np.testing.assert_array_equal(exported, window)


def normal(values: np.ndarray) -> np.ndarray:
    """The values, 0 for denormal ones: whether they are flushed depends on which of the rasteriser's threads draws."""
    return np.where(np.abs(values) < np.finfo(np.float32).tiny, 0.0, values)


def test_files_that_change_on_disk(drive, tmp_path):
    for name in ("plume.usda", "plume.vdb"):
        shutil.copy(SCENES / name, tmp_path / name)
    drive("follows_the_disk", tmp_path / "plume.usda")


def test_time(drive, tmp_path):
    drive("scrubs", animated_stage(tmp_path))


def test_the_error_at_rest(drive, tmp_path):
    drive("measures", small_stage(tmp_path), PREVIS_TEST_SIZE="320x200")


def test_a_picture_at_rest_converges(drive, tmp_path):
    drive("converges", small_stage(tmp_path), PREVIS_TEST_SIZE="320x200")


def test_a_bare_vdb(drive):
    drive("drops_a_vdb", None, PREVIS_TEST_VDB=str(SCENES / "plume.vdb"))


@pytest.mark.skipif("PREVIS_TEST_DATA" not in os.environ, reason="PREVIS_TEST_DATA is not set")
def test_a_bare_vdb_of_others(drive):
    drive("drops_a_vdb", None, PREVIS_TEST_VDB=str(Path(os.environ["PREVIS_TEST_DATA"]) / "arnold_usd" / "smoke.vdb"))


def test_a_crash_loses_nothing(drive, tmp_path):
    config = str(tmp_path / "config")
    drive("crashes_after_an_edit", PREVIS_CONFIG=config)
    drive("recovers", None, PREVIS_CONFIG=config)


def small_stage(folder: Path) -> Path:
    """A cloud of few voxels, which even a brute-force march goes through quickly."""
    axis = np.linspace(-1.0, 1.0, 20)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = np.clip(1.0 - x * x - y * y - z * z + 0.4 * np.sin(7.0 * x) * np.sin(6.0 * y + 2.0 * z), 0.0, None)
    with previs.Scene() as scene:
        scene.add_volume("/cloud", density, bounds=((-1, -1, -1), (1, 1, 1)), extinction=(6, 5, 4))
        scene.add_distant_light("/sun", (-1, -1, -0.5), irradiance=3)
        scene.save(folder / "small.usda")
    return folder / "small.usda"


def animated_stage(folder: Path) -> Path:
    """A cloud that moves for eight frames, a .vdb file for each."""
    axis = np.linspace(-1.0, 1.0, 40)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    matrix = np.diag([0.05, 0.05, 0.05, 1.0])
    matrix[3, :3] = -0.975
    with previs.Scene() as scene:
        scene.add_volume("/cloud", np.ones_like(x), transform=matrix, extinction=(4, 4, 4))
        scene.add_distant_light("/sun", (-1, -1, -0.5), irradiance=3)
        scene.save(folder / "cloud.usda")
    stage = Usd.Stage.Open(str(folder / "cloud.usda"))
    files = UsdVol.OpenVDBAsset(stage.GetPrimAtPath("/cloud/density")).GetFilePathAttr()
    files.Clear()
    for frame in range(1, 9):
        density = np.clip(1.0 - (x - 0.08 * (frame - 1)) ** 2 - y * y - z * z, 0.0, None).astype(np.float32)
        vdb.write(folder / f"cloud.{frame:04d}.vdb", [vdb.Grid.from_dense("density", density, matrix)])
        files.Set(Sdf.AssetPath(f"./cloud.{frame:04d}.vdb"), frame)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(8)
    stage.GetRootLayer().Save()
    return folder / "cloud.usda"

"""Stages made by others, where PREVIS_TEST_DATA has them: each opens, or says in one line why not."""

import os
from pathlib import Path

import pytest

from previs.errors import PrevisError
from previs.stage import StageReader, open_stage

DATA = os.environ.get("PREVIS_TEST_DATA")
STAGES = sorted(Path(DATA).rglob("*.usda")) if DATA else []

pytestmark = pytest.mark.skipif(not STAGES, reason="PREVIS_TEST_DATA is not set")


@pytest.mark.parametrize("path", STAGES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_opens_or_says_why_not(path, capfd):
    try:
        scene = StageReader(open_stage(path)).read()
    except PrevisError as error:
        assert "\n" not in str(error)
        assert ".vdb" in str(error)
    else:
        assert scene.volumes or scene.lights or scene.meshes
        assert all("\n" not in str(n) for n in scene.notes)
        assert len(set(scene.notes)) == len(scene.notes)
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(not DATA, reason="PREVIS_TEST_DATA is not set")
def test_an_animated_file_path_holds_its_empty_frame():
    reader = StageReader(open_stage(Path(DATA) / "openusd_vdb" / "vdbVolumeFallbackMaterial.usda"))
    assert "no active voxels" in str(reader.read(1.0).notes)


@pytest.mark.skipif(not DATA, reason="PREVIS_TEST_DATA is not set")
def test_field_index_of_houdini_files():
    scene = StageReader(open_stage(Path(DATA) / "arnold_usd" / "test_2315.usda")).read()
    keys = {v.density.key for v in scene.volumes.values()}
    assert len(keys) == 3

"""Stages made by others, where PREVIS_TEST_DATA has them: each renders, or fails with one line that is known here."""

import os
from pathlib import Path

import numpy as np
import pytest

import previs

DATA = Path(os.environ.get("PREVIS_TEST_DATA") or "/nonexistent")
STAGES = sorted(p for folder in ("openusd_vdb", "arnold_usd") for p in (DATA / folder).glob("*.usda"))

#: What cannot be rendered, and why: a piece of the line.
FAILURES = {"arnold_usd/test_2239.usda": "./cube01.vdb: no such file"}
#: Stages whose first frame is empty smoke; the second is not.
EMPTY_FIRST = {"vdbVolumeFallbackMaterial.usda", "vdbVolumeTargetMemory.usda"}

pytestmark = [pytest.mark.gl, pytest.mark.skipif(not STAGES, reason="PREVIS_TEST_DATA is not set")]


def name(path: Path) -> str:
    return f"{path.parent.name}/{path.name}"


@pytest.mark.parametrize("path", STAGES, ids=name)
def test_renders_or_says_why_not(path, capfd):
    time = 2.0 if path.name in EMPTY_FIRST else None
    try:
        image = previs.render(path, size=96, time=time)
    except previs.PrevisError as error:
        assert "\n" not in str(error)
        assert name(path) in FAILURES, error
        assert FAILURES[name(path)] in str(error)
    else:
        assert name(path) not in FAILURES
        assert image.size[0] == 96
        assert np.isfinite(image.color).all() and (image.color >= 0.0).all()
        assert ((image.alpha >= 0.0) & (image.alpha <= 1.0)).all()
        assert image.aovs["transmittance"].min() < 0.7, "no volume is in view"
    assert capfd.readouterr().err == ""


def test_an_empty_frame_shows_what_else_there_is():
    image = previs.render(DATA / "openusd_vdb" / "vdbVolumeFallbackMaterial.usda", size=96, time=1.0)
    assert any("no active voxels" in note for note in image.stats["notes"])
    assert np.isfinite(image.depth).any()
    assert image.color.max() < 1e-6


def test_a_flipped_volume_is_the_flipped_picture():
    upright, flipped = (
        previs.render(DATA / "openusd_vdb" / f"vdbVolume{name}.usda", size=96).aovs["transmittance"]
        for name in ("", "Flipped")
    )
    assert not np.allclose(upright, flipped, atol=0.2)
    assert np.abs(upright - flipped[::-1]).mean() < 0.1 * np.abs(upright - flipped).mean()


def test_the_houdini_smoke_lit_by_a_sun():
    with previs.open(DATA / "arnold_usd" / "test_0030.usda") as scene:
        scene.add_distant_light("/sun", direction=(1, -1, -0.5), irradiance=3)
        image = previs.render(scene, size=96)
        reference = previs.render(scene, size=96, transmittance="march")
    assert image.color.max() > 0.05
    error = np.sqrt(np.mean((image.color - reference.color) ** 2))
    assert error < 0.02 * np.percentile(reference.color, 99.9)


def test_missing_frames_are_left_out_when_asked():
    with previs.Scene.open(DATA / "arnold_usd" / "test_2239.usda", keep_going=True) as scene:
        image = previs.render(scene, size=96)
    assert np.isfinite(image.color).all()
    assert any("cube01.vdb" in note for note in image.stats["notes"])

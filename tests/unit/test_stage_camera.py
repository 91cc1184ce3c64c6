"""Cameras, the choice of one, and render settings."""

import numpy as np
import pytest
from stages import describe, notes, only, stage_of

from previs.errors import PrevisError
from previs.stage import StageReader, default_camera, find_camera, read_render_settings


def camera(body=""):
    return only(describe(f'def Camera "C" {{ {body} }}').cameras)


def test_perspective():
    found = camera(
        """
        float focalLength = 35
        float horizontalAperture = 36
        float verticalAperture = 24
        float horizontalApertureOffset = 1
        float verticalApertureOffset = -2
        float2 clippingRange = (0.5, 100)
        """
    )
    assert (found.focal_length, found.horizontal_aperture, found.vertical_aperture) == (35, 36, 24)
    assert found.window() == pytest.approx((-17 / 35, 19 / 35, -14 / 35, 10 / 35))
    assert found.clipping_range == (0.5, 100)


def test_orthographic():
    found = camera('token projection = "orthographic"\nfloat horizontalAperture = 40\nfloat verticalAperture = 20')
    assert found.projection == "orthographic"
    assert found.window() == (-2, 2, -1, 1)


def test_scale_is_removed_without_a_note():
    body = """
        double3 xformOp:translate = (1, 2, 3)
        float3 xformOp:rotateXYZ = (10, 20, 30)
        float3 xformOp:scale = (2, 3, 4)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    """
    scene = describe(f'def Camera "C" {{ {body} }}')
    matrix = only(scene.cameras).camera_to_world
    assert matrix[:3, :3] @ matrix[:3, :3].T == pytest.approx(np.eye(3))
    assert matrix[3, :3].tolist() == [1, 2, 3]
    assert not scene.notes


def test_shear_is_removed_with_a_note():
    body = "matrix4d xformOp:transform = ((1, 0, 0, 0), (1, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))\n"
    scene = describe(f'def Camera "C" {{ {body} uniform token[] xformOpOrder = ["xformOp:transform"] }}')
    matrix = only(scene.cameras).camera_to_world
    assert matrix[:3, :3] @ matrix[:3, :3].T == pytest.approx(np.eye(3))
    assert "shear" in only_note(scene)


def only_note(scene):
    [note] = notes(scene)
    return note.message


def test_unusable_values_are_repaired():
    scene = describe('def Camera "C" { float focalLength = 0\n float2 clippingRange = (5, 1) }')
    assert only(scene.cameras).focal_length == 50.0
    assert only(scene.cameras).clipping_range == (1.0, 1.0e6)
    assert len(notes(scene, "repaired")) == 2


def test_lens_and_shutter_are_reported():
    message = only_note(
        describe('def Camera "C" { float fStop = 2\n float exposure = 1\n double shutter:close = 0.5 }')
    )
    assert message == "depth of field (fStop), motion blur (shutter), exposure"


THREE = 'def Camera "a" {} def Xform "G" { def Camera "b" {} def Camera "c" {} } def Xform "H" { def Camera "c" {} }'


def test_find_by_path_and_by_name():
    for scene in (describe(THREE), stage_of(THREE)):
        assert find_camera(scene, "/G/b").path == "/G/b"
        assert find_camera(scene, "b").path == "/G/b"
        assert find_camera(scene, "/H/c").path == "/H/c"


@pytest.mark.parametrize("name", ["nothing", "c", "/G"])
def test_unknown_or_ambiguous_camera_lists_all(name):
    with pytest.raises(PrevisError, match="/a, /G/b, /G/c, /H/c"):
        find_camera(describe(THREE), name)


def test_no_camera():
    assert default_camera(describe("")) is None
    with pytest.raises(PrevisError, match="none"):
        find_camera(describe(""), "main")


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ('def Camera "a" {}', "/a"),
        ('def Camera "a" {} def Camera "b" {}', "/a"),
        ('def Camera "a" {} def Xform "X" { def Camera "main_cam" {} }', "/X/main_cam"),
    ],
)
def test_default_camera(text, chosen):
    assert default_camera(describe(text)).path == chosen


def test_render_settings_choose_the_camera():
    text = """( renderSettingsPrimPath = "/R/s" )
def Camera "a" {} def Camera "b" {}
def Scope "R" { def RenderSettings "s" { rel camera = </b>
    uniform int2 resolution = (640, 480) } def RenderSettings "t" {} }"""
    stage = stage_of(text)
    reader = StageReader(stage)
    settings = reader.render_settings()
    assert (settings.path, settings.camera, settings.resolution) == ("/R/s", "/b", (640, 480))
    assert default_camera(reader.read(), settings.camera).path == "/b"
    assert StageReader(stage, render_settings="/R/t").render_settings().resolution is None


def test_render_settings_that_are_none():
    assert read_render_settings(stage_of("")) is None
    with pytest.raises(PrevisError, match="/a"):
        read_render_settings(stage_of('def Camera "a" {}'), "/a")


@pytest.mark.parametrize(("name", "reported"), [("lin_rec709", False), ("acescg", True)])
def test_another_rendering_color_space_is_reported(name, reported):
    text = 'def RenderSettings "s" { uniform token renderingColorSpace = "%s" }' % name  # noqa: UP031
    assert bool(describe(text).notes) is reported

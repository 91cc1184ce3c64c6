"""UsdLux: every factor of the schema formulas, and the reduction of a light to its centre."""

import math

import numpy as np
import pytest
from pxr import UsdLux
from stages import describe, notes, only

from previs.description import Light


def light(kind: str, body: str = "", parent: str = "") -> Light:
    text = f'def {kind} "L" (prepend apiSchemas = ["ShapingAPI", "ShadowAPI"]) {{\n{body}\n}}'
    if parent:
        text = f'def Xform "P" {{\n{parent}\n{text}\n}}'
    return only(describe(text).lights)


NARROW = math.pi * math.sin(math.radians(0.265)) ** 2
SCALED = 'double3 xformOp:scale = (2, 2, 2)\nuniform token[] xformOpOrder = ["xformOp:scale"]'


@pytest.mark.parametrize(
    ("kind", "body", "strength"),
    [
        ("DistantLight", "", 50000.0 * NARROW),
        ("DistantLight", "float inputs:intensity = 2\nfloat inputs:exposure = 3", 16.0 * NARROW),
        ("DistantLight", "bool inputs:normalize = 1\nfloat inputs:intensity = 3", 3.0),
        ("DistantLight", "float inputs:angle = 0\nfloat inputs:intensity = 3", 3.0),
        ("DistantLight", "float inputs:angle = 90\nfloat inputs:intensity = 1", math.pi / 2),
        ("DistantLight", "bool inputs:normalize = 1\nfloat inputs:angle = 20\nfloat inputs:intensity = 3", 3.0),
        ("SphereLight", "", math.pi * 0.25),
        ("SphereLight", "float inputs:radius = 2\nfloat inputs:intensity = 3", 12.0 * math.pi),
        ("SphereLight", "float inputs:radius = 2\nbool inputs:normalize = 1", 0.25),
        ("SphereLight", "float inputs:radius = 0\nbool inputs:normalize = 1", 0.25),
        ("SphereLight", "float inputs:radius = 0", 0.0),
        ("SphereLight", "bool treatAsPoint = 1", math.pi * 0.25),
        ("SphereLight", "float inputs:diffuse = 0.5", math.pi * 0.125),
        ("SphereLight", SCALED, math.pi),
        ("SphereLight", SCALED + "\nbool inputs:normalize = 1", 0.25),
        ("DiskLight", "float inputs:radius = 2", 4.0 * math.pi),
        ("DiskLight", "float inputs:radius = 2\nbool inputs:normalize = 1", 1.0),
        ("RectLight", "float inputs:width = 2\nfloat inputs:height = 3", 6.0),
        ("RectLight", SCALED, 4.0),
        ("RectLight", "float inputs:width = 2\nbool inputs:normalize = 1", 1.0),
        ("CylinderLight", "float inputs:radius = 1\nfloat inputs:length = 2", math.pi),
        ("CylinderLight", "float inputs:radius = 1\nbool inputs:normalize = 1", 0.25),
    ],
)
def test_strength(kind, body, strength):
    assert light(kind, body).strength == pytest.approx((strength,) * 3, rel=1e-5)


def test_default_distant_light_gives_the_known_irradiance():
    assert light("DistantLight").strength[0] == pytest.approx(3.36, abs=0.005)


@pytest.mark.parametrize(
    ("kind", "body", "radiance"),
    [
        ("SphereLight", "float inputs:intensity = 3", 3.0),
        ("SphereLight", "float inputs:radius = 2\nbool inputs:normalize = 1", 1.0 / (16.0 * math.pi)),
        ("DiskLight", "float inputs:radius = 2\nbool inputs:normalize = 1", 1.0 / (4.0 * math.pi)),
        ("RectLight", "float inputs:width = 2\nbool inputs:normalize = 1", 0.5),
        ("CylinderLight", "float inputs:radius = 2\nbool inputs:normalize = 1", 1.0 / (4.0 * math.pi)),
        ("DistantLight", "bool inputs:normalize = 1\nfloat inputs:intensity = 1", 1.0 / NARROW),
        ("DomeLight", "float inputs:intensity = 2", 2.0),
        ("DomeLight_1", "float inputs:exposure = 1", 2.0),
    ],
)
def test_radiance(kind, body, radiance):
    assert light(kind, body).radiance == pytest.approx((radiance,) * 3, rel=1e-5)


def test_temperature_multiplies_the_colour():
    found = light(
        "SphereLight",
        """
        color3f inputs:color = (1, 0.5, 0)
        bool inputs:enableColorTemperature = 1
        float inputs:colorTemperature = 3000
        """,
    )
    assert found.radiance == pytest.approx(np.array((1, 0.5, 0)) * UsdLux.BlackbodyTemperatureAsRgb(3000.0), rel=1e-6)


def test_temperature_needs_to_be_enabled():
    assert light("SphereLight", "float inputs:colorTemperature = 3000").radiance == (1.0, 1.0, 1.0)


def test_shaping():
    found = light(
        "SphereLight",
        """
        float inputs:shaping:cone:angle = 40
        float inputs:shaping:cone:softness = 0.25
        float inputs:shaping:focus = 2
        color3f inputs:shaping:focusTint = (0.5, 0, 0)
        """,
    ).shaping
    assert (found.cone_angle, found.cone_softness, found.focus, found.focus_tint) == (40.0, 0.25, 2.0, (0.5, 0.0, 0.0))


def test_no_shaping_without_the_schema():
    assert only(describe('def SphereLight "L" {}').lights).shaping is None


def test_shadows_can_be_switched_off():
    assert light("SphereLight").casts_shadows
    assert not light("SphereLight", "bool inputs:shadow:enable = 0").casts_shadows


def test_direction_and_position_are_in_the_world():
    found = light(
        "DistantLight",
        'float xformOp:rotateX = -90\nuniform token[] xformOpOrder = ["xformOp:rotateX"]',
        parent='double3 xformOp:translate = (1, 2, 3)\nuniform token[] xformOpOrder = ["xformOp:translate"]',
    )
    assert found.direction == pytest.approx((0, -1, 0), abs=1e-12)
    assert found.position == pytest.approx((1, 2, 3))


def test_invisible_light_is_off():
    assert not describe('def SphereLight "L" { token visibility = "invisible" }').lights


def test_light_in_an_invisible_group_is_off():
    assert not describe('def Xform "G" { token visibility = "invisible"\n def SphereLight "L" {} }').lights


@pytest.mark.parametrize("kind", ["GeometryLight", "PortalLight", "PluginLight"])
def test_kinds_that_are_not_modelled_are_reported(kind):
    scene = describe(f'def {kind} "L" {{}}')
    assert not scene.lights
    assert [n.path for n in notes(scene, "ignored")] == ["/L"]


def test_mesh_light_is_reported_and_its_mesh_shown():
    scene = describe(
        """
def Mesh "L" (prepend apiSchemas = ["MeshLightAPI"]) {
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
}"""
    )
    assert not scene.lights
    assert list(scene.meshes) == ["/L"]
    assert "mesh lights" in notes(scene, "ignored")[0].message


@pytest.mark.parametrize(
    ("kind", "body", "fragment"),
    [
        ("DomeLight", "asset inputs:texture:file = @sky.exr@", "texture sky.exr"),
        ("SphereLight", "asset inputs:shaping:ies:file = @lamp.ies@", "IES profile lamp.ies"),
        ("SphereLight", "rel light:filters = </F>", "light filters"),
        ("SphereLight", "color3f inputs:shadow:color = (1, 0, 0)", "shadow:color"),
        ("SphereLight", "float inputs:shadow:distance = 3", "shadow:distance"),
        ("SphereLight", "rel collection:lightLink:excludes = </X>", "lightLink"),
        ("SphereLight", "bool collection:shadowLink:includeRoot = 0", "shadowLink"),
        ("SphereLight", "float intensity = 3", "intensity: since USD 21.02"),
        ("SphereLight", "float inputs:specular = 0", "specular"),
        ("DistantLight", "float inputs:shaping:focus = 3", "shaping"),
    ],
)
def test_ignored_features_are_reported(kind, body, fragment):
    scene = describe(f'def {kind} "L" (prepend apiSchemas = ["ShapingAPI", "ShadowAPI"]) {{\n{body}\n}}')
    assert any(fragment in n.message for n in notes(scene, "ignored"))


def test_trivial_links_are_not_reported():
    assert not describe('def SphereLight "L" { bool collection:lightLink:includeRoot = 1 }').notes


def test_zero_power_is_reported():
    scene = describe('def SphereLight "L" { float inputs:radius = 0 }')
    assert [n.kind for n in scene.notes] == ["empty"]


@pytest.mark.parametrize("kind", ["DiskLight", "RectLight", "CylinderLight"])
def test_area_lights_are_reported_as_reduced(kind):
    assert [n.kind for n in describe(f'def {kind} "L" {{}}').notes] == ["approximated"]


def test_only_large_sphere_lights_are_reported_as_reduced():
    text = 'def SphereLight "L" { float inputs:radius = %g }\ndef Cube "C" { double size = 10 }'
    assert not describe(text % 0.5).notes
    assert "centre" in describe(text % 2.0).notes[0].message


def test_negative_and_broken_values_are_repaired():
    scene = describe('def SphereLight "L" { float inputs:intensity = -3\n float inputs:radius = nan }')
    assert only(scene.lights).radiance == (0.0, 0.0, 0.0)
    assert only(scene.lights).radius == 0.5
    assert len(notes(scene, "repaired")) == 2


def test_animated_light():
    text = 'def SphereLight "L" { float inputs:intensity.timeSamples = {1: 1, 3: 5} }'
    assert only(describe(text, 2.0).lights).radiance[0] == 3.0
    assert only(describe(text).lights).radiance[0] == 1.0


def test_a_light_that_is_nowhere_is_left_out() -> None:
    """Whatever its size is, which is measured by the transform too."""
    place = 'double3 xformOp:translate = (nan, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:translate"]'
    scene = describe(f'def SphereLight "L" {{\nfloat inputs:radius = 0.5\n{place}\n}}\ndef SphereLight "K" {{\n}}')
    assert set(scene.lights) == {"/K"}
    assert [str(n) for n in notes(scene, "ignored")] == ["/L: ignored: its transform is not finite; it is left out"]

"""Edits of an opened stage: taken back exactly, value by value or all, and read beside what the stage says."""

import numpy as np
import pytest
from pxr import Sdf, UsdGeom
from stages import PREVIS_VOLUME, usda, write_field

from previs.description import Medium
from previs.errors import PrevisError
from previs.index import RenderIndex
from previs.scene import Scene, TimeRange
from previs.settings import Settings

SHOT = """
def Xform "W" {
    def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        %s
        rel field:density = </W/V/f>
        def OpenVDBAsset "f" { asset filePath = @./smoke.vdb@
            token fieldName = "density" }
    }
    def SphereLight "Key" { float inputs:intensity = 3
        float inputs:radius = 0.25
        color3f inputs:color = (1, 0.5, 0.25) }
    def Sphere "Ball" {}
    def Camera "Cam" {}
}
"""
BOUND = SHOT % "rel material:binding = </M>"
UNBOUND = SHOT % ""


@pytest.fixture
def shot(tmp_path):
    """A file with a volume, a light, a shape and a camera; what is given are inputs of its PrevisVolume."""

    def write(inputs="color3f inputs:albedo = (0.5, 0.5, 0.5)", body=BOUND, name="shot.usda"):
        write_field(tmp_path / "smoke.vdb")
        path = tmp_path / name
        # Time samples have braces of their own, on one line.
        path.write_text(usda(body) + PREVIS_VOLUME % inputs)
        return path

    return write


def moved(before, index):
    """(path, part) whose version is another than before."""
    entries = {**index.volumes, **index.lights, **index.meshes}
    return {(p, part) for p, e in entries.items() for part, v in e.versions.items() if before.get((p, part)) != v}


def versions(index):
    entries = {**index.volumes, **index.lights, **index.meshes}
    return {(p, part): v for p, e in entries.items() for part, v in e.versions.items()}


def test_undo_and_redo_restore_exactly(shot):
    with Scene.open(shot()) as scene:
        states = [scene.snapshot()]
        for edit in (
            lambda: scene.set_medium("/W/V", albedo=0.25),
            lambda: scene.set_medium("/W/V", scattering=2),
            lambda: scene.set_light("/W/Key", intensity=9, position=(1, 2, 3), cone_angle=20),
            lambda: scene.set_visible("/W/Ball", False),
            lambda: scene.add_distant_light("/Sun"),
            lambda: scene.remove("/W/Ball"),
        ):
            edit()
            states.append(scene.snapshot())
        media = []
        for state in states[::-1]:
            scene.restore(state)
            assert scene.snapshot() == state
            media.append(scene.describe().volumes["/W/V"].medium.albedo)
        assert not scene.has_overrides
        for state, albedo in zip(states, media[::-1], strict=True):
            scene.restore(state)
            assert scene.snapshot() == state
            assert scene.describe().volumes["/W/V"].medium.albedo == albedo


def test_restoring_the_present_state_reads_nothing(shot):
    with Scene.open(shot()) as scene:
        scene.set_medium("/W/V", albedo=0.25)
        first = scene.describe()
        scene.reader.counters.clear()
        scene.restore(scene.snapshot())
        assert scene.describe() is first
        assert not scene.reader.counters


def test_undoing_an_albedo_moves_the_scattering_alone(shot):
    with Scene.open(shot()) as scene:
        index = RenderIndex()
        states = [scene.snapshot()]
        index.update(scene.describe())
        for albedo in (0.25, 0.75):
            scene.set_medium("/W/V", albedo=albedo)
            states.append(scene.snapshot())
        index.update(scene.describe())
        scene.reader.counters.clear()
        for state in (states[1], states[0], states[2]):
            before = versions(index)
            scene.restore(state)
            index.update(scene.describe())
            assert moved(before, index) == {("/W/V", "scattering")}
        assert scene.reader.counters["grids"] == 0
        assert scene.reader.counters["geometry"] == 0


def test_undoing_the_first_edit_of_an_unbound_volume_keeps_its_voxels(shot):
    with Scene.open(shot(body=UNBOUND)) as scene:
        empty = scene.snapshot()
        before = scene.describe().volumes["/W/V"]
        scene.set_medium("/W/V", albedo=0.25)
        scene.describe()
        scene.restore(empty)
        assert scene.describe().volumes["/W/V"].density.grid is before.density.grid
        assert scene.reader.counters["grids"] == 1


def test_a_snapshot_holds_edits_only(shot, tmp_path):
    path = shot()
    with Scene.open(path) as scene:
        scene.set_light("/W/Key", intensity=7)
        scene.save_overrides(tmp_path / "look.usda")
    with Scene.open(path, tmp_path / "look.usda") as scene:
        assert not scene.has_overrides
        empty = scene.snapshot()
        assert "Key" not in empty and "look.usda" not in empty
        scene.set_light("/W/Key", radius=2)
        scene.restore(empty)
        assert scene.light_values("/W/Key").intensity == 7
        assert scene.authored_light("/W/Key").intensity == 7
        scene.set_light("/W/Key", intensity=1)
        scene.reset_light("/W/Key", "intensity")
        assert scene.light_values("/W/Key").intensity == 7
        assert scene.snapshot() == empty


def test_a_variant_chosen_when_opening_is_no_edit(tmp_path):
    path = tmp_path / "a.usda"
    path.write_text(
        usda(
            """
def Xform "A" (prepend variantSets = "look"
 variants = { string look = "dim" }
) { variantSet "look" = { "dim" { def SphereLight "L" { float inputs:intensity = 1 }
 }
 "bright" { def SphereLight "L" { float inputs:intensity = 5 }
 }
 }
}
"""
        )
    )
    with Scene.open(path, variants={"/A": {"look": "bright"}}) as scene:
        assert not scene.has_overrides
        assert scene.light_values("/A/L").intensity == scene.authored_light("/A/L").intensity == 5
        scene.set_light("/A/L", intensity=2)
        scene.discard_overrides()
        assert scene.light_values("/A/L").intensity == 5


def test_restoring_what_is_no_snapshot(shot):
    with Scene.open(shot()) as scene:
        scene.set_medium("/W/V", albedo=0.25)
        before = scene.snapshot()
        with pytest.raises(PrevisError, match="cannot be read as USD") as caught:
            scene.restore("nonsense")
        assert "\n" not in str(caught.value)
        assert scene.snapshot() == before


def test_a_built_scene_can_be_put_back_too():
    with Scene() as scene:
        scene.add_volume("/V", np.ones((2, 2, 2)))
        state = scene.snapshot()
        scene.set_voxels("/V", np.full((2, 2, 2), 3.0))
        scene.add_ground()
        scene.restore(state)
        described = scene.describe()
        assert not described.meshes
        assert described.volumes["/V"].density.grid.leaf_values.max() == 1.0
        assert not scene.has_overrides
        for call in (scene.discard_overrides, lambda: scene.reset_medium("/V"), lambda: scene.reset_light("/V")):
            with pytest.raises(ValueError, match="not opened from a file"):
                call()


def test_discarding_leaves_no_trace(shot):
    with Scene.open(shot()) as scene:
        empty = scene.snapshot()
        scene.set_medium("/W/V", extinction=3)
        scene.set_light("/W/Key", intensity=7)
        assert scene.has_overrides
        scene.discard_overrides()
        assert not scene.has_overrides
        assert scene.snapshot() == empty
        assert scene.medium("/W/V").albedo == (0.5, 0.5, 0.5)


# --- what the stage says -------------------------------------------------------------------------------------------


def test_authored_values_are_those_without_the_edits(shot):
    with Scene.open(shot()) as scene:
        medium, light = scene.medium("/W/V"), scene.light_values("/W/Key")
        scene.set_medium("/W/V", albedo=0.25, anisotropy=0.5)
        scene.set_light("/W/Key", intensity=7, visible=False)
        assert scene.authored_medium("/W/V") == medium != scene.medium("/W/V")
        assert scene.authored_light("/W/Key") == light != scene.light_values("/W/Key")


def test_authored_values_of_what_the_edits_made_are_defaults(shot):
    with Scene.open(shot()) as scene:
        scene.add_box_medium("/Fog", extinction=3)
        scene.add_sphere_light("/Bulb", intensity=7)
        assert scene.authored_medium("/Fog") == Medium()
        assert scene.authored_light("/Bulb").intensity == 1.0
        assert scene.authored_light("/Bulb").radius == 0.5
        scene.reset_light("/Bulb", "intensity")
        assert scene.light_values("/Bulb").intensity == 1.0


def test_light_values(shot):
    with Scene.open(shot()) as scene:
        values = scene.light_values("/W/Key")
        assert (values.kind, values.intensity, values.color, values.radius) == ("sphere", 3, (1, 0.5, 0.25), 0.25)
        assert (values.cone_angle, values.focus, values.color_temperature) == (90, 0, 6500)
        assert (values.casts_shadows, values.visible, values.normalize) == (True, True, False)
        assert (values.angle, values.width) == (0, 0)
        scene.set_light("/W/Key", color_temperature=3000, casts_shadows=False, exposure=-2)
        values = scene.light_values("/W/Key")
        assert (values.color_temperature, values.enable_color_temperature) == (3000, True)
        assert (values.casts_shadows, values.exposure) == (False, -2)
        scene.set_visible("/W", False)
        assert not scene.light_values("/W/Key").visible
        scene.add_distant_light("/Sun")
        assert scene.light_values("/Sun").angle == pytest.approx(0.53)
        for path in ("/W/Ball", "/nothing"):
            with pytest.raises(PrevisError, match=path):
                scene.light_values(path)


# --- resetting -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [(), ("albedo", "extinction", "phase")])
@pytest.mark.parametrize("body", [BOUND, UNBOUND])
def test_resetting_a_medium_leaves_no_trace(shot, body, names):
    with Scene.open(shot(body=body)) as scene:
        empty, medium = scene.snapshot(), scene.medium("/W/V")
        scene.set_medium("/W/V", albedo=0.25, extinction=4, phase="rayleigh")
        scene.reset_medium("/W/V", *names)
        assert scene.snapshot() == empty
        assert scene.medium("/W/V") == medium
        assert not scene.has_overrides


def test_resetting_one_value_keeps_the_others(shot):
    with Scene.open(shot(body=UNBOUND)) as scene:
        scene.set_medium("/W/V", albedo=0.25, extinction=4)
        scene.reset_medium("/W/V", "albedo")
        medium = scene.medium("/W/V")
        assert (medium.albedo, medium.extinction) == (Medium().albedo, (4, 4, 4))
        with pytest.raises(ValueError, match="opacity is not a value of a medium"):
            scene.reset_medium("/W/V", "opacity")


PAIR = "color3f inputs:scattering = (1, 1, 1)\ncolor3f inputs:absorption = (3, 3, 3)"


def test_resetting_across_the_two_parametrisations(shot):
    with Scene.open(shot(PAIR)) as scene:
        empty, medium = scene.snapshot(), scene.medium("/W/V")
        scene.set_medium("/W/V", albedo=0.5)
        assert scene.medium("/W/V").extinction == (4, 4, 4)
        scene.reset_medium("/W/V", "albedo")
        assert scene.snapshot() == empty
        scene.set_medium("/W/V", albedo=0.5, extinction=8)
        scene.reset_medium("/W/V", "albedo")
        assert scene.medium("/W/V").extinction == (8, 8, 8)
        assert scene.medium("/W/V").albedo == medium.albedo
        scene.reset_medium("/W/V", "scattering")
        assert scene.medium("/W/V").scattering == pytest.approx((1, 1, 1))
        assert scene.medium("/W/V").absorption == pytest.approx((6, 6, 6))
        scene.reset_medium("/W/V", "absorption")
        assert scene.medium("/W/V") == medium
        scene.reset_medium("/W/V")
        assert scene.snapshot() == empty


def test_setting_one_of_a_pair_keeps_the_other(shot):
    with Scene.open(shot("")) as scene:
        scene.set_medium("/W/V", scattering=5)
        assert scene.medium("/W/V").absorption == pytest.approx((0.1, 0.1, 0.1))
        scene.set_medium("/W/V", extinction=2)
        assert scene.medium("/W/V").albedo == pytest.approx((5 / 5.1,) * 3)
        assert not scene.describe().notes


INTERFACE = (
    UNBOUND.replace("rel field", "rel material:binding = </N>\n rel field")
    + """
def Material "N" {
    color3f inputs:tint = (0.5, 0.5, 0.5)
    token outputs:volume.connect = </N/G.outputs:out>
    def NodeGraph "G" {
        color3f inputs:tint.connect = </N.inputs:tint>
        token outputs:out.connect = </N/G/S.outputs:out>
        def Shader "S" { uniform token info:id = "PrevisVolume"
            color3f inputs:scattering.connect = </N/G.inputs:tint>
            color3f inputs:emission.connect = </N/G.inputs:tint>
            color3f inputs:absorption = (1.5, 1.5, 1.5)
            token outputs:out }
    }
}
"""
)


def test_interface_inputs_behind_a_node_graph(shot):
    with Scene.open(shot(body=INTERFACE)) as scene:
        empty, medium = scene.snapshot(), scene.medium("/W/V")
        assert medium.albedo == (0.25, 0.25, 0.25)
        scene.set_medium("/W/V", scattering=4.5)
        assert scene.stage.GetAttributeAtPath("/N.inputs:tint").Get() == (4.5, 4.5, 4.5)
        scene.reset_medium("/W/V", "scattering")
        assert scene.snapshot() == empty
        scene.set_medium("/W/V", scattering=4.5)
        scene.set_medium("/W/V", albedo=0.5)
        # What else the interface drives keeps its value.
        assert scene.medium("/W/V").emission == (4.5, 4.5, 4.5)
        assert scene.medium("/W/V").albedo == (0.5, 0.5, 0.5)
        assert scene.medium("/W/V").extinction == (6, 6, 6)
        scene.reset_medium("/W/V")
        assert scene.medium("/W/V") == medium
        assert scene.snapshot() == empty


def test_an_edit_replaces_what_a_shader_drives(shot):
    driven = """color3f inputs:albedo.connect = </M/T.outputs:out>
    }
    def Shader "T" { uniform token info:id = "Ramp"
        color3f outputs:out
    """
    with Scene.open(shot(driven)) as scene:
        scene.set_medium("/W/V", albedo=0.25)
        assert scene.medium("/W/V").albedo == (0.25, 0.25, 0.25)
        scene.reset_medium("/W/V", "albedo")
        assert not scene.has_overrides
        assert any("driven by Ramp" in n.message for n in scene.describe().notes)


def test_a_material_of_several_volumes_changes_and_resets_for_all(shot):
    body = BOUND + BOUND.replace('"W"', '"X"').replace("/W/", "/X/")
    with Scene.open(shot(body=body)) as scene:
        scene.set_medium("/W/V", albedo=0.25)
        assert scene.medium("/X/V").albedo == (0.25, 0.25, 0.25)
        scene.reset_medium("/X/V", "albedo")
        assert scene.medium("/W/V").albedo == (0.5, 0.5, 0.5)
        assert not scene.has_overrides


def test_a_binding_that_cannot_be_replaced_leaves_nothing_behind(shot):
    body = BOUND.replace(
        'def Xform "W" {',
        """def Xform "W" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        rel material:binding:preview = </F> ( bindMaterialAs = "strongerThanDescendants" )
        """,
    )
    body += """
def Material "F" { token outputs:volume.connect = </F/S.outputs:out>
    def Shader "S" { uniform token info:id = "Other"
        token outputs:out } }
"""
    with Scene.open(shot(body=body)) as scene:
        empty = scene.snapshot()
        with pytest.raises(PrevisError, match="/F is bound by a prim above it"):
            scene.set_medium("/W/V", albedo=0.25)
        scene.reset_medium("/W/V")
        assert scene.snapshot() == empty


def test_resetting_a_light_leaves_no_trace(shot):
    with Scene.open(shot()) as scene:
        empty, values = scene.snapshot(), scene.light_values("/W/Key")
        placement = scene.describe().lights["/W/Key"].parts()["placement"]
        edits = {
            "intensity": 7,
            "color": (1, 1, 1),
            "cone_angle": 20,
            "casts_shadows": False,
            "position": (1, 2, 3),
            "direction": (1, 0, 0),
            "visible": False,
        }
        scene.set_light("/W/Key", **edits)
        scene.reset_light("/W/Key")
        assert scene.snapshot() == empty
        for name, value in edits.items():
            scene.set_light("/W/Key", **{name: value})
            assert scene.has_overrides
            scene.reset_light("/W/Key", name)
            assert scene.snapshot() == empty, name
        assert scene.light_values("/W/Key") == values
        assert scene.describe().lights["/W/Key"].parts()["placement"] == placement
        with pytest.raises(ValueError, match="brightness is not a value of a light"):
            scene.reset_light("/W/Key", "brightness")


def test_position_and_direction_reset_one_by_one(shot):
    with Scene.open(shot()) as scene:
        empty = scene.snapshot()
        scene.set_light("/W/Key", position=(1, 2, 3), direction=(1, 0, 0))
        scene.reset_light("/W/Key", "position")
        light = scene.describe().lights["/W/Key"]
        assert light.position == pytest.approx((0, 0, 0))
        assert light.direction == pytest.approx((1, 0, 0))
        scene.reset_light("/W/Key", "direction")
        assert scene.snapshot() == empty


# --- animation -----------------------------------------------------------------------------------------------------

MOVING = """float inputs:density_scale.timeSamples = { 1: 1, 3: 3, }
color3f inputs:scattering.timeSamples = { 1: (1, 1, 1), 3: (3, 3, 3), }
color3f inputs:absorption = (1, 1, 1)"""


def test_which_values_are_animated(shot):
    body = BOUND.replace("float inputs:intensity = 3", "float inputs:intensity.timeSamples = {1: 1, 3: 3 }")
    with Scene.open(shot(MOVING, body)) as scene:
        animated = {n for n in ("density_scale", "scattering", "absorption", "albedo", "phase", "emission")}
        animated = {n for n in animated if scene.is_animated("/W/V", n)}
        assert animated == {"density_scale", "scattering", "albedo"}
        assert scene.is_animated("/W/Key", "intensity")
        assert not scene.is_animated("/W/Key", "radius")
        assert not scene.is_animated("/W/Key", "position")
        scene.set_light("/W/Key", intensity=2)
        assert not scene.is_animated("/W/Key", "intensity")
        scene.reset_light("/W/Key", "intensity")
        assert scene.is_animated("/W/Key", "intensity")
        with pytest.raises(ValueError, match="opacity"):
            scene.is_animated("/W/V", "opacity")
        with pytest.raises(PrevisError, match="/W/Ball"):
            scene.is_animated("/W/Ball", "albedo")


def test_an_edit_at_a_time_is_reset_to_the_animation(shot):
    with Scene.open(shot(MOVING)) as scene:
        empty = scene.snapshot()
        for value in (5, 7):
            scene.set_medium("/W/V", density_scale=value, time=2)
        assert [scene.medium("/W/V", t).density_scale for t in (1, 2, 3)] == [1, 7, 3]
        scene.reset_medium("/W/V", "density_scale")
        assert scene.snapshot() == empty


@pytest.mark.parametrize("time", [None, 3.0])
def test_the_other_parametrisation_keeps_the_animation(shot, time):
    with Scene.open(shot(MOVING)) as scene:
        empty = scene.snapshot()
        scene.set_medium("/W/V", albedo=0.125, time=time)
        media = [scene.medium("/W/V", t) for t in (1, 3)]
        assert [m.extinction[0] for m in media] == pytest.approx([2, 4])
        assert [m.albedo[0] for m in media] == pytest.approx([0.125 if time is None else 0.5, 0.125])
        scene.reset_medium("/W/V", "albedo")
        assert scene.snapshot() == empty


def test_a_reset_brings_the_animation_of_one_value_back(shot):
    with Scene.open(shot(MOVING)) as scene:
        scene.set_medium("/W/V", albedo=0.125, extinction=9)
        scene.reset_medium("/W/V", "albedo")
        assert [scene.medium("/W/V", t).albedo[0] for t in (1, 3)] == pytest.approx([0.5, 0.75])
        assert [scene.medium("/W/V", t).extinction[0] for t in (1, 3)] == [9, 9]


def test_the_time_that_a_stage_covers(shot, tmp_path):
    with Scene.open(shot()) as scene:
        assert scene.time_range is None
    with Scene.open(shot(MOVING, name="b.usda")) as scene:
        covered = scene.time_range
        assert (covered.start, covered.end, covered.frames_per_second) == (1, 3, 24)
    path = shot(MOVING, name="c.usda")
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.startTimeCode, layer.endTimeCode, layer.timeCodesPerSecond = 0, 50, 30
    layer.Save()
    with Scene.open(path) as scene:
        covered = scene.time_range
        assert (covered.start, covered.end, covered.frames_per_second) == (0, 50, 30)
    # A range alone animates nothing.
    path = shot(name="d.usda")
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.startTimeCode, layer.endTimeCode = 0, 50
    layer.Save()
    with Scene.open(path) as scene:
        assert scene.time_range is None


# --- outline and visibility ----------------------------------------------------------------------------------------


def test_outline(shot):
    body = (
        BOUND
        + """
def Scope "G" { def Cube "Guide" { uniform token purpose = "guide" }
    def Cube "Hidden" { token visibility = "invisible" } }
"""
    )
    with Scene.open(shot(body=body)) as scene:
        items = scene.outline()
        assert [(i.path, i.kind, i.visible) for i in items] == [
            ("/W/V", "volume", True),
            ("/W/Key", "light", True),
            ("/W/Ball", "mesh", True),
            ("/W/Cam", "camera", True),
            ("/G/Hidden", "mesh", False),
        ]
        assert items[0].name == "V" and all(i.editable for i in items)
        scene.set_medium("/W/V", albedo=0.125)
        scene.set_visible("/W", False)
        assert [i.visible for i in scene.outline()] == [False] * 5
        scene.remove("/W/Key")
        assert "/W/Key" not in {i.path for i in scene.outline()}


def test_a_shape_that_becomes_a_medium_is_outlined_as_one(shot):
    with Scene.open(shot()) as scene:
        assert [i.kind for i in scene.outline() if i.path == "/W/Ball"] == ["mesh"]
        ball = scene.stage.GetPrimAtPath("/W/Ball")
        ball.CreateRelationship("material:binding").SetTargets(["/M"])
        assert [i.kind for i in scene.outline() if i.path == "/W/Ball"] == ["volume"]


def test_visibility_toggled_twice_leaves_no_trace(shot):
    with Scene.open(shot()) as scene:
        empty = scene.snapshot()
        scene.set_visible("/W/V", False)
        assert not scene.describe().volumes
        scene.set_visible("/W/V", True)
        assert scene.describe().volumes
        assert scene.snapshot() == empty


def test_a_prim_that_something_above_hides_stays_hidden(shot):
    with Scene.open(shot()) as scene:
        scene.set_visible("/W", False)
        before = scene.snapshot()
        with pytest.raises(PrevisError, match="/W/V: stays hidden, since /W above it is invisible"):
            scene.set_visible("/W/V", True)
        assert scene.snapshot() == before
        scene.set_visible("/W/V", False)
        scene.set_visible("/W", True)
        assert not scene.describe().volumes
        with pytest.raises(PrevisError, match="/M/S: is nothing that can be shown or hidden"):
            scene.set_visible("/M/S", False)


def test_set_visible_in_a_built_scene():
    with Scene() as scene:
        scene.add_ground()
        scene.set_visible("/ground", False)
        assert not scene.describe().meshes
        scene.set_visible("/ground", True)
        assert scene.describe().meshes


INSTANCES = """
def Xform "P" { def SphereLight "L" { float inputs:intensity = 4 }
 def Cube "C" {}
}
def Xform "a" (references = </P>
 instanceable = true) {}
def PointInstancer "i" { rel prototypes = [</i/S>]
 int[] protoIndices = [0, 0]
 point3f[] positions = [(0, 0, 0), (1, 0, 0)]
 def Sphere "S" {} }
"""


def test_instances_are_looked_at_and_not_edited(shot):
    with Scene.open(shot(body=INSTANCES)) as scene:
        items = {i.path: i for i in scene.outline()}
        assert not items["/a/L"].editable and not items["/a/C"].editable
        assert items["/i/S"].editable and items["/P/L"].editable
        assert scene.light_values("/a/L").intensity == scene.authored_light("/a/L").intensity == 4
        assert scene.prim_path("/i/S[1]") == "/i/S"
        assert scene.prim_path("/i</i/S>[1]") == "/i/S"
        before = scene.snapshot()
        for call in (
            lambda: scene.set_light("/a/L", intensity=2),
            lambda: scene.reset_light("/a/L"),
            lambda: scene.set_visible("/a/C", False),
            lambda: scene.set_medium("/a/C", albedo=1),
            lambda: scene.light_values("/i/S[1]"),
            lambda: scene.set_light("/missing[3]", intensity=2),
        ):
            with pytest.raises(PrevisError) as caught:
                call()
            assert "\n" not in str(caught.value)
        assert scene.snapshot() == before


def test_the_part_of_a_mesh_is_the_mesh(shot):
    with Scene.open(shot()) as scene:
        mesh = UsdGeom.Mesh.Define(scene.stage, "/Mesh")
        UsdGeom.Subset.CreateGeomSubset(mesh, "part", UsdGeom.Tokens.face, [0])
        assert scene.prim_path("/Mesh/part") == "/Mesh"


# --- knobs -----------------------------------------------------------------------------------------------------------

RENDER = """
def Scope "Render" { def RenderSettings "%s" { int previs:coefficients = 10
    float previs:threshold = 0.02
    rel camera = </W/Cam>
    token previs:map_filter = "nearest" }
}
"""


def test_knobs_of_a_stage_without_any(shot):
    with Scene.open(shot()) as scene:
        assert scene.settings() == dict(Settings())
        empty = scene.snapshot()
        for name, value in (("coefficients", 14), ("threshold", 0.03), ("transmittance", "march")):
            scene.set_setting(name, value)
            assert scene.settings()[name] == value
            assert scene.authored_settings() == dict(Settings())
        scene.set_setting("projective_steps", "off")
        assert scene.settings()["projective_steps"] is False
        assert scene.settings({"coefficients": 4, "steps": 7})["coefficients"] == 4
        assert not scene.describe().notes
        scene.reset_settings("coefficients")
        assert scene.settings()["coefficients"] == 6
        assert scene.settings()["threshold"] == 0.03
        scene.set_setting("threshold", 0.01)
        scene.reset_settings()
        assert scene.snapshot() == empty


@pytest.mark.parametrize(
    ("name", "value", "fragment"), [("quality", 1, "unknown setting 'quality'"), ("coefficients", 7, "an even number")]
)
def test_knobs_that_are_none(shot, name, value, fragment):
    with Scene.open(shot()) as scene:
        with pytest.raises(ValueError, match=fragment):
            scene.set_setting(name, value)
        with pytest.raises(ValueError, match=name):
            scene.settings({name: value})
        assert not scene.has_overrides


@pytest.mark.parametrize("name", ["main", "previs"])
def test_knobs_of_the_render_settings(shot, name):
    with Scene.open(shot(body=BOUND + RENDER % name)) as scene:
        empty = scene.snapshot()
        assert (scene.settings()["coefficients"], scene.settings()["threshold"]) == (10, 0.02)
        scene.set_setting("coefficients", 14)
        scene.set_setting("steps", 64)
        assert scene.stage.GetAttributeAtPath(f"/Render/{name}.previs:coefficients").Get() == 14
        assert scene.settings()["coefficients"] == 14
        assert scene.authored_settings()["coefficients"] == 10
        assert scene.camera().path == "/W/Cam"
        # What the stage says anyway is no edit.
        scene.set_setting("coefficients", 10)
        scene.reset_settings("steps")
        assert scene.snapshot() == empty


def test_knobs_that_cannot_be_used_are_noted(shot):
    text = RENDER.replace("previs:coefficients = 10", 'previs:coefficients = 7\n string previs:quality = "best"')
    with Scene.open(shot(body=BOUND + text % "main")) as scene:
        assert scene.settings()["coefficients"] == 6
        notes = [str(n) for n in scene.describe().notes]
        assert len(notes) == 2
        assert "/Render/main: ignored: previs:coefficients: 7 is not an even number from 2 to 16" in notes
        assert any("previs:quality is not a knob" in n for n in notes)
        scene.set_setting("coefficients", 8)
        assert len(scene.describe().notes) == 1


def test_a_knob_reads_no_voxels_again(shot):
    with Scene.open(shot()) as scene:
        index = RenderIndex()
        index.update(scene.describe())
        scene.reader.counters.clear()
        before = versions(index)
        scene.set_setting("coefficients", 14)
        index.update(scene.describe())
        assert not moved(before, index)
        assert scene.reader.counters["grids"] == 0
        scene.set_setting("coefficients", 8)
        scene.reader.counters.clear()
        scene.describe()
        assert not scene.reader.counters


def test_a_mask_leaves_the_knobs(shot):
    path = shot(body=BOUND + RENDER % "previs")
    with Scene.open(path, mask="/W/V") as scene:
        assert scene.settings()["coefficients"] == 10


def test_saved_knobs_are_found_below_another_root(shot, tmp_path):
    path = shot()
    with Scene.open(path) as scene:
        scene.set_setting("coefficients", 14)
        scene.set_medium("/W/V", albedo=0.125)
        scene.save_overrides(tmp_path / "look.usda")
    root = Sdf.Layer.CreateNew(str(tmp_path / "both.usda"))
    root.subLayerPaths = ["./look.usda", "./shot.usda"]
    root.Save()
    with Scene.open(tmp_path / "both.usda") as scene:
        assert scene.settings()["coefficients"] == 14
        assert scene.medium("/W/V").albedo == (0.125, 0.125, 0.125)


def test_knobs_of_render_settings_that_the_metadata_choose(shot, tmp_path):
    body = BOUND + RENDER % "main" + 'def RenderSettings "other" {}'
    path = shot(body=body)
    path.write_text(path.read_text().replace("#usda 1.0\n", '#usda 1.0\n( renderSettingsPrimPath = "/Render/main" )\n'))
    with Scene.open(path) as scene:
        empty = scene.snapshot()
        scene.set_setting("coefficients", 14)
        assert scene.stage.GetAttributeAtPath("/Render/main.previs:coefficients").Get() == 14
        scene.save_overrides(tmp_path / "look.usda")
        scene.reset_settings("coefficients")
        assert scene.snapshot() == empty
    # Metadata of a sublayer do not count.
    (tmp_path / "both.usda").write_text("#usda 1.0\n(\n subLayers = [@./look.usda@, @./shot.usda@]\n)\n")
    with Scene.open(tmp_path / "both.usda") as scene:
        assert scene.settings()["coefficients"] == 14


# --- saved edits over the shot --------------------------------------------------------------------------------------


@pytest.mark.parametrize("body", [BOUND, UNBOUND, INTERFACE])
@pytest.mark.parametrize("inputs", ["", PAIR, MOVING])
def test_saved_edits_over_the_shot_describe_the_same(shot, tmp_path, body, inputs):
    def content(described):
        records = {**described.volumes, **described.lights, **described.meshes, **described.cameras}
        return {path: record.parts() for path, record in records.items()}, described.notes

    path = shot(inputs, body)
    with Scene.open(path) as scene:
        scene.set_medium("/W/V", albedo=0.25, time=1.0)
        scene.set_medium("/W/V", phase="two_lobe", anisotropy=-0.5)
        scene.set_light("/W/Key", intensity=7, cone_angle=20, position=(1, 2, 3), casts_shadows=False)
        scene.set_visible("/W/Ball", False)
        scene.add_distant_light("/Sun", (1, -1, 0), irradiance=3)
        scene.remove("/W/Cam")
        scene.save_overrides(tmp_path / "look.usda")
        expected = [content(scene.describe(t)) for t in (1, 2, 3)]
    (tmp_path / "both.usda").write_text("#usda 1.0\n(\n subLayers = [@./look.usda@, @./shot.usda@]\n)\n")
    for options in ((tmp_path / "both.usda",), (path, tmp_path / "look.usda")):
        with Scene.open(*options) as scene:
            assert [content(scene.describe(t)) for t in (1, 2, 3)] == expected
    with Scene.open(path) as scene:
        scene.load_overrides(tmp_path / "look.usda")
        assert [content(scene.describe(t)) for t in (1, 2, 3)] == expected
        scene.reset_medium("/W/V")
        scene.reset_light("/W/Key")
        scene.set_visible("/W/Ball", True)
        assert scene.medium("/W/V") == scene.authored_medium("/W/V")
        assert scene.light_values("/W/Key") == scene.authored_light("/W/Key")


def test_an_albedo_edit_of_scattering_and_absorption_leaves_the_light_maps(shot):
    pair = "color3f inputs:scattering = (0.1, 0.3, 0.7)\ncolor3f inputs:absorption = (0.2, 0.7, 0.1)"
    with Scene.open(shot(pair)) as scene:
        index = RenderIndex()
        index.update(scene.describe())
        empty = scene.snapshot()
        for change in (lambda: scene.set_medium("/W/V", albedo=0.25), lambda: scene.restore(empty)):
            before = versions(index)
            change()
            index.update(scene.describe())
            assert moved(before, index) == {("/W/V", "scattering")}


def test_media_of_native_instances_can_be_looked_at(shot):
    body = BOUND.replace('def Xform "W"', 'def Xform "P"').replace("/W/", "/P/")
    body += 'def Xform "W" (references = </P>\n instanceable = true) {}'
    with Scene.open(shot(body=body)) as scene:
        assert scene.medium("/W/V") == scene.authored_medium("/W/V") == scene.medium("/P/V")
        assert not scene.is_animated("/W/V", "albedo")
        with pytest.raises(PrevisError, match="native instance"):
            scene.set_medium("/W/V", albedo=0.5)
        # The material is outside and shared.
        scene.set_medium("/P/V", albedo=0.125)
        assert scene.describe().volumes["/W/V"].medium.albedo == (0.125,) * 3


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ("startTimeCode = 1\nendTimeCode = inf", (2.0, 5.0, 24.0)),
        ("startTimeCode = nan\nendTimeCode = 9", (2.0, 5.0, 24.0)),
        ("startTimeCode = 1\nendTimeCode = 9\ntimeCodesPerSecond = 0", (1.0, 9.0, 24.0)),
        ("startTimeCode = 9\nendTimeCode = 1\ntimeCodesPerSecond = 12", (2.0, 5.0, 12.0)),
    ],
)
def test_a_range_of_time_that_no_clock_can_go_by(tmp_path, metadata, expected):
    path = tmp_path / "t.usda"
    light = 'def SphereLight "L" {\n float inputs:intensity.timeSamples = { 2: 1, 5: 2 }\n}\n'
    path.write_text(f"#usda 1.0\n(\n{metadata}\n)\n{light}")
    with Scene.open(path) as scene:
        covered = scene.time_range
        assert (covered.start, covered.end, covered.frames_per_second) == expected


def test_frames_go_round_the_range():
    span = TimeRange(1.0, 4.0, 24.0)
    assert [span.after(t, 1) for t in (1.0, 3.0, 4.0, 2.4)] == [2.0, 4.0, 1.0, 3.0]
    assert [span.after(t, -1) for t in (1.0, 3.0)] == [4.0, 2.0]
    assert span.after(3.0, 10) == 1.0
    assert TimeRange(0.25, 0.5, 24.0).after(0.5, 3) == 0.25

"""What is read again after an edit, and what is not."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdVol
from stages import PREVIS_VOLUME, QUAD, stage_of, usda, volume_text, write_field

from previs.index import RenderIndex
from previs.stage import StageReader, open_stage

TEXT = (
    f"""
def Xform "World" {{
    def Mesh "Ground" {{ uniform token subdivisionScheme = "none"
        {QUAD}
    }}
    def Mesh "Other" {{ uniform token subdivisionScheme = "none"
        {QUAD}
    }}
    def Volume "Smoke" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
        rel material:binding = </M>
        rel field:density = </World/Smoke/f>
        def OpenVDBAsset "f" {{ asset filePath = @./smoke.vdb@
            token fieldName = "density" }}
    }}
    def DistantLight "Sun" {{ float inputs:intensity = 1 }}
    def Camera "Cam" {{}}
}}
"""
    + PREVIS_VOLUME % "color3f inputs:albedo = (0.5, 0.5, 0.5)"
)


class Watched:
    """A reader, and what it did since it was last asked."""

    def __init__(self, stage):
        self.stage = stage
        self.reader = StageReader(stage)
        self.first = self.reader.read()
        self.reader.counters.clear()

    def __call__(self, time=None):
        scene = self.reader.read(time)
        work = {k: v for k, v in self.reader.counters.items() if v}
        self.reader.counters.clear()
        return scene, work


@pytest.fixture
def watched(tmp_path):
    write_field(tmp_path / "smoke.vdb")
    (tmp_path / "scene.usda").write_text(usda(TEXT))
    stage = open_stage(tmp_path / "scene.usda")
    stage.SetEditTarget(stage.GetSessionLayer())
    return Watched(stage)


def attribute(watched, path):
    return watched.stage.GetAttributeAtPath(path)


def test_an_unchanged_stage_is_not_read_again(watched):
    scene, work = watched()
    assert work == {}
    assert scene.volumes["/World/Smoke"] is watched.first.volumes["/World/Smoke"]


@pytest.mark.parametrize("twice", [False, True])
def test_an_albedo_edit_translates_only_its_volume(watched, twice):
    if twice:
        # The first edit makes a spec in the session layer, which USD announces otherwise than the next ones.
        attribute(watched, "/M/S.inputs:albedo").Set((0.1, 0.1, 0.1))
        watched()
    attribute(watched, "/M/S.inputs:albedo").Set((0.25, 0.25, 0.25))
    scene, work = watched()
    assert work == {"prims": 1}
    assert scene.volumes["/World/Smoke"].medium.albedo == (0.25, 0.25, 0.25)
    assert scene.meshes["/World/Ground"] is watched.first.meshes["/World/Ground"]
    assert scene.volumes["/World/Smoke"].density.grid is watched.first.volumes["/World/Smoke"].density.grid


def test_a_light_edit_translates_only_the_light(watched):
    attribute(watched, "/World/Sun.inputs:intensity").Set(4.0)
    scene, work = watched()
    assert work == {"prims": 1}
    assert scene.lights["/World/Sun"].radiance == (4.0, 4.0, 4.0)


def test_moving_a_mesh_builds_no_triangles(watched):
    UsdGeom.XformCommonAPI(watched.stage.GetPrimAtPath("/World/Ground")).SetTranslate((1, 2, 3))
    watched()
    UsdGeom.XformCommonAPI(watched.stage.GetPrimAtPath("/World/Ground")).SetTranslate((4, 5, 6))
    scene, work = watched()
    assert work == {"prims": 1}
    assert scene.meshes["/World/Ground"].local_to_world[0, 3, :3].tolist() == [4, 5, 6]


def test_moving_a_group_moves_everything_in_it_and_reads_nothing(watched):
    UsdGeom.XformCommonAPI(watched.stage.GetPrimAtPath("/World")).SetTranslate((1, 2, 3))
    scene, work = watched()
    assert "grids" not in work
    assert "geometry" not in work
    assert scene.volumes["/World/Smoke"].local_to_world[3, :3].tolist() == [1, 2, 3]
    assert scene.meshes["/World/Other"].local_to_world[0, 3, :3].tolist() == [1, 2, 3]
    assert scene.lights["/World/Sun"].position.tolist() == [1, 2, 3]


def test_hiding_a_group(watched):
    UsdGeom.Imageable(watched.stage.GetPrimAtPath("/World")).MakeInvisible()
    scene, work = watched()
    assert not scene.volumes
    assert not scene.lights
    UsdGeom.Imageable(watched.stage.GetPrimAtPath("/World")).MakeVisible()
    scene, work = watched()
    assert "grids" not in work
    assert "geometry" not in work
    assert list(scene.volumes) == ["/World/Smoke"]


def test_new_points_build_one_mesh(watched):
    points = np.zeros((4, 3), np.float32)
    points[:] = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)]
    UsdGeom.Mesh(watched.stage.GetPrimAtPath("/World/Ground")).GetPointsAttr().Set(points)
    scene, work = watched()
    assert work == {"prims": 1, "geometry": 1}
    assert scene.meshes["/World/Ground"].geometry.key != watched.first.meshes["/World/Ground"].geometry.key


def test_a_colour_edit_builds_no_triangles(watched):
    gprim = UsdGeom.Gprim(watched.stage.GetPrimAtPath("/World/Ground"))
    gprim.GetDisplayColorAttr().Set([(1, 0, 0)])
    scene, _ = watched()
    assert scene.meshes["/World/Ground"].surface.diffuse_color == (1.0, 0.0, 0.0)
    assert scene.meshes["/World/Ground"].geometry.key == watched.first.meshes["/World/Ground"].geometry.key


def test_another_file_is_read_once(watched, tmp_path):
    write_field(tmp_path / "other.vdb", value=3.0)
    field = UsdVol.OpenVDBAsset(watched.stage.GetPrimAtPath("/World/Smoke/f"))
    field.GetFilePathAttr().Set(Sdf.AssetPath(str(tmp_path / "other.vdb")))
    scene, work = watched()
    assert work == {"prims": 1, "grids": 1}
    assert scene.volumes["/World/Smoke"].density.key != watched.first.volumes["/World/Smoke"].density.key


def test_an_edit_of_the_up_axis_arrives(watched):
    assert watched.first.up_axis == "Y"
    UsdGeom.SetStageUpAxis(watched.stage, UsdGeom.Tokens.z)
    scene, work = watched()
    assert scene.up_axis == "Z"
    assert work == {}


def test_a_first_binding_reads_no_heavy_data(watched):
    prim = watched.stage.GetPrimAtPath("/World/Ground")
    material = UsdShade.Material.Define(watched.stage, "/Paint")
    shader = UsdShade.Shader.Define(watched.stage, "/Paint/S")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set((0, 1, 0))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
    scene, work = watched()
    assert scene.meshes["/World/Ground"].surface.diffuse_color == (0.0, 1.0, 0.0)
    assert "grids" not in work


def test_adding_and_removing_prims(watched):
    UsdGeom.Cube.Define(watched.stage, "/World/New")
    scene, work = watched()
    assert "/World/New" in scene.meshes
    assert work["geometry"] == 1
    assert "grids" not in work
    watched.stage.RemovePrim("/World/New")
    scene, _ = watched()
    assert "/World/New" not in scene.meshes


def test_deactivating_and_activating(watched):
    prim = watched.stage.GetPrimAtPath("/World/Smoke")
    prim.SetActive(False)
    assert not watched()[0].volumes
    prim.SetActive(True)
    scene, work = watched()
    assert list(scene.volumes) == ["/World/Smoke"]
    assert "grids" not in work


def test_muting_a_layer(watched):
    session = Sdf.Layer.CreateAnonymous()
    watched.stage.GetSessionLayer().subLayerPaths.append(session.identifier)
    with Usd.EditContext(watched.stage, session):
        attribute(watched, "/World/Sun.inputs:intensity").Set(9.0)
    assert watched()[0].lights["/World/Sun"].radiance[0] == 9.0
    watched.stage.MuteLayer(session.identifier)
    assert watched()[0].lights["/World/Sun"].radiance[0] == 1.0


def test_only_the_changed_part_gets_a_new_version(watched):
    index = RenderIndex()
    index.update(watched.first)
    before = dict(index.volumes["/World/Smoke"].versions)
    attribute(watched, "/M/S.inputs:albedo").Set((0.25, 0.25, 0.25))
    index.update(watched()[0])
    after = index.volumes["/World/Smoke"].versions
    assert {part for part in after if after[part] != before[part]} == {"scattering"}


def test_edits_inside_an_instanced_prototype():
    stage = stage_of(
        f"""
def Xform "P" {{ def Mesh "X" {{ {QUAD} }} }}
def Xform "a" (references = </P>
 instanceable = true) {{}}
"""
    )
    watched = Watched(stage)
    UsdGeom.XformCommonAPI(stage.GetPrimAtPath("/P/X")).SetTranslate((1, 0, 0))
    scene, _ = watched()
    UsdGeom.XformCommonAPI(stage.GetPrimAtPath("/P/X")).SetTranslate((2, 0, 0))
    scene, work = watched()
    assert scene.meshes["/a/X"].local_to_world[0, 3, 0] == 2.0
    assert "geometry" not in work


SHARED = (
    """
class "Proto" {
    def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        rel material:binding = </Proto/Mat/M>
        rel field:density = </Proto/Fields/f> }
    def Scope "Fields" { def OpenVDBAsset "f" { asset filePath = @FILE@
            double xformOp:translateX = 0
            uniform token[] xformOpOrder = ["xformOp:translateX"] } }
    def Mesh "Ground" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        rel material:binding = </Proto/Mat/Paint>
        QUAD }
    def Scope "Mat" {
        def Material "M" { token outputs:volume.connect = </Proto/Mat/M/S.outputs:out>
            def Shader "S" { uniform token info:id = "PrevisVolume"
                color3f inputs:albedo = (0.5, 0.5, 0.5)
                float inputs:anisotropy.connect = </Proto/Mat/M.inputs:g>
                token outputs:out }
            float inputs:g = 0 }
        def Material "Paint" { token outputs:surface.connect = </Proto/Mat/Paint/S.outputs:out>
            def Shader "S" { uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = (0.5, 0.5, 0.5)
                token outputs:out } }
    }
    def SphereLight "Lamp" { float inputs:intensity = 1 }
}
def Xform "Outer" {
    def Xform "Inner" (references = </Proto>
 instanceable = true) { double xformOp:translateX = 0
        uniform token[] xformOpOrder = ["xformOp:translateX"]
    }
}
"""
).replace("QUAD", QUAD)
INSTANCED = {
    "once": """
def Xform "A" (references = </Proto>
 instanceable = true) {}
def Xform "B" (references = </Proto>
 instanceable = true) {}
""",
    "nested": """
def Xform "A" (references = </Outer>
 instanceable = true) {}
def Xform "B" (references = </Outer>
 instanceable = true) {}
""",
    "points": """
def PointInstancer "I" { rel prototypes = </I/P>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(1, 0, 0), (2, 0, 0)]
    def Xform "P" (references = </Outer>
 instanceable = true) {} }
""",
}


@pytest.mark.parametrize("how", INSTANCED)
def test_edits_of_what_instances_share(tmp_path, how):
    """Whatever a prim in an instance is read from, its edit reaches all instances, the first edit and the next ones."""
    file = write_field(tmp_path / "smoke.vdb")
    watched = Watched(stage_of(SHARED.replace("FILE", str(file)) + INSTANCED[how]))

    def shared(records):
        """What the instances show, without the prototype's source where that is shown too."""
        found = [r for path, r in records.items() if not path.startswith("/Outer")]
        assert found
        return found

    for value in (0.25, 0.75):
        for path, authored in (
            ("Mat/M/S.inputs:albedo", (value,) * 3),
            ("Mat/M.inputs:g", value),
            ("Fields/f.xformOp:translateX", value),
            ("Mat/Paint/S.inputs:diffuseColor", (value,) * 3),
            ("Lamp.inputs:intensity", value),
        ):
            attribute(watched, f"/Proto/{path}").Set(authored)
            scene, _ = watched()
            for volume in shared(scene.volumes):
                if path.startswith("Mat/M/"):
                    assert volume.medium.albedo == (value,) * 3
                elif path.startswith("Mat/M."):
                    assert volume.medium.anisotropy == value
                elif path.startswith("Fields"):
                    assert volume.density.index_to_local[3, 0] == value
            for mesh in shared(scene.meshes):
                if path.startswith("Mat/Paint"):
                    assert mesh.surface.diffuse_color == (value,) * 3
            for light in shared(scene.lights):
                if path.startswith("Lamp"):
                    assert light.radiance == (value,) * 3
        attribute(watched, "/Proto/Ground.points").Set([(0, 0, 0), (value, 0, 0), (value, 1, 0), (0, 1, 0)])
        scene, _ = watched()
        assert all(m.geometry.points.max(axis=0)[0] == value for m in shared(scene.meshes))


@pytest.mark.parametrize("how", INSTANCED)
def test_another_shader_for_a_shared_material(tmp_path, how):
    file = write_field(tmp_path / "smoke.vdb")
    watched = Watched(stage_of(SHARED.replace("FILE", str(file)) + INSTANCED[how]))
    output = UsdShade.Material(watched.stage.GetPrimAtPath("/Proto/Mat/M")).GetVolumeOutput()
    shader = UsdShade.Shader.Define(watched.stage, "/Proto/Mat/M/Other")
    shader.CreateIdAttr("PrevisVolume")
    shader.CreateInput("density_scale", Sdf.ValueTypeNames.Float).Set(3.0)
    shader.CreateOutput("out", Sdf.ValueTypeNames.Token)
    watched()
    for targets, scale in ((["Other"], 3.0), (["S"], 1.0), ([], 1.0), (["Other"], 3.0)):
        output.GetAttr().SetConnections([f"/Proto/Mat/M/{t}.outputs:out" for t in targets])
        scene, _ = watched()
        assert {v.medium.density_scale for v in scene.volumes.values()} == {scale}


@pytest.mark.parametrize("how", ["nested", "points"])
def test_moving_an_instance_within_a_prototype(tmp_path, how):
    file = write_field(tmp_path / "smoke.vdb")
    watched = Watched(stage_of(SHARED.replace("FILE", str(file)) + INSTANCED[how]))
    for x in (5.0, 7.0):
        attribute(watched, "/Outer/Inner.xformOp:translateX").Set(x)
        scene, _ = watched()
        offsets = [1.0, 2.0] if how == "points" else [0.0, 0.0]
        moved = [v.local_to_world[3, 0] for path, v in scene.volumes.items() if not path.startswith("/Outer")]
        assert moved == [x + o for o in offsets]


def test_edits_of_a_point_instancer_and_its_prototype():
    stage = stage_of(
        """
def PointInstancer "I" { rel prototypes = </P/V>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(1, 0, 0), (2, 0, 0)] }
over "P" { def Volume "V" { float3[] extent = [(-1, -1, -1), (1, 1, 1)] } }
"""
    )
    watched = Watched(stage)
    UsdGeom.PointInstancer(stage.GetPrimAtPath("/I")).GetPositionsAttr().Set([(5, 0, 0), (6, 0, 0)])
    scene, work = watched()
    assert [v.local_to_world[3, 0] for v in scene.volumes.values()] == [5, 6]
    UsdGeom.Boundable(stage.GetPrimAtPath("/P/V")).GetExtentAttr().Set([(-2, -2, -2), (2, 2, 2)])
    scene, work = watched()
    assert scene.volumes["/P/V[1]"].shape.maximum == (2.0, 2.0, 2.0)
    assert work == {"prims": 1}


def test_a_failing_volume_is_tried_again(tmp_path):
    (tmp_path / "scene.usda").write_text(usda(volume_text("./late.vdb")))
    stage = open_stage(tmp_path / "scene.usda")
    reader = StageReader(stage)
    with pytest.raises(Exception, match="no such file"):
        reader.read()
    write_field(tmp_path / "late.vdb")
    stage.SetEditTarget(stage.GetSessionLayer())
    UsdVol.OpenVDBAsset(stage.GetPrimAtPath("/V/f")).GetFilePathAttr().Set(Sdf.AssetPath(str(tmp_path / "late.vdb")))
    assert len(reader.read().volumes) == 1


def test_geometry_keys_are_equal_across_readers_and_prims(watched):
    again = StageReader(watched.stage).read()
    keys = {m.geometry.key for s in (watched.first, again) for m in s.meshes.values()}
    assert len(keys) == 1


def test_closing_stops_listening(watched):
    watched.reader.close()
    attribute(watched, "/World/Sun.inputs:intensity").Set(4.0)
    assert not watched.reader.pending

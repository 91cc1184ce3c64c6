"""What is read again at another time, and what is not; USD's default time."""

import math

import pytest
from pxr import Sdf, Usd
from stages import PREVIS_VOLUME, QUAD, describe, notes, only, stage_of, usda, write_field

from previs import PrevisError
from previs.stage import StageReader, open_stage

STATIC = (
    f"""
def Xform "World" {{
    double3 xformOp:translate.timeSamples = {{ 1: (0, 0, 0) }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "Ground" {{ {QUAD} }}
    def Cube "Box" {{}}
    def DistantLight "Sun" {{ float inputs:intensity = 1 }}
    def PointInstancer "Trees" {{ rel prototypes = </World/Trees/P>
        int[] protoIndices = [0, 0]
        point3f[] positions = [(1, 0, 0), (2, 0, 0)]
        def Xform "P" {{ def Sphere "Crown" {{}} }} }}
    def Xform "Shared" (references = </Source>
 instanceable = true) {{}}
    def Volume "Smoke" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
        rel material:binding = </M>
        rel field:density = </World/Smoke/f>
        def OpenVDBAsset "f" {{ asset filePath.timeSamples = {{ 1: @./smoke.vdb@ }} }}
    }}
}}
class "Source" {{ def Cone "C" {{}} }}
def Camera "Cam" {{ float focalLength.timeSamples = {{ 1: 50, 48: 96 }} }}
"""
    + PREVIS_VOLUME % "color3f inputs:albedo = (0.5, 0.5, 0.5)"
)


def read_counting(reader: StageReader, time):
    """(description, the work that took)."""
    reader.counters.clear()
    scene = reader.read(time)
    return scene, {k: v for k, v in reader.counters.items() if v}


def test_static_prims_are_translated_once_for_a_sequence(tmp_path):
    write_field(tmp_path / "smoke.vdb")
    (tmp_path / "scene.usda").write_text(usda(STATIC))
    reader = StageReader(open_stage(tmp_path / "scene.usda"))
    first, work = read_counting(reader, 1)
    assert work["prims"] > 6
    for frame in range(2, 49):
        scene, work = read_counting(reader, frame)
        assert work == {"prims": 1}
        assert scene.cameras["/Cam"].focal_length == pytest.approx(50 + (frame - 1) * 46 / 47)
    assert all(scene.meshes[path] is record for path, record in first.meshes.items())
    assert scene.volumes["/World/Smoke"] is first.volumes["/World/Smoke"]


def test_a_wholly_static_stage_is_the_same_at_every_time():
    reader = StageReader(stage_of(f'def Mesh "G" {{ {QUAD} }}'))
    first = reader.read(1)
    assert reader.read(2) is first


# Each of these changes between the times 1 and 3.
MATERIAL = PREVIS_VOLUME % "float inputs:density_scale.timeSamples = {1: 1, 3: 3}"
BOX = "float3[] extent = [(-1, -1, -1), (1, 1, 1)]"
VARYING = {
    "own transform": """def Sphere "X" { double xformOp:translateX.timeSamples = {1: 1, 3: 3}
        uniform token[] xformOpOrder = ["xformOp:translateX"] }""",
    "ancestor's transform": """def Xform "G" { double xformOp:translateX.timeSamples = {1: 1, 3: 3}
        uniform token[] xformOpOrder = ["xformOp:translateX"]
        def Scope "S" { def Sphere "X" {} } }""",
    "ancestor's visibility": """def Xform "G" { token visibility.timeSamples = {1: "inherited", 3: "invisible"}
        def Sphere "X" {} }""",
    "appearing": """def Xform "G" { token visibility.timeSamples = {1: "invisible", 3: "inherited"}
        def Sphere "X" {} }""",
    "size": 'def Sphere "X" { double radius.timeSamples = {1: 1, 3: 3} }',
    "points": f"""def Mesh "X" {{ {QUAD}
        point3f[] points.timeSamples = {{1: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
            3: [(0, 0, 0), (2, 0, 0), (1, 1, 0), (0, 1, 0)]}} }}""".replace(
        "point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]", ""
    ),
    "subset": f"""def Mesh "X" {{ {QUAD}
        def GeomSubset "S" (prepend apiSchemas = ["MaterialBindingAPI"]) {{ uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices.timeSamples = {{1: [], 3: [0]}} }} }}""",
    "inherited colour": """def Xform "G" {
        color3f[] primvars:displayColor.timeSamples = {1: [(1, 0, 0)], 3: [(0, 1, 0)]}
        def Sphere "X" {} }""",
    "medium": f"""def Volume "X" (prepend apiSchemas = ["MaterialBindingAPI"]) {{ {BOX}
        rel material:binding = </M> }}"""
    + MATERIAL,
    "interface": f"""def Volume "X" (prepend apiSchemas = ["MaterialBindingAPI"]) {{ {BOX}
        rel material:binding = </M> }}
    def Material "M" {{ token outputs:volume.connect = </M/S.outputs:out>
        float inputs:d.timeSamples = {{1: 1, 3: 3}}
        def Shader "S" {{ uniform token info:id = "PrevisVolume"
            float inputs:density_scale.connect = </M.inputs:d>
            token outputs:out }} }}""",
    "surface": """def Sphere "X" (prepend apiSchemas = ["MaterialBindingAPI"]) { rel material:binding = </M> }
    def Material "M" { token outputs:surface.connect = </M/S.outputs:out>
        def Shader "S" { uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>
            token outputs:out }
        def Shader "T" { uniform token info:id = "UsdUVTexture"
            float4 inputs:fallback.timeSamples = {1: (1, 0, 0, 1), 3: (0, 1, 0, 1)}
            float3 outputs:rgb } }""",
    "extent": 'def Volume "X" { float3[] extent.timeSamples = {1: [(0, 0, 0), (1, 1, 1)], 3: [(0, 0, 0), (3, 1, 1)]} }',
    "field": """def Volume "X" { rel field:density = </F/f> }
    def Scope "F" { def OpenVDBAsset "f" { asset filePath.timeSamples = {1: @A@, 3: @B@} } }""",
    "field's transform": """def Volume "X" { rel field:density = </F/f> }
    def Scope "F" { def OpenVDBAsset "f" { asset filePath = @A@
        double xformOp:translateX.timeSamples = {1: 1, 3: 3}
        uniform token[] xformOpOrder = ["xformOp:translateX"] } }""",
    "light": 'def DistantLight "X" { float inputs:intensity.timeSamples = {1: 1, 3: 3} }',
    "camera": 'def Camera "X" { float focalLength.timeSamples = {1: 1, 3: 3} }',
    "instancer": """def PointInstancer "X" { rel prototypes = </P>
        int[] protoIndices = [0]
        point3f[] positions.timeSamples = {1: [(1, 0, 0)], 3: [(3, 0, 0)]} }
    class "P" { def Sphere "S" {} }""",
    "velocities": """def PointInstancer "X" { rel prototypes = </P>
        int[] protoIndices = [0]
        vector3f[] velocities.timeSamples = {1: [(1, 0, 0)]}
        point3f[] positions.timeSamples = {1: [(1, 0, 0)]} }
    class "P" { def Sphere "S" {} }""",
    "within a prototype": """def PointInstancer "X" { rel prototypes = </P>
        int[] protoIndices = [0]
        point3f[] positions = [(1, 0, 0)] }
    class "P" { def Xform "G" { def Sphere "S" { double radius.timeSamples = {1: 1, 3: 3} } } }""",
    "hidden in a prototype": """def PointInstancer "X" { rel prototypes = </P>
        int[] protoIndices = [0]
        point3f[] positions = [(1, 0, 0)] }
    class "P" { def Xform "G" { token visibility.timeSamples = {1: "invisible", 3: "inherited"}
        def Sphere "S" {} } }""",
    "within an instance": """def Xform "X" (references = </P>
 instanceable = true) {}
    class "P" { def Xform "G" { def Sphere "S" { double radius.timeSamples = {1: 1, 3: 3} } } }""",
    "an instance's transform": """def Xform "X" (references = </P>
 instanceable = true) { double xformOp:translateX.timeSamples = {1: 1, 3: 3}
        uniform token[] xformOpOrder = ["xformOp:translateX"] }
    class "P" { def Sphere "S" {} }""",
    "spline": """def Sphere "X" { double radius.spline = { bezier,
        1: 1; post linear,
        3: 3; post linear, } }""",
}


@pytest.mark.parametrize("what", VARYING)
def test_whatever_may_vary_is_read_anew(tmp_path, what):
    text = VARYING[what]
    for name, value in (("A", 1.0), ("B", 2.0)):
        text = text.replace(f"@{name}@", f"@{write_field(tmp_path / f'{name}.vdb', value=value)}@")
    reader = StageReader(stage_of(text))
    alone = [StageReader(stage_of(text)).read(t) for t in (1, 3)]
    assert fingerprint(alone[0]) != fingerprint(alone[1])
    for time in (1, 3, 1, 3):
        assert fingerprint(reader.read(time)) == fingerprint(alone[time == 3])


def fingerprint(scene) -> str:
    """Everything that a description says, as text; voxels and triangles by their keys."""
    records = [*scene.volumes.values(), *scene.lights.values(), *scene.meshes.values(), *scene.cameras.values()]
    keys = [(m.path, m.geometry.key) for m in scene.meshes.values()]
    keys += [(v.path, v.density.key if v.density else None) for v in scene.volumes.values()]
    text = []
    for record in records:
        values = {n: v for n, v in vars(record).items() if n not in ("geometry", "density")}
        text.append(repr(values))
        density = getattr(record, "density", None)
        text.append(repr(density.index_to_local) if density else "")
    return repr((text, keys, scene.notes))


def test_value_clips_may_vary(tmp_path):
    """Clips give values to attributes that no layer of the stage mentions."""
    for name, text in (
        ("manifest", 'over "X" { float inputs:intensity }'),
        ("one", 'over "X" { float inputs:intensity.timeSamples = {0: 1} }'),
        ("two", 'over "X" { float inputs:intensity.timeSamples = {0: 5} }'),
    ):
        (tmp_path / f"{name}.usda").write_text(usda(text))
    (tmp_path / "scene.usda").write_text(
        """#usda 1.0
def DistantLight "X" (
    clips = { dictionary default = {
        asset[] assetPaths = [@./one.usda@, @./two.usda@]
        asset manifestAssetPath = @./manifest.usda@
        string primPath = "/X"
        double2[] active = [(0, 0), (2, 1)]
        double2[] times = [(0, 0), (1, 1), (2, 0), (9, 7)]
    } }
) {
}
"""
    )
    reader = StageReader(open_stage(tmp_path / "scene.usda"))
    radiances = [only(reader.read(t).lights).radiance[0] for t in (1, 3, 1)]
    assert radiances == [1.0, 5.0, 1.0]


def test_a_kept_prim_follows_edits_at_other_times():
    stage = stage_of('def Sphere "X" {} def Camera "C" { float focalLength.timeSamples = {1: 1, 3: 3} }')
    reader = StageReader(stage)
    reader.read(1)
    reader.read(2)
    radius = stage.GetAttributeAtPath("/X.radius")
    radius.Set(2.0)
    assert only(reader.read(3).meshes).geometry.points.max() == 2.0
    radius.Set(1.0, 1)
    radius.Set(4.0, 4)
    assert [only(reader.read(t).meshes).geometry.points.max() for t in (3, 4, 1)] == [3.0, 4.0, 1.0]


def test_a_file_reached_by_another_link_is_read_anew(tmp_path):
    for i in (1, 2):
        write_field(tmp_path / f"v{i}.vdb", value=float(i))
    link = tmp_path / "latest.vdb"
    link.symlink_to(tmp_path / "v1.vdb")
    text = f"""def Volume "X" {{ rel field:density = </X/f>
        def OpenVDBAsset "f" {{ asset filePath = @{link}@ }} }}"""
    reader = StageReader(stage_of(text))
    first = reader.read(1)
    assert reader.read(2) is first
    link.unlink()
    link.symlink_to(tmp_path / "v2.vdb")
    assert only(reader.read(3).volumes).density.grid.leaf_values.max() == 2.0
    (tmp_path / "v2.vdb").unlink()
    with pytest.raises(PrevisError, match="no such file"):
        reader.read(4)


def test_a_volume_left_out_is_tried_again_at_the_next_time(tmp_path):
    text = f"""def Volume "X" {{ rel field:density = </X/f>
        def OpenVDBAsset "f" {{ asset filePath = @{tmp_path / "late.vdb"}@ }} }}"""
    reader = StageReader(stage_of(text), keep_going=True)
    assert notes(reader.read(1), "missing")
    write_field(tmp_path / "late.vdb")
    assert list(reader.read(2).volumes) == ["/X"]


# --- the default time -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [math.nan, Usd.TimeCode.Default()])
def test_the_default_time_reads_no_samples(time):
    text = """def Sphere "X" { double radius = 2
        double radius.timeSamples = {1: 1} }"""
    assert only(describe(text, time).meshes).geometry.points.max() == 2.0
    reader = StageReader(stage_of(text))
    for asked, radius in ((1, 1.0), (time, 2.0), (None, 1.0), (time, 2.0)):
        # One sample varies at no time, yet it does not count at the default time.
        assert only(reader.read(asked).meshes).geometry.points.max() == radius


def test_nothing_is_read_again_at_the_default_time():
    reader = StageReader(stage_of('def Sphere "X" { double radius.timeSamples = {1: 1, 3: 3} }'))
    first = reader.read(math.nan)
    scene, work = read_counting(reader, Usd.TimeCode.Default())
    assert scene is first
    assert work == {}
    reader.stage.SetMetadata("comment", "x")
    assert read_counting(reader, math.nan)[0] is first
    reader.stage.DefinePrim(Sdf.Path("/Y"), "Sphere")
    assert len(reader.read(math.nan).meshes) == 2


@pytest.mark.parametrize("time", [math.inf, -math.inf])
def test_an_infinite_time_is_refused(time):
    with pytest.raises(PrevisError, match="finite"):
        describe('def Sphere "X" {}', time)

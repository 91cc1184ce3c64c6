"""The medium of a volume: PrevisVolume's inputs, their connections and ranges, and shaders that stand for others."""

import pytest
from pxr import Sdf, UsdShade
from stages import PREVIS_VOLUME, describe, notes, only, stage_of

from previs.description import ANISOTROPY_LIMIT, Medium
from previs.stage import StageReader

SPHERE = """
def Sphere "V" (prepend apiSchemas = ["MaterialBindingAPI"]) { rel material:binding = </M> }
"""
BOX = """
def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    float3[] extent = [(-1, -1, -1), (1, 1, 1)]
    rel material:binding%s = </M>
}
"""


def medium(inputs: str) -> Medium:
    return only(describe(SPHERE + PREVIS_VOLUME % inputs).volumes).medium


def test_defaults():
    assert medium("") == Medium()


@pytest.mark.parametrize(
    ("declaration", "name", "value"),
    [
        ("float inputs:density_scale = 2", "density_scale", 2.0),
        ("color3f inputs:extinction = (1, 2, 4)", "extinction", (1.0, 2.0, 4.0)),
        ("color3f inputs:albedo = (0.5, 0.25, 1)", "albedo", (0.5, 0.25, 1.0)),
        ("float inputs:albedo = 0.5", "albedo", (0.5, 0.5, 0.5)),
        ("float inputs:anisotropy = -0.5", "anisotropy", -0.5),
        ('token inputs:phase = "rayleigh"', "phase", "rayleigh"),
        ('string inputs:phase = "two_lobe"', "phase", "two_lobe"),
        ("float inputs:anisotropy2 = 0.25", "anisotropy2", 0.25),
        ("float inputs:lobe_mix = 0.25", "lobe_mix", 0.25),
        ("color3f inputs:emission = (3, 0, 1)", "emission", (3.0, 0.0, 1.0)),
        ("float inputs:emission_scale = 5", "emission_scale", 5.0),
        ("float inputs:temperature_scale = 100", "temperature_scale", 100.0),
        ("float inputs:temperature_offset = 300", "temperature_offset", 300.0),
    ],
)
def test_input(declaration, name, value):
    assert getattr(medium(declaration), name) == value


def test_scattering_and_absorption():
    found = medium("color3f inputs:scattering = (1, 0, 3)\ncolor3f inputs:absorption = (1, 0, 1)")
    assert found.extinction == (2.0, 0.0, 4.0)
    assert found.albedo == (0.5, 0.0, 0.75)


def test_scattering_alone_means_no_absorption():
    found = medium("color3f inputs:scattering = (2, 2, 2)")
    assert (found.extinction, found.albedo) == ((2.0, 2.0, 2.0), (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("declaration", "name", "value"),
    [
        ("color3f inputs:extinction = (-1, 2, 4)", "extinction", (0.0, 2.0, 4.0)),
        ("color3f inputs:albedo = (2, -1, 0.5)", "albedo", (1.0, 0.0, 0.5)),
        ("float inputs:anisotropy = 1", "anisotropy", ANISOTROPY_LIMIT),
        ("float inputs:anisotropy2 = -3", "anisotropy2", -ANISOTROPY_LIMIT),
        ('token inputs:phase = "mie"', "phase", "hg"),
        ("float inputs:density_scale = -2", "density_scale", 0.0),
        ("float inputs:lobe_mix = 2", "lobe_mix", 1.0),
        ("color3f inputs:emission = (nan, 0, 0)", "emission", (0.0, 0.0, 0.0)),
    ],
)
def test_illegal_values_are_repaired_and_reported(declaration, name, value):
    scene = describe(SPHERE + PREVIS_VOLUME % declaration)
    assert getattr(only(scene.volumes).medium, name) == value
    assert [(n.kind, n.path) for n in scene.notes] == [("repaired", "/M/S")]
    assert f"inputs:{name}" in scene.notes[0].message


def test_unknown_input_is_reported():
    scene = describe(SPHERE + PREVIS_VOLUME % "float inputs:densityScale = 2")
    [note] = scene.notes
    assert (note.kind, note.path) == ("ignored", "/M/S")
    assert note.message.startswith("inputs:densityScale is not an input of PrevisVolume; known are density_scale, ")
    assert "extinction, albedo" in note.message and note.message.endswith("scattering, absorption")


def test_an_input_without_its_prefix_is_reported():
    scene = describe(SPHERE + PREVIS_VOLUME % "color3f extinction = (9, 9, 9)\nfloat mine = 2")
    assert only(scene.volumes).medium == Medium()
    assert [str(n) for n in scene.notes] == ["/M/S: ignored: attribute extinction is not read; write inputs:extinction"]


@pytest.mark.parametrize(
    ("declaration", "sentence", "scale"),
    [
        (
            "float inputs:density_scale.connect = </M/T.outputs:r>",
            "inputs:density_scale is connected to </M/T.outputs:r>, which does not exist; the default is used",
            1.0,
        ),
        (
            "float inputs:density_scale = 3\nfloat inputs:density_scale.connect = </M.inputs:thick>",
            "inputs:density_scale is connected to </M.inputs:thick>, which does not exist; "
            "the value authored beside the connection is used",
            3.0,
        ),
        (
            "float inputs:density_scale.connect = </M>",
            "inputs:density_scale is connected to </M>, which is a prim and not one of its outputs; "
            "the default is used",
            1.0,
        ),
        (
            "float inputs:density_scale.connect = </G.inputs:a>",
            "</G.inputs:a> is connected to </G.inputs:b>, which does not exist; the default is used",
            1.0,
        ),
        (
            "float inputs:density_scale.connect = </G.c>",
            "inputs:density_scale is connected to </G.c>, which is neither an input nor an output; the default is used",
            1.0,
        ),
    ],
)
def test_an_input_connected_to_nothing_is_reported(declaration, sentence, scale):
    graph = 'def NodeGraph "G" { float inputs:a.connect = </G.inputs:b>\nfloat c }'
    scene = describe(SPHERE + PREVIS_VOLUME % declaration + graph)
    assert [str(n) for n in scene.notes] == [f"/M/S: missing: {sentence}"]
    assert only(scene.volumes).medium.density_scale == scale


@pytest.mark.parametrize("bound", [SPHERE, BOX % ""])
@pytest.mark.parametrize(
    ("target", "flaw"),
    [
        ("/M/Medum.outputs:out", "which does not exist"),
        ("/M/S.outputs:volume", "which does not exist"),
        ("/M/S", "which is a prim and not one of its outputs"),
    ],
)
def test_a_volume_output_connected_to_nothing_is_reported(bound, target, flaw):
    text = (PREVIS_VOLUME % "float inputs:density_scale = 2").replace("</M/S.outputs:out>", f"<{target}>")
    scene = describe(bound + text)
    assert only(scene.volumes).medium == Medium()
    assert [str(n) for n in notes(scene) if n.path == "/M"] == [
        f"/M: missing: outputs:volume is connected to <{target}>, {flaw}; PrevisVolume's defaults stand in for it"
    ]


def test_another_volume_output_stands_in_for_one_connected_to_nothing():
    text = (PREVIS_VOLUME % "float inputs:density_scale = 2").replace("outputs:volume", "outputs:arnold:volume")
    text = text.replace(
        "token outputs:arnold", "token outputs:volume.connect = </M/N.outputs:out>\ntoken outputs:arnold"
    )
    scene = describe(SPHERE + text)
    assert only(scene.volumes).medium.density_scale == 2.0
    assert "another volume output stands in" in notes(scene, "missing")[0].message


def test_what_a_connection_misses_is_read_once_it_is_made():
    stage = stage_of(SPHERE + (PREVIS_VOLUME % "").replace("</M/S.outputs:out>", "</Late.outputs:out>"))
    reader = StageReader(stage)
    assert len(reader.read(1.0).notes) == len(reader.read(2.0).notes) == 1
    late = UsdShade.Shader.Define(stage, "/Late")
    late.CreateIdAttr("PrevisVolume")
    late.CreateInput("density_scale", Sdf.ValueTypeNames.Float).Set(4.0)
    late.CreateOutput("out", Sdf.ValueTypeNames.Token)
    scene = reader.read(2.0)
    assert not scene.notes
    assert only(scene.volumes).medium.density_scale == 4.0


def test_a_volume_with_only_a_surface_has_no_volume_shader():
    text = (PREVIS_VOLUME % "").replace("outputs:volume", "outputs:surface")
    scene = describe(BOX % "" + text)
    assert "has no volume shader" in notes(scene, "approximated")[0].message


def test_values_come_through_the_material_interface_and_node_graphs():
    text = """
def Material "M" {
    float inputs:thickness = 7
    token outputs:volume.connect = </M/G.outputs:vol>
    def NodeGraph "G" {
        float inputs:thickness.connect = </M.inputs:thickness>
        token outputs:vol.connect = </M/G/S.outputs:out>
        def Shader "S" {
            uniform token info:id = "PrevisVolume"
            float inputs:density_scale.connect = </M/G.inputs:thickness>
            token outputs:out
        }
    }
}
"""
    assert only(describe(SPHERE + text).volumes).medium.density_scale == 7.0


def test_animated_input():
    text = SPHERE + PREVIS_VOLUME % "float inputs:density_scale.timeSamples = {1: 1, 2: 3}"
    assert only(describe(text, 1.5).volumes).medium.density_scale == 2.0


def test_nothing_bound_means_defaults_without_a_note():
    scene = describe('def Volume "V" { float3[] extent = [(-1, -1, -1), (1, 1, 1)] }')
    assert only(scene.volumes).medium == Medium()
    assert not scene.notes


@pytest.mark.parametrize("purpose", ["", ":preview", ":full"])
def test_binding_purposes(purpose):
    scene = describe(BOX % purpose + PREVIS_VOLUME % "float inputs:density_scale = 2")
    assert only(scene.volumes).medium.density_scale == 2.0


def test_a_box_is_worth_a_note_only_under_a_foreign_shader():
    assert not describe(BOX % "" + PREVIS_VOLUME % "").notes
    foreign = describe(BOX % "" + (PREVIS_VOLUME % "").replace("PrevisVolume", "PxrVolume"))
    assert any("box" in n.message and n.path == "/V" for n in foreign.notes)


@pytest.mark.parametrize("context", ["arnold", "ri", "kma", "karma", "mtlx"])
def test_render_context_outputs(context):
    text = PREVIS_VOLUME.replace("outputs:volume", f"outputs:{context}:volume") % "float inputs:density_scale = 2"
    assert only(describe(BOX % "" + text).volumes).medium.density_scale == 2.0


@pytest.mark.parametrize(
    ("identifier", "label"),
    [
        ("arnold:standard_volume", "Arnold"),
        ("PxrVolume", "RenderMan"),
        ("kma_volume", "Karma"),
        ("ND_volume_volumeshader", "MaterialX"),
        ("SomethingElse", "SomethingElse"),
    ],
)
def test_other_shaders_are_recognised_and_reported_once(identifier, label):
    text = (BOX + BOX.replace('"V"', '"W"')) % ("", "") + (PREVIS_VOLUME % "").replace("PrevisVolume", identifier)
    scene = describe(text)
    assert {v.medium for v in scene.volumes.values()} == {Medium()}
    about_material = [n for n in notes(scene, "approximated") if n.path == "/M"]
    assert len(about_material) == 1
    assert label in about_material[0].message


def test_missing_material_is_reported():
    assert [n.kind for n in describe(SPHERE.replace("Sphere", "Cube")).notes] == ["missing"]


@pytest.mark.parametrize(
    ("kind", "body", "low", "high"),
    [
        ("Cube", "double size = 4", (-2, -2, -2), (2, 2, 2)),
        ("Sphere", "double radius = 3", (-3, -3, -3), (3, 3, 3)),
        ("Capsule", 'token axis = "X"\ndouble height = 2\ndouble radius = 1', (-2, -1, -1), (2, 1, 1)),
    ],
)
def test_homogeneous_shapes(kind, body, low, high):
    text = SPHERE.replace("Sphere", kind).replace("rel", body + "\nrel")
    scene = describe(text + PREVIS_VOLUME % "")
    volume = only(scene.volumes)
    assert not scene.meshes
    assert [tuple(c) for c in volume.shape.local_bounds] == [low, high]


def test_a_shape_with_a_surface_is_a_mesh():
    text = SPHERE + (PREVIS_VOLUME % "").replace(
        "token outputs:volume", "token outputs:surface.connect = </M/S.outputs:out>\ntoken outputs:volume", 1
    )
    scene = describe(text)
    assert not scene.volumes
    assert list(scene.meshes) == ["/V"]


def test_a_medium_in_a_mesh_is_left_out_and_reported():
    scene = describe(SPHERE.replace("Sphere", "Cylinder") + PREVIS_VOLUME % "")
    assert not scene.volumes
    assert not scene.meshes
    assert "mesh" in notes(scene, "ignored")[0].message

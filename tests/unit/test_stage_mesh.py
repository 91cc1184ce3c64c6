"""Meshes and implicit shapes as triangles: topology, winding, normals, colours, surfaces, subsets, bad input."""

import math

import numpy as np
import pytest
from stages import QUAD, describe, notes, only

from previs.description import Geometry, Mesh, mesh_world_bounds
from previs.stage.polygons import triangulate


def mesh(body: str = QUAD, scheme: str = "none") -> Mesh:
    return only(describe(f'def Mesh "X" {{ uniform token subdivisionScheme = "{scheme}"\n{body} }}').meshes)


def areas(geometry: Geometry) -> np.ndarray:
    a, b, c = (geometry.points[geometry.triangles[:, i]].astype(float) for i in range(3))
    return 0.5 * np.cross(b - a, c - a)


def is_wound_like_its_normals(geometry: Geometry) -> bool:
    return bool(np.all(np.einsum("ij,ij->i", areas(geometry), geometry.normals[geometry.triangles[:, 0]]) > 0))


def polygon(points: list[tuple[float, float]], body: str = "") -> str:
    listed = ", ".join(f"({x}, {y}, 0)" for x, y in points)
    return f"""
        int[] faceVertexCounts = [{len(points)}]
        int[] faceVertexIndices = [{", ".join(map(str, range(len(points))))}]
        point3f[] points = [{listed}]
        {body}
    """


def test_quad_becomes_two_triangles_facing_the_viewer():
    geometry = mesh().geometry
    assert geometry.triangles.shape == (2, 3)
    assert areas(geometry).sum(axis=0) == pytest.approx((0, 0, 1))
    assert is_wound_like_its_normals(geometry)


def test_left_handed_faces_are_turned_over():
    geometry = mesh(QUAD + '\nuniform token orientation = "leftHanded"').geometry
    assert areas(geometry).sum(axis=0) == pytest.approx((0, 0, -1))
    assert is_wound_like_its_normals(geometry)


def test_mirrored_transform_flips_the_winding_and_keeps_the_points():
    scale = 'double3 xformOp:scale = (-1, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    plain, mirrored = mesh(), mesh(QUAD + scale)
    assert np.array_equal(plain.geometry.points, mirrored.geometry.points)
    assert areas(mirrored.geometry).sum(axis=0) == pytest.approx((0, 0, -1))
    assert plain.geometry.key != mirrored.geometry.key


@pytest.mark.parametrize(
    "points",
    [
        [(0, 0), (2, 0), (2, 2), (1, 0.5)],
        [(2, 2), (1, 0.5), (0, 0), (2, 0)],
        [(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)],
        [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)],
        [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)],
    ],
)
@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
@pytest.mark.parametrize("turn", [1, -1])
def test_concave_polygons_are_covered_once(points, axes, turn):
    flat = np.array([(x, y, 0.0) for x, y in points])[::turn]
    x, y = flat[:, 0], flat[:, 1]
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    placed = flat[:, axes]
    corners, faces = triangulate(placed, np.array([len(flat)]), np.arange(len(flat)), np.array([True]))
    a, b, c = (placed[corners[:, i]] for i in range(3))
    signed = 0.5 * np.cross(b - a, c - a)[:, axes.index(2)]
    assert len(corners) == len(points) - 2
    assert np.abs(signed).sum() == pytest.approx(abs(area))
    assert signed.sum() == pytest.approx(area)
    assert (faces == 0).all()


def test_mixed_polygons_keep_their_order_of_faces():
    counts = np.array([3, 5, 4, 3])
    points = np.random.default_rng(1).random((15, 3))
    _, faces = triangulate(points, counts, np.arange(15), np.ones(4, bool))
    assert faces.tolist() == [0, 1, 1, 1, 2, 2, 3]


def test_holes_are_left_out():
    body = """
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        int[] holeIndices = [1]
    """
    assert len(mesh(body).geometry.triangles) == 1


def test_polygonal_mesh_is_faceted_and_subdivision_mesh_is_smooth():
    body = """
        int[] faceVertexCounts = [4, 4]
        int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 5, 2]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 0, -1), (1, 1, -1)]
    """
    faceted, smooth = mesh(body).geometry, mesh(body, "catmullClark").geometry
    assert sorted({tuple(np.round(n, 6)) for n in faceted.normals.tolist()}) == [(0, 0, 1), (1, 0, 0)]
    assert smooth.normals[1] == pytest.approx((math.sqrt(0.5), 0, math.sqrt(0.5)))
    assert len(smooth.points) == 6


def test_smooth_normals_weigh_by_angle():
    # One side of the corner is cut in two triangles: weighting by triangle would tilt the normal.
    body = """
        int[] faceVertexCounts = [3, 3, 4, 4]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3, 0, 4, 5, 1, 0, 3, 6, 4]
        point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0), (0,0,1), (1,0,1), (0,1,1)]
    """
    normal = mesh(body, "catmullClark").geometry.normals[0]
    assert np.abs(normal) == pytest.approx([math.sqrt(1 / 3)] * 3, abs=1e-6)


@pytest.mark.parametrize(
    ("interpolation", "values"),
    [
        ("vertex", "(1,0,0), (1,0,0), (0,1,0), (0,1,0)"),
        ("varying", "(1,0,0), (1,0,0), (0,1,0), (0,1,0)"),
        ("faceVarying", "(1,0,0), (1,0,0), (0,1,0), (0,1,0)"),
        ("uniform", "(0,2,0)"),
        ("constant", "(0,2,0)"),
    ],
)
@pytest.mark.parametrize("name", ["normals", "primvars:normals"])
def test_authored_normals(interpolation, values, name):
    geometry = mesh(QUAD + f'\nnormal3f[] {name} = [{values}] (interpolation = "{interpolation}")').geometry
    by_point = {tuple(p): tuple(n) for p, n in zip(geometry.points.tolist(), geometry.normals.tolist(), strict=True)}
    expected = (0, 1, 0) if interpolation in ("uniform", "constant") else (1, 0, 0)
    assert by_point[(1.0, 0.0, 0.0)] == expected
    assert by_point[(1.0, 1.0, 0.0)] == (0, 1, 0)


def test_constant_display_color_belongs_to_the_surface():
    found = mesh(QUAD + "\ncolor3f[] primvars:displayColor = [(1, 0.5, 0)]")
    assert found.surface.diffuse_color == (1.0, 0.5, 0.0)
    assert found.geometry.colors is None
    assert not found.surface.specular


def test_display_color_is_inherited():
    text = f'def Xform "G" {{ color3f[] primvars:displayColor = [(1, 0, 0)]\n def Mesh "X" {{ {QUAD} }} }}'
    assert only(describe(text).meshes).surface.diffuse_color == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("interpolation", "values", "indices"),
    [
        ("vertex", "(1,0,0), (0,1,0), (0,0,1), (1,1,1)", ""),
        ("faceVarying", "(1,0,0), (0,1,0), (0,0,1), (1,1,1)", ""),
        ("vertex", "(0,1,0), (0,0,1), (1,1,1), (1,0,0)", "[3, 0, 1, 2]"),
    ],
)
def test_varying_display_color(interpolation, values, indices):
    body = f'\ncolor3f[] primvars:displayColor = [{values}] (interpolation = "{interpolation}")'
    if indices:
        body += f"\nint[] primvars:displayColor:indices = {indices}"
    found = mesh(QUAD + body)
    geometry = found.geometry
    by_point = {tuple(p): tuple(c) for p, c in zip(geometry.points.tolist(), geometry.colors.tolist(), strict=True)}
    assert by_point[(0.0, 0.0, 0.0)] == (1, 0, 0)
    assert by_point[(1.0, 1.0, 0.0)] == (0, 0, 1)
    assert found.surface.diffuse_color == (1.0, 1.0, 1.0)


def test_uniform_display_color():
    body = """
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)] (interpolation = "uniform")
    """
    geometry = mesh(body).geometry
    assert geometry.colors[geometry.triangles[:, 0]].tolist() == [[1, 0, 0], [0, 1, 0]]


def test_colours_of_the_wrong_number_are_reported_and_dropped():
    text = (
        f'def Mesh "X" {{ {QUAD}\n color3f[] primvars:displayColor = [(1,0,0), (0,1,0)] (interpolation = "vertex") }}'
    )
    scene = describe(text)
    assert only(scene.meshes).geometry.colors is None
    assert any("displayColor" in n.message for n in notes(scene, "ignored"))


@pytest.mark.parametrize(
    ("body", "fragment"),
    [
        (
            "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 9]\npoint3f[] points = [(0,0,0)]",
            "outside",
        ),
        (
            "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 0, 0]\npoint3f[] points = [(0,0,0)]",
            "4 indices",
        ),
        ("int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 0, 0]\npoint3f[] points = [(nan,0,0)]", "finite"),
        ("", "no points"),
        ("int[] faceVertexCounts = [2]\nint[] faceVertexIndices = [0, 0]\npoint3f[] points = [(0,0,0)]", "no faces"),
    ],
)
def test_bad_topology_is_reported(body, fragment):
    scene = describe(f'def Mesh "X" {{ {body} }}')
    assert not scene.meshes
    assert [n.path for n in notes(scene, "ignored")] == ["/X"]
    assert fragment in scene.notes[0].message


SURFACE = """
def Mesh "X" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    uniform token subdivisionScheme = "none"
    rel material:binding = </M>
    %s
}
def Material "M" {
    token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S" { uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
        %s
    }
    def Shader "T" { uniform token info:id = "%s"
        %s
        token outputs:result
    }
}
"""


def surfaced(inputs: str, other: str = "UsdUVTexture", other_inputs: str = "", body: str = QUAD):
    return describe(SURFACE % (body, inputs, other, other_inputs))


def test_preview_surface_defaults():
    surface = only(surfaced("").meshes).surface
    assert surface.specular
    assert surface.diffuse_color == (0.18, 0.18, 0.18)
    assert (surface.roughness, surface.metallic, surface.ior) == (0.5, 0.0, 1.5)


def test_preview_surface_constants():
    surface = only(
        surfaced(
            """
            color3f inputs:diffuseColor = (1, 0.5, 0.25)
            color3f inputs:emissiveColor = (2, 0, 0)
            int inputs:useSpecularWorkflow = 1
            color3f inputs:specularColor = (0.5, 0.5, 0.5)
            float inputs:metallic = 0.75
            float inputs:roughness = 0.25
            float inputs:ior = 2
            """
        ).meshes
    ).surface
    assert surface.diffuse_color == (1.0, 0.5, 0.25)
    assert surface.emissive_color == (2.0, 0.0, 0.0)
    assert surface.use_specular_workflow
    assert surface.specular_color == (0.5, 0.5, 0.5)
    assert (surface.metallic, surface.roughness, surface.ior) == (0.75, 0.25, 2.0)


def test_texture_is_reported_and_its_fallback_shown():
    connection = "color3f inputs:diffuseColor.connect = </M/T.outputs:result>"
    scene = surfaced(connection, other_inputs="float4 inputs:fallback = (1, 0, 0, 1)")
    assert only(scene.meshes).surface.diffuse_color == (1.0, 0.0, 0.0)
    assert "UsdUVTexture" in notes(scene, "approximated")[0].message
    assert only(surfaced(connection).meshes).surface.diffuse_color == (0.18, 0.18, 0.18)


def test_diffuse_color_from_display_color():
    scene = surfaced(
        "color3f inputs:diffuseColor.connect = </M/T.outputs:result>",
        "UsdPrimvarReader_float3",
        'string inputs:varname = "displayColor"',
        QUAD + "\ncolor3f[] primvars:displayColor = [(1, 0.5, 0)]",
    )
    assert only(scene.meshes).surface.diffuse_color == (1.0, 0.5, 0.0)
    assert not scene.notes


def test_authored_diffuse_color_hides_the_colours_of_the_mesh():
    body = QUAD + '\ncolor3f[] primvars:displayColor = [(1,0,0),(0,1,0),(0,0,1),(1,1,1)] (interpolation = "vertex")'
    assert only(surfaced("color3f inputs:diffuseColor = (1, 1, 0)", body=body).meshes).geometry.colors is None


def test_opacity():
    assert not surfaced("float inputs:opacity = 0").meshes
    assert "transparent" in surfaced("float inputs:opacity = 0").notes[0].message
    scene = surfaced("float inputs:opacity = 0.5")
    assert len(scene.meshes) == 1
    assert notes(scene, "approximated")[0].path == "/M/S"


def test_unknown_surface_shader_shows_the_display_color():
    text = SURFACE.replace("UsdPreviewSurface", "PxrSurface") % (
        QUAD + "\ncolor3f[] primvars:displayColor = [(1, 0, 0)]",
        "",
        "X",
        "",
    )
    scene = describe(text)
    assert only(scene.meshes).surface.diffuse_color == (1.0, 0.0, 0.0)
    assert notes(scene, "approximated")[0].path == "/M"


def test_subsets_become_meshes_of_their_own():
    text = """
def Mesh "X" {
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [3, 3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3, 0, 1, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    def GeomSubset "red" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        uniform token familyName = "materialBind"
        uniform token elementType = "face"
        int[] indices = [1, 2]
        rel material:binding = </M>
    }
}
def Material "M" {
    token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S" { uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (1, 0, 0)
        token outputs:surface
    }
}
"""
    meshes = describe(text).meshes
    assert {p: len(m.geometry.triangles) for p, m in meshes.items()} == {"/X": 1, "/X/red": 2}
    assert meshes["/X/red"].surface.diffuse_color == (1.0, 0.0, 0.0)
    assert meshes["/X"].surface.diffuse_color == (0.18, 0.18, 0.18)


def closed_volume(geometry: Geometry) -> float:
    a, b, c = (geometry.points[geometry.triangles[:, i]].astype(float) for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize(
    ("kind", "body", "volume", "half_size"),
    [
        ("Sphere", "double radius = 2", 32 / 3 * math.pi, (2, 2, 2)),
        ("Cube", "double size = 3", 27.0, (1.5, 1.5, 1.5)),
        ("Cylinder", "double radius = 1\ndouble height = 4", 4 * math.pi, (1, 1, 2)),
        ("Cylinder", 'double radius = 1\ndouble height = 4\ntoken axis = "X"', 4 * math.pi, (2, 1, 1)),
        ("Cylinder", 'double radius = 1\ndouble height = 4\ntoken axis = "Y"', 4 * math.pi, (1, 2, 1)),
        ("Cone", "double radius = 1\ndouble height = 3", math.pi, (1, 1, 1.5)),
        ("Capsule", "double radius = 1\ndouble height = 2", (2 + 4 / 3) * math.pi, (1, 1, 2)),
        ("Cylinder_1", "double radiusBottom = 2\ndouble radiusTop = 1\ndouble height = 3", 7 * math.pi, (2, 2, 1.5)),
    ],
)
def test_implicit_shapes_are_closed_and_of_the_right_size(kind, body, volume, half_size):
    found = only(describe(f'def {kind} "X" {{ {body} }}').meshes)
    assert closed_volume(found.geometry) == pytest.approx(volume, rel=0.01)
    assert is_wound_like_its_normals(found.geometry)
    assert np.linalg.norm(found.geometry.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert mesh_world_bounds(found)[1] == pytest.approx(half_size, abs=1e-6)


def test_cone_points_along_its_axis():
    geometry = only(describe('def Cone "X" {}').meshes).geometry
    assert np.abs(geometry.points[geometry.points[:, 2] > 0.999][:, :2]).max() < 1e-6


@pytest.mark.parametrize(
    ("axis", "normal", "half"), [("Z", (0, 0, 1), (1, 2, 0)), ("X", (1, 0, 0), (0, 2, 1)), ("Y", (0, 1, 0), (1, 0, 2))]
)
def test_plane(axis, normal, half):
    found = only(describe(f'def Plane "X" {{ double width = 2\n double length = 4\n token axis = "{axis}" }}').meshes)
    assert areas(found.geometry).sum(axis=0) == pytest.approx(8 * np.array(normal))
    assert mesh_world_bounds(found)[1] == pytest.approx(half)


@pytest.mark.parametrize("kind", ["Points", "BasisCurves", "NurbsPatch", "TetMesh"])
def test_other_geometry_is_reported(kind):
    assert [n.kind for n in describe(f'def {kind} "X" {{}}').notes] == ["ignored"]


def test_animated_points():
    body = QUAD.replace(
        "point3f[] points =", "point3f[] points.timeSamples = { 1: [(0,0,0), (0,0,0), (0,0,0), (0,0,0)], 3:"
    )
    body = body.rstrip() + ",}"
    text = f'def Mesh "X" {{ uniform token subdivisionScheme = "none"\n {body} }}'
    first, second = describe(text, 2.0), describe(text, 3.0)
    assert only(first.meshes).geometry.points.max() == 0.5
    assert only(second.meshes).geometry.points.max() == 1.0
    assert only(first.meshes).geometry.key != only(second.meshes).geometry.key

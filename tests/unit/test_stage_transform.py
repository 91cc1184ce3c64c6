"""Where prims are and whether they are shown: transforms, visibility, purpose, instances."""

import numpy as np
import pytest
from stages import QUAD, describe, notes, only

CUBE = 'def Cube "C" { %s }'
MOVE = 'double3 xformOp:translate = (%g, %g, %g)\nuniform token[] xformOpOrder = ["xformOp:translate"]\n'
BOX = 'def Volume "V" { float3[] extent = [(-1, -1, -1), (1, 1, 1)]\n %s }'


def test_transforms_are_inherited():
    text = f'def Xform "A" {{ {MOVE % (1, 2, 3)} def Xform "B" {{ {MOVE % (10, 0, 0)} {CUBE % ""} }} }}'
    assert only(describe(text).meshes).local_to_world[0, 3, :3].tolist() == [11, 2, 3]


def test_shear_and_non_uniform_scale_are_kept():
    matrix = "matrix4d xformOp:transform = ((2, 0, 0, 0), (1, 1, 0, 0), (0, 0, -3, 0), (5, 6, 7, 1))\n"
    order = 'uniform token[] xformOpOrder = ["xformOp:transform"]'
    volume = only(describe(BOX % (matrix + order)).volumes)
    assert volume.local_to_world.tolist() == [[2, 0, 0, 0], [1, 1, 0, 0], [0, 0, -3, 0], [5, 6, 7, 1]]


def test_reset_xform_stack():
    inner = """
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:translate"]
    """
    text = f'def Xform "A" {{ {MOVE % (5, 5, 5)} {CUBE % inner} }}'
    assert only(describe(text).meshes).local_to_world[0, 3, :3].tolist() == [1, 0, 0]


def test_animated_transform():
    text = CUBE % (
        "double3 xformOp:translate.timeSamples = {0: (0, 0, 0), 10: (10, 0, 0)}\n"
        'uniform token[] xformOpOrder = ["xformOp:translate"]'
    )
    assert only(describe(text, 2.5).meshes).local_to_world[0, 3, 0] == 2.5


def test_a_volume_without_thickness_is_reported_and_left_out():
    flat = 'double3 xformOp:scale = (1, 0, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    scene = describe(BOX % flat)
    assert not scene.volumes
    assert [n.kind for n in scene.notes] == ["empty"]


def test_an_extent_without_thickness_is_reported_and_left_out():
    scene = describe('def Volume "V" { float3[] extent = [(0, 0, 0), (1, 0, 1)] }')
    assert not scene.volumes
    assert [n.kind for n in scene.notes] == ["empty"]


@pytest.mark.parametrize("text", [CUBE, BOX])
def test_visibility_is_inherited_and_animated(text):
    hidden = 'def Xform "A" { token visibility.timeSamples = {1: "inherited", 2: "invisible"}\n' + text % "" + "}"
    for time, count in ((1.0, 1), (1.5, 1), (2.0, 0)):
        scene = describe(hidden, time)
        assert len(scene.meshes) + len(scene.volumes) == count


def test_inactive_prims_are_not_there():
    assert not describe('def Cube "C" (active = false) {}').meshes


@pytest.mark.parametrize(
    ("purpose", "asked", "shown"),
    [
        ("render", ("render",), True),
        ("render", (), False),
        ("proxy", ("render",), False),
        ("proxy", ("proxy",), True),
        ("guide", ("guide",), True),
        ("default", (), True),
    ],
)
def test_purpose_is_inherited(purpose, asked, shown):
    text = f'def Xform "A" {{ uniform token purpose = "{purpose}"\n {CUBE % ""} }}'
    assert bool(describe(text, purposes=asked).meshes) is shown


def test_mask_of_the_reader():
    text = f'def Xform "A" {{ {CUBE % ""} }} def Xform "B" {{ {CUBE % ""} }}'
    assert list(describe(text, mask=["/B"]).meshes) == ["/B/C"]


def test_native_instances_share_their_triangles():
    text = f"""
class Xform "P" {{ def Mesh "X" {{ {QUAD} }} }}
def Xform "a" (inherits = </P>
 instanceable = true) {{ {MOVE % (1, 0, 0)} }}
def Xform "b" (inherits = </P>
 instanceable = true) {{ {MOVE % (2, 0, 0)} }}
"""
    scene = describe(text)
    a, b = scene.meshes["/a/X"], scene.meshes["/b/X"]
    assert a.geometry is b.geometry
    assert [m.local_to_world[0, 3, 0] for m in (a, b)] == [1.0, 2.0]


INSTANCER = """
def PointInstancer "I" {
    rel prototypes = [%s]
    int[] protoIndices = [%s]
    point3f[] positions = [%s]
    %s
}
"""


def test_point_instances_of_a_mesh_are_one_record():
    inside = f'def Mesh "X" {{ {QUAD} {MOVE % (0, 0, 1)} }}'
    scene = describe(INSTANCER % ("</I/X>", "0, 0, 0", "(1, 0, 0), (2, 0, 0), (3, 0, 0)", inside))
    mesh = only(scene.meshes)
    assert mesh.path == "/I/X"
    assert mesh.local_to_world[:, 3, :3].tolist() == [[1, 0, 1], [2, 0, 1], [3, 0, 1]]


def test_point_instances_of_a_volume_are_records_of_their_own():
    scene = describe(INSTANCER % ("</I/V>", "0, 0", "(1, 0, 0), (2, 0, 0)", BOX % ""))
    assert [(p, v.local_to_world[3, 0]) for p, v in scene.volumes.items()] == [("/I/V[0]", 1.0), ("/I/V[1]", 2.0)]


def test_point_instances_of_a_light():
    inside = 'def SphereLight "L" { float inputs:radius = 0.01 }'
    scene = describe(INSTANCER % ("</I/L>", "0, 0", "(1, 0, 0), (2, 0, 0)", inside))
    assert [(p, x.position[0]) for p, x in scene.lights.items()] == [("/I/L[0]", 1.0), ("/I/L[1]", 2.0)]


def test_invisible_and_inactive_ids():
    body = BOX % "" + "\nint64[] ids = [10, 11, 12]\nint64[] invisibleIds = [11]"
    scene = describe(INSTANCER % ("</I/V>", "0, 0, 0", "(1, 0, 0), (2, 0, 0), (3, 0, 0)", body))
    assert list(scene.volumes) == ["/I/V[0]", "/I/V[2]"]


def test_orientation_and_scale_of_point_instances():
    body = BOX % "" + "\nquath[] orientations = [(0, 0, 0, 1)]\nfloat3[] scales = [(2, 3, 4)]"
    volume = only(describe(INSTANCER % ("</I/V>", "0", "(1, 0, 0)", body)).volumes)
    assert np.diag(volume.local_to_world)[:3] == pytest.approx((-2, -3, 4), abs=1e-3)


def test_several_prototypes_with_groups():
    inside = f'def Xform "A" {{ {MOVE % (0, 5, 0)} def Cube "C" {{ {MOVE % (0, 0, 7)} }} }} {BOX % ""}'
    scene = describe(INSTANCER % ("</I/A>, </I/V>", "0, 1, 0", "(1, 0, 0), (2, 0, 0), (3, 0, 0)", inside))
    assert scene.meshes["/I/A/C"].local_to_world[:, 3, :3].tolist() == [[1, 5, 7], [3, 5, 7]]
    assert list(scene.volumes) == ["/I/V[1]"]


def test_mirrored_point_instances_are_wound_the_other_way():
    body = f'def Mesh "X" {{ {QUAD} }}\nfloat3[] scales = [(1, 1, 1), (-1, 1, 1)]'
    scene = describe(INSTANCER % ("</I/X>", "0, 0", "(0, 0, 0), (5, 0, 0)", body))
    plain, mirrored = scene.meshes["/I/X"], scene.meshes["/I/X[mirrored]"]
    assert np.array_equal(plain.geometry.triangles, mirrored.geometry.triangles[:, ::-1])
    assert mirrored.local_to_world[0, 3, 0] == 5.0


def test_prototypes_elsewhere_and_the_place_of_the_instancer():
    text = f"""
over "P" {{ def Xform "Group" {{ {MOVE % (100, 0, 0)} {BOX % ""} }} }}
def Xform "A" {{ {MOVE % (0, 50, 0)}
{INSTANCER % ("</P/Group/V>", "0", "(1, 0, 0)", "")} }}
"""
    scene = describe(text)
    # What lies above the prototype's root does not move its instances.
    assert scene.volumes["/P/Group/V[0]"].local_to_world[3, :3].tolist() == [1, 50, 0]


def test_a_prototype_shared_by_two_instancers():
    text = f'over "P" {{ {BOX % ""} }}' + "".join(
        (INSTANCER % ("</P/V>", "0", f"({x}, 0, 0)", "")).replace('"I"', f'"{name}"')
        for x, name in ((1, "I"), (2, "J"))
    )
    assert [v.local_to_world[3, 0] for v in describe(text).volumes.values()] == [1.0, 2.0]


def test_nested_point_instancers():
    inner = (INSTANCER % ("</I/J/V>", "0, 0", "(1, 0, 0), (2, 0, 0)", BOX % "")).replace('"I"', '"J"')
    scene = describe(INSTANCER % ("</I/J>", "0, 0", "(0, 10, 0), (0, 20, 0)", inner))
    found = {p: tuple(v.local_to_world[3, :2]) for p, v in scene.volumes.items()}
    assert found == {
        "/I/J/V[0][0]": (1.0, 10.0),
        "/I/J/V[0][1]": (2.0, 10.0),
        "/I/J/V[1][0]": (1.0, 20.0),
        "/I/J/V[1][1]": (2.0, 20.0),
    }


def test_native_instances_as_prototypes():
    inside = f"""def Xform "a" (inherits = </P>
    instanceable = true) {{ {MOVE % (0, 3, 0)} }}"""
    text = f'class Xform "P" {{ {BOX % ""} }}' + INSTANCER % ("</I/a>", "0, 0", "(1, 0, 0), (2, 0, 0)", inside)
    assert [v.local_to_world[3, :2].tolist() for v in describe(text).volumes.values()] == [[1, 3], [2, 3]]


def test_point_instancers_inside_native_instances():
    inner = INSTANCER % ("</P/I/V>", "0, 0", "(1, 0, 0), (2, 0, 0)", BOX % "")
    text = f"""
def Xform "P" (active = true) {{ {inner} }}
def Xform "a" (references = </P>
    instanceable = true) {{ {MOVE % (0, 5, 0)} }}
"""
    found = {p: tuple(v.local_to_world[3, :2]) for p, v in describe(text).volumes.items()}
    assert found == {
        "/P/I/V[0]": (1.0, 0.0),
        "/P/I/V[1]": (2.0, 0.0),
        "/a/I/V[0]": (1.0, 5.0),
        "/a/I/V[1]": (2.0, 5.0),
    }


def test_hidden_parts_of_prototypes():
    inside = f'def Xform "A" {{ def Xform "H" {{ token visibility = "invisible"\n {CUBE % ""} }} {BOX % ""} }}'
    scene = describe(INSTANCER % ("</I/A>", "0", "(1, 0, 0)", inside))
    assert not scene.meshes
    assert len(scene.volumes) == 1


@pytest.mark.parametrize(
    ("parts", "kind"),
    [
        (("</I/V>", "0, 7", "(1, 0, 0), (2, 0, 0)", BOX % ""), "ignored"),
        (("</I/V>", "0, 0", "(1, 0, 0)", BOX % ""), "ignored"),
        (("</Nowhere>", "0", "(1, 0, 0)", ""), "missing"),
        (("</I>", "0", "(1, 0, 0)", ""), "ignored"),
        (("</I/V>", "", "", BOX % ""), "empty"),
    ],
)
def test_broken_instancers_are_reported(parts, kind):
    scene = describe(INSTANCER % parts)
    assert [(n.kind, n.path) for n in notes(scene)] == [(kind, "/I")]


def test_up_axis():
    assert describe('( upAxis = "Z" )').up_axis == "Z"
    assert describe("").up_axis == "Y"

"""Volumes and their fields: which file, which grid, where it sits, and everything that can be wrong with it."""

import numpy as np
import pytest
from pxr import Sdf, UsdUtils
from stages import describe, notes, only, usda, volume_text, write_field

from previs import vdb
from previs.description import Box, volume_world_bounds
from previs.errors import PrevisError
from previs.stage import StageReader, open_stage


def read(path, time=None, **options):
    return StageReader(open_stage(path), **options).read(time)


def save(folder, text, name="scene.usda"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(usda(text))
    return path


@pytest.fixture
def fail(tmp_path):
    """The sentence that reading a stage fails with; with keep_going the volume is left out with a note."""

    def run(text, time=None):
        path = save(tmp_path, text)
        with pytest.raises(PrevisError) as caught:
            read(path, time)
        message = str(caught.value)
        assert "\n" not in message
        scene = read(path, time, keep_going=True)
        assert not scene.volumes
        assert [n.kind for n in notes(scene, "missing")] == ["missing"]
        return message

    return run


def test_field_with_its_transform(tmp_path):
    matrix = np.diag([0.5, 0.5, 0.5, 1.0])
    matrix[3, :3] = 1, 2, 3
    write_field(tmp_path / "smoke.vdb", transform=matrix)
    place = '\ndouble3 xformOp:translate = (10, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:translate"]'
    text = volume_text("./smoke.vdb").replace('"V" {', '"V" {' + place)
    volume = only(read(save(tmp_path, text)).volumes)
    assert volume.density.index_to_local[3, :3].tolist() == [1, 2, 3]
    lo, hi = volume_world_bounds(volume)
    assert lo == pytest.approx((10.5, 1.5, 2.5))
    assert hi == pytest.approx((13, 4, 5))


def test_the_field_prims_own_transform_is_applied_and_said(tmp_path):
    write_field(tmp_path / "smoke.vdb")
    extra = 'double3 xformOp:scale = (2, 2, 2)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    scene = read(save(tmp_path, volume_text("./smoke.vdb", extra=extra)))
    assert only(scene.volumes).density.index_to_local[0, 0] == 2.0
    assert notes(scene)[0].path == "/V/f"


def test_an_identity_transform_of_the_field_is_not_worth_a_note(tmp_path):
    write_field(tmp_path / "smoke.vdb")
    extra = 'double3 xformOp:scale = (1, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    assert not read(save(tmp_path, volume_text("./smoke.vdb", extra=extra))).notes


def test_density_temperature_and_emission(tmp_path):
    write_field(tmp_path / "a.vdb", "density", "heat", "light")
    fields = "".join(
        f'rel field:{n} = </V/{n}>\ndef OpenVDBAsset "{n}" {{ asset filePath = @./a.vdb@\n token fieldName = "{g}" }}\n'
        for n, g in (("density", "density"), ("temperature", "heat"), ("emission", "light"), ("vel", "vel"))
    )
    scene = read(save(tmp_path, f'def Volume "V" {{ {fields} }}'))
    volume = only(scene.volumes)
    assert [f.grid.name for f in (volume.density, volume.temperature, volume.emission)] == ["density", "heat", "light"]
    assert [(n.kind, n.message) for n in scene.notes] == [("ignored", "field:vel")]


def test_a_single_field_of_another_name_is_the_density(tmp_path):
    write_field(tmp_path / "a.vdb", "soot")
    scene = read(save(tmp_path, volume_text("./a.vdb", field="soot", grid="soot")))
    assert only(scene.volumes).density.grid.name == "soot"
    assert "field:soot" in notes(scene, "approximated")[0].message


def test_several_fields_that_might_be_the_density(fail):
    text = """def Volume "V" { rel field:a = </V/f>
    rel field:b = </V/f>
    def OpenVDBAsset "f" { asset filePath = @./x.vdb@ } }"""
    assert fail(text).startswith("/V: no field named density, and several that might be: a, b")


def test_empty_field_name_means_the_only_grid(tmp_path):
    write_field(tmp_path / "a.vdb", "anything")
    assert only(read(save(tmp_path, volume_text("./a.vdb", grid=""))).volumes).density.grid.name == "anything"


def test_empty_field_name_of_a_file_with_several_grids(fail, tmp_path):
    write_field(tmp_path / "a.vdb", "one", "two")
    assert "one, two" in fail(volume_text("./a.vdb", grid=""))


def test_field_index_picks_among_equal_names(tmp_path):
    grids = [vdb.Grid.from_dense("density", np.full((3, 3, 3), v, np.float32)) for v in (1.0, 2.0, 3.0)]
    vdb.write(tmp_path / "a.vdb", grids)
    for index in range(3):
        scene = read(save(tmp_path, volume_text("./a.vdb", extra=f"int fieldIndex = {index}"), f"{index}.usda"))
        assert only(scene.volumes).density.grid.leaf_values.max() == index + 1
    scene = read(save(tmp_path, volume_text("./a.vdb")))
    assert only(scene.volumes).density.grid.leaf_values.max() == 1.0
    assert "3 grids" in notes(scene, "approximated")[0].message


def test_wrong_field_index(fail, tmp_path):
    vdb.write(tmp_path / "a.vdb", [vdb.Grid.from_dense("density", np.ones((2, 2, 2)))] * 2)
    assert "fieldIndex 7" in fail(volume_text("./a.vdb", extra="int fieldIndex = 7"))


def test_wrong_field_name(fail, tmp_path):
    write_field(tmp_path / "a.vdb", "density", "heat")
    message = fail(volume_text("./a.vdb", grid="smoke"))
    assert message.startswith("/V/f: ")
    assert "a.vdb: no grid named smoke; its grids: density, heat" in message


def test_missing_file(fail):
    assert fail(volume_text("./nowhere.vdb")).startswith("/V/f: ./nowhere.vdb: no such file")


@pytest.mark.parametrize("content", [b"", b"not a vdb", bytes(range(256)) * 8])
def test_corrupt_file(fail, tmp_path, content):
    (tmp_path / "a.vdb").write_bytes(content)
    message = fail(volume_text("./a.vdb"))
    assert message.startswith("/V/f: ")
    assert message.count("a.vdb") == 1


def test_truncated_file(fail, tmp_path):
    write_field(tmp_path / "whole.vdb", size=20, value=0.37)
    (tmp_path / "a.vdb").write_bytes((tmp_path / "whole.vdb").read_bytes()[:-200])
    assert "a.vdb" in fail(volume_text("./a.vdb"))


def test_no_file_path(fail):
    assert "filePath" in fail(volume_text("", grid="density").replace("asset filePath = @@", ""))


def test_dangling_field(fail):
    assert "/Nowhere, which does not exist" in fail('def Volume "V" { rel field:density = </Nowhere> }')


@pytest.mark.parametrize(
    ("target", "what"),
    [
        ('def Mesh "Ground" {}', "a Mesh"),
        ('def "Ground" {}', "a prim without a type"),
    ],
)
@pytest.mark.parametrize("extent", ["", "float3[] extent = [(-1, -1, -1), (1, 1, 1)]"])
def test_a_density_that_is_no_field(fail, target, what, extent):
    text = f'def Xform "World" {{ def Volume "V" {{ {extent}\n rel field:density = </World/Ground> }} {target} }}'
    sentence = f"/World/V: field:density points to </World/Ground>, which is {what} and not an OpenVDBAsset"
    assert fail(text) == sentence


def test_another_field_that_is_no_field_is_reported(tmp_path):
    write_field(tmp_path / "a.vdb")
    text = volume_text("./a.vdb").replace('"V" {', '"V" { rel field:temperature = </Ground>\n')
    scene = read(save(tmp_path, text + 'def Mesh "Ground" {}'))
    assert only(scene.volumes).temperature is None
    assert [str(n) for n in scene.notes if n.path == "/V"] == [
        "/V: ignored: field:temperature points to </Ground>, which is a Mesh and not an OpenVDBAsset"
    ]


def test_neither_field_nor_extent(fail):
    assert fail('def Volume "V" {}').startswith("/V: has neither a density field nor an extent")


def test_vector_density(fail, tmp_path):
    vdb.write(tmp_path / "a.vdb", [vdb.Grid.from_dense("density", np.ones((2, 2, 2, 3)))])
    assert "vectors" in fail(volume_text("./a.vdb"))


def test_volume_without_fields_is_the_box_of_its_extent():
    scene = describe('def Volume "V" { float3[] extent = [(-1, 0, -1), (1, 3, 1)] }')
    assert only(scene.volumes).shape == Box((-1.0, 0.0, -1.0), (1.0, 3.0, 1.0))


def test_field3d_is_reported():
    scene = describe(
        """def Volume "V" { float3[] extent = [(-1, -1, -1), (1, 1, 1)]
        rel field:density = </V/f>
        def Field3DAsset "f" {} }"""
    )
    assert notes(scene, "ignored")[0].path == "/V/f"


def test_empty_grid_keeps_the_volume_out_of_the_picture(tmp_path):
    write_field(tmp_path / "a.vdb", value=0.0)
    scene = read(save(tmp_path, volume_text("./a.vdb")))
    assert not scene.volumes
    assert [(n.kind, n.path) for n in scene.notes] == [("empty", "/V/f")]


def test_bad_voxels_are_cleaned_and_counted(tmp_path):
    array = np.full((4, 4, 4), 2.0, np.float32)
    array[0, 0, 0], array[0, 0, 1:3], array[1, 0, :3] = np.nan, np.inf, -1.0
    vdb.write(tmp_path / "a.vdb", [vdb.Grid.from_dense("density", array)])
    scene = read(save(tmp_path, volume_text("./a.vdb")))
    grid = only(scene.volumes).density.grid
    expected = np.full((4, 4, 4), 2.0, np.float32)
    expected[0, 0, 0], expected[1, 0, :3] = 0.0, 0.0
    assert np.array_equal(grid.dense((0, 0, 0), (3, 3, 3)), expected)
    [note] = scene.notes
    assert note.kind == "repaired"
    assert "1 NaN, 2 infinite, 3 negative" in note.message


def test_negative_background_is_cleaned(tmp_path):
    grid = vdb.Grid.from_dense("density", np.ones((2, 2, 2)), background=-1.0)
    vdb.write(tmp_path / "a.vdb", [grid])
    cleaned = only(read(save(tmp_path, volume_text("./a.vdb"))).volumes).density.grid
    assert cleaned.background == 0.0
    assert cleaned.leaf_values.min() == 0.0


def test_level_set_is_reported(tmp_path):
    grid = vdb.Grid.from_dense("density", np.ones((2, 2, 2)), grid_class="level set")
    vdb.write(tmp_path / "a.vdb", [grid])
    assert "level set" in read(save(tmp_path, volume_text("./a.vdb"))).notes[0].message


def test_time_samples_of_the_file_are_held(tmp_path):
    for i in (1, 2):
        write_field(tmp_path / f"f{i}.vdb", value=float(i))
    text = volume_text("x").replace("asset filePath = @x@", "asset filePath.timeSamples = {1: @f1.vdb@, 2: @./f2.vdb@}")
    reader = StageReader(open_stage(save(tmp_path, text.replace("@f1", "@./f1"))))
    values = {t: only(reader.read(t).volumes).density.grid.leaf_values.max() for t in (None, 0.0, 1.0, 1.9, 2.0, 9.0)}
    assert list(values.values()) == [1, 1, 1, 1, 2, 2]
    assert reader.counters["grids"] == 2


def test_path_is_relative_to_the_layer_that_authors_it(tmp_path):
    write_field(tmp_path / "fx" / "cache" / "smoke.vdb")
    save(tmp_path / "fx", volume_text("./cache/smoke.vdb"), "smoke.usda")
    path = save(tmp_path / "shot", "( subLayers = [@../fx/smoke.usda@] )")
    assert len(read(path).volumes) == 1


def test_referenced_and_crate_layers(tmp_path):
    write_field(tmp_path / "fx" / "smoke.vdb")
    text = '( defaultPrim = "V" )' + volume_text("./smoke.vdb")
    Sdf.Layer.FindOrOpen(str(save(tmp_path / "fx", text))).Export(str(tmp_path / "fx" / "smoke.usdc"))
    path = save(tmp_path, 'def "A" (references = @./fx/smoke.usdc@) {}')
    assert list(read(path).volumes) == ["/A"]


def test_field_inside_a_usdz(tmp_path):
    write_field(tmp_path / "smoke.vdb", value=3.0)
    source = save(tmp_path, volume_text("./smoke.vdb"))
    assert UsdUtils.CreateNewUsdzPackage(str(source), str(tmp_path / "a.usdz"))
    (tmp_path / "smoke.vdb").unlink()
    assert only(read(tmp_path / "a.usdz").volumes).density.grid.leaf_values.max() == 3.0


def test_equal_files_under_two_prims_are_read_once(tmp_path):
    write_field(tmp_path / "a.vdb")
    text = volume_text("./a.vdb") + volume_text("./a.vdb", name="W")
    reader = StageReader(open_stage(save(tmp_path, text)))
    a, b = reader.read().volumes.values()
    assert a.density.key == b.density.key
    assert a.density.grid is b.density.grid
    assert reader.counters["grids"] == 1


def test_a_file_written_anew_is_read_anew(tmp_path):
    path = write_field(tmp_path / "a.vdb", value=1.0)
    stage = open_stage(save(tmp_path, volume_text("./a.vdb")))
    reader = StageReader(stage)
    first = only(reader.read(1.0).volumes).density.key
    write_field(path, value=2.0, size=6)
    second = only(reader.read(2.0).volumes).density.key
    assert first != second
    assert reader.counters["grids"] == 2


def test_grids_out_of_the_picture_leave_the_cache(tmp_path):
    for i in range(4):
        write_field(tmp_path / f"f{i}.vdb", value=1.0 + i)
    samples = ", ".join(f"{i}: @./f{i}.vdb@" for i in range(4))
    text = volume_text("x").replace("asset filePath = @x@", f"asset filePath.timeSamples = {{{samples}}}")
    reader = StageReader(open_stage(save(tmp_path, text)))
    reader._grids._limit = 6000
    for i in range(4):
        reader.read(i)
    assert len(reader._grids._grids) == 2
    reader.read(3)
    assert reader.counters["grids"] == 4


@pytest.mark.parametrize(
    ("name", "content", "fragment"),
    [
        ("nowhere.usda", None, "no such file"),
        ("a.txt", b"hello", "not a USD file"),
        ("a.usda", b'#usda 1.0\ndef Xform "A" (', "cannot be read as USD"),
        ("a.usda", b"hello", "cannot be read as USD"),
        ("a.usdc", b"PXR-USDC" + bytes(300), "cannot be read as USD"),
        ("a.usdz", b"PK\x03\x04" + bytes(300), "cannot be read as USD"),
        ("a.usda", b"", "cannot be read as USD"),
    ],
)
def test_unreadable_stages(tmp_path, name, content, fragment, capfd):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PrevisError) as caught:
        open_stage(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert fragment in message
    assert "\n" not in message
    assert capfd.readouterr().err == ""


def test_a_folder_is_no_stage(tmp_path):
    with pytest.raises(PrevisError, match="folder"):
        open_stage(tmp_path)


def test_unresolved_reference_is_reported(tmp_path, capfd):
    scene = read(save(tmp_path, 'def Xform "A" (references = @./nowhere.usda@) {}'))
    assert [(n.kind, n.path) for n in scene.notes] == [("missing", "/A")]
    assert capfd.readouterr().err == ""


def test_session_layer_and_its_absence(tmp_path):
    path = save(tmp_path, 'def Cube "C" {}')
    session = save(tmp_path, 'over "C" (active = false) {}', "session.usda")
    assert not StageReader(open_stage(path, session)).read().meshes
    with pytest.raises(PrevisError, match=r"nothing\.usda: no such file"):
        open_stage(path, tmp_path / "nothing.usda")


def test_mask_keeps_what_is_bound(tmp_path):
    text = """
def Cube "A" (prepend apiSchemas = ["MaterialBindingAPI"]) { rel material:binding = </M> }
def Cube "B" {}
def Material "M" { token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S" { uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (1, 0, 0)
        token outputs:surface } }
"""
    path = save(tmp_path, text)
    mesh = only(StageReader(open_stage(path, mask="/A")).read().meshes)
    assert mesh.surface.diffuse_color == (1.0, 0.0, 0.0)
    with pytest.raises(PrevisError, match="/Nowhere"):
        open_stage(path, mask=["/Nowhere"])


def test_variants(tmp_path):
    text = """
def Xform "A" (variants = { string shape = "ball" }
    prepend variantSets = "shape") {
    variantSet "shape" = { "ball" { def Sphere "X" {} } "box" { def Cube "X" {} } }
}
"""
    path = save(tmp_path, text)
    assert open_stage(path).GetPrimAtPath("/A/X").GetTypeName() == "Sphere"
    assert open_stage(path, variants={"/A": {"shape": "box"}}).GetPrimAtPath("/A/X").GetTypeName() == "Cube"
    with pytest.raises(PrevisError, match="ball, box"):
        open_stage(path, variants={"/A": {"shape": "cone"}})

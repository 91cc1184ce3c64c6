"""Scenes in Python: what is built is what is described, edits are USD, and a saved scene is the same scene."""

import math
import os

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade
from stages import PREVIS_VOLUME, usda, write_field

from previs.description import Camera, Medium, mesh_world_bounds, volume_world_bounds
from previs.errors import PrevisError
from previs.scene import Scene


@pytest.fixture
def scene():
    with Scene() as made:
        yield made


def ramp(*shape):
    return np.arange(1, math.prod(shape) + 1, dtype=np.float32).reshape(shape)


def dense(field):
    return field.grid.dense(*field.grid.bounds)


def test_the_smallest_scene(scene):
    scene.add_volume("/smoke", ramp(3, 4, 5), extinction=2.0)
    scene.add_distant_light("/sun")
    described = scene.describe()
    assert described.volumes["/smoke"].medium.extinction == (2.0, 2.0, 2.0)
    assert np.array_equal(dense(described.volumes["/smoke"].density), ramp(3, 4, 5))
    assert not described.notes


def test_bounds_are_those_of_the_voxels_cells(scene):
    scene.add_volume("/v", ramp(2, 4, 8), bounds=((-1, 0, 2), (1, 2, 4)))
    matrix = scene.describe().volumes["/v"].density.index_to_local
    assert np.diag(matrix).tolist() == [1, 0.5, 0.25, 1]
    assert matrix[3, :3].tolist() == [-0.5, 0.25, 2.125]


def test_default_voxels_are_one_wide_and_centred(scene):
    scene.add_volume("/v", ramp(2, 3, 4))
    lo, hi = volume_world_bounds(scene.describe().volumes["/v"])
    assert lo == pytest.approx(-hi)
    assert hi.tolist() == [1.5, 2, 2.5]


def test_transform_of_the_voxels(scene):
    matrix = np.diag([2.0, 3.0, 4.0, 1.0])
    scene.add_volume("/v", ramp(2, 2, 2), transform=matrix)
    assert np.array_equal(scene.describe().volumes["/v"].density.index_to_local, matrix)


def test_temperature_and_emission(scene):
    scene.add_volume("/v", ramp(2, 2, 2), temperature=ramp(2, 2, 2) * 10, emission=ramp(2, 2, 2) * 2)
    volume = scene.describe().volumes["/v"]
    assert np.array_equal(dense(volume.temperature), ramp(2, 2, 2) * 10)
    assert np.array_equal(dense(volume.emission), ramp(2, 2, 2) * 2)


@pytest.mark.parametrize("color", [(20, 10, 5), [20, 10, 5], np.array([20.0, 10.0, 5.0])])
def test_emission_of_three_numbers_is_the_colour_of_the_medium(scene, color):
    scene.add_volume("/v", ramp(3, 3, 3), emission=color, emission_scale=2)
    volume = scene.describe().volumes["/v"]
    assert volume.emission is None
    assert (volume.medium.emission, volume.medium.emission_scale) == ((20.0, 10.0, 5.0), 2.0)


def test_emission_of_one_number_is_the_colour_of_the_medium(scene):
    scene.add_volume("/v", ramp(2, 2, 2), emission=0.5)
    assert scene.describe().volumes["/v"].medium.emission == (0.5, 0.5, 0.5)


@pytest.mark.parametrize(
    ("emission", "fragment"),
    [
        ((1, 2), r"emission must be an array of shape \(X, Y, Z\)"),
        ((1, -2, 3), "emission must be at least 0"),
    ],
)
def test_emission_that_is_neither_voxels_nor_a_colour(scene, emission, fragment):
    with pytest.raises(ValueError, match=fragment):
        scene.add_volume("/v", ramp(2, 2, 2), emission=emission)
    assert not scene.describe().volumes


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.uint8, np.int32, bool])
def test_any_real_type(scene, dtype):
    scene.add_volume("/v", np.ones((2, 2, 2), dtype))
    assert dense(scene.describe().volumes["/v"].density).max() == 1.0


def test_set_voxels_keeps_the_place_and_the_medium(scene):
    scene.add_volume("/v", ramp(2, 2, 2), bounds=((0, 0, 0), (4, 4, 4)), temperature=ramp(2, 2, 2), albedo=0.25)
    before = scene.describe().volumes["/v"]
    scene.set_voxels("/v", 2 * ramp(2, 2, 2))
    after = scene.describe().volumes["/v"]
    assert np.array_equal(dense(after.density), 2 * ramp(2, 2, 2))
    assert np.array_equal(after.density.index_to_local, before.density.index_to_local)
    assert after.temperature.key == before.temperature.key
    assert after.medium == before.medium


def test_set_voxels_leaves_no_files_behind(scene):
    scene.add_volume("/v", ramp(2, 2, 2))
    for i in range(5):
        scene.set_voxels("/v", ramp(2 + i, 2, 2), bounds=((0, 0, 0), (1, 1, 1)))
        assert scene.describe().volumes["/v"].density.grid.active_count == 4 * (2 + i)
    folder = os.path.dirname(scene.stage.GetAttributeAtPath("/v/density.filePath").Get().path)
    assert len(os.listdir(folder)) == 1


def test_set_voxels_of_what_has_none(scene):
    scene.add_box_medium("/box")
    with pytest.raises(PrevisError, match="no voxels"):
        scene.set_voxels("/box", ramp(2, 2, 2))


def test_homogeneous_shapes(scene):
    scene.add_box_medium("/box", ((0, 0, 0), (2, 4, 6)), albedo=0.5)
    scene.add_sphere_medium("/ball", 2.0, (5, 0, 0), scattering=1, absorption=3)
    described = scene.describe()
    assert volume_world_bounds(described.volumes["/box"])[1].tolist() == [2, 4, 6]
    assert volume_world_bounds(described.volumes["/ball"])[0].tolist() == [3, -2, -2]
    assert described.volumes["/ball"].medium.albedo == (0.25, 0.25, 0.25)
    assert not described.meshes


def test_mesh(scene):
    matrix = np.eye(4)
    matrix[3, :3] = 1, 2, 3
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    scene.add_mesh("/m", points, [[0, 1, 2], [0, 2, 3]], color=(1, 0, 0), transform=matrix)
    mesh = scene.describe().meshes["/m"]
    assert mesh.surface.diffuse_color == (1.0, 0.0, 0.0)
    assert mesh.geometry.normals[0].tolist() == [0, 0, 1]
    assert mesh_world_bounds(mesh)[1].tolist() == [2, 3, 3]


def test_mesh_with_a_colour_per_point_and_smooth_normals(scene):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    scene.add_mesh("/m", points, faces, color=np.eye(4)[:, :3], smooth=True)
    geometry = scene.describe().meshes["/m"].geometry
    assert geometry.colors.tolist() == np.eye(4)[:, :3].tolist()
    assert geometry.normals[0] == pytest.approx([-math.sqrt(1 / 3)] * 3, abs=1e-6)


@pytest.mark.parametrize(("up", "axis"), [("Y", 1), ("Z", 2)])
def test_ground_lies_across_the_up_axis(up, axis):
    with Scene(up) as scene:
        scene.add_ground(height=3, size=10)
        mesh = scene.describe().meshes["/ground"]
    lo, hi = mesh_world_bounds(mesh)
    assert lo[axis] == hi[axis] == 3
    assert np.delete(hi, axis).tolist() == [5, 5]
    assert mesh.geometry.normals[0].tolist() == np.eye(3)[axis].tolist()


def test_lights_have_the_strength_asked_for(scene):
    scene.add_distant_light("/sun", (1, -1, 0), irradiance=3, angle=2)
    scene.add_sphere_light("/bulb", (1, 2, 3), radiant_intensity=5, radius=0.3)
    scene.add_spot_light("/spot", (0, 5, 0), (0, 0, 0), radiant_intensity=7, cone_angle=20, cone_softness=0.5)
    scene.add_dome_light("/sky", intensity=2)
    lights = scene.describe().lights
    assert [lights[p].strength[0] for p in ("/sun", "/bulb", "/spot")] == pytest.approx([3, 5, 7])
    assert lights["/sun"].direction == pytest.approx((math.sqrt(0.5), -math.sqrt(0.5), 0))
    assert lights["/bulb"].position.tolist() == [1, 2, 3]
    assert lights["/spot"].direction == pytest.approx((0, -1, 0))
    assert (lights["/spot"].shaping.cone_angle, lights["/spot"].shaping.cone_softness) == (20, 0.5)
    assert lights["/sky"].radiance == (2.0, 2.0, 2.0)


def test_intensity_is_that_of_usd(scene):
    scene.add_sphere_light("/bulb", intensity=2, radius=1)
    assert scene.describe().lights["/bulb"].strength[0] == pytest.approx(2 * math.pi)


def test_camera(scene):
    scene.add_camera("/cam", (0, 0, 10), (0, 0, 0), focal_length=35)
    scene.add_camera("/flat", (0, 10, 0), (0, 0, 0), orthographic_width=8)
    camera = scene.camera("cam")
    assert camera.camera_to_world == pytest.approx(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 10, 1]]))
    assert camera.focal_length == 35
    flat = scene.camera("/flat")
    assert flat.window() == pytest.approx((-4, 4, -2.25, 2.25))
    assert flat.camera_to_world[2, :3] == pytest.approx((0, 1, 0))
    assert scene.camera().path == "/cam"
    with pytest.raises(PrevisError, match="/cam, /flat"):
        scene.camera("other")


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ({"density": np.ones((2, 2))}, r"\(X, Y, Z\), not \(2, 2\)"),
        ({"density": np.ones((0, 2, 2))}, "X, Y, Z"),
        ({"density": np.ones((2, 2, 2), complex)}, "real numbers"),
        ({"density": np.ones((2, 2, 2)), "temperature": np.ones((3, 2, 2))}, "equal"),
        ({"density": np.ones((2, 2, 2)), "bounds": ((0, 0, 0), (1, 0, 1))}, "thickness"),
        ({"density": np.ones((2, 2, 2)), "bounds": ((0, 0, 0), (1, 1, 1)), "transform": np.eye(4)}, "either"),
        ({"density": np.ones((2, 2, 2)), "transform": np.eye(3)}, "4×4"),
        ({"density": np.ones((2, 2, 2)), "transform": np.eye(4) + np.eye(4, k=3)}, "row vectors"),
        ({"density": np.ones((2, 2, 2)), "transform": np.diag([1, 0, 1, 1])}, "singular"),
        ({"density": np.ones((2, 2, 2)), "albedo": 2}, "albedo must be in"),
        ({"density": np.ones((2, 2, 2)), "extinction": -1}, "at least 0"),
        ({"density": np.ones((2, 2, 2)), "phase": "mie"}, "phase must be one of"),
        ({"density": np.ones((2, 2, 2)), "opacity": 1}, "opacity is not a value of a medium"),
        ({"density": np.ones((2, 2, 2)), "albedo": 0.5, "scattering": 1}, "either"),
        ({"density": np.ones((2, 2, 2)), "path": "/a b"}, "not a prim path"),
        ({"density": np.ones((2, 2, 2)), "path": "/taken"}, "already"),
    ],
)
def test_bad_volumes(scene, arguments, fragment):
    scene.add_ground("/taken")
    with pytest.raises(ValueError, match=fragment):
        scene.add_volume(**{"path": "/v", **arguments})
    assert not scene.stage.GetPrimAtPath("/v")


@pytest.mark.parametrize(
    ("call", "fragment"),
    [
        (lambda s: s.add_mesh("/m", [[0, 0]], [[0, 1, 2]]), r"\(V, 3\)"),
        (lambda s: s.add_mesh("/m", np.eye(3), [[0, 1, 3]]), "outside the 3 points"),
        (lambda s: s.add_mesh("/m", np.eye(3), [[0, 1]]), "three point indices"),
        (lambda s: s.add_mesh("/m", np.eye(3), [[0, 1, 2]], color=np.eye(2)), "color"),
        (lambda s: s.add_distant_light("/l", irradiance=1, intensity=1), "either"),
        (lambda s: s.add_distant_light("/l", (0, 0, 0)), "no direction"),
        (lambda s: s.add_sphere_light("/l", (0, 0)), "position"),
        (lambda s: s.add_sphere_light("/l", radius=-1), "radius must be at least 0"),
        (lambda s: s.add_spot_light("/l", (0, 0, 0), (0, 0, 0)), "no direction"),
        (lambda s: s.add_spot_light("/l", (0, 0, 0), (0, 0, 1), cone_softness=2), "cone_softness"),
        (lambda s: s.add_camera("/c", (0, 0, 0), (0, 0, 1), focal_length=0), "focal_length must be above 0"),
        (lambda s: s.add_camera("/c", (0, 0, 0), (0, 0, 1), clipping_range=(2, 1)), "clipping_range"),
        (lambda s: s.add_sphere_medium("/b", 0), "radius must be above 0"),
        (lambda s: s.add_sphere_medium("/b", "big"), "radius must be a number"),
    ],
)
def test_bad_arguments(scene, call, fragment):
    with pytest.raises(ValueError, match=fragment):
        call(scene)


def test_set_medium_reads_nothing_again(scene):
    scene.add_volume("/v", ramp(2, 2, 2), albedo=0.5)
    scene.describe()
    scene.reader.counters.clear()
    scene.set_medium("/v", albedo=0.25, phase="rayleigh")
    medium = scene.describe().volumes["/v"].medium
    assert (medium.albedo, medium.phase) == ((0.25, 0.25, 0.25), "rayleigh")
    assert scene.reader.counters == {"prims": 1}
    assert scene.medium("/v") == medium


def test_set_medium_makes_a_material_where_there_is_none(scene):
    scene.add_volume("/v", ramp(2, 2, 2))
    assert scene.medium("/v") == Medium()
    scene.set_medium("/v", density_scale=3)
    assert scene.describe().volumes["/v"].medium.density_scale == 3.0


def test_the_two_parametrisations_replace_each_other(scene):
    scene.add_volume("/v", ramp(2, 2, 2), extinction=4, albedo=0.5)
    scene.set_medium("/v", scattering=1)
    assert scene.medium("/v").extinction == pytest.approx((3, 3, 3))
    assert scene.medium("/v").absorption == pytest.approx((2, 2, 2))
    scene.set_medium("/v", albedo=0.5)
    assert scene.medium("/v").extinction == pytest.approx((3, 3, 3))
    assert scene.medium("/v").albedo == (0.5, 0.5, 0.5)
    assert not scene.describe().notes


def test_set_light(scene):
    scene.add_sphere_light("/l", radiant_intensity=1)
    scene.set_light("/l", intensity=8, color=(1, 0, 0), position=(1, 2, 3), direction=(1, 0, 0), cone_angle=40)
    light = scene.describe().lights["/l"]
    assert light.strength == pytest.approx((2, 0, 0))
    assert light.position.tolist() == [1, 2, 3]
    assert light.direction == pytest.approx((1, 0, 0))
    assert light.shaping.cone_angle == 40
    scene.set_light("/l", color_temperature=3000, casts_shadows=False)
    light = scene.describe().lights["/l"]
    assert not light.casts_shadows
    scene.set_light("/l", visible=False)
    assert not scene.describe().lights


def test_set_light_under_a_moved_group(scene):
    UsdGeom.XformCommonAPI(UsdGeom.Xform.Define(scene.stage, "/g")).SetTranslate((10, 0, 0))
    scene.add_sphere_light("/g/l")
    scene.set_light("/g/l", position=(1, 2, 3))
    assert scene.describe().lights["/g/l"].position.tolist() == [1, 2, 3]


def test_edits_of_what_is_not_there(scene):
    scene.add_ground()
    for call in (
        lambda: scene.set_medium("/nothing", albedo=1),
        lambda: scene.set_medium("/ground", albedo=1),
        lambda: scene.set_light("/ground", intensity=1),
        lambda: scene.remove("/nothing"),
        lambda: scene.medium("not a path"),
    ):
        with pytest.raises(PrevisError):
            call()
    with pytest.raises(ValueError, match="brightness is not a value of a light"):
        scene.add_sphere_light("/l")
        scene.set_light("/l", brightness=1)


def test_remove(scene):
    scene.add_ground()
    scene.remove("/ground")
    assert not scene.describe().meshes
    assert not scene.stage.GetPrimAtPath("/ground")


def test_remove_from_an_opened_file_leaves_the_file_alone(tmp_path):
    path = tmp_path / "a.usda"
    path.write_text(usda('def Cube "C" {}'))
    before = path.read_bytes()
    with Scene.open(path) as scene:
        scene.remove("/C")
        assert not scene.describe().meshes
        assert not scene.stage.GetRootLayer().dirty
    assert path.read_bytes() == before


def build(scene):
    scene.add_volume("/fx/smoke", ramp(3, 4, 5), bounds=((-1, 0, -1), (1, 2, 1)), temperature=ramp(3, 4, 5), albedo=0.5)
    scene.add_volume("/more/smoke", ramp(2, 2, 2), anisotropy=0.5)
    scene.add_box_medium("/fog", extinction=0.1)
    scene.add_mesh("/mesh", np.eye(3), [[0, 1, 2]], color=(1, 0.5, 0.25))
    scene.add_distant_light("/sun", irradiance=3)
    scene.add_spot_light("/spot", (0, 5, 0), (0, 0, 0))
    scene.add_camera("/cam", (0, 0, 10), (0, 0, 0))


def content(described):
    """A description without what depends on where its files are."""
    return {
        "volumes": {p: (v.parts()["placement"], v.medium) for p, v in described.volumes.items()},
        "voxels": {
            p: [dense(f).tobytes() for f in (v.density, v.temperature) if f] for p, v in described.volumes.items()
        },
        "lights": {p: x.parts() for p, x in described.lights.items()},
        "meshes": {p: m.parts() for p, m in described.meshes.items()},
        "cameras": {p: c.parts() for p, c in described.cameras.items()},
        "notes": described.notes,
    }


@pytest.mark.parametrize("ending", [".usda", ".usdc", ".usd"])
def test_a_saved_scene_is_the_same_scene(scene, tmp_path, ending):
    build(scene)
    path = tmp_path / f"shot{ending}"
    scene.save(path)
    assert sorted(os.listdir(tmp_path)) == sorted([path.name, "shot_smoke.vdb", "shot_smoke_2.vdb"])
    with Scene.open(path) as again:
        assert content(again.describe()) == content(scene.describe())


def test_saved_paths_are_relative(scene, tmp_path):
    build(scene)
    (tmp_path / "here").mkdir()
    scene.save(tmp_path / "here" / "shot.usda")
    assert str(tmp_path) not in (tmp_path / "here" / "shot.usda").read_text()
    (tmp_path / "here").rename(tmp_path / "there")
    with Scene.open(tmp_path / "there" / "shot.usda") as again:
        assert len(again.describe().volumes) == 3


def test_saving_twice_and_over_an_existing_file(scene, tmp_path):
    build(scene)
    for albedo in (0.25, 0.75):
        scene.set_medium("/fx/smoke", albedo=albedo)
        scene.save(tmp_path / "shot.usda")
    with Scene.open(tmp_path / "shot.usda") as again:
        assert again.medium("/fx/smoke").albedo == (0.75, 0.75, 0.75)


def test_a_failing_save_leaves_nothing_behind(scene, tmp_path, monkeypatch):
    build(scene)
    (tmp_path / "shot.usda").write_text("precious")

    def fail(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("previs.vdb.write", fail)
    with pytest.raises(PrevisError, match="No space left"):
        scene.save(tmp_path / "shot.usda")
    assert os.listdir(tmp_path) == ["shot.usda"]
    assert (tmp_path / "shot.usda").read_text() == "precious"


def test_save_wants_a_folder_and_an_ending(scene, tmp_path):
    with pytest.raises(PrevisError, match="no such folder"):
        scene.save(tmp_path / "nowhere" / "a.usda")
    with pytest.raises(ValueError, match=r"\.usda"):
        scene.save(tmp_path / "a.txt")
    with pytest.raises(ValueError, match="not opened"):
        scene.save_overrides(tmp_path / "a.usda")


FOREIGN = (
    """
def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    rel material:binding:preview = </M>
    rel field:density = </V/f>
    def OpenVDBAsset "f" { asset filePath = @./smoke.vdb@
        token fieldName = "density" }
}
"""
    + PREVIS_VOLUME
)


@pytest.fixture
def shot(tmp_path):
    """A file with a volume, whose PrevisVolume inputs or shader the test chooses."""

    def write(inputs="", identifier="PrevisVolume"):
        write_field(tmp_path / "smoke.vdb")
        path = tmp_path / "shot.usda"
        path.write_text(usda((FOREIGN % inputs).replace("PrevisVolume", identifier)))
        return path

    return write


def test_edits_of_an_opened_file_go_to_the_session_layer(shot):
    path = shot("color3f inputs:albedo = (0.5, 0.5, 0.5)")
    before = path.read_bytes()
    with Scene.open(path) as scene:
        scene.set_medium("/V", albedo=0.25)
        assert scene.medium("/V").albedo == (0.25, 0.25, 0.25)
        assert not scene.stage.GetRootLayer().dirty
    assert path.read_bytes() == before


def test_a_foreign_shader_is_replaced_by_the_edit(shot):
    with Scene.open(shot(identifier="arnold:standard_volume")) as scene:
        scene.set_medium("/V", albedo=0.25)
        described = scene.describe()
        assert described.volumes["/V"].medium.albedo == (0.25, 0.25, 0.25)
        assert not described.notes


def test_an_edit_reaches_the_interface_behind_an_input(tmp_path):
    path = tmp_path / "a.usda"
    path.write_text(
        usda(
            """
def Sphere "V" (prepend apiSchemas = ["MaterialBindingAPI"]) { rel material:binding = </M> }
def Material "M" {
    float inputs:thick = 2
    token outputs:volume.connect = </M/S.outputs:out>
    def Shader "S" { uniform token info:id = "PrevisVolume"
        float inputs:density_scale.connect = </M.inputs:thick>
        token outputs:out }
}
"""
        )
    )
    with Scene.open(path) as scene:
        scene.set_medium("/V", density_scale=7)
        assert scene.medium("/V").density_scale == 7.0
        assert scene.stage.GetAttributeAtPath("/M.inputs:thick").Get() == 7.0


def test_the_other_parametrisation_in_the_file_is_blocked(shot):
    with Scene.open(shot("color3f inputs:scattering = (1, 1, 1)\ncolor3f inputs:absorption = (3, 3, 3)")) as scene:
        scene.set_medium("/V", albedo=0.5)
        assert scene.medium("/V").extinction == (4.0, 4.0, 4.0)
        assert scene.medium("/V").albedo == (0.5, 0.5, 0.5)
        assert not scene.describe().notes


ANIMATED = "float inputs:density_scale.timeSamples = {1: 1, 3: 3}"


def test_an_edit_for_all_times_hides_the_animation(shot):
    with Scene.open(shot(ANIMATED)) as scene:
        scene.set_medium("/V", density_scale=5)
        assert [scene.medium("/V", t).density_scale for t in (1, 2, 3)] == [5, 5, 5]


def test_an_edit_at_a_time_keeps_the_rest_of_the_animation(shot):
    with Scene.open(shot(ANIMATED)) as scene:
        scene.set_medium("/V", density_scale=7, time=2)
        assert [scene.medium("/V", t).density_scale for t in (1, 2, 3)] == [1, 7, 3]
        scene.set_medium("/V", density_scale=5)
        assert [scene.medium("/V", t).density_scale for t in (1, 2, 3)] == [5, 5, 5]


def test_overrides_round_trip(shot, tmp_path):
    path = shot("color3f inputs:scattering = (1, 1, 1)")
    with Scene.open(path) as scene:
        scene.set_medium("/V", albedo=0.5, extinction=2)
        scene.add_volume("/extra", ramp(2, 2, 2))
        scene.add_distant_light("/sun", irradiance=3)
        scene.save_overrides(tmp_path / "edits.usda")
        first = content(scene.describe())
    assert str(tmp_path) not in (tmp_path / "edits.usda").read_text()
    with Scene.open(path, tmp_path / "edits.usda") as scene:
        assert content(scene.describe()) == first
        # Saving over the layer that is in use keeps what it holds.
        scene.set_light("/sun", intensity=5)
        scene.save_overrides(tmp_path / "edits.usda")
    with Scene.open(path, tmp_path / "edits.usda") as scene:
        described = scene.describe()
        assert described.lights["/sun"].strength[0] == 5
        assert described.volumes["/V"].medium.albedo == (0.5, 0.5, 0.5)
        assert "/extra" in described.volumes


def test_an_opened_scene_is_saved_flattened(shot, tmp_path):
    (tmp_path / "out").mkdir()
    with Scene.open(shot()) as scene:
        scene.set_medium("/V", albedo=0.25)
        scene.save(tmp_path / "out" / "b.usda")
        first = content(scene.describe())
    with Scene.open(tmp_path / "out" / "b.usda") as scene:
        assert content(scene.describe()) == first
    assert "../smoke.vdb" in (tmp_path / "out" / "b.usda").read_text()


def test_native_instances_cannot_be_edited_on_their_own(tmp_path):
    path = tmp_path / "a.usda"
    path.write_text(
        usda(
            """
def Xform "P" { def SphereLight "L" {} }
def Xform "a" (references = </P>
 instanceable = true) {}
"""
        )
    )
    with Scene.open(path) as scene, pytest.raises(PrevisError, match="native instance"):
        scene.set_light("/a/L", intensity=2)


def test_a_record_of_a_point_instance_names_its_prototype(scene):
    scene.add_volume("/v", ramp(2, 2, 2))
    instancer = UsdGeom.PointInstancer.Define(scene.stage, "/i")
    instancer.CreatePrototypesRel().SetTargets(["/v"])
    instancer.CreateProtoIndicesAttr([0, 0])
    instancer.CreatePositionsAttr([(10, 0, 0), (20, 0, 0)])
    scene.set_medium("/v[1]", albedo=0.25)
    assert scene.describe().volumes["/v[0]"].medium.albedo == (0.25, 0.25, 0.25)


def test_stronger_binding_above_is_an_error(scene):
    group = UsdGeom.Xform.Define(scene.stage, "/g")
    material = UsdShade.Material.Define(scene.stage, "/M")
    UsdShade.MaterialBindingAPI.Apply(group.GetPrim()).Bind(
        material, UsdShade.Tokens.strongerThanDescendants, UsdShade.Tokens.preview
    )
    scene.add_volume("/g/v", ramp(2, 2, 2))
    with pytest.raises(PrevisError, match="/M is bound by a prim above it"):
        scene.set_medium("/g/v", albedo=0.5)


def test_closing_removes_the_temporary_files():
    scene = Scene()
    scene.add_volume("/v", ramp(2, 2, 2))
    file = scene.stage.GetAttributeAtPath("/v/density.filePath").Get().path
    assert os.path.isfile(file)
    scene.close()
    scene.close()
    assert not os.path.exists(os.path.dirname(file))
    with pytest.raises(ValueError, match="closed"):
        scene.describe()


def test_everything_authored_is_plain_usd(scene, tmp_path):
    build(scene)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(scene.stage.GetRootLayer())
    stage = Usd.Stage.Open(layer)
    assert stage.GetPrimAtPath("/fx").GetTypeName() == "Xform"
    assert stage.GetPrimAtPath("/fx/smoke").GetTypeName() == "Volume"


@pytest.mark.parametrize("projection", ("perspective", "orthographic"))
def test_a_copied_camera_sees_the_same(scene, projection):
    turned = np.eye(4)
    turned[:3, :3] = [[0.6, 0.0, -0.8], [0.48, 0.8, 0.36], [0.64, -0.6, 0.48]]
    turned[3, :3] = (3.0, -2.0, 7.5)
    camera = Camera("", turned, projection, 35.0, 40.0, 17.0, 1.5, -0.5, (0.25, 900.0))
    assert scene.copy_camera("/cams/copy", camera) == "/cams/copy"
    copied = scene.camera("copy")
    np.testing.assert_allclose(copied.camera_to_world, camera.camera_to_world, atol=1e-12)
    assert copied.projection == projection
    np.testing.assert_allclose(copied.window(), camera.window(), rtol=1e-6)
    assert copied.clipping_range == camera.clipping_range

"""The render index: a version moves exactly when its part changes."""

from dataclasses import replace

import numpy as np
import pytest

from previs import vdb
from previs.description import (
    Box,
    Camera,
    Field,
    Geometry,
    Light,
    Medium,
    Mesh,
    Note,
    SceneDescription,
    Shaping,
    Surface,
    Volume,
)
from previs.index import RenderIndex, camera_key


def moved(x: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[3, 0] = x
    return matrix


def field(key: str = "voxels", x: float = 0.0) -> Field:
    return Field(key, vdb.Grid.from_dense("density", np.ones((2, 2, 2), np.float32)), moved(x))


VOLUME = Volume("/v", np.eye(4), density=field())
BOX = Volume("/b", np.eye(4), shape=Box((0, 0, 0), (1, 1, 1)))
LIGHT = Light("/l", "sphere", np.eye(4), (1, 1, 1), (2, 2, 2), radius=0.1)
MESH = Mesh("/m", Geometry("g", np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((1, 3), int)), np.eye(4)[None])


def scene(*records) -> SceneDescription:
    kinds = {kind: {r.path: r for r in records if isinstance(r, kind)} for kind in (Volume, Light, Mesh)}
    return SceneDescription(kinds[Volume], kinds[Light], kinds[Mesh])


def index_of(*records) -> RenderIndex:
    index = RenderIndex()
    index.update(scene(*records))
    return index


def versions(index: RenderIndex) -> dict:
    return {
        (path, part): version
        for entries in (index.volumes, index.lights, index.meshes)
        for path, entry in entries.items()
        for part, version in entry.versions.items()
    }


CHANGES = [
    (VOLUME, {"medium": Medium(albedo=(0.1, 0.2, 0.3))}, {"scattering"}),
    (VOLUME, {"medium": Medium(anisotropy=0.5)}, {"scattering"}),
    (VOLUME, {"medium": Medium(emission=(1, 1, 1))}, {"scattering"}),
    (VOLUME, {"medium": Medium(extinction=(2, 2, 2))}, {"extinction", "scattering"}),
    (VOLUME, {"medium": Medium(density_scale=2.0)}, {"extinction", "scattering"}),
    (VOLUME, {"local_to_world": moved(1.0)}, {"placement"}),
    (VOLUME, {"density": field("other voxels")}, {"density"}),
    (VOLUME, {"density": field(x=1.0)}, {"density"}),
    (VOLUME, {"temperature": field("heat")}, {"emission_fields"}),
    (VOLUME, {"emission": field("glow")}, {"emission_fields"}),
    (BOX, {"shape": Box((0, 0, 0), (1, 1, 2))}, {"placement"}),
    (LIGHT, {"strength": (3, 3, 3)}, {"colour"}),
    (LIGHT, {"radiance": (3, 3, 3)}, {"colour"}),
    (LIGHT, {"radius": 0.2}, {"colour"}),
    (LIGHT, {"treat_as_point": True}, {"colour"}),
    (LIGHT, {"light_to_world": moved(1.0)}, {"placement"}),
    (LIGHT, {"casts_shadows": False}, {"placement"}),
    (LIGHT, {"kind": "disk"}, {"placement"}),
    (LIGHT, {"shaping": Shaping(cone_angle=20.0)}, {"placement", "colour"}),
    (MESH, {"surface": Surface(diffuse_color=(1, 0, 0))}, {"surface"}),
    (MESH, {"local_to_world": moved(1.0)[None]}, {"shape"}),
    (MESH, {"local_to_world": np.stack([np.eye(4), moved(1.0)])}, {"shape"}),
    (MESH, {"geometry": replace(MESH.geometry, key="other")}, {"shape"}),
]


@pytest.mark.parametrize(
    ("record", "change", "parts"), CHANGES, ids=lambda c: "-".join(c) if c.__class__ is dict else ""
)
def test_a_change_moves_the_versions_of_its_parts_and_no_other(record, change, parts):
    others = [r for r in (VOLUME, BOX, LIGHT, MESH) if r is not record]
    index = index_of(record, *others)
    before = versions(index)
    changed = replace(record, **change)
    index.update(scene(changed, *others))
    after = versions(index)
    assert {key for key in after if after[key] != before[key]} == {(record.path, part) for part in parts}
    assert all(after[key] >= before[key] for key in after)
    entries = index.volumes | index.lights | index.meshes
    assert entries[record.path].record is changed


def test_equal_content_in_new_objects_moves_nothing():
    index = index_of(VOLUME, LIGHT, MESH)
    before = versions(index)
    index.update(scene(*(replace(r) for r in (VOLUME, LIGHT, MESH))))
    again = replace(VOLUME, local_to_world=-0.0 * np.ones((4, 4)) + np.eye(4), medium=Medium(), density=field())
    index.update(scene(again, LIGHT, MESH))
    assert versions(index) == before


def test_a_change_and_its_undoing_are_two_versions():
    """Versions are not hashes: what was made in between is gone."""
    index = index_of(LIGHT)
    first = versions(index)
    index.update(scene(replace(LIGHT, strength=(9, 9, 9))))
    index.update(scene(LIGHT))
    assert versions(index)["/l", "colour"] > first["/l", "colour"]
    assert versions(index)["/l", "placement"] == first["/l", "placement"]


def test_removed_and_added_records():
    index = index_of(VOLUME, BOX, LIGHT)
    before = versions(index)
    index.update(scene(VOLUME))
    assert list(index.volumes) == ["/v"]
    assert not index.lights
    assert {k: v for k, v in before.items() if k[0] == "/v"} == versions(index)
    index.update(scene(VOLUME, BOX, LIGHT))
    after = versions(index)
    assert after.keys() == before.keys()
    for key in after:
        assert (after[key] == before[key]) == (key[0] == "/v"), "what left and came back is new"


def test_order_follows_the_scene():
    other = replace(VOLUME, path="/a")
    index = index_of(VOLUME, BOX)
    before = versions(index)
    index.update(scene(other, BOX, VOLUME))
    assert list(index.volumes) == ["/a", "/b", "/v"]
    assert {k: v for k, v in versions(index).items() if k[0] != "/a"} == before


def test_versions_of_two_indices_never_meet():
    assert set(versions(index_of(VOLUME)).values()).isdisjoint(versions(index_of(VOLUME)).values())


def test_notes_and_scene_are_those_of_the_last_update():
    noted = replace(scene(VOLUME), notes=(Note("ignored", "/x", "nothing"),))
    index = index_of(LIGHT)
    index.update(noted)
    assert index.scene is noted
    assert index.notes == noted.notes


def test_camera_key_is_of_the_view():
    camera = Camera("/c", np.eye(4))
    assert camera_key(camera) == camera_key(replace(camera, path="/d"))
    for change in (
        {"camera_to_world": moved(1.0)},
        {"focal_length": 35.0},
        {"horizontal_aperture_offset": 1.0},
        {"clipping_range": (1.0, 10.0)},
        {"projection": "orthographic"},
    ):
        assert camera_key(camera) != camera_key(replace(camera, **change))


def test_bounds_of_a_scene_are_found_once_and_cannot_be_written_to():
    volume = Volume("/Box", np.eye(4), shape=Box((-1.0, -2.0, -3.0), (1.0, 2.0, 3.0)))
    description = SceneDescription(volumes={"/Box": volume})
    lo, hi = description.world_bounds()
    assert (lo.tolist(), hi.tolist()) == ([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0])
    assert description.world_bounds()[0] is lo
    with pytest.raises(ValueError, match="read-only"):
        hi += 1.0

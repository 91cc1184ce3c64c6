"""The orbiting camera: rigid, level, under the cursor, and true to the stage's camera."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from building import camera, look_at, rotation
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from previs.description import Camera, SceneDescription, box_corners, framing_camera
from previs.render.projection import camera_rays
from previs.ui.camera_control import FRAMING_MARGIN, TURN, WHEEL_STEP, OrbitCamera

BOUNDS = (np.array([-2.0, -1.0, 0.0]), np.array([3.0, 4.0, 2.0]))
ASPECT = 1.6

#: No deadline: machines that run tests are busy.
properties = settings(max_examples=50, deadline=None)

drags = st.floats(-3.0, 3.0)
small_drags = st.floats(-0.2, 0.2)
aspects = st.floats(0.3, 4.0)
coordinates = st.floats(-50.0, 50.0)


@st.composite
def stage_cameras(draw) -> Camera:
    """Anywhere, in any direction and roll, with any lens."""
    axis = draw(st.tuples(coordinates, coordinates, coordinates).filter(lambda a: np.linalg.norm(a) > 1.0))
    matrix = rotation(axis, draw(st.floats(-180.0, 180.0)))
    matrix[3, :3] = draw(st.tuples(coordinates, coordinates, coordinates))
    return Camera(
        "/Camera",
        matrix,
        projection=draw(st.sampled_from(["perspective", "orthographic"])),
        focal_length=draw(st.floats(10.0, 200.0)),
        horizontal_aperture=draw(st.floats(5.0, 60.0)),
        vertical_aperture=draw(st.floats(5.0, 60.0)),
        horizontal_aperture_offset=draw(st.floats(-5.0, 5.0)),
        vertical_aperture_offset=draw(st.floats(-5.0, 5.0)),
        clipping_range=(0.5, 300.0),
    )


views = st.builds(OrbitCamera.from_camera, stage_cameras(), st.just(BOUNDS), st.sampled_from("YZ"))


def place_in_picture(c: Camera, point) -> np.ndarray:
    """(u, v) of a world point, u right and v up; from the definition of a camera, not from the module under test."""
    matrix = np.asarray(c.camera_to_world)
    x, y, z = matrix[:3, :3] @ (np.asarray(point) - matrix[3, :3])
    left, right, bottom, top = c.window()
    scale = -z if c.projection == "perspective" else 1.0
    return np.array([(x / scale - left) / (right - left), (y / scale - bottom) / (top - bottom)])


def assert_rigid(matrix: np.ndarray) -> None:
    assert np.all(np.isfinite(matrix))
    assert np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(matrix[:3, :3]) > 0.0
    assert matrix[:, 3].tolist() == [0.0, 0.0, 0.0, 1.0]


@properties
@given(views, st.lists(st.tuples(st.sampled_from(["orbit", "pan", "dolly", "frame"]), drags, drags), max_size=8))
def test_transforms_stay_rigid_and_clipping_holds_the_scene(view, movements):
    for kind, x, y in movements:
        if kind == "orbit":
            view = view.orbit(x, y)
        elif kind == "pan":
            view = view.pan(x, y, ASPECT)
        elif kind == "dolly":
            view = view.dolly(x)
        else:
            view = view.framing(BOUNDS, ASPECT)
    c = view.camera(ASPECT)
    assert_rigid(c.camera_to_world)
    assert c.aspect_ratio == pytest.approx(ASPECT)
    near, far = c.clipping_range
    assert 0.0 < near < far
    if movements:
        depths = (c.camera_to_world[3, :3] - box_corners(*BOUNDS)) @ c.camera_to_world[2, :3]
        assert depths.max() < far
        ahead = depths[depths > 0.0]
        # Where the camera is inside the scene the near plane is close to it.
        assert near <= max(ahead.min(initial=np.inf), 1e-3 * np.linalg.norm(BOUNDS[1] - BOUNDS[0])) or not len(ahead)


@properties
@given(views, drags, drags)
def test_the_pivot_stays_in_its_place_when_orbiting_and_dollying(view, x, y):
    before = place_in_picture(view.camera(ASPECT), view.pivot)
    for moved in (view.orbit(x, y), view.dolly(x), view.orbit(x, y).dolly(y)):
        assert place_in_picture(moved.camera(ASPECT), moved.pivot) == pytest.approx(before, abs=1e-6)
        assert moved.pivot == pytest.approx(view.pivot)


@properties
@given(views, drags)
def test_a_turn_around_and_back(view, x):
    assume(abs(math.sin(view.roll)) < 1e-3)
    level = view.levelled()
    back = level.orbit(x, 0.0).orbit(-x, 0.0)
    assert back.camera().camera_to_world == pytest.approx(level.camera().camera_to_world, abs=1e-9)
    around = level.orbit(2.0, 0.0)
    assert around.camera().camera_to_world == pytest.approx(level.camera().camera_to_world, abs=1e-9)


@properties
@given(views, small_drags, small_drags)
def test_a_tilt_and_back(view, x, y):
    # A rolled view too, as long as neither drag reaches a pole.
    assume(abs(view.elevation) + TURN * (abs(x) + abs(y)) < 0.5 * math.pi)
    back = view.orbit(x, y).orbit(-x, -y)
    assert back.camera().camera_to_world == pytest.approx(view.orbit(0.0, 0.0).camera().camera_to_world, abs=1e-9)


@properties
@given(views, st.lists(st.tuples(drags, drags), min_size=1, max_size=6), st.sampled_from("YZ"))
def test_up_stays_up(view, movements, up_axis):
    view = OrbitCamera.from_camera(view.camera(), BOUNDS, up_axis).levelled()
    for x, y in movements:
        view = view.orbit(x, y)
        right, up, _ = view.camera().camera_to_world[:3, :3]
        axis = "XYZ".index(up_axis)
        assert abs(right[axis]) < 1e-12
        assert up[axis] > -1e-12


def test_the_poles_are_a_stop():
    view = OrbitCamera.from_camera(camera((0.0, 0.0, 10.0)), BOUNDS)
    top = view.orbit(0.0, -5.0)
    assert top.camera().camera_to_world[2, :3] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert top.orbit(0.0, -0.1).camera().camera_to_world == pytest.approx(top.camera().camera_to_world)
    # Turning there turns the picture, and leaving is towards where one looks from then.
    turned = top.orbit(0.5, 0.5)
    assert turned.camera().camera_to_world[2, :3] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)
    assert turned.camera().camera_to_world[1, :3] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_the_front_of_the_scene_follows_the_cursor():
    view = OrbitCamera.from_camera(camera((0.0, 0.0, 10.0)), (-np.ones(3), np.ones(3)))
    point = [0.0, 0.0, 1.0]
    u, v = place_in_picture(view.orbit(0.05, 0.02).camera(1.0), point)
    assert u > 0.5 and v > 0.5
    assert view.orbit(1.0, 0.0).eye == pytest.approx([0.0, 0.0, -10.0])


def test_a_rolled_picture_follows_the_cursor_too():
    quarter = rotation((0.0, 0.0, 1.0), 90.0)
    quarter[3, :3] = 0.0, 0.0, 10.0
    view = OrbitCamera.from_camera(Camera("/C", quarter), (-np.ones(3), np.ones(3)))
    assert view.roll == pytest.approx(0.5 * math.pi)
    u, v = place_in_picture(view.orbit(0.05, 0.0).camera(1.0), [0.0, 0.0, 1.0])
    assert u > 0.51 and v == pytest.approx(0.5, abs=1e-6)


@properties
@given(views, drags, drags, aspects, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_pan_moves_what_is_under_the_cursor_with_it(view, x, y, aspect, u, v):
    c = view.camera(aspect)
    # A point under the cursor, in the plane of the pivot.
    left, right, bottom, top = c.window()
    depth = -view.offset[2] if c.projection == "perspective" else 1.0
    local = np.array([(left + u * (right - left)) * depth, (bottom + v * (top - bottom)) * depth, view.offset[2]])
    point = local @ view.rotation + view.eye
    before = place_in_picture(c, point)
    after = place_in_picture(view.pan(x, y, aspect).camera(aspect), point)
    assert (after - before) * (aspect, 1.0) == pytest.approx([x, y], abs=1e-6)


@properties
@given(views, st.floats(-200.0, 200.0))
def test_a_dolly_never_passes_the_pivot_and_comes_back(view, amount):
    moved = view.dolly(amount)
    assert moved.offset[2] < 0.0 and moved.distance > 0.0
    size, new = (
        (v.distance if v.lens.projection == "perspective" else v.lens.horizontal_aperture) for v in (view, moved)
    )
    assert new <= size if amount >= 0.0 else new >= size
    if abs(amount) < 2.0:
        assert moved.dolly(-amount).camera(ASPECT).window() == pytest.approx(view.camera(ASPECT).window())
        assert moved.dolly(-amount).eye == pytest.approx(view.eye, abs=1e-6)


def test_the_wheel_is_usdviews():
    view = OrbitCamera.from_camera(camera((0.0, 0.0, 10.0)), BOUNDS)
    assert view.wheel(1.0).distance == pytest.approx(0.88 * view.distance)
    assert view.wheel(2.5).distance == pytest.approx(view.dolly(2.5 * WHEEL_STEP).distance)
    assert view.dolly(1.0).distance == pytest.approx(view.distance / 4.0)


def test_an_orthographic_dolly_changes_the_width_of_view():
    c = Camera("/C", look_at((0, 0, 9), (0, 0, 0)), "orthographic", horizontal_aperture=40.0, vertical_aperture=20.0)
    moved = OrbitCamera.from_camera(c, BOUNDS).dolly(0.5).camera()
    assert moved.horizontal_aperture == pytest.approx(20.0)
    assert moved.vertical_aperture == pytest.approx(10.0)


@properties
@given(views, aspects, st.tuples(coordinates, coordinates, coordinates), st.floats(1e-3, 100.0))
def test_framing_fits_the_sphere(view, aspect, centre, radius):
    half = radius / math.sqrt(3.0)
    framed = view.framing((np.array(centre) - half, np.array(centre) + half), aspect)
    c = framed.camera(aspect)
    assert framed.rotation == pytest.approx(view.rotation)
    assert place_in_picture(c, centre) == pytest.approx([0.5, 0.5], abs=1e-5)
    # The silhouette of the sphere, from its distance to the four planes of the view.
    left, right, bottom, top = c.window()
    local = framed.rotation @ (np.array(centre) - c.camera_to_world[3, :3])
    gaps = []
    for axis, edge, sign in ((0, left, 1.0), (0, right, -1.0), (1, bottom, 1.0), (1, top, -1.0)):
        if c.projection == "perspective":
            gaps.append(sign * (local[axis] + edge * local[2]) / math.hypot(1.0, edge))
        else:
            gaps.append(sign * (local[axis] - edge))
    assert min(gaps) / radius == pytest.approx(FRAMING_MARGIN, rel=1e-4)


def test_framing_without_an_extent_centres():
    view = OrbitCamera.from_camera(camera((0.0, 0.0, 10.0)), BOUNDS)
    framed = view.framing((np.full(3, 5.0), np.full(3, 5.0)), ASPECT)
    assert framed.distance == pytest.approx(view.distance)
    assert framed.pivot.tolist() == [5.0, 5.0, 5.0]
    assert view.framing(None, ASPECT).pivot == pytest.approx(0.5 * (BOUNDS[0] + BOUNDS[1]))


@properties
@given(stage_cameras(), st.sampled_from("YZ"))
def test_a_camera_of_the_stage_is_shown_as_it_is_until_it_moves(c, up_axis):
    view = OrbitCamera.from_camera(framing_camera(SceneDescription()), BOUNDS, up_axis).looking_through(c)
    assert view.camera() is c
    fitted = view.camera(ASPECT)
    assert fitted.camera_to_world is c.camera_to_world and fitted.clipping_range == c.clipping_range
    # The first movement starts from there: same lens, same roll, no jump.
    moved = view.pan(0.0, 0.0, ASPECT).camera(ASPECT)
    assert moved.path == ""
    assert moved.window() == fitted.window()
    assert moved.camera_to_world[:3, :3] == pytest.approx(c.camera_to_world[:3, :3], abs=1e-7)
    if c.projection == "perspective":
        assert moved.camera_to_world[3] == pytest.approx(c.camera_to_world[3], abs=1e-6)


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_camera_that_looks_straight_down_or_up(up_axis, sign):
    up = np.eye(3)["XYZ".index(up_axis)]
    for degrees in (0.0, 37.0, 180.0, -90.0):
        side = np.roll(up, 1)
        matrix = look_at(tuple(sign * 10.0 * up), (0.0, 0.0, 0.0), tuple(side)) @ rotation(tuple(up), degrees)
        view = OrbitCamera.from_camera(Camera("/C", matrix), BOUNDS, up_axis)
        assert view.pan(0.0, 0.0, 1.0).camera().camera_to_world == pytest.approx(matrix, abs=1e-9)
        assert view.roll == 0.0
        assert_rigid(view.orbit(0.3, 0.2).camera().camera_to_world)


@properties
@given(views, st.tuples(coordinates, coordinates, coordinates))
def test_another_pivot_does_not_move_the_picture(view, point):
    about = view.pan(0.0, 0.0, ASPECT).about(np.array(point))
    assert about.rotation == pytest.approx(view.rotation)
    assert about.eye == pytest.approx(view.eye, abs=1e-9)
    if about.pivot.tolist() == list(point):
        assert about.offset[2] < 0.0
    else:
        assert (np.array(point) - view.eye) @ view.rotation[2] > -1e-5


@properties
@given(views, drags, drags, st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.floats(0.3, 3.0))
def test_a_pivot_anywhere_in_the_picture_stays_there(view, x, y, u, v, nearer):
    left, right, bottom, top = view.camera(ASPECT).window()
    depth = nearer * -view.offset[2]
    scale = depth if view.lens.projection == "perspective" else 1.0
    local = np.array([(left + u * (right - left)) * scale, (bottom + v * (top - bottom)) * scale, -depth])
    point = local @ view.rotation + view.eye
    about = view.about(point)
    assert about.pivot == pytest.approx(point)
    assert about.unmoved is view.unmoved
    for moved in (about.orbit(x, y), about.dolly(x), about.dolly(y).orbit(y, x).dolly(x)):
        assert place_in_picture(moved.camera(ASPECT), point) == pytest.approx([u, v], abs=1e-6)


@properties
@given(views, drags, drags)
def test_a_saved_camera_renders_identically(view, x, y):
    shown = view.orbit(x, y).dolly(y).camera(ASPECT)
    # The renderer conforms the aspect of what it gets; a saved record comes back with float64 values unchanged.
    saved = replace(shown, path="/Saved")
    description = SceneDescription()
    kept = camera_rays(shown, np.zeros(3), description, (0.0, 0.0))
    again = camera_rays(saved.conformed(ASPECT), np.zeros(3), description, (0.0, 0.0))
    assert again.view_projection == pytest.approx(kept.view_projection, rel=1e-12, abs=1e-12)
    reopened = OrbitCamera.from_camera(saved, BOUNDS)
    assert reopened.camera(ASPECT).window() == pytest.approx(shown.window(), rel=1e-12, abs=1e-12)


@properties
@given(views, drags, drags)
def test_the_state_survives_json(view, x, y):
    view = view.orbit(x, y).pan(y, x, ASPECT)
    again = OrbitCamera.from_camera(camera((0, 0, 9)), BOUNDS, view.up_axis).restored(
        json.loads(json.dumps(view.state()))
    )
    assert again.camera(ASPECT).parts() == view.camera(ASPECT).parts()


@pytest.mark.parametrize(
    "change",
    [
        {"pivot": [0, 0]},
        {"pivot": [math.nan, 0, 0]},
        {"film": [50, 0, 1, 0, 0]},
        {"film": None},
        {"offset": [0, 0, 1]},
        {"projection": "fisheye"},
        {"angles": "x"},
    ],
)
def test_a_state_that_is_none_is_refused(change):
    view = OrbitCamera.from_camera(camera((0, 0, 9)), BOUNDS)
    with pytest.raises(ValueError, match="not the state of a view"):
        view.restored(view.state() | change)
    with pytest.raises(ValueError, match="not the state of a view"):
        view.restored({})


def test_scenes_without_or_with_broken_bounds():
    for bounds in (None, (np.full(3, np.inf), np.full(3, -np.inf)), (np.zeros(3), np.zeros(3))):
        view = OrbitCamera.from_camera(camera((0.0, 0.0, 10.0)), bounds)
        for moved in (view.orbit(0.1, 0.1), view.dolly(1.0), view.framing(None, 1.0), view.with_bounds(BOUNDS)):
            assert_rigid(moved.camera(1.0).camera_to_world)
            near, far = moved.camera(1.0).clipping_range
            assert 0.0 < near < far < np.inf


def test_named_directions():
    view = OrbitCamera.from_camera(camera((3.0, 4.0, 10.0)), BOUNDS)
    assert view.turned_to(0.0, 0.0).rotation == pytest.approx(np.eye(3))
    assert view.turned_to(0.5 * math.pi, 0.0).rotation[2] == pytest.approx([1.0, 0.0, 0.0])
    z_up = OrbitCamera.from_camera(camera((3.0, 4.0, 10.0)), BOUNDS, "Z")
    assert z_up.turned_to(0.0, 0.0).rotation == pytest.approx(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))

"""Lists of lights by place: nothing that a light reaches may be missing."""

import numpy as np
import pytest
from building import camera, distant, point, scene, spot

from previs.description import Light, Shaping
from previs.render.light_lists import MOST_INDICES, light_lists, reached_balls, reached_rectangle, reaches_box
from previs.render.projection import camera_rays


def lit(light: Light, points: np.ndarray) -> np.ndarray:
    """Whether a light shines on points, by its angles: (N,) bool."""
    to_point = points - light.position
    cosine = to_point @ light.direction / np.linalg.norm(to_point, axis=1)
    found = np.ones(len(points), bool)
    if light.shaping is not None:
        found &= np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) < light.shaping.cone_angle
    if light.kind in ("disk", "rect"):
        found &= cosine > 0.0
    return found


@pytest.mark.parametrize("kind", ["sphere", "disk"])
@pytest.mark.parametrize("angle", [0.5, 8.0, 45.0, 89.0, 91.0, 140.0, 179.0])
def test_a_ball_with_a_lit_point_is_reached(angle: float, kind: str):
    random = np.random.default_rng(int(angle))
    reached = 0
    for _ in range(60):
        place, target, centre = random.normal(size=(3, 3))
        light = spot(tuple(place), tuple(target), shaping=Shaping(cone_angle=angle), kind=kind)
        radius = random.uniform(0.05, 1.5)
        points = random.normal(size=(4000, 3))
        points *= radius * random.uniform(0.0, 1.0, (4000, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1)[:, None]
        found = bool(reached_balls(light, centre[None], radius)[0])
        assert found or not lit(light, centre + points).any()
        reached += found
    assert 0 < reached
    if angle < 10.0:
        assert reached < 60, "nothing is culled"


def test_what_a_narrow_spot_misses_is_not_reached():
    light = spot((0, 5, 0), (0, 0, 0), shaping=Shaping(cone_angle=5.0))
    assert reaches_box(light, np.full(3, -1.0), np.full(3, 1.0))
    assert not reaches_box(light, np.array([1.0, -1.0, 1.0]), np.array([2.0, 1.0, 2.0]))
    assert not reaches_box(light, np.array([-1.0, 6.0, -1.0]), np.array([1.0, 7.0, 1.0])), "behind it"


@pytest.mark.parametrize("light", [distant((0, -1, 0)), point((9, 9, 9))])
def test_lights_without_a_cone_reach_everything(light: Light):
    assert reaches_box(light, np.full(3, -1.0), np.full(3, 1.0))


def spots(count: int, angle: float) -> list[Light]:
    random = np.random.default_rng(7)
    shaping = Shaping(cone_angle=angle)
    return [
        spot((x, 3, z), (x, 0, z), shaping=shaping, path=f"/S{i}")
        for i, (x, z) in enumerate(random.uniform(-1, 1, (count, 2)))
    ]


def test_lists_hold_every_light_that_reaches_a_place():
    lights = spots(120, 5.0)
    lo, hi = np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0])
    lists = light_lists(lights, lo, hi, 0.01)
    assert lists is not None and len(lists.lights) == lists.count.sum() <= MOST_INDICES
    places = np.random.default_rng(3).uniform(lo, hi, (2000, 3))
    x, y, z = np.minimum(((places - lo) / (hi - lo) * lists.cells).astype(int), lists.cells - 1).T
    cells = (z * lists.cells + y) * lists.cells + x
    held = np.zeros((len(places), len(lights)), bool)
    for row, cell in zip(held, cells, strict=True):
        row[lists.lights[lists.first[cell] : lists.first[cell] + lists.count[cell]]] = True
    needed = np.stack([lit(light, places) for light in lights], axis=1)
    assert needed.any() and not (needed & ~held).any()
    assert held.mean() < 0.3 and lists.longest < len(lights)


def test_there_are_no_lists_where_they_leave_out_little():
    lo, hi = np.full(3, -1.0), np.full(3, 1.0)
    assert light_lists(spots(4, 5.0), lo, hi, 0.0) is None, "few lights"
    assert light_lists(spots(20, 80.0), lo, hi, 0.0) is None, "wide ones"


def test_the_part_of_the_picture_that_a_light_reaches():
    lo, hi = np.array([-2.0, -0.1, -2.0]), np.array([2.0, 0.1, 2.0])
    rays = camera_rays(camera((0, 4, 4), degrees=60), np.zeros(3), scene(), (0.0, 0.0))
    size = (160, 90)
    random = np.random.default_rng(5)
    points = random.uniform(lo, hi, (20000, 3))
    clip = points @ rays.view_projection[:3] + rays.view_projection[3]
    places = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * size
    shown = ((places >= 0) & (places < size)).all(axis=1)
    for x, z in random.uniform(-2, 2, (20, 2)):
        light = spot((x, 3, z), (x, 0, z), shaping=Shaping(cone_angle=6.0))
        inside = places[lit(light, points) & shown]
        rectangle = reached_rectangle(light, lo, hi, rays.view_projection, size)
        if rectangle is None:
            assert not len(inside)
            continue
        left, bottom, width, height = rectangle
        assert width * height < 0.5 * size[0] * size[1]
        assert ((inside >= (left, bottom)) & (inside < (left + width, bottom + height))).all()
    away = spot((0, 3, 0), (0, 9, 0), shaping=Shaping(cone_angle=6.0))
    assert reached_rectangle(away, lo, hi, rays.view_projection, size) is None
    assert reached_rectangle(point((0, 3, 0)), lo, hi, rays.view_projection, size) == (0, 0, 160, 90)

"""Rectangles around what can be seen: nothing is left out, nothing is drawn twice."""

import numpy as np
import pytest
from building import box, camera, orthographic_camera, scene

from previs.description import Medium
from previs.render.covered import common, covered_boxes
from previs.render.projection import camera_rays

SIZE = (317, 203)
CAMERAS = {
    "perspective": camera((3.0, 2.0, 6.0), (0, 0, 0)),
    "orthographic": orthographic_camera((3.0, 2.0, 6.0), (0, 0, 0)),
}


def view_projection(name: str) -> np.ndarray:
    around = scene(box(Medium(), (-9, -9, -9), (9, 9, 9)))
    return camera_rays(CAMERAS[name].conformed(SIZE[0] / SIZE[1]), np.zeros(3), around, (0.0, 0.0)).view_projection


def projected(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    clip = points @ matrix[:3] + matrix[3]
    return (0.5 * clip[:, :2] / clip[:, 3:] + 0.5) * SIZE


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("seed", range(5))
def test_every_point_of_every_sphere_is_covered_once(name: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix = view_projection(name)
    centres, radius = random.uniform(-1.5, 1.5, (30, 3)), 0.2
    boxes = covered_boxes([(centres[:20], radius), (centres[20:], radius)], matrix, SIZE)
    assert boxes
    counts = np.zeros(SIZE[::-1], int)
    for x, y, width, height in boxes:
        assert width > 0 and height > 0
        counts[y : y + height, x : x + width] += 1
    assert counts.max() == 1
    directions = random.normal(size=(30, 200, 3))
    surface = centres[:, None] + radius * directions / np.linalg.norm(directions, axis=2, keepdims=True)
    pixels = np.floor(projected(surface.reshape(-1, 3), matrix)).astype(int)
    seen = pixels[(pixels >= 0).all(axis=1) & (pixels < SIZE).all(axis=1)]
    assert len(seen) > 100
    assert (counts[seen[:, 1], seen[:, 0]] == 1).all()
    assert counts.mean() < 0.9


def test_a_sphere_around_the_camera_is_everywhere() -> None:
    matrix = view_projection("perspective")
    assert covered_boxes([(np.array([[3.0, 2.0, 6.0]]), 0.5)], matrix, SIZE) is None


def test_what_is_beside_the_picture_is_nowhere() -> None:
    matrix = view_projection("orthographic")
    assert covered_boxes([(np.array([[500.0, 0.0, 0.0]]), 0.5)], matrix, SIZE) == []
    assert covered_boxes([(np.zeros((0, 3)), 0.5)], matrix, SIZE) == []


def test_common_parts() -> None:
    assert common(None, (1, 2, 3, 4)) == (1, 2, 3, 4)
    assert common((0, 0, 5, 5), (3, 4, 10, 10)) == (3, 4, 2, 1)
    assert common((0, 0, 5, 5), (5, 0, 1, 1)) is None

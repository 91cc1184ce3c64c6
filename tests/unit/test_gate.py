"""A camera's aperture in a view of another shape."""

import numpy as np
import pytest

from previs.description import Camera
from previs.ui.gate import fitted


@pytest.mark.parametrize("aspect", (0.4, 1.0, 36 / 24, 16 / 9, 4.0))
@pytest.mark.parametrize("projection", ("perspective", "orthographic"))
def test_all_of_the_aperture_is_seen_where_the_gate_says(aspect, projection):
    camera = Camera(
        "/cam",
        np.eye(4),
        projection,
        horizontal_aperture=36.0,
        vertical_aperture=24.0,
        horizontal_aperture_offset=3.0,
        vertical_aperture_offset=-2.0,
    )
    wide, (left, top, right, bottom) = fitted(camera, aspect)
    assert wide.aspect_ratio == pytest.approx(aspect)
    l0, r0, b0, t0 = camera.window()
    l1, r1, b1, t1 = wide.window()
    assert l1 + left * (r1 - l1) == pytest.approx(l0)
    assert l1 + right * (r1 - l1) == pytest.approx(r0)
    assert t1 - top * (t1 - b1) == pytest.approx(t0)
    assert t1 - bottom * (t1 - b1) == pytest.approx(b0)
    assert min(left, top) >= 0.0 and max(right, bottom) <= 1.0
    assert min(left, top) == pytest.approx(0.0)


def test_a_view_without_a_shape_is_refused():
    with pytest.raises(ValueError, match="aspect_ratio"):
        fitted(Camera("/cam", np.eye(4)), 0.0)

"""Angles and reaches of lights."""

import numpy as np
import pytest

from previs import Scene
from previs.ui import placing


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
@pytest.mark.parametrize("elevation", [-89.9, -30.0, 0.0, 12.5, 89.9])
@pytest.mark.parametrize("azimuth", [-179.0, -90.0, 0.0, 33.0, 180.0])
def test_angles_and_direction_are_inverse(up_axis, elevation, azimuth):
    direction = placing.direction(elevation, azimuth, up_axis)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert placing.angles(direction, up_axis) == pytest.approx((elevation, azimuth), abs=1e-9)


def test_angles_say_where_light_comes_from():
    assert placing.angles((0.0, -1.0, 0.0), "Y")[0] == pytest.approx(90.0)
    assert placing.angles((0.0, 0.0, -1.0), "Z")[0] == pytest.approx(90.0)
    assert placing.angles((0.0, 0.0, -1.0), "Y") == pytest.approx((0.0, 0.0))
    assert placing.angles((0.0, 1.0, 0.0), "Z") == pytest.approx((0.0, 0.0))
    for up_axis in "YZ":
        assert placing.angles((-1.0, 0.0, 0.0), up_axis) == pytest.approx((0.0, 90.0))


def test_a_light_is_always_inside_its_reach():
    low, high = placing.reach(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 2.0]]), (50.0, 1.0, -0.5))
    np.testing.assert_allclose(low, (-3.0, -3.0, -3.0))
    np.testing.assert_allclose(high, (50.0, 5.0, 5.0))
    low, high = placing.reach(None, (1.0, 2.0, 3.0))
    assert (low < (1.0, 2.0, 3.0)).all() and (high > (1.0, 2.0, 3.0)).all()


def test_light_values_say_where_the_light_is():
    with Scene() as scene:
        scene.add_spot_light("/Spot", position=(1, 2, 3), target=(1, 2, -1))
        scene.set_light("/Spot", direction=placing.direction(30.0, 60.0, "Y"))
        values = scene.light_values("/Spot")
    assert values.position == pytest.approx((1.0, 2.0, 3.0))
    assert placing.angles(values.direction, "Y") == pytest.approx((30.0, 60.0))

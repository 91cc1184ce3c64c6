"""How many slices a plan takes: within the device, finer where voxels are deep, and said where they are few."""

import dataclasses

import numpy as np
from building import camera, distant, index_of, scene, smooth_noise, volume

from previs import Medium, Settings
from previs.render.plan import make_plan
from previs.render.planned import DeviceLimits

SUN = distant((0.0, -1.0, 0.2))


def plan_of(values: np.ndarray, extinction: float = 1.0, limits: DeviceLimits | None = None, **settings):
    index = index_of(scene(volume(values, Medium(extinction=(extinction,) * 3)), SUN))
    return make_plan(index, camera((0.0, 0.0, 5.0)), 32, 18, Settings(**settings), limits=limits or DeviceLimits())


def test_no_more_slices_than_a_3d_texture_is_long() -> None:
    small = dataclasses.replace(DeviceLimits(), texture_3d_size=256)
    assert plan_of(np.ones((4, 4, 4)), slices=1000, limits=small).map_slices == 252
    assert plan_of(np.ones((4, 4, 4)), slices=1000).map_slices == 1008


def test_deep_voxels_take_more_even_in_a_small_grid() -> None:
    thin, deep = (plan_of(smooth_noise((12, 12, 12)), extinction) for extinction in (1.0, 1000.0))
    assert deep.map_slices == 2 * thin.map_slices and deep.map_size == 2 * thin.map_size


def test_few_slices_for_many_voxels_are_said() -> None:
    long = np.ones((700, 2, 2))
    said = [n for n in plan_of(long).notes if "depths for 700 voxels" in n.message]
    assert len(said) == 1 and said[0].kind == "approximated"
    for plan in (plan_of(long, slices=112), plan_of(np.ones((300, 2, 2))), plan_of(long, transmittance="quantile")):
        assert not [n for n in plan.notes if "depths for" in n.message]

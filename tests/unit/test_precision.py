"""Every note on precision: a medium that provokes it, and one short of it that does not."""

import re

import numpy as np
import pytest
from building import box, camera, distant, index_of, scaling, scene, sphere, volume

from previs import Medium, Settings
from previs.render.plan import make_plan

SUN = distant((0, -1, 0))
VIEW = camera((0.0, 0.0, 6.0))
SOLID = r"an optical depth of up to .* across; positions of 32 bits"
SPAN = r"its densities span .* to 1; half floats round those below"
VOXEL = r"an optical depth of up to .* in a voxel; light on such a surface is as fine as a texel"
FULL_RANGE = r"an optical depth of up to .* across; tfm-plain blurs light in it, tfm and quantile do not"


def grey(extinction: float) -> Medium:
    return Medium(extinction=(extinction,) * 3)


def messages(held, **settings) -> list[str]:
    """What a plan says of the only volume."""
    made = make_plan(index_of(scene(held, SUN)), VIEW, 16, 9, Settings(**settings))
    for note in made.notes:
        assert (note.kind, note.path) == ("approximated", held.path)
    return [note.message for note in made.notes]


def said(found: list[str], pattern: str) -> bool:
    return any(re.match(pattern, message) for message in found)


def ramp(least: float) -> np.ndarray:
    """Densities from `least` to 1, in equal ratios."""
    return np.geomspace(least, 1.0, 512).reshape(8, 8, 8)


def test_an_ordinary_medium_is_not_spoken_of() -> None:
    for held in (box(grey(1.0)), sphere(grey(1e3)), volume(ramp(1e-2), grey(10.0))):
        assert messages(held) == []


@pytest.mark.parametrize("make", [lambda m: box(m), lambda m: volume(np.ones((8, 8, 8)), m)], ids=["shape", "voxels"])
def test_what_is_solid(make) -> None:
    """From an optical depth of 2·10⁵ across the bounds, 2√3 of a cube from −1 to 1."""
    limit = 2e5 / (2.0 * 3.0**0.5)
    assert said(messages(make(grey(1.1 * limit))), SOLID)
    assert not said(messages(make(grey(0.9 * limit))), SOLID)


def test_solid_in_one_channel_is_solid() -> None:
    assert said(messages(box(Medium(extinction=(1.0, 1.0, 1e6)))), SOLID)


def test_a_larger_body_is_deeper() -> None:
    assert not said(messages(box(grey(1e3))), SOLID)
    assert said(messages(box(grey(1e3), local_to_world=scaling(100.0, 100.0, 100.0))), SOLID)


def test_densities_that_half_floats_lose() -> None:
    """Small ones, in a medium so deep that what is lost of them adds up."""
    assert said(messages(volume(ramp(1e-6), grey(1e4))), SPAN)
    assert not said(messages(volume(ramp(1e-4), grey(1e4))), SPAN)
    # Next to nothing is lost of a thin medium.
    assert not said(messages(volume(ramp(1e-6), grey(10.0))), SPAN)


def test_an_empty_voxel_is_not_a_small_density() -> None:
    values = ramp(1e-2)
    values[:4] = 0.0
    assert not said(messages(volume(values, grey(1e4))), SPAN)


def test_a_voxel_that_is_opaque() -> None:
    """An optical depth of 100 in a voxel of a cube of side 2 that 7 voxels and a margin of one at each end span."""
    limit = 100.0 / (2.0 / 8.0)
    assert said(messages(volume(np.ones((7, 7, 7)), grey(1.1 * limit))), VOXEL)
    assert not said(messages(volume(np.ones((7, 7, 7)), grey(0.9 * limit))), VOXEL)
    # A march has no texels, a shape no voxels.
    assert not said(messages(volume(np.ones((7, 7, 7)), grey(1.1 * limit)), transmittance="march"), VOXEL)
    assert not said(messages(box(grey(1.1 * limit))), VOXEL)


def test_cosines_over_the_full_range_of_a_dense_medium() -> None:
    limit = 30.0 / (2.0 * 3.0**0.5)
    dense, thin = (volume(np.ones((8, 8, 8)), grey(part * limit)) for part in (1.1, 0.9))
    assert said(messages(dense, transmittance="tfm-plain"), FULL_RANGE)
    assert not said(messages(thin, transmittance="tfm-plain"), FULL_RANGE)
    for name in ("slices", "tfm", "quantile", "march"):
        assert not said(messages(dense, transmittance=name), FULL_RANGE)


def test_the_peak_counts_and_not_only_the_extinction() -> None:
    assert said(messages(volume(np.full((7, 7, 7), 1e4), grey(1.0))), VOXEL)
    assert not said(messages(volume(np.full((7, 7, 7), 1e-4), grey(1e4))), VOXEL)

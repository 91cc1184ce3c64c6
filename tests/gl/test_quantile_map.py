"""Maps of quantiles, texel by texel: what is stored against the definition, and the curve between the values."""

from dataclasses import dataclass

import numpy as np
import pytest
from building import camera, distant, index_of, point, rotation, scene, smooth_noise, volume
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

import previs
from previs import Medium, Settings
from previs.bench.reference_scene import reference_scene
from previs.description import Light, Volume
from previs.render.probe import probe

pytestmark = pytest.mark.gl

SIZE = 16
STEPS = 1024
VIEW = camera((0.0, 0.0, 6.0))
TURNED = rotation((0.3, 1.0, 0.2), 35.0)
NOISE = smooth_noise((14, 16, 12), seed=3)
ALONG_X = distant((1.0, 0.0, 0.0), path="/Light")
#: Optical depth that may lie before the range begins.
LEFT_OUT = 0.001


def grey(extinction: float) -> Medium:
    return Medium(extinction=(extinction,) * 3)


@dataclass(frozen=True)
class Filled:
    """A map as it was filled. Rows of texels; distances along a texel's ray count from `origins` (world).

    `places` are in [0, 1] of the range, (T, COEFFICIENTS − 1); gap as the distance behind `begin`, and its length.
    """

    origins: np.ndarray
    directions: np.ndarray
    places: np.ndarray
    tail: np.ndarray
    total: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    gap_begin: np.ndarray
    gap_length: np.ndarray
    weighting: float
    stored: float
    end_depth: float
    stretched: bool
    column: object

    @property
    def used(self) -> np.ndarray:
        """Texels whose ray meets any density."""
        return self.begin < 1e29

    def distances(self) -> np.ndarray:
        """Where the curve crosses the levels, (T, COEFFICIENTS − 1): places with the gap put back."""
        length = (self.end - self.begin - self.gap_length)[:, None]
        behind = self.places * length
        return self.begin[:, None] + behind + np.where(behind > self.gap_begin[:, None], self.gap_length[:, None], 0.0)

    def depth(self, distance: np.ndarray) -> np.ndarray:
        """Stored optical depth, exact, at distances (T,) or (T, N)."""
        shape = distance.shape
        distance = distance.reshape(len(self.origins), -1)
        rays = np.repeat(np.arange(len(self.origins)), distance.shape[1])
        flat = np.clip(distance.reshape(-1), 0.0, 100.0)
        found = self.column(self.origins[rays], self.directions[rays], np.zeros(len(flat)), flat)
        return self.stored * found.reshape(shape)

    def levels(self) -> np.ndarray:
        """Stored optical depths of the levels, (T, COEFFICIENTS − 1): of evenly spaced values of the curve."""
        count = self.places.shape[1] + 1
        root = np.sqrt(self.total) if self.stretched else self.total
        level = 1.0 - (1.0 - np.exp(-root))[:, None] * np.arange(1, count) / count
        return np.log(level) ** 2 if self.stretched else -np.log(level)


def octahedral(uv: np.ndarray) -> np.ndarray:
    p = 2.0 * uv - 1.0
    z = 1.0 - np.abs(p).sum(axis=1)
    folded = (1.0 - np.abs(p[:, ::-1])) * np.where(p >= 0.0, 1.0, -1.0)
    d = np.column_stack([np.where(z[:, None] < 0.0, folded, p), z])
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def filled(renderer: previs.Renderer, held: Volume, light: Light, **knobs) -> Filled:
    settings = Settings(**{"transmittance": "quantile", "steps": 4, "light_steps": STEPS, "map_size": SIZE, **knobs})
    description = scene(held, light)
    plan = renderer.plan(index_of(description), VIEW, 4, 3, settings)
    renderer.draw(plan)
    (item,) = plan.maps
    maps, fit = renderer._frame.maps, item.fit
    x, y = plan.map_atlas.corner(item.tile)

    def read(texture, dtype) -> np.ndarray:
        whole = np.frombuffer(texture.read(), dtype).reshape(texture.height, texture.width, 4)
        return whole[y : y + SIZE, x : x + SIZE].reshape(-1, 4).astype(float)

    with renderer.context:
        values = np.concatenate([read(t, np.float16) for t in maps.values], axis=1)
        begin, end, gap_begin, gap_length = read(maps.range, np.float32).T
    count = settings.coefficients
    rows, columns = np.mgrid[:SIZE, :SIZE]
    uv = (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) / SIZE
    if fit.kind == "octahedral":
        directions = octahedral(uv)
        origins = np.broadcast_to(-fit.from_light, directions.shape)
    else:
        affine = np.column_stack([np.ones(len(uv)), uv])
        origins, directions = affine @ fit.ray_origin, affine @ fit.ray_direction
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    # Stored distances count from that of the centre; here they count from before the volume.
    if fit.kind == "orthographic":
        start = origins - (origins @ fit.from_light + 10.0)[:, None] * directions
        shift = 10.0
    else:
        start = np.broadcast_to(-fit.from_light, directions.shape)
        shift = np.linalg.norm(fit.from_light)
    (medium,) = reference_scene(description).volumes
    strongest, weakest = max(held.medium.strength), min(s for s in held.medium.strength if s > 0.0)
    stored = strongest / item.weighting
    return Filled(
        start + fit.centre,
        directions,
        values[:, : count - 1],
        values[:, count],
        values[:, count + 1],
        begin + shift,
        end + shift,
        gap_begin,
        gap_length,
        item.weighting,
        stored,
        -np.log(item.threshold) * stored / weakest,
        item.stretched,
        medium.density.column,
    )


CASES = {
    "sun": (volume(NOISE, grey(3.0), TURNED), distant((-1.0, -0.7, -0.4)), {}),
    "dense": (volume(NOISE, grey(60.0), TURNED), distant((-1.0, -0.7, -0.4)), {}),
    "two values": (volume(NOISE, grey(10.0), TURNED), distant((-1.0, -0.7, -0.4)), {"coefficients": 2}),
    "sixteen values": (volume(NOISE, grey(10.0), TURNED), distant((-1.0, -0.7, -0.4)), {"coefficients": 16}),
    "lamp": (volume(NOISE, grey(3.0), TURNED), point((1.5, 2.5, 1.0)), {}),
    "lamp inside": (volume(NOISE, grey(20.0), TURNED), point((0.2, 0.1, 0.0)), {"coefficients": 14}),
    "stretched": (volume(NOISE, Medium(extinction=(0.3, 3.0, 30.0)), TURNED), distant((-1.0, -0.7, -0.4)), {}),
    "gap": (
        volume(np.where(np.abs(np.linspace(-1, 1, 24)) > 0.5, 1.0, 0.0)[:, None, None] * np.ones((1, 8, 8)), grey(2.0)),
        ALONG_X,
        {"coefficients": 10},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_values_are_the_places_of_the_levels(renderer: previs.Renderer, name: str) -> None:
    """The exact curve at the stored places has the value of the level, in every texel."""
    held, light, knobs = CASES[name]
    found = filled(renderer, held, light, **knobs)
    used = found.used
    assert used.mean() > 0.2
    assert found.stretched == (name == "stretched")
    assert (found.gap_length[used].max() > 0.5) == (name == "gap")
    exact, levels = found.depth(found.distances())[used], found.levels()[used]
    # Places are half floats, and steps of the march are straight.
    np.testing.assert_allclose(np.exp(-exact), np.exp(-levels), atol=6e-3)
    assert np.sqrt(np.mean((np.exp(-exact) - np.exp(-levels)) ** 2)) < 1e-3


@pytest.mark.parametrize("name", CASES)
def test_places_rise_within_the_range(renderer: previs.Renderer, name: str) -> None:
    held, light, knobs = CASES[name]
    found = filled(renderer, held, light, **knobs)
    stored = found.places[found.used]
    places = np.column_stack([np.zeros(len(stored)), stored, np.ones(len(stored))])
    assert np.all(np.diff(places, axis=1) >= 0.0)
    assert np.all(found.tail >= 0.0)
    assert np.all(np.isfinite(places))


@pytest.mark.parametrize("name", CASES)
def test_a_range_is_where_the_curve_falls(renderer: previs.Renderer, name: str) -> None:
    """From where next to nothing is lost to the threshold, or to where density ends."""
    held, light, knobs = CASES[name]
    found = filled(renderer, held, light, **knobs)
    used = found.used
    step = 2.0 * 3.0**0.5 * 1.2 / STEPS
    whole = found.depth(np.full(len(used), 100.0))
    # A texel whose ray only grazes the volume may be left out.
    assert np.all(whole[~used] < 1e-3)
    least = LEFT_OUT / found.weighting
    assert found.depth(found.begin)[used].max() <= 1.2 * least
    later = found.depth(found.begin + 3.0 * step)[used]
    assert np.all((later >= 0.5 * least) | (whole[used] < 4.0 * least))
    total = np.minimum(whole, found.end_depth)[used]
    # A total is a half float.
    np.testing.assert_allclose(found.total[used], total, rtol=5e-3, atol=2e-3)
    np.testing.assert_allclose(np.exp(-found.depth(found.end)[used]), np.exp(-total), atol=4e-3)
    assert np.any(whole > found.end_depth) == (name in ("dense", "two values", "sixteen values"))


def test_a_slab_has_exact_depths(renderer: previs.Renderer) -> None:
    """Along the axis of a homogeneous block depths are logarithms: (−ln level / σ), behind half a voxel of margin."""
    held = volume(np.ones((30, 6, 6)), grey(3.0))
    for count in (2, 6, 14):
        found = filled(renderer, held, ALONG_X, coefficients=count, density_weighting=1.0, threshold=1e-6)
        voxel = 2.0 / 31.0
        # The margin's ramp from 0 to 1 is worth half of it; at both ends.
        total = 3.0 * (2.0 - voxel)
        middle = np.all(np.abs(found.origins[:, 1:]) < 0.5, axis=1)
        assert middle.sum() > 16
        levels = 1.0 - (1.0 - np.exp(-total)) * np.arange(1, count) / count
        # Rays start 10 before the centre, and the block 1.
        expected = 9.0 + 0.5 * voxel - np.log(levels) / 3.0
        np.testing.assert_allclose(found.total[middle], total, rtol=1e-3)
        np.testing.assert_allclose(
            found.distances()[middle], np.broadcast_to(expected, (middle.sum(), count - 1)), atol=2e-3
        )


def test_a_gap_is_left_out(renderer: previs.Renderer) -> None:
    """Between two slabs nothing is lost, and so it takes no part of the range; a medium without a gap has none."""
    held, light, knobs = CASES["gap"]
    found = filled(renderer, held, light, **knobs)
    used = found.used
    assert np.all(found.gap_length[used] > 0.8)
    before = found.depth(found.begin + found.gap_begin)[used]
    behind = found.depth(found.begin + found.gap_begin + found.gap_length)[used]
    np.testing.assert_allclose(before, behind, atol=1e-6)
    solid = filled(renderer, *CASES["sun"][:2])
    assert not solid.gap_length[solid.used].any()


def along(renderer: previs.Renderer, row: list[float], extinction: float, count: int):
    """The curve that a map of `count` values gives through a row of voxels, and that of a fine march."""
    held = volume(np.array(row)[:, None, None] * np.ones((1, 4, 4)), grey(extinction), path="/Cloud")
    knobs = Settings(transmittance="quantile", coefficients=count, map_size=SIZE, light_steps=STEPS)
    found = probe(renderer, index_of(scene(held, ALONG_X)), knobs, "/Light", np.zeros(3), 400)
    return found, next(c for c in found.curves if c.coefficients == count)


@given(
    st.lists(st.one_of(st.just(0.0), st.floats(0.01, 1.0)), min_size=3, max_size=16).filter(any),
    st.floats(0.1, 200.0),
    st.sampled_from([2, 6, 14]),
)
@hypothesis_settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_curves_fall_and_stay_between_the_levels(renderer, row: list[float], extinction: float, count: int) -> None:
    """Whatever the density: monotone, within [0, 1], and off by no more than one level, because nothing rings."""
    found, curve = along(renderer, row, extinction, count)
    transmittance, truth = curve.transmittance[:, 0], found.march.transmittance[:, 0]
    assert transmittance.min() >= 0.0
    assert transmittance.max() <= 1.0
    assert np.diff(transmittance).max() <= 1e-6
    # Levels are evenly spaced in T^(1/1.5); half floats and steps add a little.
    assert np.abs(transmittance ** (1 / 1.5) - truth ** (1 / 1.5)).max() <= 1.0 / count + 0.02


@pytest.mark.parametrize("count", [2, 6, 14])
def test_a_slab_is_exact_between_its_values(renderer: previs.Renderer, count: int) -> None:
    """Optical depth is interpolated: it is a straight line in a homogeneous medium."""
    found, curve = along(renderer, [1.0] * 300, 1.5, count)
    np.testing.assert_allclose(curve.transmittance, found.march.transmittance, atol=5e-3)

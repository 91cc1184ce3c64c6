"""Marching fewer pixels: what lies between them is that of the whole march, edges of surfaces are sharp, and the meter
counts what is off."""

from collections.abc import Iterator

import numpy as np
import pytest
from building import box, box_mesh, camera, distant, index_of, point, scene, smooth_noise, spot, volume

import previs
from previs import Medium, Settings, metrics
from previs.render import draws
from previs.render.measure import ErrorMeter, brute_force, converged

pytestmark = pytest.mark.gl

NOISE = smooth_noise((12, 12, 12))
VIEW = camera((0.5, 1.0, 6.0))
SIZE = (97, 54)
QUICK = Settings(steps=24, light_steps=24, shadow_map_size=128, map_size=32, coefficients=4, error_pixels=256)
SUN = distant((0.1, -1.0, 0.2), (3.0, 3.0, 3.0))
LAMPS = [point((i - 1.0, 3.0, i), (4.0, 2.0, 1.0), path=f"/Lamp{i}") for i in range(3)]
SMOKE = volume(NOISE, Medium(extinction=(2.0, 2.0, 2.0)))
COLOURED = volume(NOISE, Medium(extinction=(1.0, 2.0, 3.0)))
GLOW = volume(NOISE, Medium(emission=(2.0, 1.0, 0.5)), emission=NOISE)
FOG = box(Medium(extinction=(0.4, 0.4, 0.4), albedo=(0.9, 0.9, 0.9)), (-4, -4, -4), (4, 4, 4))
GROUND = box_mesh((-6.0, -1.1, -6.0), (6.0, -1.0, 6.0), path="/Ground")
POLE = box_mesh((-0.5, -2.0, 0.2), (-0.2, 2.0, 0.6), path="/Pole")
#: Narrower than the way from one marched pixel to the next.
WIRE = box_mesh((0.305, -2.0, 0.2), (0.33, 2.0, 0.225), (0.1, 0.1, 0.1), path="/Wire")
CUBE = box_mesh((-0.4, -0.4, -0.4), (0.4, 0.4, 0.4), path="/Cube")
#: The scene, and what the mean relative error may be at a half and at a quarter of the resolution.
SMOOTH = {
    "smoke": (scene(SMOKE, SUN), 0.01, 0.03),
    "coloured, lamps": (scene(COLOURED, *LAMPS), 0.01, 0.03),
    "emission, ground": (scene(GLOW, GROUND, SUN), 0.005, 0.015),
    "smoke, cube in it": (scene(SMOKE, CUBE, GROUND, SUN), 0.005, 0.02),
    "fog, pole and wire": (scene(FOG, POLE, WIRE, GROUND, SUN), 0.004, 0.01),
    "fog, spot": (scene(FOG, POLE, spot((0.0, 3.0, 1.0), (0.0, 0.0, 0.0), (30.0, 30.0, 30.0))), 0.01, 0.04),
}


@pytest.fixture(scope="module")
def renderer() -> Iterator[previs.Renderer]:
    with previs.Renderer() as made:
        yield made


def drawn(renderer, index, divisor=1, size=SIZE, view=VIEW, **values) -> previs.Image:
    return renderer.render(index, view, size, QUICK.replace(march_divisor=divisor, **values))


@pytest.mark.parametrize("antialias", [1, 2])
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_media_are_nearly_those_of_the_whole_march(renderer, name: str, antialias: int) -> None:
    description, half, quarter = SMOOTH[name]
    index = index_of(description)
    whole = drawn(renderer, index, antialias=antialias)
    for divisor, most in ((2, half), (4, quarter)):
        image = drawn(renderer, index, divisor, antialias=antialias)
        error = metrics.mean_relative_error(image.color, whole.color)
        assert 0.0 < error < most
        assert np.abs(image.alpha - whole.alpha).mean() < most
        assert set(image.aovs) == set(whole.aovs)
        for plane in ("volume", "transmittance", "emission"):
            if plane in whole.aovs:
                difference = np.abs(image.aovs[plane] - whole.aovs[plane])
                assert difference.mean() < 0.0025 * divisor**2 * whole.aovs[plane].mean()


@pytest.mark.parametrize("size", [(97, 54), (96, 53), (7, 5), (1, 9), (2, 1), (1, 1)])
@pytest.mark.parametrize("divisor", [2, 4])
def test_marched_pixels_are_those_of_the_whole_march(renderer, size: tuple[int, int], divisor: int) -> None:
    """From the lower left, and the last of a row or column whatever the size."""
    index = index_of(scene(SMOKE, CUBE, SUN))
    whole, image = (drawn(renderer, index, d, size).aovs["volume"][::-1] for d in (1, divisor))
    rows, columns = (np.unique([*range(0, n, divisor), n - 1]) for n in size[::-1])
    plan = renderer.plan(index, VIEW, *size, QUICK.replace(march_divisor=divisor))
    assert plan.march_size == (len(columns), len(rows))
    found, wanted = image[np.ix_(rows, columns)], whole[np.ix_(rows, columns)]
    assert np.abs(found - wanted).max() <= 1e-4 * max(whole.max(), 1e-6)


@pytest.mark.parametrize("divisor", [2, 4])
def test_an_edge_before_fog_has_no_halo(renderer, divisor: int) -> None:
    """A pixel of a pole, and one beside it, have the fog before them that the whole march finds there."""
    index = index_of(scene(FOG, POLE, WIRE, GROUND, SUN))
    # At fewer steps the whole march is off by half as much as is allowed here: shadows as thin as a step come and go.
    whole, image = drawn(renderer, index, steps=48), drawn(renderer, index, divisor, steps=48)
    depth = np.where(np.isinf(whole.depth), 100.0, whole.depth)
    near = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        for step in (-1, 1):
            near |= np.abs(np.roll(depth, step, axis) - depth) > 0.5
    assert near.sum() > 200
    through, wanted = (i.aovs["transmittance"] for i in (image, whole))
    # Of a pixel that is interpolated across the edge it would be the mean of both sides.
    assert np.abs(through - wanted)[near].max() < 0.035 < 0.2 * np.ptp(wanted[near])
    assert np.abs(image.color - whole.color)[near].max() < 0.05 * metrics.peak(whole.color)


def test_a_wire_that_no_marched_pixel_meets_is_marched(renderer) -> None:
    index = index_of(scene(FOG, WIRE, SUN))
    whole, image = drawn(renderer, index), drawn(renderer, index, 4)
    wire = np.isfinite(whole.depth)
    columns = np.unique(np.nonzero(wire)[1])
    assert len(columns) <= 3 and not set(columns) & set(range(0, SIZE[0], 4))
    difference = np.abs(image.aovs["volume"] - whole.aovs["volume"])[wire]
    assert difference.max() < 1e-4 * whole.aovs["volume"].max()


def test_edges_with_no_medium_between_are_none(renderer) -> None:
    """What is behind all media ends no ray in them; what is before them hides them to the last pixel."""
    front = box_mesh((-2.0, 0.42, 3.0), (2.0, 0.5, 3.01), path="/Front")
    behind = box_mesh((-2.0, -0.6, -3.01), (2.0, -0.5, -3.0), path="/Behind")
    bare = drawn(renderer, index_of(scene(SMOKE, SUN)), 2).aovs["transmittance"]
    image = drawn(renderer, index_of(scene(SMOKE, behind, SUN)), 2)
    assert np.isfinite(image.depth).sum() > 50
    np.testing.assert_allclose(image.aovs["transmittance"], bare, atol=1e-6)
    image = drawn(renderer, index_of(scene(SMOKE, front, SUN)), 2)
    hidden = np.isfinite(image.depth)
    assert hidden.sum() > 50
    assert image.aovs["transmittance"][hidden].min() == 1.0
    np.testing.assert_allclose(image.aovs["transmittance"][~hidden], bare[~hidden], atol=0.02)


def test_the_camera_in_the_fog(renderer) -> None:
    view = camera((0.5, 0.2, 2.0))
    for content in ((FOG, SUN), (FOG, CUBE, WIRE, SUN)):
        index = index_of(scene(*content))
        whole, image = (drawn(renderer, index, d, view=view) for d in (1, 2))
        assert metrics.mean_relative_error(image.color, whole.color) < 0.01


@pytest.mark.parametrize("content", [(SMOKE, *LAMPS), (GLOW, WIRE, GROUND, *LAMPS)], ids=["bare", "meshes"])
def test_long_marches_are_cut_into_draws(renderer, monkeypatch, content) -> None:
    """Batches of lights and slices of the rays, at both resolutions."""
    index = index_of(scene(*content))
    settings = QUICK.replace(march_divisor=2, transmittance="march")
    whole = renderer.render(index, VIEW, SIZE, settings)
    monkeypatch.setattr(draws, "LOOP_BUDGET", 3000)
    plan = renderer.plan(index, VIEW, *SIZE, settings)
    assert len(plan.batches) * len(plan.slices) > 2
    renderer.forget_scene()
    cut = renderer.render(index, VIEW, SIZE, settings)
    difference = np.abs(cut.color - whole.color)
    # The deepest steps may be cut fewer times.
    assert difference.max() < 0.02 * whole.color.max() and difference.mean() < 1e-3 * whole.color.mean()


def test_pieces_add_up_to_the_same_bits(renderer) -> None:
    index = index_of(SMOOTH["fog, pole and wire"][0])
    settings = QUICK.replace(march_divisor=2)
    with previs.Renderer(share=renderer) as one, previs.Renderer(share=renderer) as other:
        whole = one.render(index, VIEW, SIZE, settings)
        plan = other.plan(index, VIEW, *SIZE, settings)
        told = list(other.drawing(plan, 1e-4))
        assert told == sorted(told) and len(told) > len(plan.passes)
        np.testing.assert_array_equal(other.image(plan).color, whole.color)


def test_it_runs_when_the_march_does(renderer) -> None:
    index = index_of(scene(SMOKE, CUBE, SUN))
    renderer.forget_scene()
    drawn(renderer, index, 2)
    drawn(renderer, index, 2)
    assert renderer.executed == []
    drawn(renderer, index, 2, opacity_cutoff=1e-3)
    assert renderer.executed == ["march", "upsample", "composite"]
    drawn(renderer, index, 4, opacity_cutoff=1e-3)
    assert renderer.executed == ["march", "upsample", "composite"]
    drawn(renderer, index, 1, opacity_cutoff=1e-3)
    assert renderer.executed == ["march", "composite"]


def test_the_plan_says_what_is_marched(renderer) -> None:
    index = index_of(scene(SMOKE, CUBE, SUN))
    plans = {d: renderer.plan(index, VIEW, 640, 360, Settings(march_divisor=d)) for d in (1, 2, 4)}
    passes = {d: {p.name: p for p in plan.passes} for d, plan in plans.items()}
    assert "upsample" not in passes[1] and plans[1].media_target == "march"
    for divisor, size in ((2, (321, 181)), (4, (161, 91))):
        march, upsample = passes[divisor]["march"], passes[divisor]["upsample"]
        assert march.resolution == plans[divisor].march_size == size
        assert upsample.resolution == (640, 360)
        assert march.memory < 1.05 * passes[1]["march"].memory / divisor**2
        assert f"{divisor}×{divisor}" in march.why
    nothing = renderer.plan(index_of(scene(CUBE, SUN)), VIEW, 64, 36, Settings(march_divisor=4))
    assert [p.name for p in nothing.passes if p.kind in ("march", "upsample")] == []


@pytest.mark.parametrize("method", ["quantile", "march"])
def test_the_meter_counts_what_is_interpolated(renderer, method: str) -> None:
    """It is in the whole error and in the view's part of it, not in the light's."""
    index = index_of(scene(volume(smooth_noise((24, 24, 24), modes=9), Medium(extinction=(9.0, 9.0, 9.0))), CUBE, SUN))
    volumes = [e.record for e in index.volumes.values()]
    settings = QUICK.replace(steps=200, coefficients=14, map_size=64, march_divisor=4, transmittance=method)
    image = renderer.render(index, VIEW, SIZE, settings)
    truth = renderer.render(index, VIEW, SIZE, converged(settings, volumes))
    wanted = metrics.mean_relative_error(image.color, truth.color)
    assert converged(settings, volumes).march_divisor == brute_force(settings, volumes).march_divisor == 1
    with ErrorMeter(renderer) as meter:
        found = meter.measure(index, VIEW, image, settings)
    assert found.mean_relative_error.low <= wanted <= found.mean_relative_error.high
    assert 0.7 * wanted < found.mean_relative_error.value < 1.4 * wanted
    assert found.view.mean_relative_error.value > 0.7 * found.mean_relative_error.value
    assert found.light.mean_relative_error.value < 0.3 * found.mean_relative_error.value

"""The error meter: scattered pixels are those of the picture, and the estimate is the error of the picture."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from building import box, box_mesh, camera, distant, index_of, point, scene, smooth_noise, spot, translation, volume

import previs
from previs import Medium, Settings, metrics
from previs.description import SceneDescription
from previs.meter import choose_again, choose_pixels, estimate_error
from previs.render.measure import ErrorMeter, converged
from previs.render.renderer import sample_shifts
from previs.render.scattered import ScatteredPixels

pytestmark = pytest.mark.gl

NOISE = smooth_noise((12, 12, 12))
VIEW = camera((0.5, 1.0, 6.0))
SIZE = (80, 45)
QUICK = Settings(steps=24, shadow_map_size=128, map_size=32, coefficients=4, error_pixels=64)
SUN = distant((0.1, -1.0, 0.2), (3.0, 3.0, 3.0))
MESH = box_mesh((-0.5, -2.0, -0.5), (0.5, -1.0, 0.5))
CLOUD = volume(NOISE, Medium(extinction=(4.0, 5.0, 6.0)), path="/Cloud")
GLOW = volume(NOISE, Medium(emission=(2.0, 1.0, 0.5)), path="/Glow", temperature=3000.0 * NOISE, emission=NOISE)
LAMPS = [point((i - 1.0, 3.0, i), (4.0, 2.0, 1.0), path=f"/Lamp{i}") for i in range(3)]
LAMP = spot((0.0, 3.0, 1.0), (0.0, 0.0, 0.0), (30.0, 30.0, 30.0))
SCENES: dict[str, SceneDescription] = {
    "cloud": scene(CLOUD, SUN),
    "mesh, three lights": scene(CLOUD, MESH, *LAMPS),
    "emission": scene(GLOW, MESH, SUN),
    "shaft": scene(box(Medium()), MESH, LAMP),
    "two volumes": scene(CLOUD, replace(CLOUD, path="/Other", local_to_world=translation(1.1, 0, 0)), SUN),
}


@pytest.fixture(scope="module")
def renderer() -> Iterator[previs.Renderer]:
    with previs.Renderer() as made:
        yield made


def scattered(renderer, index, settings, pixels) -> np.ndarray:
    total = np.zeros((len(pixels), 4))
    shifts = sample_shifts(settings.antialias)
    for shift in shifts:
        plan = renderer.plan(index, VIEW, *SIZE, settings, shift, pixels)
        renderer.draw(plan)
        total += renderer.scattered(plan)
    return total / len(shifts)


@pytest.mark.parametrize("antialias", [1, 2])
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", ["tfm", "march"])
def test_scattered_pixels_are_those_of_the_picture(renderer, name, method, antialias):
    """But for the rounding of where they are in it."""
    index = index_of(SCENES[name])
    settings = QUICK.replace(transmittance=method, antialias=antialias)
    image = renderer.render(index, VIEW, SIZE, settings)
    sample = choose_pixels(image.color, None, 300, 1)
    with previs.Renderer(share=renderer) as other:
        found = scattered(other, index, settings, ScatteredPixels(sample.rows, sample.columns))
    wanted = np.dstack([image.color, image.alpha])[sample.rows, sample.columns]
    peak = float(image.color.max())
    off = np.abs(found - wanted).max(axis=1) > 1e-4 * peak
    # A shadow's edge may fall on the other side of a pixel's ray.
    assert np.count_nonzero(off) <= 3
    assert np.abs(found - wanted)[~off].max() < 1e-4 * peak
    assert renderer.stale(renderer.plan(index, VIEW, *SIZE, settings, sample_shifts(antialias)[-1])) == ()


def test_more_pixels_than_a_row_of_the_target_holds(renderer):
    index = index_of(SCENES["cloud"])
    image = renderer.render(index, VIEW, SIZE, QUICK)
    rows, columns = (a.ravel() for a in np.mgrid[: SIZE[1], : SIZE[0]])
    pixels = ScatteredPixels(rows, columns)
    assert len(pixels) < np.prod(pixels.target_size)
    places = np.stack(pixels.places)
    assert len(np.unique(places, axis=1).T) == len(pixels) and (places.T < pixels.target_size[::-1]).all()
    found = scattered(renderer, index, QUICK, pixels)[:, :3].reshape(SIZE[1], SIZE[0], 3)
    assert np.abs(found - image.color).max() < 1e-4 * image.color.max()


def test_pixels_that_were_not_drawn_cannot_be_read(renderer):
    index = index_of(SCENES["cloud"])
    plan = renderer.plan(index, VIEW, *SIZE, QUICK, pixels=ScatteredPixels(np.array([3]), np.array([4])))
    with pytest.raises(previs.PrevisError, match="not drawn"):
        renderer.scattered(plan)


@pytest.mark.parametrize("name", SCENES)
def test_the_estimate_is_the_error_of_the_picture(renderer, name):
    """Whole pictures by the settings of the truth, then the meter's own choice of pixels for 100 seeds."""
    index = index_of(SCENES[name])
    volumes = [e.record for e in index.volumes.values()]
    settings = QUICK.replace(antialias=2) if name == "emission" else QUICK
    image = renderer.render(index, VIEW, SIZE, settings)
    truth = renderer.render(index, VIEW, SIZE, converged(settings, volumes).replace(steps=1024)).color.astype(float)
    same = renderer.render(index, VIEW, SIZE, settings.replace(transmittance="march", light_steps=0)).color.astype(
        float
    )
    finer = settings.replace(transmittance="quantile", coefficients=14, steps=48, map_size=0)
    better = renderer.render(index, VIEW, SIZE, finer).color.astype(float)
    wanted = [f(image.color, truth) for f in (metrics.relative_rmse, metrics.mean_relative_error, metrics.psnr)]
    hits = np.zeros(3)
    for seed in range(100):
        first = choose_pixels(image.color, None, 1024, seed)
        sample = choose_again(image.color, first, better[first.rows, first.columns], 64, seed)
        places = sample.rows, sample.columns
        found = estimate_error(image.color, sample, same[places], truth[places])
        estimates = (found.relative_rmse, found.mean_relative_error, found.psnr)
        hits += [e.low <= w <= e.high for e, w in zip(estimates, wanted, strict=True)]
    assert (hits >= 90).all(), hits
    with ErrorMeter(renderer) as meter:
        found = meter.measure(index, VIEW, image, settings.replace(error_pixels=256))
    for estimate, value in zip((found.relative_rmse, found.mean_relative_error), wanted, strict=False):
        assert 0.7 * value < estimate.value < 1.4 * value
    assert found.pixels == 256 and found.seconds > 0.0 and found.steps >= 2048


def test_the_error_goes_to_the_part_that_makes_it(renderer):
    index = index_of(SCENES["cloud"])

    def measured(**values):
        settings = Settings(error_pixels=128, **values)
        with ErrorMeter(renderer) as meter:
            return meter.measure(index, VIEW, renderer.render(index, VIEW, SIZE, settings), settings)

    few_steps = measured(transmittance="march", steps=6)
    assert few_steps.light.mean_relative_error.value < 1e-4 < 0.001 < few_steps.view.mean_relative_error.value
    few_values = measured(transmittance="tfm-plain", coefficients=2, steps=512)
    assert few_values.view.mean_relative_error.value < 0.001 < 0.01 < few_values.light.mean_relative_error.value


def test_the_converged_march_has_no_error(renderer):
    index = index_of(SCENES["mesh, three lights"])
    settings = converged(QUICK, [e.record for e in index.volumes.values()])
    size = (32, 18)
    image = renderer.render(index, VIEW, size, settings)
    with ErrorMeter(renderer) as meter:
        found = meter.measure(index, VIEW, image, settings.replace(error_pixels=1024))
    assert found.pixels == 32 * 18
    assert found.relative_rmse.high < 1e-4 and found.psnr.low > 80.0


@pytest.mark.parametrize("content", [(), (CLOUD,), (MESH,), (SUN,), (CLOUD, MESH)])
def test_pictures_of_nothing_and_of_the_unlit(renderer, content):
    index = index_of(scene(*content))
    image = renderer.render(index, VIEW, (16, 9), QUICK)
    with ErrorMeter(renderer) as meter:
        found = meter.measure(index, VIEW, image, QUICK)
    assert found.relative_rmse.value == found.mean_relative_error.value == 0.0


def test_measuring_in_pieces(renderer):
    """Other things may be drawn between two pieces, and the measuring may be dropped at any."""
    index = index_of(SCENES["mesh, three lights"])
    image = renderer.render(index, VIEW, SIZE, QUICK)
    with ErrorMeter(renderer) as meter:
        whole = meter.measure(index, VIEW, image, QUICK)
        dropped = meter.measuring(index, VIEW, image, QUICK, piece_seconds=1e-3)
        for _ in range(5):
            next(dropped)
        dropped.close()
        work, told = meter.measuring(index, VIEW, image, QUICK, piece_seconds=1e-3), []
        while True:
            try:
                told.append(next(work))
            except StopIteration as end:
                found = end.value
                break
            if len(told) % 7 == 0:
                renderer.render(index, VIEW, SIZE, QUICK.replace(steps=20 + len(told) % 3))
    assert len(told) > 10 and told == sorted(told) and told[-1] == pytest.approx(1.0)
    assert replace(found, seconds=0.0) == replace(whole, seconds=0.0)


def test_other_seeds_take_other_pixels(renderer):
    index = index_of(SCENES["cloud"])
    image = renderer.render(index, VIEW, SIZE, QUICK)
    with ErrorMeter(renderer) as meter:
        one, two = (meter.measure(index, VIEW, image, QUICK, seed) for seed in (1, 2))
    assert one.relative_rmse != two.relative_rmse


def test_a_broken_picture_is_refused(renderer):
    index = index_of(SCENES["cloud"])
    image = renderer.render(index, VIEW, SIZE, QUICK)
    color = image.color.copy()
    color[3, 4, 1] = np.nan
    with ErrorMeter(renderer) as meter, pytest.raises(previs.PrevisError, match="1 values"):
        meter.measure(index, VIEW, replace(image, color=color), QUICK)

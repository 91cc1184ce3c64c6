"""A picture that goes on to the truth: what its levels are off, and what becomes of them when something changes."""

import itertools
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from building import camera, distant, index_of, point, scene, smooth_noise, volume

import previs
from previs import Medium, Settings
from previs.bench.reference_scene import reference_image
from previs.metrics import mean_relative_error
from previs.ui import resting
from previs.ui.picture import Picture, Request
from previs.ui.refinement import CONVERGED_ERROR, SliceCounts, finer_levels
from previs.ui.resting import Rest

pytestmark = pytest.mark.gl

SIZE = (24, 14)
VIEW = camera((0.5, 1.0, 6.0))
SMOKE = volume(smooth_noise((12, 12, 12)), Medium(extinction=(7.0, 5.0, 4.0), anisotropy=0.3))
SCENE = scene(SMOKE, distant((0.3, -1.0, 0.2), (3.0, 3.0, 3.0)), point((2.0, 1.0, 1.5), (8.0, 6.0, 4.0)))
INDEX = index_of(SCENE)
ROUGH = Settings(steps=64, map_size=64, slices=28)
_keys = itertools.count()


@pytest.fixture
def picture(renderer: previs.Renderer) -> Iterator[Picture]:
    made = Picture(renderer.context)
    yield made
    made.release()


def request(settings: Settings = ROUGH) -> Request:
    return Request(next(_keys), INDEX, VIEW, SIZE, settings)


def finish(picture: Picture) -> None:
    while picture.pending(False):
        picture.work(1.0, False)
    assert picture.finished


def settle(picture: Picture, rest: Rest) -> tuple[list[int], list[float]]:
    """Work at rest until there is nothing to do: numbers of the levels, and their measured errors."""
    numbers, errors = [], []
    while rest.pending:
        rest.check(False)
        if picture.refining:
            picture.work(1.0, False)
        else:
            rest.work(1.0)
        if not numbers or numbers[-1] != picture.finer[0]:
            numbers.append(picture.finer[0])
        if rest.estimate is not None and len(errors) < len(numbers):
            errors.append(rest.estimate.mean_relative_error.value)
    return numbers, errors


@pytest.mark.parametrize("values", [{}, {"transmittance": "quantile", "coefficients": 4}], ids=["slices", "maps"])
def test_every_level_is_nearer_the_truth(renderer, values):
    rough = ROUGH.replace(**values)
    plan = renderer.plan(INDEX, VIEW, *SIZE, rough.replace(transmittance="slices"))
    levels = finer_levels(rough, plan.volumes, SliceCounts(plan.map_size, plan.map_slices, len(plan.maps)))
    assert len(levels) > 3
    truth = reference_image(SCENE, VIEW, *SIZE, rough, 1e-5).color
    pictures = [renderer.render(INDEX, VIEW, SIZE, s).color for s in (rough, *(x.settings for x in levels))]
    errors = [mean_relative_error(p, truth) for p in pictures]
    assert all(after < before for before, after in pairwise(errors)), errors
    assert errors[0] > CONVERGED_ERROR > errors[-1], errors


def test_samples_of_a_pixel_do_not_keep_it_from_the_truth(renderer):
    """Averaged pictures of few steps would stay off: the exponential of a mean is not the mean of exponentials."""
    several = ROUGH.replace(antialias=2)
    last = finer_levels(several, [SMOKE])[-1]
    truth = reference_image(SCENE, VIEW, SIZE[0] * 2, SIZE[1] * 2, several, 1e-5).color
    truth = truth.reshape(SIZE[1], 2, SIZE[0], 2, 3).mean(axis=(1, 3))
    found = renderer.render(INDEX, VIEW, SIZE, last.settings).color
    assert mean_relative_error(found, truth) < CONVERGED_ERROR


@pytest.mark.parametrize("values", [{}, {"transmittance": "quantile", "coefficients": 4}], ids=["slices", "maps"])
def test_a_picture_goes_up_to_the_truth(picture, monkeypatch, values):
    monkeypatch.setattr(resting, "CONVERGED_ERROR", 0.0)
    rest = Rest(picture)
    picture.converging = True
    picture.show(request(ROUGH.replace(**values)))
    finish(picture)
    final = picture.read()
    numbers, errors = settle(picture, rest)
    count = picture.finer[1]
    assert numbers == list(range(count + 1)) and picture.level == "exact" and rest.converged
    assert len(errors) == count and all(after < before for before, after in pairwise(errors)), errors
    assert rest.estimate is None, "there is nothing to measure the truth against"
    serial = picture.serial
    rest.work(1.0)
    picture.work(1.0, False)
    assert picture.serial == serial and not rest.pending
    picture.converging = False
    finish(picture)
    assert picture.level == "final"
    np.testing.assert_array_equal(picture.read(), final)


def test_a_picture_that_is_good_enough_goes_no_further(picture):
    rest = Rest(picture)
    picture.converging = True
    picture.show(request(Settings(steps=1024, slices=112)))
    finish(picture)
    numbers, errors = settle(picture, rest)
    assert rest.converged and picture.level != "exact" and errors[-1] < CONVERGED_ERROR
    assert numbers[-1] < picture.finer[1]


def test_an_estimate_belongs_to_one_picture(picture):
    rest = Rest(picture)
    asked = request()
    picture.show(asked)
    finish(picture)
    settle(picture, rest)
    found = rest.estimate
    assert found is not None and found.pixels == ROUGH.error_pixels and not rest.pending
    picture.show(request(ROUGH.replace(slices=56)))
    assert rest.estimate is None and not rest.pending, "the next picture is not there yet"
    finish(picture)
    assert rest.estimate is None and rest.pending
    settle(picture, rest)
    assert rest.estimate is not None and rest.estimate is not found


def test_a_change_drops_what_is_under_way(picture, monkeypatch):
    monkeypatch.setattr(resting, "CONVERGED_ERROR", 0.0)
    rest = Rest(picture)
    picture.converging = True
    picture.show(request())
    finish(picture)
    rest.work(0.009)
    rest.work(0.009)
    assert rest.progress > 0.0
    picture.show(request(ROUGH.replace(slices=56)))
    rest.check(True)
    assert rest.progress == 0.0 and rest._meter is None
    finish(picture)
    while not picture.refining:
        rest.work(1.0)
    picture.show(request())
    picture.work(1.0, True)
    assert not picture.refining and picture.current and picture.finer[0] == 0


def test_what_cannot_be_measured_says_why(picture, monkeypatch):
    rest = Rest(picture)
    picture.show(request())
    finish(picture)

    def refused(*_, **__):
        raise previs.PrevisError("no truth to be had")
        yield

    monkeypatch.setattr(resting.ErrorMeter, "measuring", refused)
    settle(picture, rest)
    assert rest.estimate is None and rest.problem == "no truth to be had" and not rest.pending


def test_a_level_that_cannot_be_drawn_ends_it(picture, monkeypatch):
    monkeypatch.setattr(resting, "CONVERGED_ERROR", 0.0)
    rest = Rest(picture)
    picture.converging = True
    picture.show(request())
    finish(picture)
    before = picture.read()

    def refused(*_, **__):
        raise previs.PrevisError("too much")

    monkeypatch.setattr(picture._final, "plan", refused)
    settle(picture, rest)
    assert picture.refusal == "too much" and not picture.error and picture.finished and not rest.pending
    np.testing.assert_array_equal(picture.read(), before)


def test_without_media_there_is_nothing_to_measure(picture):
    rest = Rest(picture)
    picture.converging = True
    picture.show(Request("bare", index_of(scene(distant((0.0, -1.0, 0.0)))), VIEW, SIZE, ROUGH))
    finish(picture)
    assert not rest.pending and rest.estimate is None

"""The error meter's statistics, on pictures whose error is known in every pixel."""

import functools
import json
import math

import numpy as np
import pytest

from previs import metrics
from previs.meter import ErrorEstimate, choose_again, choose_pixels, estimate_error

SHAPE = (72, 128)


def smooth(rng: np.random.Generator, scale: float) -> np.ndarray:
    """A smooth random plane, values about 0."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    waves = rng.normal(size=(12, 4)) * [scale, scale, math.pi, 1.0]
    return sum(a * np.sin(fx * x + fy * y + p) for fx, fy, p, a in waves)


@functools.cache
def pictures(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A picture, the same with marched light, the truth, and a better picture."""
    rng = np.random.default_rng(sum(map(ord, kind)))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    cloud = np.exp(-(((x - 60) / 25) ** 2) - ((y - 36) / 15) ** 2) * np.exp(0.5 * smooth(rng, 20.0))
    truth = cloud[..., None] * [1.0, 0.8, 0.6]
    if kind == "smooth":
        light, view = 0.02 * smooth(rng, 15.0) * cloud, 0.005 * smooth(rng, 30.0) * cloud
    elif kind == "concentrated":
        # Most of the error is in one pixel of a hundred.
        light, view = 0.3 * cloud * (smooth(rng, 40.0) > 5.5), 0.003 * smooth(rng, 30.0) * cloud
    elif kind == "noise":
        light, view = 0.05 * rng.standard_normal(SHAPE) * cloud, 0.05 * rng.standard_normal(SHAPE) * cloud
    else:
        light, view = 0.01 * smooth(rng, 9.0) * (cloud > 0.5), 0.04 * smooth(rng, 25.0) * np.sqrt(cloud) * (y % 7 == 0)
    same = truth + view[..., None]
    test = same + light[..., None]
    return test, same, truth, truth + 0.2 * (test - truth) + 0.0003 * rng.standard_normal(SHAPE)[..., None] * truth


def estimate(kind: str, seed: int, count: int = 256) -> ErrorEstimate:
    test, same, truth, better = pictures(kind)
    first = choose_pixels(test, None, 16 * count, seed)
    sample = choose_again(test, first, better[first.rows, first.columns], count, seed)
    return estimate_error(test, sample, same[sample.rows, sample.columns], truth[sample.rows, sample.columns])


@pytest.mark.parametrize("kind", ["smooth", "concentrated", "noise", "edges"])
def test_intervals_hold_the_true_error(kind):
    """In at least 90 of 100 seeds, of the error and of its parts; and the estimates lie around it."""
    test, same, truth, _ = pictures(kind)
    lit = metrics.lit_mask(truth)
    total, values = truth[lit].sum(), 3 * lit.sum()

    def relative(difference):
        return (
            np.sqrt((difference**2).sum() * values) / total,
            np.abs(difference).sum() / total,
            difference.sum() / total,
        )

    wanted = {
        "relative_rmse": metrics.relative_rmse(test, truth),
        "mean_relative_error": metrics.mean_relative_error(test, truth),
        "psnr": metrics.psnr(test, truth),
        "bias": relative(test - truth)[2],
    }
    assert relative(test - truth)[:2] == pytest.approx((wanted["relative_rmse"], wanted["mean_relative_error"]))
    for part, difference in (("light", test - same), ("view", same - truth)):
        names = ("relative_rmse", "mean_relative_error", "bias")
        wanted |= {f"{part}.{name}": v for name, v in zip(names, relative(difference), strict=True)}
    found = {name: [] for name in wanted}
    for seed in range(100):
        estimated = estimate(kind, seed)
        for name, values_of in found.items():
            owner = getattr(estimated, name.split(".")[0]) if "." in name else estimated
            values_of.append(getattr(owner, name.split(".")[-1]))
    for name, estimates in found.items():
        covered = sum(e.low <= wanted[name] <= e.high for e in estimates)
        assert covered >= 90, name
        centre, spread = np.mean([e.value for e in estimates]), np.std([e.value for e in estimates])
        assert abs(centre - wanted[name]) < 0.03 * abs(wanted[name]) + 0.5 * spread, name


def test_sums_are_unbiased_whatever_the_better_picture_shows():
    test, _, truth, _ = pictures("smooth")
    nonsense = np.random.default_rng(0).random(test.shape)
    difference = (test - truth) ** 2
    sums = []
    for seed in range(400):
        first = choose_pixels(test, None, 1024, seed)
        sample = choose_again(test, first, nonsense[first.rows, first.columns], 128, seed)
        sums.append(np.sum(difference[sample.rows, sample.columns] / sample.probability[:, None]))
    assert abs(np.mean(sums) - difference.sum()) < 4.0 * np.std(sums) / math.sqrt(len(sums))


def test_pixels_are_chosen_as_often_as_their_probability_says():
    color = pictures("smooth")[0][:12, 50:66]
    chosen, probability = np.zeros(color.shape[:2]), np.full(color.shape[:2], np.nan)
    for seed in range(3000):
        sample = choose_pixels(color, None, 24, seed)
        assert len({*zip(sample.rows.tolist(), sample.columns.tolist(), strict=True)}) == 24
        chosen[sample.rows, sample.columns] += 1
        probability[sample.rows, sample.columns] = sample.probability
    assert np.isfinite(probability).all()
    assert probability.sum() == pytest.approx(24)
    deviation = np.sqrt(3000 * probability * (1 - probability))
    assert np.all(np.abs(chosen - 3000 * probability) < 5 * deviation + 1)


def test_neighbours_in_the_order_of_choice_are_neighbours_in_the_picture():
    sample = choose_pixels(np.ones((*SHAPE, 3)), None, 10**6)
    assert len(sample) == SHAPE[0] * SHAPE[1]
    step = np.abs(np.diff(sample.rows)) + np.abs(np.diff(sample.columns))
    # The curve leaves the picture where that is no square, and comes back elsewhere.
    assert np.mean(step == 1) > 0.99


def test_all_pixels_give_the_error_itself():
    test, same, truth, _ = pictures("concentrated")
    sample = choose_pixels(test, None, test.size)
    found = estimate_error(test, sample, same[sample.rows, sample.columns], truth[sample.rows, sample.columns])
    for name in ("relative_rmse", "mean_relative_error", "psnr"):
        value = getattr(metrics, name)(test, truth)
        assert getattr(found, name) == pytest.approx((value, value, value))
    assert found.bias.value == pytest.approx(found.light.bias.value + found.view.bias.value)


def test_parts_add_up():
    found = estimate("edges", 3)
    assert found.bias.value == pytest.approx(found.light.bias.value + found.view.bias.value)
    for name in ("relative_rmse", "mean_relative_error"):
        whole, light, view = (getattr(p, name).value for p in (found, found.light, found.view))
        assert abs(light - view) <= whole <= light + view


@pytest.mark.parametrize("count", [64, 10**6])
def test_no_error(count):
    color = pictures("smooth")[0]
    sample = choose_pixels(color, None, count)
    same = color[sample.rows, sample.columns]
    found = estimate_error(color, sample, same, same)
    assert found.relative_rmse == found.mean_relative_error == found.bias == (0.0, 0.0, 0.0)
    assert found.psnr.value == math.inf
    json.dumps(found.to_dict(), allow_nan=False)
    assert "PSNR" in str(found)


@pytest.mark.parametrize("count", [64, 10**6])
def test_black_pictures(count):
    """Against black any light is infinitely wrong, as for the metrics; black against black is right."""
    black = np.zeros((*SHAPE, 3))
    sample = choose_pixels(black, None, count)
    nothing = np.zeros((len(sample), 3))
    found = estimate_error(black, sample, nothing, nothing)
    assert (found.relative_rmse.value, found.mean_relative_error.value) == (0.0, 0.0)
    glowing = np.full_like(black, 0.5)
    found = estimate_error(glowing, sample, nothing, nothing)
    assert (
        found.relative_rmse.value
        == found.mean_relative_error.value
        == metrics.relative_rmse(glowing, black)
        == math.inf
    )
    assert found.psnr.value < -100.0 or count > 64
    found = estimate_error(black, sample, nothing, nothing + 0.5)
    assert found.mean_relative_error.value == pytest.approx(1.0)
    json.dumps(found.to_dict(), allow_nan=False)


def test_one_pixel():
    sample = choose_pixels(np.ones((1, 1, 3)))
    found = estimate_error(np.ones((1, 1, 3)), sample, np.full((1, 3), 0.9), np.full((1, 3), 0.8))
    assert found.mean_relative_error.value == pytest.approx(0.25)
    assert found.pixels == 1


def test_values_that_are_not_finite_are_refused():
    color = np.ones((4, 4, 3))
    sample = choose_pixels(color)
    with pytest.raises(ValueError, match="1 values of the truth"):
        estimate_error(
            color, sample, np.ones((16, 3)), np.ones((16, 3)) * np.where(np.arange(48) == 5, np.nan, 1).reshape(16, 3)
        )


def test_what_it_says():
    found = estimate("smooth", 0)
    assert str(found).startswith("mean error ") and str(found).endswith("256 pixels")
    stored = found.to_dict()
    assert set(stored["light"]) == {"relative_rmse", "mean_relative_error", "psnr", "bias"}
    assert stored["psnr"]["low"] < stored["psnr"]["value"] < stored["psnr"]["high"]

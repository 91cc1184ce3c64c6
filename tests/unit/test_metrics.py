"""Image metrics against values computed by hand."""

import subprocess
import sys

import numpy as np
import pytest

from previs import metrics

PAIRWISE = [
    metrics.rmse,
    metrics.relative_rmse,
    metrics.mean_relative_error,
    metrics.psnr,
    metrics.ssim,
    metrics.flip,
    metrics.flip_map,
]


@pytest.fixture
def picture() -> np.ndarray:
    return np.random.default_rng(7).random((24, 32, 3))


@pytest.mark.parametrize("metric", PAIRWISE)
def test_shapes_that_differ_are_refused(metric, picture):
    with pytest.raises(ValueError, match="differ in shape"):
        metric(picture[:20], picture)


@pytest.mark.parametrize("metric", PAIRWISE)
@pytest.mark.parametrize("shape", [(5,), (4, 4, 2), (0, 4), (2, 3, 3, 3)])
def test_other_kinds_of_arrays_are_refused(metric, shape):
    with pytest.raises(ValueError, match="needed"):
        metric(np.zeros(shape), np.zeros(shape))


@pytest.mark.parametrize("metric", PAIRWISE)
@pytest.mark.parametrize("which", ["test", "reference"])
def test_values_that_are_not_finite_are_counted(metric, which, picture):
    broken = picture.copy()
    broken[0, 0, 0], broken[1, 1, 1], broken[2, 2, 2] = np.nan, np.inf, -np.inf
    images = (broken, picture) if which == "test" else (picture, broken)
    with pytest.raises(ValueError, match=f"3 of {picture.size} values of the {which} image are not finite"):
        metric(*images)


def test_rmse_of_a_constant_offset(picture):
    assert metrics.rmse(picture + 0.25, picture) == pytest.approx(0.25, rel=1e-12)
    assert metrics.rmse(picture, picture) == 0.0
    assert metrics.rmse([[0.0, 3.0]], [[4.0, 0.0]]) == pytest.approx(np.sqrt(12.5))


def test_peak_ignores_a_few_singular_pixels():
    image = np.ones((100, 100))
    image[0, 0] = 1e9
    assert metrics.peak(image) == 1.0
    assert metrics.peak(np.zeros((100, 100))) == 0.0
    single = np.zeros((100, 100))
    single[3, 4] = 2.0
    assert metrics.peak(single) == 2.0


def test_lit_mask():
    image = np.zeros((10, 10, 3))
    image[2:4, 5, 1] = 1.0
    image[7, 7, 2] = 1e-4
    mask = metrics.lit_mask(image)
    assert mask.shape == (10, 10)
    assert np.argwhere(mask).tolist() == [[2, 5], [3, 5]]
    assert np.count_nonzero(metrics.lit_mask(image, threshold=1e-5)) == 3
    assert not metrics.lit_mask(np.zeros((4, 4))).any()
    np.testing.assert_array_equal(metrics.lit_mask(image[..., 1]), image[..., 1] > 0.5)


def test_relative_errors_by_hand():
    reference, test = np.zeros((10, 10)), np.zeros((10, 10))
    reference[0, :4], test[0, :4] = 2.0, 3.0
    # Four lit values, mean 2, each off by 1.
    assert metrics.mean_relative_error(test, reference) == pytest.approx(0.5)
    assert metrics.relative_rmse(test, reference) == pytest.approx(0.5)
    # Light outside the lit pixels is an error too, shared among the lit ones.
    test[5, 5] = 4.0
    assert metrics.mean_relative_error(test, reference) == pytest.approx((4 * 1.0 + 4.0) / 4 / 2.0)
    assert metrics.relative_rmse(test, reference) == pytest.approx(np.sqrt((4 * 1.0 + 16.0) / 4) / 2.0)


@pytest.mark.parametrize("metric", [metrics.relative_rmse, metrics.mean_relative_error])
def test_relative_errors_do_not_depend_on_scale_or_background(metric, picture):
    test = picture * 1.1
    assert metric(test * 1e-7, picture * 1e-7) == pytest.approx(metric(test, picture), rel=1e-9)
    wide = [np.pad(i, ((0, 0), (0, 40), (0, 0))) for i in (test, picture)]
    assert metric(*wide) == pytest.approx(metric(test, picture), rel=1e-2)
    black = np.zeros_like(picture)
    assert metric(black, black) == 0.0
    assert metric(picture, black) == float("inf")


def test_mean_relative_error_of_a_gain(picture):
    lit = picture + 0.1
    assert metrics.mean_relative_error(1.05 * lit, lit) == pytest.approx(0.05, rel=1e-9)


def test_psnr(picture):
    reference = np.full((50, 50), 4.0)
    assert metrics.psnr(reference + 0.04, reference) == pytest.approx(40.0)
    assert metrics.psnr(reference + 0.04, reference, peak=0.4) == pytest.approx(20.0)
    assert metrics.psnr(picture, picture) == float("inf")
    assert metrics.psnr(picture, np.zeros_like(picture)) == float("-inf")
    default = metrics.psnr(picture + 0.01, picture)
    assert default == pytest.approx(20 * np.log10(np.percentile(picture, 99.9) / 0.01))
    with pytest.raises(ValueError, match="peak"):
        metrics.psnr(picture, picture, peak=0.0)


def test_ssim_of_equal_and_constant_images(picture):
    assert metrics.ssim(picture, picture) == pytest.approx(1.0)
    assert metrics.ssim(np.zeros((16, 16)), np.zeros((16, 16))) == pytest.approx(1.0)
    # Constant images have no variance: only the luminance term of eq. 6 is left.
    a, b = np.full((16, 16), 0.6), np.full((16, 16), 0.8)
    expected = (2 * 0.6 * 0.8 + 1e-4) / (0.6**2 + 0.8**2 + 1e-4)
    assert metrics.ssim(a, b, peak=1.0) == pytest.approx(expected, rel=1e-9)


def test_ssim_of_one_window_is_the_formula():
    rng = np.random.default_rng(3)
    a, b = rng.random((11, 11)), rng.random((11, 11))
    x = np.arange(-5, 6)
    w = np.exp(-(x[:, None] ** 2 + x[None, :] ** 2) / (2 * 1.5**2))
    w /= w.sum()
    ma, mb = (w * a).sum(), (w * b).sum()
    va, vb, cov = (w * (a - ma) ** 2).sum(), (w * (b - mb) ** 2).sum(), (w * (a - ma) * (b - mb)).sum()
    expected = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    assert metrics.ssim(a, b, peak=1.0) == pytest.approx(expected, rel=1e-9)


def test_ssim_channels_and_limits(picture):
    rng = np.random.default_rng(5)
    noisy = picture + 0.1 * rng.standard_normal(picture.shape)
    gray = metrics.ssim(noisy @ [0.2126, 0.7152, 0.0722], picture @ [0.2126, 0.7152, 0.0722], peak=1.0)
    assert metrics.ssim(noisy, picture, peak=1.0) == pytest.approx(gray)
    each = [metrics.ssim(noisy[..., c], picture[..., c], peak=1.0) for c in range(3)]
    assert metrics.ssim(noisy, picture, peak=1.0, channels="average") == pytest.approx(np.mean(each))
    assert metrics.ssim(noisy, picture) < 0.999
    with pytest.raises(ValueError, match="11 × 11"):
        metrics.ssim(picture[:10], picture[:10])
    with pytest.raises(ValueError, match="channels"):
        metrics.ssim(picture, picture, channels="red")


@pytest.mark.parametrize("dynamic_range", ["LDR", "HDR"])
def test_flip(dynamic_range, picture):
    assert metrics.flip(picture, picture, dynamic_range) == pytest.approx(0.0, abs=1e-6)
    other = np.clip(picture + 0.3, 0.0, 1.0)
    error = metrics.flip_map(other, picture, dynamic_range)
    assert error.shape == picture.shape[:2]
    assert 0.0 < error.min() and error.max() <= 1.0
    assert metrics.flip(other, picture, dynamic_range) == pytest.approx(error.mean())
    gray = metrics.flip_map(other[..., 0], picture[..., 0], dynamic_range)
    assert gray.shape == picture.shape[:2] and gray.max() > 0.0


def test_flip_of_black_against_white_is_large():
    black, white = np.zeros((16, 16, 3)), np.ones((16, 16, 3))
    assert metrics.flip(black, white) > 0.9


def test_flip_argument_errors(picture):
    with pytest.raises(ValueError, match="outside"):
        metrics.flip(picture * 2.0, picture)
    with pytest.raises(ValueError, match="outside"):
        metrics.flip(picture - 1.0, picture, "HDR")
    with pytest.raises(ValueError, match="dynamic_range"):
        metrics.flip(picture, picture, "SDR")
    with pytest.raises(ValueError, match="pixels_per_degree"):
        metrics.flip(picture, picture, pixels_per_degree=0.0)
    with pytest.raises(ValueError, match="black"):
        metrics.flip(picture, np.zeros_like(picture), "HDR")


def test_flip_package_is_imported_only_when_asked_for():
    code = "import sys, previs.metrics; sys.exit('flip_evaluator' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

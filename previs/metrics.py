"""How far one image is from another: RMSE, relative errors, PSNR, SSIM and FLIP.

Every function takes `test` and `reference`: arrays of one shape, (H, W) or (H, W, 3), in linear radiance unless it says
otherwise. All raise ValueError, with a sentence, when the shapes differ or are of another kind, when an image is
empty, and when it holds NaN or infinity: the message says how many values, because a metric that skipped them
would call a broken picture good.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

# Rec. 709, the rendering space of a stage.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: A pixel is lit when a channel of the reference is above this part of the reference's peak.
LIT_THRESHOLD = 1e-3


def rmse(test: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square difference over all pixels and channels, in the unit of the images."""
    test, reference = _pair(test, reference)
    return float(np.sqrt(np.mean((test - reference) ** 2)))


def lit_mask(reference: np.ndarray, threshold: float = LIT_THRESHOLD) -> np.ndarray:
    """The lit pixels of an image, (H, W) bool: any channel above `threshold` times `peak`; none in a black image."""
    reference = _image(reference, "reference")
    bright = reference if reference.ndim == 2 else reference.max(axis=2)
    return bright > threshold * peak(reference)


def peak(reference: np.ndarray) -> float:
    """The 99.9th percentile of all values of the reference, which a few singular pixels do not move.

    Where that is 0 or less (fewer than one value in a thousand is lit) the maximum stands in; 0 for a black image.
    """
    reference = _image(reference, "reference")
    value = float(np.percentile(reference, 99.9))
    return value if value > 0.0 else max(float(reference.max()), 0.0)


def relative_rmse(test: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square error relative to the mean of the reference over its lit pixels.

    sqrt(Σ (test − reference)² / n) / m, the sum over *all* pixels, n the number of lit values and m their mean in
    the reference (`lit_mask`). Light where the reference has none counts as an error, while an empty background does
    not flatter the result. Against a black reference: 0 for equal images, otherwise inf.
    """
    test, reference = _pair(test, reference)
    lit = reference[lit_mask(reference)]
    squares = float(np.sum((test - reference) ** 2))
    return _ratio(np.sqrt(squares / max(lit.size, 1)), float(lit.mean()) if lit.size else 0.0)


def mean_relative_error(test: np.ndarray, reference: np.ndarray) -> float:
    """Mean absolute error relative to the mean of the reference over its lit pixels.

    (Σ |test − reference| / n) / m with the sum over *all* pixels and n and m as in `relative_rmse`: the share of the
    picture's light that is in the wrong place. Against a black reference: 0 for equal images, otherwise inf.
    """
    test, reference = _pair(test, reference)
    lit = reference[lit_mask(reference)]
    total = float(np.sum(np.abs(test - reference)))
    return _ratio(total / max(lit.size, 1), float(lit.mean()) if lit.size else 0.0)


def psnr(test: np.ndarray, reference: np.ndarray, peak: float | None = None) -> float:
    """Peak signal-to-noise ratio in dB: 20·log10(peak / RMSE); inf for equal images.

    `peak` defaults to the function `peak` of the reference, its 99.9th percentile. Against a black reference the result
    for different images is −inf. Raises ValueError for a given peak that is not positive and finite.
    """
    test, reference = _pair(test, reference)
    scale = _peak_or(peak, reference)
    error = rmse(test, reference)
    if error == 0.0:
        return float("inf")
    return float(20.0 * np.log10(scale / error)) if scale > 0.0 else float("-inf")


def ssim(
    test: np.ndarray,
    reference: np.ndarray,
    peak: float | None = None,
    channels: Literal["luminance", "average"] = "luminance",
) -> float:
    """Structural similarity, 1 for equal images (Wang et al. 2004, eq. 13; K1 = 0.01, K2 = 0.03).

    Local means and variances are weighted by an 11 × 11 Gaussian of standard deviation 1.5, and the index is averaged
    over the positions where that window fits inside the image. The dynamic range L of the paper is `peak`, by
    default the function `peak` of the reference; against a black reference it is 1. Colour images are compared by
    Rec. 709 luminance, or with ``channels="average"`` by the mean over the channels.

    Raises ValueError for an image below 11 × 11 pixels, an unknown `channels`, or a bad peak.
    """
    test, reference = _pair(test, reference)
    if channels not in ("luminance", "average"):
        raise ValueError(f"channels is {channels!r}; known are 'luminance' and 'average'.")
    if min(test.shape[:2]) < 11:
        raise ValueError(f"SSIM needs at least 11 × 11 pixels; the images have {test.shape[1]} × {test.shape[0]}.")
    scale = _peak_or(peak, reference) or 1.0
    if test.ndim == 3 and channels == "luminance":
        test, reference = test @ _LUMINANCE, reference @ _LUMINANCE
    c1, c2 = (0.01 * scale) ** 2, (0.03 * scale) ** 2
    mean_a, mean_b = _gaussian(test), _gaussian(reference)
    variance_a = _gaussian(test * test) - mean_a**2
    variance_b = _gaussian(reference * reference) - mean_b**2
    covariance = _gaussian(test * reference) - mean_a * mean_b
    index = (2.0 * mean_a * mean_b + c1) * (2.0 * covariance + c2)
    index /= (mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2)
    return float(index.mean())


def flip(
    test: np.ndarray,
    reference: np.ndarray,
    dynamic_range: Literal["LDR", "HDR"] = "LDR",
    pixels_per_degree: float = 67.0,
) -> float:
    """Mean of `flip_map`: 0 for images that look the same, 1 at worst."""
    return float(flip_map(test, reference, dynamic_range, pixels_per_degree).mean())


def flip_map(
    test: np.ndarray,
    reference: np.ndarray,
    dynamic_range: Literal["LDR", "HDR"] = "LDR",
    pixels_per_degree: float = 67.0,
) -> np.ndarray:
    """FLIP, the difference seen when flipping between two images, per pixel (H, W) in [0, 1].

    ``"LDR"`` (Andersson et al. 2020) takes sRGB-encoded values in [0, 1]; ``"HDR"`` (Andersson et al. 2021) linear
    values ≥ 0, compared at several exposures chosen from the reference. `pixels_per_degree` is the viewing distance:
    67 is a 0.7 m wide 4K display at 0.7 m. Evaluated by the `flip_evaluator` package, which is imported only here.

    Raises ValueError for values outside these ranges, an unknown `dynamic_range`, a `pixels_per_degree` that is not
    positive, and a black reference in HDR, from which no exposure can be chosen.
    """
    test, reference = _pair(test, reference)
    if dynamic_range not in ("LDR", "HDR"):
        raise ValueError(f"dynamic_range is {dynamic_range!r}; known are 'LDR' and 'HDR'.")
    if not (np.isfinite(pixels_per_degree) and pixels_per_degree > 0.0):
        raise ValueError(f"pixels_per_degree is {pixels_per_degree}; it must be positive.")
    top = 1.0 if dynamic_range == "LDR" else np.inf
    for image, name in ((test, "test"), (reference, "reference")):
        outside = np.count_nonzero((image < 0.0) | (image > top))
        if outside:
            raise ValueError(f"{outside} of {image.size} values of the {name} image are outside [0, {top:g}].")
    if dynamic_range == "HDR" and not reference.any():
        raise ValueError(
            "The reference image is black; HDR-FLIP chooses its exposures from it and has nothing to go by."
        )
    from flip_evaluator import evaluate

    rgb = [
        np.ascontiguousarray(np.broadcast_to(_with_channels(i), (*i.shape[:2], 3)), np.float32)
        for i in (reference, test)
    ]
    error, _, _ = evaluate(*rgb, dynamic_range, applyMagma=False, parameters={"ppd": float(pixels_per_degree)})
    return np.asarray(error, float).reshape(test.shape[:2])


def _with_channels(image: np.ndarray) -> np.ndarray:
    return image[:, :, None] if image.ndim == 2 else image


def _gaussian(image: np.ndarray) -> np.ndarray:
    """Weighted local mean by the 11 × 11 window of SSIM, where it fits: (H−10, W−10[, 3])."""
    weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        windows = np.lib.stride_tricks.sliding_window_view(image, 11, axis=axis)
        image = windows @ weights
    return image


def _ratio(error: float, scale: float) -> float:
    if error == 0.0:
        return 0.0
    return float(error / scale) if scale > 0.0 else float("inf")


def _peak_or(given: float | None, reference: np.ndarray) -> float:
    if given is None:
        return peak(reference)
    if not (np.isfinite(given) and given > 0.0):
        raise ValueError(f"The peak is {given}; it must be positive and finite.")
    return float(given)


def _image(image: np.ndarray, name: str) -> np.ndarray:
    image = np.asarray(image, float)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.size == 0:
        raise ValueError(f"The {name} image has shape {image.shape}; (H, W) or (H, W, 3) is needed.")
    bad = np.count_nonzero(~np.isfinite(image))
    if bad:
        raise ValueError(f"{bad} of {image.size} values of the {name} image are not finite.")
    return image


def _pair(test: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    test, reference = _image(test, "test"), _image(reference, "reference")
    if test.shape != reference.shape:
        raise ValueError(f"The images differ in shape: {test.shape} and {reference.shape}.")
    return test, reference

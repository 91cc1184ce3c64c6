"""The colour of a glowing body, as linear Rec.709 radiance.

The colour is Planck's spectrum seen by the CIE 1931 observer (the multi-lobe fit of Wyman, Sloan and Shirley, JCGT
2013), brought to luminance 1, like `UsdLux.BlackbodyTemperatureAsRgb`. The radiance grows with the fourth power of the
temperature (Stefan–Boltzmann) and is 1 at 6500 K, UsdLux's white: it is relative, and `emission_scale` of the medium
sets its level.
"""

from __future__ import annotations

import numpy as np

REFERENCE_TEMPERATURE = 6500.0
#: Below the first the glow is invisible; above the second the colour no longer changes.
TABLE_RANGE = (500.0, 20000.0)
#: Entries of the table that the renderer holds: as four floats each they fill the smallest uniform block there may be.
TABLE_SIZE = 1024

_SECOND_RADIATION_CONSTANT = 1.438776877e-2  # h c / k, metre kelvin
_XYZ_TO_REC709 = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def _lobe(wavelength: np.ndarray, centre: float, below: float, above: float) -> np.ndarray:
    width = np.where(wavelength < centre, below, above)
    return np.exp(-0.5 * ((wavelength - centre) * width) ** 2)


def _observer(nanometres: np.ndarray) -> np.ndarray:
    """CIE 1931 colour-matching functions, (..., 3)."""
    x = (
        0.362 * _lobe(nanometres, 442.0, 0.0624, 0.0374)
        + 1.056 * _lobe(nanometres, 599.8, 0.0264, 0.0323)
        - 0.065 * _lobe(nanometres, 501.1, 0.0490, 0.0382)
    )
    y = 0.821 * _lobe(nanometres, 568.8, 0.0213, 0.0247) + 0.286 * _lobe(nanometres, 530.9, 0.0613, 0.0322)
    z = 1.217 * _lobe(nanometres, 437.0, 0.0845, 0.0278) + 0.681 * _lobe(nanometres, 459.0, 0.0385, 0.0725)
    return np.stack([x, y, z], axis=-1)


def chromaticity(kelvin: np.ndarray) -> np.ndarray:
    """Linear Rec.709 colour of luminance 1 for temperatures above 0; negative components are cut to 0.

    Args:
        kelvin: any shape.

    Returns:
        Array of that shape with a last axis of 3.
    """
    kelvin = np.maximum(np.asarray(kelvin, float), 1.0)
    nanometres = np.arange(380.0, 781.0, 5.0)
    metres = nanometres * 1e-9
    exponent = _SECOND_RADIATION_CONSTANT / (metres * kelvin[..., None])
    # Relative to its largest value, so that a cold body's spectrum does not underflow.
    log_spectrum = -5.0 * np.log(metres) - exponent - np.log1p(-np.exp(-exponent))
    spectrum = np.exp(log_spectrum - log_spectrum.max(axis=-1, keepdims=True))
    xyz = spectrum @ _observer(nanometres)
    rgb = np.maximum((xyz / xyz[..., 1:2]) @ _XYZ_TO_REC709.T, 0.0)
    return rgb / (rgb @ np.array([0.2126, 0.7152, 0.0722]))[..., None]


def radiance(kelvin: np.ndarray) -> np.ndarray:
    """Relative emitted radiance, linear Rec.709: `chromaticity` times (T / 6500 K)⁴; 0 at and below 0 K."""
    kelvin = np.asarray(kelvin, float)
    level = (np.maximum(kelvin, 0.0) / REFERENCE_TEMPERATURE) ** 4
    return chromaticity(kelvin) * level[..., None]


def table(size: int = TABLE_SIZE) -> np.ndarray:
    """`radiance` at `size` temperatures spaced evenly over `TABLE_RANGE`, float32 (size, 3); 0 at the cold end."""
    values = radiance(np.linspace(*TABLE_RANGE, size))
    values[0] = 0.0
    return values.astype(np.float32)

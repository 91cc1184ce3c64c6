"""The colour of a glowing body."""

import numpy as np
import pytest
from pxr import UsdLux

from previs import blackbody

KELVIN = np.arange(1500.0, 9001.0, 250.0)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def test_colour_has_luminance_one():
    colours = blackbody.chromaticity(np.linspace(600.0, 20000.0, 50))
    np.testing.assert_allclose(colours @ LUMINANCE, 1.0, rtol=1e-12)
    assert (colours >= 0.0).all()


def test_redder_when_colder_and_bluer_when_hotter():
    red, _, blue = blackbody.chromaticity(KELVIN).T
    assert (np.diff(red) < 0.0).all()
    assert (np.diff(blue[blue > 0.0]) > 0.0).all()
    cold, hot = blackbody.chromaticity(np.array([2000.0, 12000.0]))
    assert cold[0] > cold[1] > cold[2]
    assert hot[0] < hot[1] < hot[2]


def test_near_white_at_6500_kelvin():
    """Rec.709's white is daylight, a little greener than the black body, hence not 1 exactly."""
    np.testing.assert_allclose(blackbody.chromaticity(np.array(6500.0)), 1.0, atol=0.06)


@pytest.mark.parametrize("kelvin", KELVIN[::3])
def test_agrees_with_usd(kelvin):
    """UsdLux fits a spline through a few temperatures, so it is only near."""
    theirs = np.array(UsdLux.BlackbodyTemperatureAsRgb(float(kelvin)))
    np.testing.assert_allclose(blackbody.chromaticity(np.array(kelvin)), theirs, atol=0.04 * theirs.max())


def test_radiance_grows_with_the_fourth_power():
    luminance = blackbody.radiance(KELVIN) @ LUMINANCE
    np.testing.assert_allclose(luminance, (KELVIN / 6500.0) ** 4, rtol=1e-12)
    assert blackbody.radiance(np.array(6500.0)) @ LUMINANCE == pytest.approx(1.0)


def test_nothing_glows_at_or_below_zero():
    np.testing.assert_array_equal(blackbody.radiance(np.array([0.0, -100.0])), 0.0)


def test_very_cold_and_very_hot_bodies_are_finite():
    assert np.isfinite(blackbody.radiance(np.array([1.0, 50.0, 1e6]))).all()


def test_table_samples_the_radiance():
    table = blackbody.table(256)
    kelvin = np.linspace(*blackbody.TABLE_RANGE, 256)
    assert table.dtype == np.float32
    assert not table[0].any(), "a body colder than the table is dark"
    np.testing.assert_allclose(table[1:], blackbody.radiance(kelvin[1:]), rtol=1e-6)
    assert (np.diff(table @ LUMINANCE) > 0.0).all()


def test_shape_of_the_input_is_kept():
    assert blackbody.radiance(np.full((2, 3), 3000.0)).shape == (2, 3, 3)
    assert blackbody.chromaticity(np.array(3000.0)).shape == (3,)

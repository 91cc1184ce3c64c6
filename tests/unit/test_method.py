"""The ways to attenuate light: what each is called, stores, and takes where knobs are left to the plan."""

import numpy as np
import pytest
from building import distant, point, smooth_noise, spot, translation, volume

from previs import Medium, Settings
from previs.render.method import (
    METHODS,
    MOST_WEIGHTING,
    THRESHOLD,
    THRESHOLD_INSIDE,
    WEIGHTING_INSIDE,
    method_of,
    stored_curve,
)
from previs.settings import BY_NAME

NOISE = smooth_noise((8, 8, 8))
SUN, INSIDE = distant((0, -1, 0)), point((0.1, 0.2, 0.3))


def cloud(*extinction: float, matrix: np.ndarray | None = None):
    return volume(NOISE, Medium(extinction=extinction or (1.0, 1.0, 1.0)), matrix)


def test_every_choice_has_a_record_and_every_record_is_a_choice() -> None:
    assert set(METHODS) == set(BY_NAME["transmittance"].choices)
    for name, method in METHODS.items():
        assert method.name == name
        assert method_of(Settings(transmittance=name)) is method


def test_the_default_is_slices() -> None:
    method = method_of(Settings())
    assert (method.name, method.curve, method.adaptive) == ("slices", "slices", False)


@pytest.mark.parametrize("name", METHODS)
def test_what_a_record_says_is_what_shaders_are_compiled_for(name: str) -> None:
    """All methods set the same names, so that none is left undefined by a change of the knob."""
    method = METHODS[name]
    defines = method.defines(Settings(transmittance=name))
    assert set(defines) == set(METHODS["march"].defines(Settings()))
    assert defines["HAS_MAPS"] == method.has_maps == (name != "march")
    assert defines["MAP_ADAPTIVE"] == (name in ("quantile", "tfm"))
    assert defines["MAP_CURVE"] == {"quantile": 1, "slices": 2}.get(name, 0)


@pytest.mark.parametrize("choice", BY_NAME["map_filter"].choices)
def test_every_filter_has_a_number_of_its_own(choice: str) -> None:
    numbers = {"nearest": 0, "blend": 1, "stochastic": 2}
    assert METHODS["quantile"].defines(Settings(map_filter=choice))["MAP_FILTER"] == numbers[choice]


@pytest.mark.parametrize(("coefficients", "layers"), [(2, 1), (4, 2), (6, 2), (8, 3), (10, 3), (14, 4), (16, 5)])
def test_a_texel_holds_its_values_and_two_more(coefficients: int, layers: int) -> None:
    """Two more for the end of the range and what lies behind it; all in vectors of four half floats."""
    settings = Settings(coefficients=coefficients)
    for method in METHODS.values():
        if not method.has_coefficients:
            continue
        assert method.layers(settings) == layers
        assert 4 * layers >= coefficients + 2
        assert method.texel_bytes(settings) == 16 + 8 * layers


def test_a_texel_of_slices_holds_a_half_float_for_each() -> None:
    assert METHODS["slices"].texel_bytes(Settings(), 56) == 112


def test_a_plan_says_what_a_method_does() -> None:
    assert METHODS["quantile"].why(6) == "6 depths, quantiles of the transmittance"
    assert METHODS["tfm"].why(14) == "14 coefficients, adaptive range"
    assert METHODS["march"].why(6) == "brute force towards every light"


@pytest.mark.parametrize(("name", "weighting"), [("quantile", 1.5), ("tfm", 2.0), ("tfm-plain", 1.0), ("march", 1.0)])
def test_curves_of_a_light_outside(name: str, weighting: float) -> None:
    for light in (SUN, point((0, 5, 0)), spot((0, 5, 0), (0, 0, 0))):
        assert stored_curve(light, cloud(), Settings(transmittance=name)) == (weighting, THRESHOLD, False)


@pytest.mark.parametrize("name", ["quantile", "tfm"])
def test_a_light_inside_needs_what_is_deep(name: str) -> None:
    """Inside is judged in the volume's own space, and for adaptive ranges alone."""
    settings = Settings(transmittance=name)
    inside = (WEIGHTING_INSIDE, THRESHOLD_INSIDE, False)
    assert stored_curve(INSIDE, cloud(), settings) == inside
    assert stored_curve(INSIDE, cloud(matrix=translation(3, 0, 0)), settings)[:2] != inside[:2]
    assert stored_curve(point((3.1, 0.2, 0.3)), cloud(matrix=translation(3, 0, 0)), settings) == inside
    assert stored_curve(INSIDE, cloud(), Settings(transmittance="tfm-plain")) == (1.0, THRESHOLD, False)


def test_channels_that_differ() -> None:
    """Cosines take a higher power the more channels differ; quantiles stretched levels where they differ much."""
    tfm, quantile = Settings(transmittance="tfm"), Settings(transmittance="quantile")
    assert stored_curve(SUN, cloud(1.0, 2.0, 5.0), tfm) == (5.0, THRESHOLD, False)
    assert stored_curve(SUN, cloud(0.1, 1.0, 10.0), tfm) == (MOST_WEIGHTING, THRESHOLD, False)
    assert stored_curve(SUN, cloud(1.0, 2.0, 8.0), quantile) == (1.5, THRESHOLD, False)
    weighting, _, stretched = stored_curve(SUN, cloud(0.1, 1.0, 10.0), quantile)
    assert stretched
    assert weighting == pytest.approx(16.0)
    # A channel without extinction transmits everything, whatever is stored.
    assert stored_curve(SUN, cloud(0.0, 1.0, 2.0), quantile) == (1.5, THRESHOLD, False)


def test_what_is_given_is_taken() -> None:
    for light in (SUN, INSIDE):
        given = Settings(density_weighting=3.0, threshold=0.2)
        assert stored_curve(light, cloud(), given) == (3.0, 0.2, False)

"""The switch between slices and maps of 6 and of 14 values, and which knobs the panel shows."""

import pytest

from previs import Settings
from previs.ui.map_values import map_values, other_map_values, with_map_values

METHODS = ("slices", "march", "quantile", "tfm", "tfm-plain")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", [6, 14])
def test_pressing_a_number_gives_maps_of_so_many_values(method, number):
    settings = Settings(transmittance=method)
    after = settings.replace(**with_map_values(settings, number))
    assert map_values(after) == number
    assert after.transmittance == (method if method in ("quantile", "tfm", "tfm-plain") else "quantile")


def test_a_method_without_values_has_none():
    assert map_values(Settings()) == map_values(Settings(transmittance="march", coefficients=14)) == 0


@pytest.mark.parametrize(
    ("values", "other"),
    [
        ({"transmittance": "quantile", "coefficients": 6}, 14),
        ({"transmittance": "tfm", "coefficients": 14}, 6),
        ({"transmittance": "quantile", "coefficients": 10}, 14),
        ({}, 6),
        ({"coefficients": 14}, 14),
    ],
)
def test_the_other_number(values, other):
    assert other_map_values(Settings(**values)) == other


def test_the_panel_hides_what_has_no_effect():
    pytest.importorskip("imgui_bundle")
    from previs.ui.render_panel import MAIN, PERFORMANCE, idle_knobs

    maps_only = {"coefficients", "density_weighting", "threshold", "map_filter"}
    assert idle_knobs(Settings()) == maps_only
    assert idle_knobs(Settings(transmittance="quantile")) == idle_knobs(Settings(transmittance="tfm")) == {"slices"}
    assert idle_knobs(Settings(transmittance="tfm-plain")) == {"slices", "threshold", "map_filter"}
    assert idle_knobs(Settings(transmittance="march")) == {*maps_only, "slices", "map_size"}
    assert set((*MAIN, *PERFORMANCE)) <= set(Settings())

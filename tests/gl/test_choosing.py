"""Settings chosen for a limit of the error."""

import pytest
from building import box, box_mesh, camera, distant, index_of, scene, smooth_noise, volume

import previs
from previs import Medium, Settings
from previs.render.choosing import CHOSEN, render_within
from previs.render.measure import ErrorMeter

pytestmark = pytest.mark.gl

VIEW = camera((0.5, 1.0, 6.0))
SIZE = (64, 36)
SETTINGS = Settings(shadow_map_size=128, error_pixels=96)
SUN = distant((0.1, -1.0, 0.2), (3.0, 3.0, 3.0))
CLOUD = volume(smooth_noise((12, 12, 12)), Medium(extinction=(8.0, 10.0, 12.0)), path="/Cloud")
INDEX = index_of(scene(CLOUD, box_mesh((-0.5, -2.0, -0.5), (0.5, -1.0, 0.5)), SUN))


@pytest.fixture(scope="module")
def renderer():
    with previs.Renderer() as made:
        yield made


def chosen(renderer, limit, settings=SETTINGS, index=INDEX, **values):
    return render_within(renderer, index, VIEW, SIZE, settings, limit, **values)


def test_a_lower_limit_takes_more(renderer):
    """Both are met, by the picture that comes back; the settings that are not chosen stay."""
    coarse, loose = chosen(renderer, 0.1)
    fine, tight = chosen(renderer, 0.003)
    assert loose.met and tight.met
    assert coarse.error.mean_relative_error.high <= 0.1
    assert fine.error.mean_relative_error.high <= 0.003
    assert loose.knobs != tight.knobs and set(loose.knobs) <= set(CHOSEN)
    assert loose.settings.transmittance == "slices" and "slices" in loose.knobs and "coefficients" not in loose.knobs
    for name in ("steps", "map_size", "slices") if tight.settings.transmittance == "slices" else ("steps",):
        amount = [c.settings[name] or 1e9 for c in (loose, tight)]
        assert amount[0] <= amount[1]
    for choice in (loose, tight):
        assert all(choice.settings[n] == SETTINGS[n] for n in SETTINGS if n not in CHOSEN)
    assert fine.stats["choice"]["met"] and "0.3 %" in str(tight)
    with ErrorMeter(renderer) as meter:
        again = meter.measure(INDEX, VIEW, fine, tight.settings, seed=77)
    assert again.mean_relative_error.low <= 0.003


def test_what_cannot_be_met_is_said_and_the_best_comes_back(renderer):
    image, choice = chosen(renderer, 1e-9)
    assert not choice.met and str(choice).startswith("no settings found")
    assert not image.stats["choice"]["met"]
    _, loose = chosen(renderer, 0.1)
    assert image.error.mean_relative_error.value < 0.005
    assert choice.tried > loose.tried


@pytest.mark.parametrize(
    "fixed",
    [{"transmittance": "tfm"}, {"transmittance": "march"}, {"steps": 700}, {"slices": 56, "map_size": 40}],
    ids=lambda f: ", ".join(f),
)
def test_knobs_that_are_given_keep_their_values(renderer, fixed):
    _, choice = chosen(renderer, 0.02, SETTINGS.replace(**fixed), fixed=fixed)
    assert {name: choice.settings[name] for name in fixed} == fixed
    assert not set(choice.knobs) & set(fixed)
    assert choice.met


def test_all_knobs_given(renderer):
    fixed = {"transmittance": "tfm-plain", "coefficients": 2, "steps": 8, "light_steps": 8, "map_size": 8}
    _, choice = chosen(renderer, 0.001, SETTINGS.replace(**fixed), fixed=fixed)
    assert not choice.met and choice.knobs == {} and "no knob was free" in str(choice)


@pytest.mark.parametrize("content", [(), (SUN,), (box(Medium()), SUN)])
def test_without_voxels_only_steps_are_chosen(renderer, content):
    index = index_of(scene(*content))
    _, choice = chosen(renderer, 0.01, index=index)
    assert choice.met
    assert all(choice.settings[n] == SETTINGS[n] for n in SETTINGS if n != "steps")


def test_settings_of_the_frame_before_are_tried_first(renderer):
    _, choice = chosen(renderer, 0.02)
    _, next_choice = chosen(renderer, 0.02, first=choice.settings.replace(steps=512, coefficients=14), seed=3)
    assert next_choice.met and next_choice.tried == 0 and next_choice.settings.steps == 512
    _, searched = chosen(renderer, 0.02, first=choice.settings.replace(steps=2, map_size=8), seed=3)
    assert searched.met and searched.tried > 0


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_limit_is_above_zero(renderer, limit):
    with pytest.raises(ValueError, match="above 0"):
        chosen(renderer, limit)
    with pytest.raises(ValueError, match="above 0"):
        previs.render("nothing.usda", max_error=limit)

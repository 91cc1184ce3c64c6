"""Quality presets: complete, legal, ordered, and overridden by what is given."""

import pytest

from previs.quality import PRESET_KNOBS, QUALITIES, at_most, preset
from previs.settings import BY_NAME, Settings


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_preset_sets_the_same_knobs_whatever_its_name(quality: str) -> None:
    """One that left a knob alone would take over what another preset or the stage says of it."""
    values = preset(quality)
    assert tuple(values) == PRESET_KNOBS
    assert {name: Settings(**values)[name] for name in values} == values


def test_final_is_the_table_of_settings() -> None:
    assert Settings(**preset("final")) == Settings()


def test_an_unknown_preset_is_named_with_those_there_are() -> None:
    with pytest.raises(ValueError, match="'best' is not one of draft, preview, final"):
        preset("best")


def test_each_preset_asks_for_no_more_than_the_next() -> None:
    for lower, higher in (("draft", "preview"), ("preview", "final"), ("draft", "final")):
        assert dict(at_most(Settings(**preset(higher)), lower)) == dict(Settings(**preset(lower)))
        assert dict(at_most(Settings(**preset(lower)), higher)) == dict(Settings(**preset(lower)))


@pytest.mark.parametrize(
    ("name", "given", "kept"),
    [
        ("steps", 16, 16),
        ("steps", 0, preset("draft")["steps"]),
        ("map_filter", "stochastic", "nearest"),
        ("opacity_cutoff", 0.1, 0.1),
        ("opacity_cutoff", 0.0, preset("draft")["opacity_cutoff"]),
        ("march_divisor", 1, preset("draft")["march_divisor"]),
        ("march_divisor", 4, 4),
        ("slices", 28, 28),
        ("slices", 0, preset("draft")["slices"]),
        ("coefficients", 2, 2),
    ],
)
def test_settings_that_ask_for_less_keep_it(name: str, given, kept) -> None:
    assert at_most(Settings(**{name: given}), "draft")[name] == kept


def test_a_preset_leaves_the_method_of_transmittance_alone() -> None:
    assert "transmittance" not in PRESET_KNOBS
    assert at_most(Settings(transmittance="tfm"), "draft").transmittance == "tfm"


def test_only_the_knobs_that_are_named_are_lowered() -> None:
    found = at_most(Settings(), "draft", ("steps",))
    assert {n for n in BY_NAME if found[n] != Settings()[n]} == {"steps"}

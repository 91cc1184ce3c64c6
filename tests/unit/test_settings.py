"""The table of knobs: what it accepts, what it says to the rest."""

import pytest

from previs.settings import BY_NAME, TABLE, Settings


@pytest.mark.parametrize("setting", TABLE, ids=lambda s: s.name)
def test_every_row_is_complete_and_accepts_its_default(setting):
    assert setting.parse(setting.default) == setting.default
    assert setting.parse(str(setting.default)) == setting.default
    assert type(setting.parse(str(setting.default))) is setting.type
    assert setting.doc.endswith(".") and "\n" not in setting.doc
    assert setting.name.isidentifier() and setting.name == setting.name.lower()
    assert setting.flag == "" or setting.flag == "--" + setting.name.replace("_", "-")


def test_names_and_flags_are_unique():
    assert len(BY_NAME) == len(TABLE)
    flags = [s.flag for s in TABLE if s.flag]
    assert len(set(flags)) == len(flags)


LIMITED = [s for s in TABLE if s.minimum is not None or s.maximum is not None]


@pytest.mark.parametrize("setting", LIMITED, ids=lambda s: s.name)
def test_ranges_are_inclusive_and_end(setting):
    step = setting.step or 1
    for end, outwards in ((setting.minimum, -step), (setting.maximum, step)):
        if end is None:
            continue
        end = setting.type(end)
        assert setting.parse(end) == end
        if setting.automatic and end + outwards == 0:
            outwards *= 2  # 0 is legal besides the range
        beyond = end + outwards if setting.type is int else end + outwards * 1e-3 * max(abs(end), 1.0)
        with pytest.raises(ValueError, match=f"^{setting.name}: ") as error:
            setting.parse(beyond)
        assert setting.accepts() in str(error.value)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("coefficients", "14", 14),
        ("coefficients", 14.0, 14),
        ("steps", " 12 ", 12),
        ("threshold", "1e-3", 1e-3),
        ("projective_steps", "off", False),
        ("projective_steps", "Yes", True),
        ("projective_steps", 1, True),
        ("transmittance", "march", "march"),
    ],
)
def test_text_becomes_the_type_of_the_knob(name, text, value):
    parsed = BY_NAME[name].parse(text)
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [
        ("coefficients", 7, "an even number from 2 to 16"),
        ("coefficients", "six", "an even number from 2 to 16"),
        ("coefficients", 6.5, "an even number"),
        ("coefficients", True, "an even number"),
        ("coefficients", None, "an even number"),
        ("coefficients", 18, "an even number from 2 to 16"),
        ("antialias", "1.5", "a whole number from 1 to 16"),
        ("steps", float("inf"), "0 or a whole number"),
        ("steps", float("nan"), "0 or a whole number"),
        ("threshold", "nan", "0 or a number from 1e-06 to 0.5"),
        ("ambient", -0.5, "a number of 0 or more"),
        ("projective_steps", "maybe", "true or false"),
        ("transmittance", "TFM", "one of slices, quantile, tfm, tfm-plain, march"),
        ("map_filter", "", "one of blend, stochastic, nearest"),
    ],
)
def test_an_illegal_value_is_named_with_what_would_be_legal(name, value, accepted):
    with pytest.raises(ValueError) as error:
        Settings(**{name: value})
    assert str(error.value).startswith(f"{name}: {value!r} is not {accepted}")


def test_unknown_knob_lists_the_known_ones():
    with pytest.raises(ValueError, match="unknown setting 'coeficients'") as error:
        Settings(coeficients=6)
    assert all(name in str(error.value) for name in BY_NAME)


def test_settings_are_a_complete_immutable_mapping():
    settings = Settings(steps=10)
    assert dict(settings) == {s.name: s.default for s in TABLE} | {"steps": 10}
    assert len(settings) == len(TABLE)
    assert settings.steps == settings["steps"] == 10
    with pytest.raises(AttributeError, match="immutable"):
        settings.steps = 11
    with pytest.raises(AttributeError, match="'stepps'"):
        _ = settings.stepps
    assert repr(settings) == "Settings(steps=10)"
    assert repr(Settings()) == "Settings()"


def test_replace_changes_a_copy():
    settings = Settings(steps=10)
    other = settings.replace(coefficients="14")
    assert (settings.coefficients, other.coefficients, other.steps) == (6, 14, 10)
    with pytest.raises(ValueError, match=r"^coefficients: "):
        settings.replace(coefficients=3)
    with pytest.raises(ValueError, match="unknown setting"):
        settings.replace(colour=3)

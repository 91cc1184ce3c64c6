"""Every hard case with every method that it is about, and that a wrong picture would be seen."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import previs
from previs.bench import hard
from previs.settings import BY_NAME

#: Where the published methods are less accurate than is asked of the default: full-range cosines ring in dense media,
#: cosines of an adaptive range where light falls within a small part of it.
SHORT = {
    "tfm-plain 6": {
        "voxels of depth 100",
        "channels 100 apart",
        "dense channels 100 apart",
        "light inside a dense medium",
        "two blobs with a gap",
        "thin dense sheet",
        "dense layer at the far end",
    },
    "tfm-plain 14": {
        "dense channels 100 apart",
        "light inside a dense medium",
        "two blobs with a gap",
        "thin dense sheet",
        "dense layer at the far end",
    },
    "tfm 6": {"dense channels 100 apart", "thin dense sheet"},
    "tfm 14": {"thin dense sheet", "dense layer at the far end"},
}


def trials() -> Iterator[object]:
    for case in hard.CASES.values():
        for method, coefficients in case.variants():
            label = f"{method} {coefficients}" if coefficients else method
            yield pytest.param(case, method, coefficients, id=f"{case.name}-{label}".replace(" ", "_"))


@pytest.mark.gl
@pytest.mark.parametrize(("case", "method", "coefficients"), list(trials()))
def test_hard_case(renderer: previs.Renderer, case: hard.Case, method: str, coefficients: int) -> None:
    outcome = hard.run_case(renderer, case, method, coefficients)
    assert outcome.verdict != "FAIL", f"{outcome.error} {outcome.note}"
    if outcome.verdict == "short":
        assert case.name in SHORT.get(outcome.label, ()), outcome.error


def test_every_line_is_covered() -> None:
    covered = {line for case in hard.CASES.values() for line in case.lines}
    assert covered == set(hard.LINES)
    assert len(set(hard.LINES)) == len(hard.LINES)


def test_every_method_is_tried() -> None:
    """The reference scenes run with every choice there is, maps with 6 and 14 values."""
    methods = BY_NAME["transmittance"].choices
    variants = {v for case in hard.CASES.values() for v in case.variants()}
    counted = {(m, n) for m in methods if m not in ("slices", "march") for n in (6, 14)}
    assert variants == counted | {("slices", 0), ("march", 0), (hard.ANY, 0)}


def test_the_default_method_is_short_of_nothing() -> None:
    labels = {f"{m} {n}" for case in hard.CASES.values() for m, n in case.variants()}
    assert set(SHORT) <= labels
    assert not any(label.split()[0] == BY_NAME["transmittance"].default for label in SHORT)
    assert set().union(*SHORT.values()) <= set(hard.CASES)


class Sabotaged:
    """A renderer that spoils every picture, or every second one."""

    def __init__(self, renderer: previs.Renderer, spoil, every: int = 1) -> None:
        self.renderer, self.spoil, self.every, self.count = renderer, spoil, every, 0

    def render(self, *arguments) -> previs.Image:
        image = self.renderer.render(*arguments)
        self.count += 1
        return replace(image, color=self.spoil(image.color.copy())) if self.count % self.every == 0 else image


def brighter(color: np.ndarray) -> np.ndarray:
    return color * np.float32(1.05)


def one_nan(color: np.ndarray) -> np.ndarray:
    color[3, 5, 1] = np.nan
    return color


def one_negative(color: np.ndarray) -> np.ndarray:
    color[3, 5, 1] = -1e-3
    return color


@pytest.mark.gl
@pytest.mark.parametrize("spoil", [one_nan, one_negative])
@pytest.mark.parametrize("name", ["voxels thin", "density times two", "no lights", "far from the origin"])
def test_one_bad_pixel_fails(renderer: previs.Renderer, name: str, spoil) -> None:
    """Whatever a case is about, every picture on its way has to be finite and within its bounds."""
    method, coefficients = hard.CASES[name].variants()[-1]
    assert hard.run_case(Sabotaged(renderer, spoil), hard.CASES[name], method, coefficients).verdict == "FAIL"


@pytest.mark.gl
@pytest.mark.parametrize(
    ("name", "every"),
    [
        ("voxels thin", 1),
        ("camera inside", 1),
        ("furnace", 1),
        ("density times two", 2),
        ("mirrored scene", 2),
        ("far from the origin", 2),
        ("bad voxels", 2),
        ("depth through the threshold", 2),
        ("flat volumes", 2),
    ],
)
def test_five_per_cent_of_light_too_much_fails(renderer: previs.Renderer, name: str, every: int) -> None:
    """Against the reference or a closed form at once; pictures compared with one another where they differ."""
    for method, coefficients in hard.CASES[name].variants()[:1]:
        spoiled = Sabotaged(renderer, brighter, every)
        assert hard.run_case(spoiled, hard.CASES[name], method, coefficients).verdict == "FAIL"


def test_a_crash_is_a_failure() -> None:
    class Broken:
        def render(self, *_) -> previs.Image:
            raise previs.PrevisError("no such luck")

    outcome = hard.run_case(Broken(), hard.CASES["furnace"], hard.ANY, 0)
    assert (outcome.verdict, outcome.note) == ("FAIL", "no such luck")


def test_reported_takes_a_word_to_the_user() -> None:
    """What should be said and is not is a failure, not a report."""
    trial = hard.Trial(None, "march", 0)
    trial.told(["/Smoke: repaired: 3 NaN values were cleaned"], "3 NaN")
    assert trial.verdict()[1:] == ("reported", "/Smoke: repaired: 3 NaN values were cleaned")
    trial.told(["/Smoke: repaired: 3 NaN values were cleaned"], "infinite")
    assert trial.verdict()[1] == "FAIL"


def test_a_table_of_outcomes() -> None:
    good = hard.Outcome("furnace", "any", 0, hard.Measure(0.001, 0.01, "furnace off by", "%"), "pass")
    bad = hard.Outcome("one voxel", "tfm", 6, hard.Measure(31.0, 40.0, "PSNR", "dB"), "FAIL", "why")
    lines = hard.table([good, bad]).splitlines()
    assert [line.split()[0] for line in lines] == ["case", "furnace", "one", "1"]
    assert lines[1].endswith("furnace off by 0.1 % (≤ 1 %)")
    assert lines[2].endswith("tfm 6   FAIL     PSNR 31.0 dB (≥ 40.0 dB); why")
    assert lines[3] == "1 pass, 0 reported, 0 short, 1 FAIL"


def test_what_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="there is no case 'nothing'"):
        hard.run(None, names=["nothing"])
    with pytest.raises(ValueError, match="there is no method 'guess'"):
        hard.run(None, methods=["guess"])


@pytest.mark.gl
def test_a_run_tells_how_far_it_is(renderer: previs.Renderer) -> None:
    told = []
    outcomes = hard.run(renderer, ["march"], ["no volume", "one voxel"], lambda part, name: told.append((part, name)))
    assert [(o.case, o.method) for o in outcomes] == [("no volume", "any"), ("one voxel", "march")]
    assert told == [(0.0, "no volume"), (0.5, "one voxel"), (1.0, "")]

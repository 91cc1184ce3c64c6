"""Every hard case with every method that it is about, and that a wrong picture would be seen."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import previs
from previs.bench import hard
from previs.settings import BY_NAME

#: (cases, methods with coefficients, why they fail). A failure that is mended has to leave this list.
KNOWN: tuple[tuple[tuple[str, ...], tuple[str, ...], str], ...] = (
    (
        ("shape thin to solid",),
        ("any",),
        "at the terminator of a solid sphere the light is gone within a small part of a view step",
    ),
    (
        ("voxels of depth 10000", "voxels of depth 1000000"),
        ("march", "tfm 6", "tfm 14", "legendre 6", "legendre 14", "quantile 6", "quantile 14"),
        "all light is in the first part of the first voxel, which a view step does not resolve",
    ),
    (
        ("dense layer at the far end",),
        ("march", "tfm 14"),
        "a view step does not resolve how the density rises to the layer within a voxel",
    ),
    (
        ("sparse column 1600 voxels long",),
        ("march",),
        "a view takes one step per voxel of a long grid, too few for what a voxel holds",
    ),
    (
        ("sparse column 1600 voxels long",),
        ("tfm 6", "tfm-plain 6", "legendre 6", "quantile 6"),
        "a map has at most 512 texels along 1600 voxels, and no note says that it blurs",
    ),
    (
        ("haze round a core 10000 times denser",),
        ("tfm 6", "tfm-plain 6", "legendre 6", "quantile 6"),
        "a curve that falls slowly and then at once takes more values than 6",
    ),
    (
        ("haze round a core 100000000 times denser",),
        ("march", "tfm 6", "tfm-plain 6", "legendre 6", "quantile 6"),
        "voxels less than 3e-8 of the largest one are 0 in half floats, and no note says so",
    ),
    (
        ("channels 100 apart", "dense channels 100 apart"),
        ("quantile 6",),
        "depths placed for the strongest channel leave the weakest with few",
    ),
    (
        ("dense channels 100 apart",),
        ("tfm 6", "legendre 6", "legendre 14", "quantile 14"),
        "one stored curve serves channels 100 times apart",
    ),
    (
        ("two blobs with a gap",),
        ("tfm 6", "tfm 14", "legendre 6", "legendre 14", "quantile 6", "quantile 14"),
        "the range spans the gap, where values say nothing",
    ),
    (("thin dense sheet",), ("tfm 6", "tfm 14"), "cosines ring at a drop within a small part of the range"),
    (
        ("light inside", "light inside a dense medium"),
        ("legendre 14",),
        "the projection on polynomials of degree 13 is further off than on those of degree 5",
    ),
    (
        (
            "voxels of depth 100",
            "voxels of depth 10000",
            "voxels of depth 1000000",
            "channels 100 apart",
            "dense channels 100 apart",
            "two blobs with a gap",
            "thin dense sheet",
            "dense layer at the far end",
            "light inside a dense medium",
        ),
        ("tfm-plain 6",),
        "cosines over the whole way through the bounds ring where the medium is dense, as published",
    ),
    (
        (
            "voxels of depth 10000",
            "voxels of depth 1000000",
            "dense channels 100 apart",
            "two blobs with a gap",
            "thin dense sheet",
            "dense layer at the far end",
            "light inside a dense medium",
        ),
        ("tfm-plain 14",),
        "cosines over the whole way through the bounds ring where the medium is dense, as published",
    ),
)


def reason_to_fail(case: str, label: str) -> str | None:
    return next((why for cases, labels, why in KNOWN if case in cases and label in labels), None)


def trials() -> Iterator[object]:
    for case in hard.CASES.values():
        for method, coefficients in case.variants():
            label = f"{method} {coefficients}" if coefficients else method
            why = reason_to_fail(case.name, label)
            marks = [] if why is None else [pytest.mark.xfail(strict=True, reason=why)]
            yield pytest.param(case, method, coefficients, id=f"{case.name}-{label}".replace(" ", "_"), marks=marks)


@pytest.mark.gl
@pytest.mark.parametrize(("case", "method", "coefficients"), list(trials()))
def test_hard_case(renderer: previs.Renderer, case: hard.Case, method: str, coefficients: int) -> None:
    outcome = hard.run_case(renderer, case, method, coefficients)
    assert outcome.verdict != "FAIL", f"{outcome.error} {outcome.note}"


def test_every_line_is_covered() -> None:
    covered = {line for case in hard.CASES.values() for line in case.lines}
    assert covered == set(hard.LINES)
    assert len(set(hard.LINES)) == len(hard.LINES)


def test_every_method_is_tried() -> None:
    """The reference scenes run with every choice there is, maps with 6 and 14 values."""
    methods = BY_NAME["transmittance"].choices
    variants = {v for case in hard.CASES.values() for v in case.variants()}
    assert variants == {(m, n) for m in methods if m != "march" for n in (6, 14)} | {("march", 0), (hard.ANY, 0)}


def test_known_failures_name_what_there_is() -> None:
    known = {(case.name, v) for case in hard.CASES.values() for v in case.variants()}
    labels = {(name, f"{m} {n}" if n else m) for name, (m, n) in known}
    for cases, methods, _ in KNOWN:
        assert {(c, m) for c in cases for m in methods} <= labels


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
    assert lines[3] == "1 pass, 0 reported, 1 FAIL"


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

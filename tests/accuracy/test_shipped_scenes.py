"""The shipped scenes against the converged march: how accurate the default method is with 6 and with 14 values.

Run with ``pytest -m slow tests/accuracy/test_shipped_scenes.py``; ``previs bench`` measures and times all methods.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import previs
from previs import metrics
from previs.bench import run

WIDTH = 480


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("stage", run.shipped_stages(), ids=lambda path: path.stem)
def test_maps_agree_with_the_converged_march(renderer: previs.Renderer, stage: Path) -> None:
    """14 coefficients reach 45 dB and 6 reach 38 dB, over the whole picture and over the in-scattered light alone."""
    with run.opened(stage, WIDTH) as subject:

        def render(**settings: object) -> previs.Image:
            values = subject.settings.replace(**settings)
            return renderer.render(subject.index, subject.camera, subject.size, values)

        truth = run.converged_march(renderer, subject)
        assert truth.converged, truth
        reference = render(**truth.variant.settings)
        for count, floor in ((14, 45.0), (6, 38.0)):
            image = render(coefficients=count)
            for plane in ("color", "volume"):
                pair = [i.color if plane == "color" else i.aovs["volume"] for i in (image, reference)]
                value, error = metrics.psnr(*pair), metrics.mean_relative_error(*pair)
                print(f"{subject.name} {plane} {count}: {value:.1f} dB, {100 * error:.2f} %")
                assert value >= floor

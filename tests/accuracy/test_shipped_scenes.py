"""The shipped scenes against the converged march: how accurate each transmittance method is, and what it costs.

Run with ``pytest -m slow tests/accuracy/test_shipped_scenes.py``; as a script it measures all coefficients and draws
the plot of the README: ``python tests/accuracy/test_shipped_scenes.py PLOT.png``.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from pathlib import Path

import pytest

import previs
from previs import metrics
from previs.api import choose_camera
from previs.render.context import is_software

SCENES = Path(__file__).parents[2] / "scenes"
NAMES = ("plume", "pyroclastic", "sandstorm", "cloud", "shaft", "duo")
SIZE = (480, 270)
#: Doubling either changes the picture by less than 0.1 % (mean relative error), on every scene.
REFERENCE = {"transmittance": "march", "steps": 1024, "light_steps": 512}


def render(renderer: previs.Renderer, name: str, settings: list[dict], repeats: int = 1):
    """(image, median seconds of the frame) for each of the settings, timed in turns so that drift hits all alike.

    On a software rasteriser the seconds are processor time over the number of cores, which other work on the machine
    does not change.
    """
    software = is_software(renderer.context)
    clock = time.process_time if software else time.perf_counter
    share = (os.cpu_count() or 1) if software else 1
    with previs.open(SCENES / f"{name}.usda") as scene:
        description = scene.describe()
        camera = choose_camera(scene, description, None, None)
        index = previs.RenderIndex()
        index.update(description)
        images, times = {}, {i: [] for i in range(len(settings))}
        for turn in range(repeats + (repeats > 1)):
            for i, values in enumerate(settings):
                renderer.forget_scene()
                begin = clock()
                images[i] = renderer.render(index, camera, SIZE, previs.Settings(**values))
                seconds = (clock() - begin) / share
                # The first turn of several compiles shaders and is not counted.
                if turn > 0 or repeats == 1:
                    times[i].append(seconds)
    return [(images[i], statistics.median(times[i])) for i in range(len(settings))]


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("name", NAMES)
def test_maps_agree_with_the_converged_march(renderer, name):
    """14 coefficients reach 45 dB and 6 reach 38 dB, over the whole picture and over the in-scattered light alone."""
    settings = [REFERENCE, {"coefficients": 14}, {"coefficients": 6}]
    (reference, _), (fine, _), (coarse, _) = render(renderer, name, settings)
    for plane in ("color", "volume"):
        truth = reference.color if plane == "color" else reference.aovs["volume"]
        for image, floor in ((fine, 45.0), (coarse, 38.0)):
            picture = image.color if plane == "color" else image.aovs["volume"]
            value = metrics.psnr(picture, truth)
            error = metrics.mean_relative_error(picture, truth)
            print(f"{name} {plane} {image.stats['settings']['coefficients']}: {value:.1f} dB, {100 * error:.2f} %")
            assert value >= floor


def main(plot: str) -> None:
    """Measure and draw: PSNR of the in-scattered light against time relative to the converged march."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    counts = (2, 6, 10, 14)
    methods = {"tfm": "adaptive maps (tfm)", "tfm-plain": "full-range maps (tfm-plain)"}
    settings = [REFERENCE]
    settings += [{"transmittance": m, "coefficients": n} for m in methods for n in counts]
    figure, axes = pyplot.subplots(2, 3, figsize=(12, 6.4), sharey=True)
    with previs.Renderer() as renderer:
        for axis, name in zip(axes.flat, NAMES, strict=True):
            (reference, slow), *rest = render(renderer, name, settings[:1]) + render(renderer, name, settings[1:], 3)
            truth = reference.aovs["volume"]
            for k, method in enumerate(methods):
                part = rest[k * len(counts) : (k + 1) * len(counts)]
                quality = [metrics.psnr(image.aovs["volume"], truth) for image, _ in part]
                error = [metrics.mean_relative_error(image.aovs["volume"], truth) for image, _ in part]
                speed = [slow / seconds for _, seconds in part]
                for n, q, e, s, (_, seconds) in zip(counts, quality, error, speed, part, strict=True):
                    print(
                        f"{name:12} {method:10} N={n:2} {q:5.1f} dB  {100 * e:6.2f} %  {s:6.1f}x  {seconds:.2f} s",
                        flush=True,
                    )
                axis.plot(speed, quality, "o-", label=methods[method], markersize=4)
                for n, q, s in zip(counts, quality, speed, strict=True):
                    if n in (6, 14):
                        axis.annotate(str(n), (s, q), textcoords="offset points", xytext=(4, 4), fontsize=8)
            axis.set_title(name)
            axis.grid(alpha=0.3)
            axis.set_xlabel("times faster than the converged march")
    for axis in axes[:, 0]:
        axis.set_ylabel("PSNR, dB")
    axes.flat[0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(plot, dpi=100)


if __name__ == "__main__":
    main(sys.argv[1])

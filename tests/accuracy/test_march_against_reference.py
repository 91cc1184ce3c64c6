"""The brute-force march on the GPU against the float64 quadrature; they share no code."""

import numpy as np
import pytest
from building import index_of
from cases import CASES, CONVERGED, Case

import previs
from previs import Settings, metrics
from previs.bench.reference_scene import reference_image

pytestmark = pytest.mark.gl

SIZE = (32, 18)


def kept_pixels(case: Case, width: int, height: int) -> np.ndarray:
    """Pixels (H, W) that are compared: all but those beside a point light inside the medium."""
    if case.singular is None:
        return np.ones((height, width), bool)
    matrix = np.linalg.inv(case.camera.camera_to_world)
    x, y, z = (np.array([*case.singular, 1.0]) @ matrix)[:3]
    left, right, bottom, top = case.camera.conformed(width / height).window()
    column, row = (-x / z - left) / (right - left) * width, (top + y / z) / (top - bottom) * height
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.hypot(columns - column, rows - row) > 3.0 * width / 48.0


def measure(renderer: previs.Renderer, case: Case, size: tuple[int, int], max_error: float) -> float:
    """Mean relative error of the march."""
    settings = Settings(**{**CONVERGED, **case.settings})
    image = renderer.render(index_of(case.scene), case.camera, size, settings)
    truth = reference_image(case.scene, case.camera, *size, settings, max_error)
    kept = kept_pixels(case, *size)[..., None]
    return metrics.mean_relative_error(image.color * kept, truth.color * kept)


@pytest.mark.parametrize("name", CASES)
def test_march_equals_the_quadrature(name: str, renderer: previs.Renderer, record_property) -> None:
    """At converged steps no more of the picture's light is in the wrong place than the case allows, 0.3 % at most."""
    case = CASES[name]()
    error = measure(renderer, case, SIZE, 1e-4)
    record_property("mean_relative_error", error)
    assert error <= case.limit


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_march_equals_the_quadrature_in_larger_pictures(name: str, renderer: previs.Renderer, record_property) -> None:
    """The same in four times the pixels and a tighter reference; run with -v it prints the figures."""
    case = CASES[name]()
    error = measure(renderer, case, (64, 36), 1e-5)
    record_property("mean_relative_error", error)
    assert error <= case.limit


@pytest.mark.parametrize(
    ("name", "at_sixteen_steps", "rounding"),
    # What voxels are rounded to, half floats, stays however fine the steps are.
    [("box and sun", 0.002, 0.0), ("point light outside", 0.004, 0.0), ("grid rotated and stretched", 0.002, 2.4e-5)],
)
def test_the_march_converges_quadratically(
    name: str, at_sixteen_steps: float, rounding: float, renderer: previs.Renderer, record_property
) -> None:
    """Four times the steps, a tenth of the error or less, once they are so short that none is cut for its depth; and
    few steps do already, as deep ones are cut and all are taken analytically."""
    case = CASES[name]()
    truth = reference_image(case.scene, case.camera, *SIZE)
    errors = []
    for steps in (16, 32, 128):
        settings = Settings(**{**CONVERGED, "steps": steps})
        image = renderer.render(index_of(case.scene), case.camera, SIZE, settings)
        errors.append(metrics.mean_relative_error(image.color, truth.color))
        record_property(f"{steps} steps", errors[-1])
    assert errors[0] <= at_sixteen_steps
    assert errors[1] < errors[0]
    assert errors[2] <= 0.1 * errors[1] + rounding

"""Between the texels of a map: one taken at random stands for four that are blended."""

import numpy as np
import pytest
from building import distant, index_of, orthographic_camera, point, scene, smooth_noise, volume
from cases import fog

import previs
from previs import Settings, metrics
from previs.description import SceneDescription

pytestmark = pytest.mark.gl

SIZE = (48, 27)
CLOUD = volume(smooth_noise((24, 24, 24), 4, 4), fog(6.0))
LIGHTS = {
    "sun": distant((-1.0, -0.7, -0.4), (3.0, 3.0, 3.0)),
    "lamp inside": point((0.1, 0.2, 0.0), (1.0, 1.0, 1.0), radius=0.1),
}
PICTURES = 16


def render(renderer: previs.Renderer, description: SceneDescription, shift: float = 0.0, **knobs) -> np.ndarray:
    view = orthographic_camera((1.2, 0.9, 5.5), offset=(shift, 0.37 * shift))
    settings = Settings(**{"steps": 48, "map_size": 12, **knobs})
    return renderer.render(index_of(description), view, SIZE, settings).color


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("method", ["quantile", "tfm"])
def test_a_random_texel_is_unbiased(renderer: previs.Renderer, record_property, light: str, method: str) -> None:
    """Over pictures that are shifted by parts of a pixel its error averages out: a quarter is left of sixteen."""
    description = scene(CLOUD, LIGHTS[light])
    errors, brightness = [], 0.0
    for i in range(PICTURES):
        knobs = {"shift": 0.003 * (i + 1) / PICTURES, "transmittance": method}
        blend = render(renderer, description, map_filter="blend", **knobs)
        errors.append(render(renderer, description, map_filter="stochastic", **knobs) - blend)
        brightness += float(blend.mean()) / PICTURES
    single = float(np.mean([np.sqrt(np.mean(e * e)) for e in errors]))
    together = float(np.sqrt(np.mean(np.mean(errors, axis=0) ** 2)))
    bias = abs(float(np.mean(errors))) / brightness
    record_property("noise of one", single / brightness)
    record_property("of all", together / brightness)
    record_property("bias", bias)
    assert single > 3e-3 * brightness
    assert together < 0.35 * single
    assert bias < 2e-3


def test_a_random_texel_is_the_same_in_the_same_picture(renderer: previs.Renderer) -> None:
    """Drawn again, and by a renderer that knows nothing of the first."""
    description = scene(CLOUD, LIGHTS["sun"])
    first = render(renderer, description, map_filter="stochastic")
    # Something else in between.
    render(renderer, scene(CLOUD, LIGHTS["lamp inside"]), map_filter="stochastic", map_size=16)
    np.testing.assert_array_equal(render(renderer, description, map_filter="stochastic"), first)
    with previs.Renderer() as fresh:
        np.testing.assert_array_equal(render(fresh, description, map_filter="stochastic"), first)


def test_filters_agree_where_texels_do(renderer: previs.Renderer) -> None:
    """A fine map of a smooth medium leaves little to choose; the best of the three is the blend."""
    description = scene(CLOUD, LIGHTS["sun"])
    truth = render(renderer, description, transmittance="march")
    knobs = {"map_size": 128, "coefficients": 14}
    found = {
        name: metrics.psnr(render(renderer, description, map_filter=name, **knobs), truth)
        for name in ("blend", "stochastic", "nearest")
    }
    assert found["blend"] >= max(found.values()) - 1e-9, found
    assert min(found.values()) >= 40.0, found

"""Golden pictures: ``pytest tests/golden --regenerate`` takes the present ones as the right ones."""

from __future__ import annotations

import pytest

import previs
from previs.render.context import is_software


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--regenerate", action="store_true", help="write the golden pictures instead of comparing them")


@pytest.fixture(scope="session")
def regenerate(request: pytest.FixtureRequest) -> bool:
    # Unknown when pytest was started above this folder: options are parsed before this file is read.
    return bool(request.config.getoption("--regenerate", default=False))


@pytest.fixture(scope="session")
def software(renderer: previs.Renderer) -> None:
    """Skip where the pictures come from a GPU, whose rounding nobody promises."""
    with renderer.context:
        if not is_software(renderer.context):
            pytest.skip("golden pictures are compared on the software rasteriser only")

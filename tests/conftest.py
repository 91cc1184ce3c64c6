"""Fixtures of all tests: the renderer that tests share, and a watch on OpenGL's error state."""

from collections.abc import Iterator

import pytest

import previs


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, so that none is left alone at the end: the window's, whose tests wait much, and the
    random scenes'."""
    longest = ("tests/ui", "tests/property")
    items.sort(
        key=lambda item: next((n for n, part in enumerate(longest) if part in item.path.as_posix()), len(longest))
    )


@pytest.fixture(scope="session")
def renderer() -> Iterator[previs.Renderer]:
    """One renderer for the whole session; tests that need it are skipped, with the reason, where there is no OpenGL."""
    try:
        shared = previs.Renderer()
    except previs.PrevisError as error:
        pytest.skip(str(error))
    yield shared
    shared.release()


@pytest.fixture(autouse=True)
def clean_gl_state(request: pytest.FixtureRequest) -> Iterator[None]:
    """A test marked gl leaves no OpenGL error behind."""
    if request.node.get_closest_marker("gl") is None:
        yield
        return
    shared = request.getfixturevalue("renderer")
    yield
    with shared.context:
        assert shared.context.error == "GL_NO_ERROR"

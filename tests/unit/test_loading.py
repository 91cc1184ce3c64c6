"""Opening a stage in a thread: its result, what is left out, cancelling at any moment, and errors of any kind."""

import threading

import pytest
from stages import PREVIS_VOLUME, SMOKE_AND_LAMP, usda, write_field

from previs.errors import PrevisError
from previs.scene import Scene
from previs.ui.document import Document
from previs.ui.loading import Loading


@pytest.fixture
def shot(tmp_path):
    write_field(tmp_path / "smoke.vdb")
    path = tmp_path / "shot.usda"
    path.write_text(usda(SMOKE_AND_LAMP) + PREVIS_VOLUME % "")
    return path


@pytest.fixture
def closed(monkeypatch) -> list[Scene]:
    """The scenes that were closed."""
    scenes = []
    close = Scene.close
    monkeypatch.setattr(Scene, "close", lambda scene: (scenes.append(scene), close(scene))[1])
    return scenes


def nothing(_document: Document, _progress) -> None:
    pass


class Gate:
    """A `prepare` that stops in the middle until it is let go."""

    def __init__(self) -> None:
        self.reached, self.go = threading.Event(), threading.Event()

    def __call__(self, _document: Document, progress) -> None:
        self.reached.set()
        assert self.go.wait(10.0)
        progress(0.5)


def loaded(*args, **options) -> Loading:
    loading = Loading(*args, **options)
    loading.wait(20.0)
    assert loading.done
    return loading


def test_a_stage_is_opened_and_prepared(shot) -> None:
    prepared = []
    loading = loaded(shot, lambda document, progress: (prepared.append(document), progress(1.0)), time=3.0)
    assert loading.error == ""
    assert not loading.cancelled
    assert loading.progress == 1.0
    assert prepared == [loading.document]
    assert loading.document.time == 3.0
    assert set(loading.document.description.volumes) == {"/V"}
    loading.document.close()


def test_progress_says_what_is_done(shot) -> None:
    gate = Gate()
    loading = Loading(shot, gate)
    assert gate.reached.wait(20.0)
    assert not loading.done
    assert 0.0 < loading.progress < 1.0
    assert loading.label == "Packing voxels"
    gate.go.set()
    loading.wait(20.0)
    loading.document.close()


def test_what_cannot_be_read_is_left_out(shot, tmp_path, closed) -> None:
    (tmp_path / "smoke.vdb").write_bytes(b"no voxels")
    loading = loaded(shot, nothing)
    assert "smoke.vdb" in loading.error
    assert set(loading.document.description.lights) == {"/L"}
    assert not loading.document.description.volumes
    assert len(closed) == 1, "the attempt that failed"
    # Once the file is mended it is there.
    write_field(tmp_path / "smoke.vdb")
    loading.document.reload()
    assert set(loading.document.description.volumes) == {"/V"}
    loading.document.close()


def test_a_file_that_is_no_stage(tmp_path) -> None:
    path = tmp_path / "no.usda"
    path.write_text("no usda")
    loading = loaded(path, nothing)
    assert loading.document is None
    assert "no.usda" in loading.error
    loading = loaded(tmp_path / "nowhere.usda", nothing)
    assert loading.document is None
    assert "nowhere.usda" in loading.error


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("deep inside"), OSError("no disk"), KeyError("x")])
def test_no_error_is_lost_in_the_thread(shot, closed, error) -> None:
    """A thread that dies in silence would leave the window waiting for nothing, or empty without a reason."""

    def fail(_document, _progress) -> None:
        raise error

    loading = loaded(shot, fail)
    assert loading.document is None
    assert "shot.usda" in loading.error
    assert "deep inside" in loading.error or not isinstance(error, RuntimeError)
    assert len(closed) == 1


def test_cancelling_while_it_reads(shot, closed) -> None:
    gate = Gate()
    loading = Loading(shot, gate)
    assert gate.reached.wait(20.0)
    loading.cancel()
    assert loading.cancelled
    gate.go.set()
    loading.wait(20.0)
    assert loading.document is None
    assert loading.error == ""
    assert len(closed) == 1


def test_cancelling_what_nobody_took(shot, closed) -> None:
    """It was done, but the window had not asked yet."""
    loading = loaded(shot, nothing)
    loading.cancel()
    assert loading.document is None
    assert len(closed) == 1
    loading.cancel()
    assert len(closed) == 1


def test_a_cancelled_attempt_has_no_error(shot, tmp_path) -> None:
    """Also when something was wrong before it was cancelled: nobody wants to know any more."""
    (tmp_path / "smoke.vdb").write_bytes(b"no voxels")
    gate = Gate()
    loading = Loading(shot, gate)
    assert gate.reached.wait(20.0)
    assert loading.error != ""
    loading.cancel()
    gate.go.set()
    loading.wait(20.0)
    assert loading.document is None
    assert loading.error == ""


def test_what_prepare_refuses_is_said(shot) -> None:
    def fail(_document, _progress) -> None:
        raise PrevisError("too large for this device")

    loading = loaded(shot, fail)
    assert loading.document is None
    assert loading.error == "too large for this device"

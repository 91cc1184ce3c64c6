"""Playing a stage: which frame is due when, and reading ahead in a thread."""

import threading
import time

import numpy as np
import pytest
from stages import PREVIS_VOLUME, usda

from previs import vdb
from previs.description import Field
from previs.scene import Scene
from previs.ui import playback as module
from previs.ui.document import Document
from previs.ui.playback import AHEAD, Playback

FRAMES = range(1, 11)
STAGE = """
def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    rel material:binding = </M>
    rel field:density = </V/f>
    rel field:emission = </V/e>
    def OpenVDBAsset "f" { asset filePath.timeSamples = { %s }
        token fieldName = "density" }
    def OpenVDBAsset "e" { asset filePath.timeSamples = { %s }
        token fieldName = "fire" }
}
"""


class Packer:
    """Stands in for the renderer: notes what is packed."""

    def __init__(self) -> None:
        self.packed: list[tuple[str, str]] = []
        self.threads: set[int] = set()

    def prepare_field(self, field: Field, settings, role: str) -> None:
        assert settings.field_memory > 0
        self.threads.add(threading.get_ident())
        self.packed.append((field.grid.name, role))


@pytest.fixture
def sequence(tmp_path):
    for frame in FRAMES:
        voxels = np.full((4, 4, 4), frame, np.float32)
        grids = [vdb.Grid.from_dense(name, voxels) for name in ("density", "fire")]
        vdb.write(tmp_path / f"s{frame}.vdb", grids)
    samples = ", ".join(f"{frame}: @./s{frame}.vdb@" for frame in FRAMES)
    path = tmp_path / "anim.usda"
    path.write_text(usda(STAGE % (samples, samples)) + PREVIS_VOLUME % "")
    return path


@pytest.fixture
def document(sequence):
    opened = Document(Scene.open(sequence), sequence)
    yield opened
    opened.close()


@pytest.fixture
def playback(document):
    made = Playback(document, Packer())
    yield made
    made.close()


def rest(playback: Playback) -> None:
    for job in list(playback._jobs.values()):
        job.result(20.0)


def test_the_first_call_only_starts_the_clock(playback: Playback) -> None:
    assert playback.advance(100.0, 10.0) is None
    assert playback.advance(100.05, 10.0) is None


def test_frames_follow_one_another_when_they_are_due(playback: Playback, document: Document) -> None:
    shown, now = [], 0.0
    while len(shown) < 12:
        following = playback.advance(now, 10.0)
        if following is not None:
            document.set_time(following)
            shown.append(following)
            playback.prefetch()
        rest(playback)
        now += 0.05
    assert shown == [2, 3, 4, 5, 6, 7, 8, 9, 10, 1, 2, 3]
    assert now == pytest.approx(1.3, abs=0.11)


def test_frames_that_there_is_no_time_for_are_skipped(playback: Playback, document: Document) -> None:
    playback.prefetch()
    rest(playback)
    playback.advance(0.0, 10.0)
    assert playback.advance(0.34, 10.0) == 4
    document.set_time(4)
    # The clock goes on from where it should be, not from where it is.
    assert playback.advance(0.39, 10.0) is None
    assert playback.advance(0.40, 10.0) == 5


def test_a_frame_that_is_not_read_yet_is_waited_for(playback: Playback, monkeypatch) -> None:
    go = threading.Event()
    fetch = playback._document.scene.reader.fetch
    monkeypatch.setattr(playback._document.scene.reader, "fetch", lambda r: (go.wait(10.0), fetch(r))[1])
    playback.advance(0.0, 10.0)
    for now in (0.2, 0.3, 5.0):
        assert playback.advance(now, 10.0) is None
    go.set()
    rest(playback)
    assert playback.advance(5.05, 10.0) == 2.0


def test_after_a_pause_nothing_is_skipped(playback: Playback) -> None:
    playback.prefetch()
    rest(playback)
    playback.advance(0.0, 10.0)
    playback.pause()
    assert playback.advance(50.0, 10.0) is None
    assert playback.advance(50.1, 10.0) == 2


def test_the_next_frames_are_read_and_packed_in_a_thread(playback: Playback, document: Document) -> None:
    reader = document.scene.reader
    playback.prefetch()
    rest(playback)
    assert playback.prefetched == {float(t) for t in range(2, 2 + AHEAD)}
    counters = dict(reader.counters)
    assert counters["grids"] == 2 * (1 + AHEAD)
    packer = playback._renderer
    assert sorted(packer.packed) == [("density", "density")] * AHEAD + [("fire", "emission")] * AHEAD
    assert threading.get_ident() not in packer.threads
    document.set_time(4.0)
    assert document.error == ""
    assert reader.counters["grids"] == counters["grids"], "nothing is left to be read"
    playback.prefetch()
    rest(playback)
    assert reader.counters["grids"] == counters["grids"] + 2 * 3


def test_prefetching_again_reads_nothing_twice(playback: Playback, document: Document) -> None:
    for _ in range(3):
        playback.prefetch()
    rest(playback)
    playback.prefetch()
    rest(playback)
    assert document.scene.reader.counters["grids"] == 2 * (1 + AHEAD)


@pytest.mark.parametrize("damage", ["missing", "damaged"])
def test_a_frame_that_cannot_be_read_does_not_stop_the_film(playback, document, sequence, damage) -> None:
    file = sequence.parent / "s3.vdb"
    file.unlink() if damage == "missing" else file.write_bytes(b"no voxels")
    shown, now = [], 0.0
    for _ in range(200):
        following = playback.advance(now, 10.0)
        if following is not None:
            document.set_time(following)
            shown.append((following, document.error))
            playback.prefetch()
        rest(playback)
        now += 0.1
        if len(shown) == 4:
            break
    assert [t for t, _ in shown] == [2, 3, 4, 5]
    assert ["s3.vdb" in error for _, error in shown] == [False, True, False, False]


def test_frames_that_do_not_fit_the_memory_do_not_stop_the_film(playback, document) -> None:
    """What was read ahead may be dropped again before it is shown."""
    document.scene.reader._grids._limit = 1
    shown, now = [], 0.0
    for _ in range(200):
        following = playback.advance(now, 10.0)
        if following is not None:
            document.set_time(following)
            shown.append(following)
            playback.prefetch()
        rest(playback)
        now += 0.1
        if len(shown) == 12:
            break
    assert shown == [2, 3, 4, 5, 6, 7, 8, 9, 10, 1, 2, 3]


def test_no_more_is_read_ahead_than_there_is_memory_for(playback, monkeypatch) -> None:
    """Otherwise the last frame read ahead would take the place of the next one shown."""
    playback.prefetch()
    rest(playback)
    frame = playback._jobs[2.0].result()
    assert frame > 0
    monkeypatch.setattr(module, "MEMORY", int(2.5 * frame))
    playback._document.set_time(6.0)
    playback._document.scene.reader._grids._grids.clear()
    playback._jobs = {7.0: playback._jobs[7.0]}
    playback.prefetch()
    rest(playback)
    assert playback.prefetched == {7.0, 8.0}


def test_closing_does_not_wait_for_a_long_file(document: Document, monkeypatch) -> None:
    go, begun = threading.Event(), threading.Event()
    fetch = document.scene.reader.fetch

    def slow(request):
        begun.set()
        go.wait(10.0)
        return fetch(request)

    monkeypatch.setattr(document.scene.reader, "fetch", slow)
    packer = Packer()
    playback = Playback(document, packer)
    playback.prefetch()
    assert begun.wait(10.0)
    began = time.perf_counter()
    playback.close()
    document.close()
    assert time.perf_counter() - began < 1.0
    jobs = list(playback._jobs.values())
    go.set()
    assert jobs[0].exception(10.0) is None
    assert all(job.cancelled() for job in jobs[1:])
    assert packer.packed == []


def test_editing_while_frames_are_read(playback: Playback, document: Document) -> None:
    """The thread shares the cache with the readings of the main thread, and nothing is lost or read wrongly."""
    for step in range(30):
        playback.prefetch()
        document.edit("Extinction", lambda scene, v=1.0 + step: scene.set_medium("/V", extinction=(v,) * 3))
        document.set_time(float(1 + (3 * step) % 10))
        assert document.error == ""
        volume = document.description.volumes["/V"]
        assert float(volume.density.grid.leaf_values.max()) == document.time
        assert volume.medium.extinction == (1.0 + step,) * 3


def test_a_stage_without_time(tmp_path) -> None:
    path = tmp_path / "still.usda"
    path.write_text(usda('def SphereLight "L" { float inputs:intensity = 2 }'))
    document = Document(Scene.open(path), path)
    playback = Playback(document, Packer())
    playback.prefetch()
    assert playback.advance(0.0, 24.0) is None
    assert playback.advance(9.0, 24.0) is None
    assert playback.prefetched == frozenset()
    playback.close()
    document.close()

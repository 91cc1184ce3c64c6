"""Work beside the drawing: what is read ahead, by whom, how much of it is held, and when failures are said."""

import os
import threading

import pytest
from stages import usda, volume_text, write_field

from previs import PrevisError, Settings
from previs.ahead import ReadAhead, Writing
from previs.scene import Scene


class Packer:
    """Stands for a renderer: notes what is packed, and by which thread."""

    def __init__(self) -> None:
        self.prepared: list[str] = []
        self.packed: list[tuple[str, str, threading.Thread]] = []

    def prepare(self, description, settings) -> None:
        self.prepared += [os.path.basename(v.density.key[0]) for v in description.volumes.values()]

    def prepare_field(self, field, settings, role) -> None:
        self.packed.append((os.path.basename(field.key[0]), role, threading.current_thread()))


@pytest.fixture
def sequence(tmp_path):
    """Four frames of voxels; the file of frame 3 is damaged, that of frame 4 missing."""
    for frame in (1, 2):
        write_field(tmp_path / f"s{frame}.vdb", "density", value=float(frame))
    (tmp_path / "s3.vdb").write_bytes(b"nonsense")
    samples = ", ".join(f"{frame}: @./s{frame}.vdb@" for frame in range(1, 5))
    timed = f"asset filePath.timeSamples = {{ {samples}, }}"
    text = usda(volume_text("s.vdb").replace("asset filePath = @s.vdb@", timed))
    (tmp_path / "a.usda").write_text(text)
    with Scene.open(tmp_path / "a.usda") as scene:
        yield scene


def test_the_next_time_is_read_and_packed_by_another_thread(sequence):
    packer = Packer()
    present = sequence.describe(1)
    with ReadAhead(sequence.reader, packer) as ahead:
        ahead.begin(2, present, Settings())
        ahead.wait()
    assert packer.prepared == ["s1.vdb"]
    [(file, role, thread)] = packer.packed
    assert (file, role) == ("s2.vdb", "density")
    assert thread is not threading.current_thread()
    assert sequence.reader.counters["grids"] == 2
    sequence.describe(2)
    assert sequence.reader.counters["grids"] == 2


def test_usd_is_asked_by_the_calling_thread(sequence, monkeypatch):
    asked = []
    requests = sequence.reader.grid_requests
    monkeypatch.setattr(
        sequence.reader, "grid_requests", lambda time: asked.append(threading.current_thread()) or requests(time)
    )
    with ReadAhead(sequence.reader, Packer()) as ahead:
        ahead.begin(2, sequence.describe(1), Settings())
        ahead.wait()
    assert asked == [threading.current_thread()]


@pytest.mark.parametrize(("frame", "words"), [(3, "s3.vdb: not a readable"), (4, "s4.vdb")])
def test_what_cannot_be_read_is_said_at_its_time(sequence, frame, words):
    packer = Packer()
    with ReadAhead(sequence.reader, packer) as ahead:
        ahead.begin(frame, sequence.describe(1), Settings())
        ahead.wait()
        assert packer.packed == []
        sequence.describe(2)
        with pytest.raises(PrevisError, match=words):
            sequence.describe(frame)


def test_one_time_at_most_is_under_way(sequence):
    """The second waits for the first: what is held does not grow with what is asked for."""
    running = []

    class Slow(Packer):
        def prepare_field(self, field, settings, role) -> None:
            running.append(sum(t.name == "previs reading" for t in threading.enumerate()))
            super().prepare_field(field, settings, role)

    packer = Slow()
    present = sequence.describe(1)
    with ReadAhead(sequence.reader, packer) as ahead:
        for following in (2, 1, 2, 1):
            ahead.begin(following, present, Settings())
        ahead.wait()
    assert running == [1, 1, 1, 1]
    assert [file for file, _, _ in packer.packed] == ["s2.vdb", "s1.vdb"] * 2


def test_memory_that_is_not_there_is_said_by_the_drawing(sequence):
    class Full(Packer):
        def prepare(self, description, settings) -> None:
            raise MemoryError

    packer = Full()
    with ReadAhead(sequence.reader, packer) as ahead:
        ahead.begin(2, sequence.describe(1), Settings())
        ahead.wait()
    assert packer.packed == []


def test_a_picture_is_written_by_another_thread():
    may_end, by = threading.Event(), []

    def write() -> None:
        by.append(threading.current_thread())
        may_end.wait(10)

    writing = Writing(write)
    assert not writing.done
    may_end.set()
    assert writing.wait() >= 0.0
    assert writing.done and by[0] is not threading.current_thread()
    assert not by[0].daemon, "the interpreter must not end before the file is whole"


def test_a_failure_to_write_is_raised_where_it_is_waited_for():
    def write() -> None:
        raise PrevisError("a.png: cannot be written")

    writing = Writing(write)
    with pytest.raises(PrevisError, match=r"a\.png: cannot be written"):
        writing.wait()

"""Frame specifications and numbered file names."""

import pytest

from previs.commands.frames import frame_path, has_placeholder, parse_frames


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("1", [1]),
        ("-3", [-3]),
        ("1:4", [1, 2, 3, 4]),
        ("4:1", [4, 3, 2, 1]),
        ("1:10x3", [1, 4, 7, 10]),
        ("1:9x3", [1, 4, 7]),
        ("10:1x4", [10, 6, 2]),
        ("-2:2x2", [-2, 0, 2]),
        ("1:2x0.25", [1, 1.25, 1.5, 1.75, 2]),
        ("1:3,10, 20:22x2", [1, 2, 3, 10, 20, 22]),
        ("5:5", [5]),
        ("3,1,3,2:1", [3, 1, 2]),
        ("0:0.3x0.1", [0, 0.1, 0.2, 0.3]),
    ],
)
def test_frames(text, frames):
    assert parse_frames(text) == pytest.approx(frames)


@pytest.mark.parametrize("text", ["", "a", "1:", ":3", "1:2:3", "1x2", "1:5x", "1:5x-1", "1:5x0", "1,,2", "nan", "1e3"])
def test_other_text_is_refused_in_a_sentence(text):
    with pytest.raises(ValueError, match=r"^frames '") as error:
        parse_frames(text)
    assert "\n" not in str(error.value)


def test_a_list_that_would_fill_memory_is_refused():
    with pytest.raises(ValueError, match="10000000001 frames"):
        parse_frames("0:1x0.0000000001")


@pytest.mark.parametrize(
    ("path", "frame", "name"),
    [
        ("out/a.###.exr", 7, "out/a.007.exr"),
        ("a.####.png", 12345, "a.12345.png"),
        ("#.png", 3, "3.png"),
        ("a_###.##.exr", 1.5, "a_001.50.exr"),
        ("a.###.###.exr", 101.25, "a.101.250.exr"),
        ("a.###.exr", -7, "a.-07.exr"),
        ("a.###.exr", 2.0000000001, "a.002.exr"),
        ("plain.png", 4, "plain.png"),
        ("folder.##/plain.png", 4, "folder.##/plain.png"),
    ],
)
def test_file_names(path, frame, name):
    assert frame_path(path, frame) == name
    assert has_placeholder(path) == ("#" in path.rsplit("/", 1)[-1])

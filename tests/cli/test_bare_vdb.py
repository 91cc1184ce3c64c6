"""A .vdb file in the place of a stage."""

import json

import numpy as np

import previs
from previs.io import load_color


def test_record_and_info(run, stages, tmp_path):
    done = run("record", stages / "ball.vdb", tmp_path / "a.exr", "-w", 64)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("warning") == 1 and "ball.vdb: approximated: a bare .vdb" in done.stderr
    recorded = load_color(tmp_path / "a.exr")[0]
    with previs.open(stages / "ball.vdb") as scene:
        assert np.array_equal(recorded, previs.render(scene, size=64).color)
    facts = json.loads(run("info", stages / "ball.vdb", "--json").stdout)
    assert facts["volumes"]["/Volume"]["fields"]["density"]["voxels"] == [12, 12, 12]
    assert facts["camera"] == "/Camera"


def test_a_file_that_cannot_be_read(run, tmp_path):
    (tmp_path / "bad.vdb").write_bytes(b"nonsense")
    done = run("record", tmp_path / "bad.vdb", tmp_path / "a.png")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "bad.vdb: not a readable .vdb file" in done.stderr

"""Files of an opened stage: what it depends on, what changes on disk meanwhile, and overrides from and to files."""

import os
import threading

import numpy as np
import pytest
from pxr import Sdf
from stages import PREVIS_VOLUME, usda, write_field

from previs import vdb
from previs.errors import PrevisError
from previs.index import RenderIndex
from previs.scene import Scene

VOLUME = """
def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    rel material:binding = </M>
    rel field:density = </V/f>
    rel field:velocity = </V/v>
    def OpenVDBAsset "f" { asset filePath = @./smoke.vdb@
        token fieldName = "density" }
    def OpenVDBAsset "v" { asset filePath = @./velocity.vdb@
        token fieldName = "v" }
}
"""


@pytest.fixture
def shot(tmp_path):
    """A stage of two layers: shot.usda has lights.usda as a sublayer."""
    write_field(tmp_path / "smoke.vdb")
    path = tmp_path / "shot.usda"
    header = "(\n subLayers = [@./lights.usda@]\n)\n"
    path.write_text(usda(VOLUME).replace("#usda 1.0\n", "#usda 1.0\n" + header) + PREVIS_VOLUME % "")
    (tmp_path / "lights.usda").write_text(usda('def SphereLight "L" { float inputs:intensity = 2 }'))
    return path


def rewrite(path, text):
    """A file with another content and, whatever the clock's grain, another time."""
    before = os.stat(path).st_mtime_ns if os.path.exists(path) else 0
    path.write_text(text)
    os.utime(path, ns=(before + 10**9, before + 10**9))


def names(files):
    return {os.path.basename(file) for file in files}


def intensity(scene):
    return scene.light_values("/L").intensity


# --- what a stage depends on ---------------------------------------------------------------------------------------


def test_files_are_layers_and_the_voxels_shown(shot, tmp_path):
    (tmp_path / "look.usda").write_text("#usda 1.0\n")
    with Scene.open(shot, tmp_path / "look.usda") as scene:
        # Nothing is described yet: a field that may be read counts.
        assert names(scene.files()) == {"shot.usda", "lights.usda", "look.usda", "smoke.vdb"}
        scene.describe()
        assert names(scene.files()) == {"shot.usda", "lights.usda", "look.usda", "smoke.vdb"}
        assert all(os.path.isabs(file) for file in scene.files())


def test_files_that_are_missing_are_waited_for(shot, tmp_path):
    os.remove(tmp_path / "smoke.vdb")
    os.remove(tmp_path / "lights.usda")
    with Scene.open(shot, keep_going=True) as scene:
        scene.describe()
        assert names(scene.files()) == {"shot.usda", "lights.usda", "smoke.vdb"}


def test_files_of_the_time_shown(tmp_path):
    for frame in (1, 2):
        write_field(tmp_path / f"s{frame}.vdb")
    text = usda(VOLUME).replace(
        "asset filePath = @./smoke.vdb@", "asset filePath.timeSamples = { 1: @./s1.vdb@, 2: @./s2.vdb@, }"
    )
    (tmp_path / "a.usda").write_text(text)
    with Scene.open(tmp_path / "a.usda") as scene:
        for frame in (1, 2):
            scene.describe(frame)
            assert names(scene.files()) == {"a.usda", f"s{frame}.vdb"}


# --- reloading -----------------------------------------------------------------------------------------------------


def test_a_layer_that_changed_is_read_again_and_the_edits_stay(shot, tmp_path):
    with Scene.open(shot) as scene:
        index = RenderIndex()
        index.update(scene.describe())
        scene.set_light("/L", radius=3)
        edits = scene.snapshot()
        scene.reload()
        assert intensity(scene) == 2
        rewrite(tmp_path / "lights.usda", usda('def SphereLight "L" { float inputs:intensity = 5 }'))
        scene.reload()
        assert intensity(scene) == scene.authored_light("/L").intensity == 5
        assert scene.light_values("/L").radius == 3
        assert scene.snapshot() == edits
        scene.reader.counters.clear()
        scene.describe()
        assert scene.reader.counters["grids"] == 0


def test_a_session_layer_that_changed_is_read_again(shot, tmp_path):
    look = tmp_path / "look.usda"
    look.write_text(usda('over "L" { float inputs:intensity = 7 }'))
    with Scene.open(shot, look) as scene:
        assert intensity(scene) == 7
        rewrite(look, usda('over "L" { float inputs:intensity = 8 }'))
        scene.reload()
        assert intensity(scene) == 8
        assert not scene.has_overrides


def test_voxels_that_changed_are_read_again_and_no_others(shot, tmp_path):
    with Scene.open(shot) as scene:
        first = scene.describe()
        scene.reload()
        assert scene.describe() is first
        write_field(tmp_path / "smoke.vdb", value=5.0)
        os.utime(tmp_path / "smoke.vdb", ns=(1, 10**18))
        # Until it is asked for, what was read stays.
        assert scene.describe() is first
        scene.reload()
        assert scene.describe().volumes["/V"].density.grid.leaf_values.max() == 5.0
        assert scene.reader.counters["grids"] == 2


@pytest.mark.parametrize("keep_going", [False, True])
def test_what_was_missing_is_found(shot, tmp_path, keep_going):
    os.rename(tmp_path / "smoke.vdb", tmp_path / "away.vdb")
    os.rename(tmp_path / "lights.usda", tmp_path / "away.usda")
    with Scene.open(shot, keep_going=keep_going) as scene:
        if keep_going:
            assert not scene.describe().volumes
        else:
            with pytest.raises(PrevisError, match=r"smoke\.vdb: no such file"):
                scene.describe()
        os.rename(tmp_path / "away.vdb", tmp_path / "smoke.vdb")
        os.rename(tmp_path / "away.usda", tmp_path / "lights.usda")
        scene.reload()
        described = scene.describe()
        assert set(described.volumes) == {"/V"} and set(described.lights) == {"/L"}
        assert scene.authored_light("/L").intensity == 2


def test_reloading_keeps_what_is_in_memory_only(tmp_path):
    with Scene() as scene:
        scene.add_ground()
        scene.reload()
        assert scene.describe().meshes
        assert scene.files() == ()
    path = tmp_path / "a.usda"
    variants = 'def "A" (prepend variantSets = "v") { variantSet "v" = { "x" { def Sphere "S" {}\n }\n } }'
    path.write_text(usda(variants))
    with Scene.open(path, variants={"/A": {"v": "x"}}) as scene:
        scene.reload()
        assert scene.describe().meshes


def test_a_damaged_layer_keeps_what_was_read(shot, tmp_path):
    with Scene.open(shot) as scene:
        scene.describe()
        rewrite(tmp_path / "lights.usda", "#usda 1.0\ndef SphereLight {")
        with pytest.raises(PrevisError, match=r"lights\.usda: cannot be read as USD") as caught:
            scene.reload()
        assert "\n" not in str(caught.value)
        assert intensity(scene) == 2
        rewrite(tmp_path / "lights.usda", usda('def SphereLight "L" { float inputs:intensity = 5 }'))
        scene.reload()
        assert intensity(scene) == 5
        os.remove(tmp_path / "lights.usda")
        with pytest.raises(PrevisError, match=r"lights\.usda: is gone"):
            scene.reload()
        assert intensity(scene) == 5


# --- overrides -----------------------------------------------------------------------------------------------------


def test_loaded_overrides_take_the_place_of_the_edits(shot, tmp_path):
    (tmp_path / "looks").mkdir()
    look = tmp_path / "looks" / "look.usda"
    with Scene.open(shot) as scene:
        scene.set_medium("/V", albedo=0.25)
        scene.add_volume("/Extra", np.full((2, 2, 2), 3.0))
        scene.save_overrides(look)
    with Scene.open(shot) as scene:
        scene.set_light("/L", intensity=9)
        before = scene.snapshot()
        scene.load_overrides(look)
        described = scene.describe()
        assert described.volumes["/V"].medium.albedo == (0.25, 0.25, 0.25)
        assert described.volumes["/Extra"].density.grid.leaf_values.max() == 3.0
        assert intensity(scene) == 2
        scene.restore(before)
        assert intensity(scene) == 9
        assert set(scene.describe().volumes) == {"/V"}
        for name, fragment in (("gone.usda", "no such file"), ("smoke.vdb", "not a USD file")):
            with pytest.raises(PrevisError, match=fragment):
                scene.load_overrides(tmp_path / name)
        assert scene.snapshot() == before


def test_overrides_hold_the_session_layer_that_was_given(shot, tmp_path):
    look = tmp_path / "look.usda"
    look.write_text(usda('over "L" { float inputs:intensity = 7 }'))
    with Scene.open(shot, look) as scene:
        scene.set_light("/L", radius=3)
        scene.save_overrides(tmp_path / "both.usda")
    assert "radius" not in look.read_text()
    with Scene.open(shot, tmp_path / "both.usda") as scene:
        assert (intensity(scene), scene.light_values("/L").radius) == (7, 3)


def test_overrides_into_a_sublayer_of_the_stage_keep_what_it_holds(shot, tmp_path):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "base.usda").write_text(usda('over "L" { float inputs:exposure = 1 }'))
    lights = usda('def SphereLight "L" { float inputs:intensity = 2 }')
    lights = lights.replace("#usda 1.0\n", "#usda 1.0\n(\n subLayers = [@./deep/base.usda@]\n)\n")
    (tmp_path / "lights.usda").write_text(lights)
    with Scene.open(shot) as scene:
        scene.set_light("/L", radius=3)
        scene.save_overrides(tmp_path / "lights.usda")
        assert (intensity(scene), scene.light_values("/L").radius) == (2, 3)
        scene.discard_overrides()
        assert (intensity(scene), scene.light_values("/L").radius) == (2, 3)
        assert scene.light_values("/L").exposure == 1
    assert Sdf.Layer.FindOrOpen(str(tmp_path / "lights.usda")).subLayerPaths == ["deep/base.usda"]


def test_overrides_never_replace_the_stage(shot, tmp_path):
    (tmp_path / "asset.usda").write_text(usda('def Sphere "A" {}'))
    both = tmp_path / "both.usda"
    both.write_text(usda('def "R" (references = @./asset.usda@</A>) {}'))
    with Scene.open(both) as scene:
        scene.set_visible("/R", False)
        for name in ("both.usda", "asset.usda"):
            before = (tmp_path / name).read_bytes()
            with pytest.raises(PrevisError, match=f"{name}: is .* overrides go to a file of their own"):
                scene.save_overrides(tmp_path / name)
            assert (tmp_path / name).read_bytes() == before


def test_a_stage_opened_by_a_relative_path(shot, tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "looks").mkdir()
    write_field(tmp_path / "looks" / "other.vdb", value=4.0)
    look = VOLUME.replace("def ", "over ").replace("smoke.vdb", "other.vdb")
    (tmp_path / "looks" / "look.usda").write_text(usda(look))
    monkeypatch.chdir(tmp_path)
    with Scene.open("shot.usda", "looks/look.usda") as scene:
        monkeypatch.chdir(tmp_path / "elsewhere")
        scene.set_medium("/V", albedo=0.25)
        scene.save_overrides("../out/saved.usda")
        assert scene.describe().volumes["/V"].density.grid.leaf_values.max() == 4.0
        assert scene.authored_medium("/V").albedo == (0.9, 0.9, 0.9)
        scene.reload()
    text = (tmp_path / "out" / "saved.usda").read_text()
    assert "../looks/other.vdb" in text and str(tmp_path) not in text
    with Scene.open("../shot.usda", "../out/saved.usda") as scene:
        described = scene.describe().volumes["/V"]
        assert described.density.grid.leaf_values.max() == 4.0
        assert described.medium.albedo == (0.25, 0.25, 0.25)


# --- reading ahead -------------------------------------------------------------------------------------------------


@pytest.fixture
def sequence(tmp_path):
    """Five frames of voxels; the file of frame 4 is missing."""
    for frame in (1, 2, 3, 5):
        write_field(tmp_path / f"s{frame}.vdb", value=float(frame))
    samples = ", ".join(f"{frame}: @./s{frame}.vdb@" for frame in range(1, 6))
    text = usda(VOLUME).replace("asset filePath = @./smoke.vdb@", f"asset filePath.timeSamples = {{ {samples}, }}")
    (tmp_path / "a.usda").write_text(text)
    with Scene.open(tmp_path / "a.usda") as scene:
        yield scene


def test_grids_fetched_ahead_are_not_read_again(sequence):
    reader = sequence.reader
    assert [os.path.basename(r.file) for r in reader.grid_requests(2)] == ["s2.vdb"]
    sequence.describe(1)
    [request] = reader.grid_requests(2)
    assert os.path.basename(request.file) == "s2.vdb"
    assert not reader.is_fetched(request)
    fetched = []
    threads = [threading.Thread(target=lambda: fetched.append(reader.fetch(request))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert reader.counters["grids"] == 2
    assert reader.is_fetched(request)
    shown = sequence.describe(2).volumes["/V"].density
    assert reader.counters["grids"] == 2
    assert all(f.key == shown.key and f.grid is shown.grid for f in fetched)


def test_requests_leave_out_what_is_not_shown_or_not_there(sequence):
    sequence.describe(1)
    assert sequence.reader.grid_requests(4) == ()
    sequence.set_visible("/V", False)
    sequence.describe(1)
    assert sequence.reader.grid_requests(2) == ()
    sequence.remove("/V")
    assert sequence.reader.grid_requests(2) == ()
    assert names(sequence.files()) == {"a.usda"}


def test_a_request_whose_file_changed_or_went(sequence, tmp_path):
    sequence.describe(1)
    [request] = sequence.reader.grid_requests(2)
    sequence.reader.fetch(request)
    write_field(tmp_path / "s2.vdb", value=9.0)
    os.utime(tmp_path / "s2.vdb", ns=(1, 10**18))
    assert not sequence.reader.is_fetched(request)
    assert sequence.reader.fetch(request).grid.leaf_values.max() == 9.0
    os.remove(tmp_path / "s2.vdb")
    assert not sequence.reader.is_fetched(request)
    with pytest.raises(PrevisError, match=r"/V/f: .*s2\.vdb: No such file"):
        sequence.reader.fetch(request)
    (tmp_path / "s2.vdb").write_bytes(b"nonsense")
    with pytest.raises(PrevisError, match="not a readable"):
        sequence.reader.fetch(request)


def test_frames_ahead_stay_below_the_limit(sequence, monkeypatch):
    sequence.describe(1)
    cache = sequence.reader._grids
    size = next(iter(cache._grids.values())).nbytes
    monkeypatch.setattr(cache, "_limit", 2 * size)
    for frame in (2, 3, 5):
        [request] = sequence.reader.grid_requests(frame)
        sequence.reader.fetch(request)
        assert sequence.reader.is_fetched(request)
    # What is shown stays, of the others the last.
    assert len(cache._grids) == 2
    assert sequence.reader.is_fetched(sequence.reader.grid_requests(1)[0])


def test_progress_of_a_reading(tmp_path):
    text = ""
    for name, size in (("A", 8), ("B", 40), ("C", 8)):
        vdb.write(tmp_path / f"{name}.vdb", [vdb.Grid.from_dense("density", np.random.rand(size, size, size))])
        text += VOLUME.replace('"V"', f'"{name}"').replace("/V/", f"/{name}/").replace("smoke.vdb", f"{name}.vdb")
    (tmp_path / "a.usda").write_text(usda(text + 'def SphereLight "L" {}'))
    with Scene.open(tmp_path / "a.usda") as scene:
        told = []
        scene.describe(progress=lambda fraction, path: told.append((path, fraction)))
        assert [path for path, _ in told] == ["/A", "/B", "/C", "/L"]
        fractions = [fraction for _, fraction in told]
        assert fractions[0] == 0 and fractions == sorted(fractions) and fractions[-1] < 1
        # Nearly all bytes are in B.
        assert fractions[1] < 0.1 and fractions[2] > 0.9
        told.clear()
        scene.set_light("/L", intensity=3)
        scene.describe(progress=lambda fraction, path: told.append(path))
        assert told == ["/L"]


def test_a_stopped_reading_goes_on_where_it_was(shot, tmp_path):
    class Stopped(Exception):
        pass

    def stop(_fraction, path):
        if path == "/V":
            raise Stopped

    with Scene.open(shot) as scene:
        with pytest.raises(Stopped):
            scene.describe(progress=stop)
        assert scene.reader.counters == {"prims": 1}
        described = scene.describe()
        assert set(described.volumes) == {"/V"} and set(described.lights) == {"/L"}
        assert scene.reader.counters == {"grids": 1, "prims": 2}

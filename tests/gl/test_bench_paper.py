"""The tables of the papers, small: what is in them, and that the methods are where they belong."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from previs.bench import media, paper, run

pytestmark = pytest.mark.gl


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "COUNTS", (8,))
    monkeypatch.setattr(paper, "THIN_TO_DENSE", (1.0, 30.0))
    monkeypatch.setattr(paper, "DEPTHS", (50.0,))


def test_the_table_of_transmittance_function_maps(renderer, few) -> None:
    told = []
    made = paper.transmittance_function_maps(
        renderer, size=48, repeats=1, map_size=64, progress=lambda *x: told.append(x)
    )
    smoke, solid, depths = made.tables
    ways = ["published [TFM11]", "tfm-plain", *paper.own_methods()]
    for table, medium in ((smoke, "smoke"), (solid, "solid")):
        assert table.title.startswith(medium)
        assert [row[:2] for row in table.rows] == [("8", way) for way in ways]
    assert smoke.rows[0][2:8] == ("14.78 fps", "–", "99.74 %", "95.49 %", "58.58", "25.50")
    assert solid.rows[0][2:8] == ("14.20 fps", "–", "99.03 %", "82.57 %", "43.27", "15.07")
    # Full-range maps are good in thin media and not in dense ones.
    for thin, dense in (depths.rows[0:2], depths.rows[3:5]):
        assert float(thin[2]) > float(dense[2]) + 10.0 and float(thin[3]) > float(dense[3]) + 10.0
    for item in made.record["media"]:
        rows = {row["variant"]: row for row in item["results"]}
        assert rows["tfm 8"]["psnr"] > rows["tfm-plain 8"]["psnr"] + 5.0
        assert rows["tfm 8"]["ssim"] > 0.99
    assert set(made.figures) == set(made.captions) == {"paper-light-rays", "paper-smoke", "paper-solid"}
    assert told and all(0 <= done < total for _, done, total in told)


def test_the_table_of_adaptive_maps(renderer, few) -> None:
    made = paper.adaptive_maps(renderer, width=48)
    [table] = made.tables
    assert table.header[2:] == ("optical depth 50",)
    found = {row["way"]: row["psnr"] for row in made.record["results"]}
    assert list(found) == [row[0] for row in table.rows]
    for count in (6, 14):
        assert found[f"tfm {count}"] > found[f"tfm-plain {count}"] + 10.0


def test_the_point_that_a_pixel_sees(renderer) -> None:
    """Of a solid that is optically deep it lies in its skin, on the pixel's ray."""
    with media.made_scene(media.solid(), 300.0, 0.5) as scene:
        subject = run.subject_of(scene, "solid", "solid", 33)
        point = paper.seen_point(subject, (16, 16))
        camera = scene.camera("/Camera")
    eye = camera.camera_to_world[3, :3]
    along = (point - eye) / np.linalg.norm(point - eye)
    assert along @ -camera.camera_to_world[2, :3] == pytest.approx(1.0, abs=1e-9)
    inside = media.solid()
    voxel = ((point + 1.0) / 2.0 * media.SIDE).astype(int)
    before = ((point - 0.1 * along + 1.0) / 2.0 * media.SIDE).astype(int)
    assert inside[tuple(voxel)] == 1.0 and inside[tuple(before)] == 0.0

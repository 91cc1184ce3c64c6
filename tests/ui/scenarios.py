"""What a user does in the window, as functions of a `Hand`; run by `driver.py`, asserted on here."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from driver import Hand
from imgui_bundle import hello_imgui, imgui

import previs

CTRL, SHIFT = imgui.Key.mod_ctrl, imgui.Key.mod_shift


def passes(hand: Hand) -> set[str]:
    """Kinds of the passes that the last change ran for its first picture, but for what goes with a draft's march."""
    return {name.split(" ")[0] for name in hand.app.picture.executed} - {"upsample"}


def relit(hand: Hand) -> set[str]:
    """Kinds of the passes that run when media attenuate light differently."""
    surfaces = {"surface"} if hand.document.description.meshes else set()
    return {"transmittance_map", "march", "composite"} | surfaces


def outliner(path: str, item: str = "##row") -> str:
    """The test engine's name of an item of a prim's row: "##row", "eye" or "solo"."""
    return "//Outliner/" + path.replace("/", "\\/") + "/" + item


def shown(hand: Hand) -> np.ndarray:
    """The picture as the window shows it, (H, W, 3) of 0 to 255, rows from the top."""
    texture = hand.app.shown
    assert texture is not None
    width, height = texture.size
    data = hand.call(lambda: texture.read(alignment=1))
    return np.frombuffer(data, np.uint8).reshape(height, width, 4)[::-1, :, :3].astype(int)


def opens_and_refines(hand: Hand) -> None:
    hand.open()
    hand.seen()
    assert hand.app.picture.level in ("draft", "final")
    hand.finish()
    picture = hand.app.picture
    assert picture.plan is not None
    assert (picture.plan.width, picture.plan.height) == hand.app.size, "the picture has the panel's pixels"
    color = hand.picture()
    assert np.isfinite(color).all() and color.max() > 0.0
    hand.frames(3)
    # Exposed so that it can be seen, whatever the units of the lights.
    assert 60 < np.percentile(shown(hand).max(axis=-1), 99) <= 255
    hand.until(lambda: not hand.app.busy, "the window to rest")
    before = picture.serial
    hand.frames(20)
    assert picture.serial == before, "a finished picture is not drawn again"
    hand.capture("opened")
    truth = hand.call(lambda: previs.render(hand.document.path, hand.app.camera(), hand.app.size))
    np.testing.assert_array_equal(truth.color, color)


def coefficients(hand: Hand) -> None:
    """Slices | 6 | 14: a number is a wish for maps, and there is a way back."""

    def light() -> tuple[str, int]:
        return hand.document.settings.transmittance, hand.document.settings.coefficients

    hand.open()
    hand.finish()
    assert light() == ("slices", 6)
    slices = hand.picture()
    hand.press(imgui.Key._6)
    assert light() == ("quantile", 6)
    hand.finish()
    six = hand.picture()
    assert np.abs(six - slices).max() > 1e-4
    hand.press(imgui.Key._4)
    assert light() == ("quantile", 14)
    hand.seen()
    assert passes(hand) == relit(hand)
    hand.finish()
    fourteen = hand.picture()
    assert np.abs(six - fourteen).max() > 1e-4
    hand.capture("maps")
    hand.press(imgui.Key._6)
    assert light() == ("quantile", 6)
    hand.press(imgui.Key.t)
    assert light() == ("quantile", 14)
    for _ in range(4):
        hand.press(CTRL | imgui.Key.z)
    assert light() == ("slices", 6) and not hand.document.modified, "a number and its method are one entry"
    hand.press(CTRL | SHIFT | imgui.Key.z)
    assert light() == ("quantile", 6)
    hand.click("//Render/coefficients_14")
    assert light() == ("quantile", 14)
    hand.click("//Render/switch_slices")
    assert light() == ("slices", 14)
    hand.finish()
    np.testing.assert_array_equal(hand.picture(), slices)
    hand.capture("slices")


def drags_albedo(hand: Hand) -> None:
    hand.open()
    hand.finish()
    volume = hand.app.view.selection
    assert volume in hand.document.description.volumes, "the first volume is selected when a stage opens"
    before = hand.document.scene.medium(volume)
    picture = hand.picture()
    hand.drag("//Look/density_scale", 40)
    hand.seen()
    assert hand.document.scene.medium(volume).density_scale > before.density_scale
    assert passes(hand) == relit(hand)
    assert hand.document.undo_label and hand.document.undo() and not hand.document.undo_label, "one drag, one entry"
    hand.finish()
    np.testing.assert_array_equal(hand.picture(), picture)
    hand.drag("//Look/albedo", -60)
    hand.seen()
    after = hand.document.scene.medium(volume)
    assert np.mean(after.albedo) < np.mean(before.albedo)
    assert after.extinction == before.extinction
    np.testing.assert_allclose(after.scattering, np.multiply(after.extinction, after.albedo), rtol=1e-5)
    assert passes(hand) == {"march", "composite"}, "albedo concerns neither maps nor surfaces"
    hand.finish()
    darker = hand.picture()
    assert darker.mean() < picture.mean()
    hand.capture("albedo")
    hand.press(CTRL | imgui.Key.z)
    assert not hand.document.modified
    hand.finish()
    np.testing.assert_array_equal(hand.picture(), picture)


def types_values(hand: Hand) -> None:
    hand.open()
    hand.seen()
    volume = hand.app.view.selection
    stage = hand.document.scene.medium(volume)
    hand.type("//Look/density_scale", "2.5")
    assert hand.document.scene.medium(volume).density_scale == 2.5
    hand.type("//Look/density_scale", "-3")
    assert hand.document.scene.medium(volume).density_scale == 0.0, "what is not legal is clamped"
    hand.context.mouse_move("//Look/density_scale")
    hand.context.mouse_click(imgui.MouseButton_.right)
    hand.frames(2)
    hand.click("//$FOCUSED/###reset")
    hand.frames(2)
    assert hand.document.scene.medium(volume) == stage
    assert not hand.document.scene.has_overrides, "nothing is left of the edit"


def wipes(hand: Hand) -> None:
    hand.open()
    hand.finish()
    six = shown(hand)
    hand.press(imgui.Key.w)
    hand.finish_both()
    hand.frames(3)
    both = shown(hand)
    width = both.shape[1]
    other = hand.app.other
    assert other is not None and other.plan is not None
    assert (other.plan.settings.transmittance, other.plan.settings.coefficients) == ("quantile", 6)
    assert np.abs(both[:, : width // 2 - 2] - six[:, : width // 2 - 2]).max() <= 1
    assert np.abs(both[:, width // 2 + 2 :] - six[:, width // 2 + 2 :]).max() > 1
    hand.capture("wipe")
    hand.context.mouse_move_to_pos(hand.picture_position(0.5, 0.3))
    hand._drag(-0.25 * width, 0.0, 6, imgui.MouseButton_.left)
    hand.frames(2)
    assert abs(hand.app.view.divider - 0.25) < 0.02
    assert hand.app.view.camera_path == "" or hand.app.picture.current
    hand.press(imgui.Key.e)
    hand.frames(3)
    assert hand.app.view.compare == "error"
    hand.capture("error")
    hand.press(imgui.Key.e)
    hand.frames(3)
    assert hand.app.view.compare == "off" and hand.app.other is None
    np.testing.assert_array_equal(shown(hand), six)


def compares_with_before(hand: Hand) -> None:
    hand.open()
    hand.finish()
    first = hand.picture()
    hand.type("//Look/density_scale", "3")
    hand.app.view.compare, hand.app.view.compare_with = "wipe", "before"
    hand.finish_both()
    assert hand.app.other is not None
    np.testing.assert_array_equal(hand.call(hand.app.other.read), first)
    assert np.abs(hand.picture() - first).max() > 1e-3
    hand.capture("before")


def saves_overrides(hand: Hand) -> None:
    """The layer is compared with what `previs record` makes of it by the test."""
    hand.open()
    hand.seen()
    hand.type("//Look/density_scale", "1.7")
    hand.click("//Render/coefficients_14")
    assert hand.document.modified
    hand.press(CTRL | imgui.Key.s)
    hand.frames(3)
    target = hand.folder / "look.usda"
    hand.click("//Save overrides/##path")
    hand.context.key_chars_replace_enter(str(target))
    hand.frames(5)
    hand.until(target.exists, "the saved layer")
    assert not hand.document.modified
    hand.finish()
    image = hand.call(hand.app.picture.image)
    assert image is not None
    np.save(hand.folder / "shown.npy", image.color)
    hand.app.export_image(hand.folder / "shown.exr")
    hand.until((hand.folder / "shown.exr").exists, "the exported picture")
    size, camera = hand.app.size, hand.document.description.cameras.get(hand.app.view.camera_path)
    (hand.folder / "view.json").write_text(json.dumps({"size": size, "camera": camera.path if camera else ""}))


def follows_the_disk(hand: Hand) -> None:
    hand.open()
    hand.finish()
    path = Path(hand.document.path)
    volume = hand.app.view.selection
    hand.type("//Look/density_scale", "1.5")
    hand.finish()
    before = hand.picture()
    text = path.read_text()
    assert "inputs:intensity" in text
    path.write_text(text.replace("inputs:intensity = ", "inputs:intensity = 3"))
    hand.until(lambda: any("disk" in m.text for m in hand.app.messages), "the change on disk")
    hand.finish()
    assert hand.document.scene.medium(volume).density_scale == 1.5, "the edits stay"
    assert hand.picture().mean() > 1.5 * before.mean()
    good, version = hand.picture(), hand.document.version
    path.write_text('#usda 1.0\ndef Xform "World" {\n  broken')
    hand.until(lambda: hand.document.error, "the message about the broken file")
    assert path.name in hand.document.error
    assert hand.document.version == version
    np.testing.assert_array_equal(hand.picture(), good)
    hand.capture("broken")
    path.write_text(text)
    hand.until(lambda: not hand.document.error, "the mended file")
    hand.finish()
    np.testing.assert_array_equal(hand.picture(), before)


def picks(hand: Hand) -> None:
    hand.open()
    hand.finish()
    hand.app.select("")
    hand.click_picture(0.5, 0.55)
    assert hand.app.view.selection in hand.document.description.volumes
    hand.click_picture(0.5, 0.97)
    assert hand.app.view.selection in hand.document.description.meshes
    hand.click_picture(0.02, 0.02)
    assert hand.app.view.selection not in hand.document.description.volumes
    light = next(p for p, x in hand.document.description.lights.items() if x.kind == "sphere")
    hand.click(outliner(light))
    assert hand.app.view.selection == light


def moves_the_camera(hand: Hand) -> None:
    hand.open()
    hand.finish()
    stage_camera = hand.app.view.camera_path
    first = hand.app.camera()
    hand.drag_picture(80, 0)
    assert hand.app.view.camera_path == "", "orbiting leaves the stage's camera as it is"
    assert not hand.document.modified
    orbited = hand.app.camera()
    assert np.abs(orbited.camera_to_world - first.camera_to_world).max() > 0.01
    hand.seen()
    hand.drag_picture(0, 60, imgui.MouseButton_.middle)
    hand.drag_picture(0, 60, imgui.MouseButton_.right)
    assert np.abs(hand.app.camera().camera_to_world - orbited.camera_to_world).max() > 0.01
    hand.press(imgui.Key.f)
    bounds = hand.document.description.bounds_of(hand.app.view.selection)
    np.testing.assert_allclose(hand.app.orbit.pivot, 0.5 * (bounds[0] + bounds[1]), atol=1e-6)
    hand.press(imgui.Key.a)
    bounds = hand.document.description.world_bounds()
    np.testing.assert_allclose(hand.app.orbit.pivot, 0.5 * (bounds[0] + bounds[1]), atol=1e-6)
    view = hand.app.camera()
    hand.press(CTRL | SHIFT | imgui.Key.c)
    assert hand.document.modified
    copied = hand.document.description.cameras[hand.app.view.camera_path]
    np.testing.assert_allclose(copied.camera_to_world, view.camera_to_world, atol=1e-6)
    hand.press(CTRL | imgui.Key.z)
    assert not hand.document.modified
    hand.seen()
    assert np.isfinite(hand.picture()).all()
    if stage_camera:
        hand.app.look_through(stage_camera)
        hand.seen()
        np.testing.assert_array_equal(hand.app.camera().camera_to_world, first.camera_to_world)


def lights(hand: Hand) -> None:
    hand.open()
    hand.finish()
    paths = list(hand.document.description.lights)
    hand.app.select(paths[0])
    hand.frames(3)
    bright = hand.picture().mean()
    values = hand.document.scene.light_values(paths[0])
    hand.drag("//Look/exposure", -60)
    hand.finish()
    assert hand.document.scene.light_values(paths[0]).exposure < values.exposure
    assert hand.picture().mean() < bright
    hand.press(CTRL | imgui.Key.z)
    hand.finish()
    hand.press(imgui.Key.s)
    hand.finish()
    alone = hand.picture().mean()
    assert hand.app.view.solo == paths[0] and alone < bright and not hand.document.modified
    hand.press(imgui.Key.s)
    hand.finish()
    assert hand.picture().mean() == bright
    hand.click(outliner(paths[0], "eye"))
    hand.finish()
    assert hand.picture().mean() < bright
    ran = hand.app.picture.executed
    assert not [p for p in ran if p.startswith("transmittance_map")], f"the others' maps are as they were: {ran}"


def inspects(hand: Hand) -> None:
    hand.open()
    hand.finish()
    hand.press(imgui.Key.i)
    hand.click_picture(0.5, 0.55)
    hand.until(lambda: hand.app.probe is not None, "the inspector's curves")
    hand.frames(5)
    hand.capture("inspector")
    serial = hand.app.picture.serial
    hand.frames(10)
    assert hand.app.picture.serial == serial, "inspecting draws no picture anew"
    hand.press(imgui.Key.i)
    assert hand.app.view.inspection is None


def scrubs(hand: Hand) -> None:
    hand.open()
    hand.finish()
    span = hand.document.time_range
    assert span is not None and hand.document.time == span.start
    first = hand.picture()
    hand.press(imgui.Key.right_arrow)
    assert hand.document.time == span.start + 1
    hand.finish()
    second = hand.picture()
    assert np.abs(second - first).max() > 1e-3
    hand.press(imgui.Key.left_arrow)
    hand.finish()
    np.testing.assert_array_equal(hand.picture(), first)
    hand.press(imgui.Key.space)
    seen = set()
    hand.until(lambda: seen.add(hand.document.time) or len(seen) >= 4, "some frames of the animation")
    hand.press(imgui.Key.space)
    hand.until(lambda: len(hand.app.prefetched) > 0, "frames read ahead")
    hand.finish()
    hand.capture("timeline")


def survives_bad_files(hand: Hand) -> None:
    hand.open()
    hand.finish()
    good = hand.picture()
    for name, content in (("bad.usda", "#usda 1.0\n("), ("bad.vdb", "nothing"), ("missing.usda", None)):
        path = hand.folder / name
        if content is not None:
            path.write_text(content)
        hand.app.open(path)
        hand.until(lambda: hand.app.loading is None, "the refusal")
        assert any(m.kind == "error" and name in m.text for m in hand.app.messages), hand.app.messages
    hand.frames(2)
    hand.capture("refused")
    np.testing.assert_array_equal(hand.picture(), good)
    volume = hand.app.view.selection
    assert not hand.app.edit("Bad", lambda scene: scene.set_medium(volume, albedo=7.0))
    assert not hand.document.modified and not hand.document.undo_label
    hand.app.view.color_correction, hand.app.view.ocio_display = "openColorIO", "no such display"
    hand.frames(3)
    assert any("no such display" in m.text for m in hand.app.messages)
    assert hand.app.view.color_correction == "sRGB"


def survives_shader_errors(hand: Hand) -> None:
    from previs.render import shader

    hand.open()
    hand.finish()
    good = hand.picture()
    original = shader.compose

    def broken(*arguments, **defines):
        source = original(*arguments, **defines)
        return replace(source, text=source.text + "\nthis is no GLSL\n")

    shader.compose = broken
    hand.app.edit("Phase", lambda scene: scene.set_medium(hand.app.view.selection, phase="rayleigh"))
    hand.until(lambda: hand.app.picture.error, "the message about the shader")
    hand.frames(3)
    hand.capture("shader_error")
    np.testing.assert_array_equal(hand.picture(), good)
    shader.compose = original
    hand.press(CTRL | imgui.Key.z)
    hand.finish()
    np.testing.assert_array_equal(hand.picture(), good)


def drops_a_vdb(hand: Hand) -> None:
    hand.frames(3)
    assert hand.app.document is None
    hand.capture("welcome")
    hand.app.open(os.environ["PREVIS_TEST_VDB"])
    hand.open()
    hand.finish()
    assert hand.document.description.volumes and hand.document.description.lights
    assert shown(hand).max() > 60
    hand.capture("vdb")


def crashes_after_an_edit(hand: Hand) -> None:
    hand.open()
    hand.seen()
    hand.drag_picture(50, 10)
    np.save(os.environ["PREVIS_CONFIG"] + "/camera.npy", hand.app.camera().camera_to_world)
    hand.type("//Look/density_scale", "2.25")
    hand.until(lambda: list(hand.app.recovery.folder.glob("session-*.json")), "the autosave")
    os._exit(0)


def recovers(hand: Hand) -> None:
    hand.frames(3)
    hand.capture("question")
    hand.click("//Recover edits/Recover")
    hand.open()
    hand.seen()
    volume = next(iter(hand.document.description.volumes))
    assert hand.document.scene.medium(volume).density_scale == 2.25
    assert hand.app.view.camera_path == "", "one looks where one looked"
    looked = np.load(os.environ["PREVIS_CONFIG"] + "/camera.npy")
    np.testing.assert_allclose(hand.app.camera().camera_to_world, looked, atol=1e-9)
    assert hand.document.modified


def asks_before_leaving(hand: Hand) -> None:
    hand.open()
    hand.seen()
    hand.type("//Look/density_scale", "2")
    hand.press(CTRL | imgui.Key.q)
    hand.capture("unsaved")
    hand.click("//Unsaved edits/Cancel")
    assert hand.app.document is not None and hand.document.modified


def rests(hand: Hand) -> None:
    """At rest nothing is drawn anew, and the window is left to wait for events."""
    hand.open()
    hand.finish()
    hand.until(lambda: not hand.app.busy, "the window to rest")
    idling = hello_imgui.get_runner_params().fps_idling
    hand.frames(2)
    serial, shown_before = hand.app.picture.serial, hand.app.shown
    assert idling.enable_idling and 0.0 < idling.fps_idle <= 1.0
    hand.frames(5)
    assert hand.app.picture.serial == serial and hand.app.shown is shown_before
    hand.app.notify("something to be seen for a while")
    hand.frames(2)
    assert not idling.enable_idling, "a message has to go away by itself"


def measures(hand: Hand) -> None:
    """The error of the picture on the screen is found at rest, and never shown for another picture."""
    hand.open()
    hand.finish()
    rest, picture = hand.app.rest, hand.app.picture
    hand.until(lambda: rest.estimate, "the error at rest")
    first = rest.estimate
    assert 0.0 < first.light.mean_relative_error.value < 0.05 and first.pixels == hand.document.settings.error_pixels
    hand.until(lambda: not hand.app.busy, "the window to rest")
    serial = picture.serial
    hand.frames(8)
    assert rest.estimate is first and picture.serial == serial, "nothing is measured or drawn twice"
    hand.capture("measured")
    hand.app.set_setting("steps", 384)
    assert rest.estimate is first, "it is that of the picture until there is another one"
    hand.frames(2)
    assert rest.estimate is None
    hand.until(lambda: rest.progress > 0.0, "the next measurement to begin")
    hand.drag_picture(60, 0)
    assert rest.progress == 0.0 and rest._meter is None and rest.estimate is None, "orbiting drops it"
    hand.finish()
    hand.until(lambda: rest.estimate, "the error of the other view")
    assert rest.estimate.mean_relative_error.value < first.mean_relative_error.value
    hand.app.commands["measure_error"].run()
    hand.app.set_setting("steps", 64)
    hand.finish()
    hand.until(lambda: not hand.app.busy, "the window to rest")
    assert rest.estimate is None and not hand.app.view.measuring


def converges(hand: Hand) -> None:
    """A picture at rest goes on to the truth, the better the further, and comes to an end."""
    from previs.ui import resting

    resting.CONVERGED_ERROR = 0.0
    hand.open()
    hand.app.set_setting("steps", 512)
    hand.finish()
    rest, picture = hand.app.rest, hand.app.picture
    hand.until(lambda: not hand.app.busy, "the window to rest")
    finished = hand.picture()
    pictures, errors = {"final": finished}, {"final": rest.estimate.mean_relative_error.value}
    hand.click("//Render/converge")
    assert hand.app.view.converging

    def followed() -> bool:
        name = f"{picture.level} {picture.finer[0]}"
        if picture.finer[0] and name not in pictures:
            pictures[name] = picture.read()
        if rest.estimate is not None and picture.finer[0]:
            errors[name] = rest.estimate.mean_relative_error.value
        return not hand.app.busy

    tick = hand.app.tick

    def watched() -> None:
        tick()
        with hand.app.context:
            followed()

    hand.app.tick = watched
    hand.until(lambda: not hand.app.busy, "the truth")
    hand.app.tick = tick
    assert picture.level == "exact" and rest.converged and rest.estimate is None
    count = picture.finer[1]
    assert count == 2 and list(pictures) == ["final", *(f"finer {n}" for n in range(1, count)), f"exact {count}"]
    truth = pictures[f"exact {count}"]
    off = [float(np.abs(p - truth).mean()) for p in pictures.values()]
    assert all(b < a for a, b in pairwise(off)), off
    assert list(errors) == [*pictures][:-1] and all(b < a for a, b in pairwise(errors.values())), errors
    serial = picture.serial
    hand.frames(5)
    assert picture.serial == serial and not hand.app.busy
    hand.capture("converged")
    resting.CONVERGED_ERROR = 1.0
    hand.drag_picture(40, 0)
    assert picture.level in ("draft", "preview", "final") and picture.finer[0] == 0, "a movement begins from below"
    hand.finish()
    hand.until(lambda: not hand.app.busy, "the window to rest")
    assert picture.level == "final" and rest.converged, "what is good enough goes no further"


def portrait(hand: Hand) -> None:
    """README's picture of the window, as portrait.png."""
    hand.open()
    hand.finish()
    hand.press(imgui.Key._6)
    hand.drag("//Look/density_scale", 16)
    hand.press(imgui.Key.i)
    hand.click_picture(0.52, 0.5)
    hand.finish()
    hand.until(lambda: hand.app.probe is not None, "the inspector's curves")
    hand.press(imgui.Key.w)
    hand.finish_both()
    hand.context.window_focus("//Look")
    hand.frames(5)
    hand.until(lambda: not hand.app.messages, "the messages to go")
    hand.capture("portrait")

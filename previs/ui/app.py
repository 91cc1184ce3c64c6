"""The application: what is open, what is shown, and what happens between two frames of the window.

`App` knows the document, the view and the pictures, and brings them together in `tick`: it takes in loaded stages and
changed files, asks for the picture that the view wants, and lets it be drawn for a while. It draws no widgets; the
panels are given the app and read and change it through its methods.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl

from ..api import choose_camera
from ..description import Camera, SceneDescription
from ..errors import PrevisError
from ..index import RenderIndex, camera_key
from ..io import auto_exposure
from ..render.display import Compare, DisplayPass, DisplayTransform
from ..render.probe import TransmittanceProbe, probe
from ..scene import Scene
from ..settings import Settings
from .camera_control import OrbitCamera
from .commands import Command
from .document import Document
from .gate import Gate, fitted
from .loading import Loading, packer
from .map_values import other_map_values, with_map_values
from .picking import pick
from .picture import Picture, Request
from .playback import Playback
from .preferences import Preferences
from .recovery import Recovery, RecoveryState
from .resting import Rest
from .state import Inspection, Message, Timings, ViewState
from .watching import FileWatch

#: Seconds after the last change from which the picture refines.
REST_SECONDS = 0.12
#: Seconds that a frame of the window may spend on refining the picture: with the window's own drawing it stays above
#: 30 frames a second.
WORK_SECONDS = 0.016
#: The same once nobody has touched anything for `HANDS_OFF_SECONDS`: nobody waits for the window then, only for the
#: picture. The first movement of the mouse is answered after one such frame at the latest.
HANDS_OFF_WORK_SECONDS = 0.033
HANDS_OFF_SECONDS = 0.6
#: How long messages stay, in seconds.
MESSAGE_SECONDS = {"info": 4.0, "warning": 8.0, "error": 12.0}


class App:
    """See the module's text.

    Args:
        context: the window's OpenGL context.
        preferences: kept between sessions.
        recovery: where edits are saved against crashes.
    """

    def __init__(
        self,
        context: moderngl.Context,
        preferences: Preferences,
        recovery: Recovery,
    ) -> None:
        self.context = context
        self.preferences = preferences
        self.recovery = recovery
        self.document: Document | None = None
        self.loading: Loading | None = None
        self.view = ViewState(
            color_correction=preferences.color_correction,
            ocio_display=preferences.ocio_display,
            ocio_view=preferences.ocio_view,
            gate_mask=preferences.gate_mask,
            measuring=preferences.measure_error,
            converging=preferences.converge,
        )
        self.picture = Picture(context)
        self.rest = Rest(self.picture)
        self.other: Picture | None = None
        self.display = DisplayPass(context)
        self.orbit: OrbitCamera | None = None
        self.gate: Gate = (0.0, 0.0, 1.0, 1.0)
        self.messages: list[Message] = []
        #: Tracebacks of errors that are ours; the window outlives them.
        self.internal_errors: list[str] = []
        self.frames = Timings()
        self.probe: TransmittanceProbe | None = None
        self.playback: Playback | None = None
        #: Size of the view in pixels, set by the viewport in every frame.
        self.size = (640, 360)
        #: When the mouse or the keyboard was last used, a time of `time.monotonic`, set by the window.
        self.touched = 0.0
        #: Whether the user is dragging something just now, set by the window.
        self.dragging = False
        #: What the picture is shown with at the present frame; None before the first picture.
        self.shown: moderngl.Texture | None = None
        self.commands: dict[str, Command] = {}
        self._index, self._other_index = RenderIndex(), RenderIndex()
        self._indexed: Any = None
        self._other_indexed: Any = None
        self._displayed: Any = None
        self._probed: Any = None
        self._watch = FileWatch()
        self._watched: Any = None
        self._moved = self._held = 0.0
        self._camera_state: Any = None
        self._on_open: Callable[[Document], None] | None = None
        #: Keyword arguments of `open` for the stage being opened, and for the one that is.
        self._options: dict[str, Any] = {}
        self._opened_with: dict[str, Any] = {}
        self._export: Path | None = None
        self._said: set[str] = set()
        self._warn_once(preferences.problem)

    # --- messages -------------------------------------------------------------------------------------------------

    def notify(self, text: str, kind: str = "info") -> None:
        """Say something to the user for a while; the same text again only stays longer."""
        until = time.monotonic() + MESSAGE_SECONDS[kind]
        self.messages = [m for m in self.messages if m.text != text]
        self.messages.append(Message(text, kind, until))

    def _warn_once(self, text: str) -> None:
        """Say what goes wrong again and again only the first time."""
        if text and text not in self._said:
            self._said.add(text)
            self.notify(text, "warning")

    # --- documents ------------------------------------------------------------------------------------------------

    def open(
        self, path: str | os.PathLike[str], then: Callable[[Document], None] | None = None, **options: Any
    ) -> None:
        """Start opening a stage or a .vdb file; the present one stays until the new one is there.

        Args:
            path: the file.
            then: called with the document once it is open.
            options: keyword arguments of `Scene.open`, and `time`, the time code to begin with.
        """
        if self.loading is not None:
            self.loading.cancel()
        self._on_open, self._options = then, options
        self.loading = Loading(path, packer(self.picture.renderer), **options)

    def close_document(self) -> None:
        """Let go of the stage."""
        self._stop_playback()
        self.rest.drop()
        self.picture.forget()
        if self.other is not None:
            self.other.release()
            self.other = None
        if self.document is not None:
            self.document.close()
        self.document, self.orbit, self.probe, self.shown = None, None, None, None
        self._export = None
        self._indexed = self._other_indexed = self._displayed = self._probed = self._watched = None
        self._index, self._other_index = RenderIndex(), RenderIndex()

    def _take_loaded(self) -> None:
        loading = self.loading
        if loading is None or not loading.done:
            return
        self.loading = None
        if loading.document is None:
            if loading.error:
                self.notify(loading.error, "error")
                self.preferences.forget_recent(loading.path)
            return
        self.close_document()
        document = self.document = loading.document
        self._opened_with = self._options
        if loading.error:
            self.notify(loading.error, "error")
        kept = self.view
        self.view = ViewState(
            color_correction=kept.color_correction,
            ocio_display=kept.ocio_display,
            ocio_view=kept.ocio_view,
            gate_mask=kept.gate_mask,
            measuring=kept.measuring,
            converging=kept.converging,
            auto_exposure=True,
        )
        if document.time_range is not None:
            self.view.frames_per_second = document.time_range.frames_per_second
        camera = choose_camera(document.scene, document.description, None, document.time_code)
        self.view.camera_path = camera.path if camera.path in document.description.cameras else ""
        self.orbit = OrbitCamera.from_camera(camera, document.description.world_bounds(), document.description.up_axis)
        selection = next(iter(document.description.volumes), "")
        self.view.selection = selection
        self.preferences.add_recent(document.path)
        then, self._on_open = self._on_open, None
        if then is not None:
            then(document)

    # --- edits ----------------------------------------------------------------------------------------------------

    def edit(self, label: str, change: Callable[[Scene], None]) -> bool:
        """Author USD, undoably. A refusal is shown and leaves everything as it was; returns whether it was done."""
        if self.document is None:
            return False
        try:
            self.document.edit(label, change)
        except PrevisError as error:
            self.notify(str(error), "error")
            return False
        return True

    def begin(self, label: str) -> None:
        """Open one entry of the history for all edits until `end`."""
        if self.document is not None:
            self.document.begin(label)

    def end(self) -> None:
        """Close the entry."""
        if self.document is not None:
            self.document.end()

    def set_setting(self, name: str, value: Any) -> bool:
        """Set a render knob, undoably."""
        return self.edit(f"Set {name.replace('_', ' ')}", lambda scene: scene.set_setting(name, value))

    def recover(self, state: RecoveryState, then: Callable[[], None]) -> None:
        """Open the stage of a session that ended badly, put its edits back, undoably, and look where it looked.

        Args:
            state: what was kept of it.
            then: called once the edits are back and kept by this session's own recovery file.
        """

        def put_back(document: Document) -> None:
            if not self.restore_edits(state.snapshot):
                return
            view = state.view
            self.view.selection = str(view.get("selection", ""))
            if document.animated and isinstance(view.get("time"), int | float):
                document.set_time(float(view["time"]))
            if isinstance(view.get("exposure"), int | float):
                self.view.exposure, self.view.auto_exposure = float(view["exposure"]), False
            if self.orbit is not None and "orbit" in view:
                with contextlib.suppress(ValueError):
                    self.orbit = self.orbit.restored(view["orbit"])
            self.view.camera_path = str(view.get("camera", self.view.camera_path))
            self.save_for_recovery()
            then()
            self.notify("The edits are back; save them to keep them")

        options = state.view.get("options", {})
        self.open(state.stage, put_back, **(options if isinstance(options, dict) else {}))

    def restore_edits(self, snapshot: str) -> bool:
        """Put edits from another session in the place of the present ones, undoably; returns whether it was done."""
        if self.document is None:
            return False
        try:
            self.document.restore_edits(snapshot)
        except PrevisError as error:
            self.notify(str(error), "error")
            return False
        return True

    def undo(self) -> None:
        """Take back the last edit."""
        if self.document is not None and (label := self.document.undo()):
            self.notify(f"Undone: {label}")

    def redo(self) -> None:
        """Do the last undone edit again."""
        if self.document is not None and (label := self.document.redo()):
            self.notify(f"Done again: {label}")

    # --- the view -------------------------------------------------------------------------------------------------

    def select(self, path: str) -> None:
        """Select a prim, "" for none."""
        self.view.selection = path

    def camera(self) -> Camera | None:
        """The camera looked through, its aperture fitted to the view."""
        document = self.document
        if document is None or self.orbit is None:
            return None
        aspect = self.size[0] / self.size[1]
        authored = document.description.cameras.get(self.view.camera_path)
        if authored is not None:
            camera, self.gate = fitted(authored, aspect)
            return camera
        self.gate = (0.0, 0.0, 1.0, 1.0)
        return self.orbit.camera(aspect)

    def look_through(self, path: str) -> None:
        """Look through a stage camera, "" for the free one, which takes over the present view."""
        if path == "":
            self.free_camera()
        self.view.camera_path = path

    def free_camera(self) -> OrbitCamera | None:
        """The free camera; when a stage camera is looked through, the free one takes its place first."""
        document = self.document
        if document is None or self.orbit is None:
            return None
        authored = document.description.cameras.get(self.view.camera_path)
        if authored is not None:
            self.orbit = self.orbit.looking_through(authored)
        self.view.camera_path = ""
        return self.orbit

    def move_camera(self, change: Callable[[OrbitCamera], OrbitCamera]) -> None:
        """Move the free camera."""
        orbit = self.free_camera()
        if orbit is not None:
            self.orbit = change(orbit)

    def frame(self, path: str = "") -> None:
        """Move the free camera so that a prim, or "" everything, fills the view."""
        if self.document is None:
            return
        bounds = self.document.description.bounds_of(path) if path else self.document.description.world_bounds()
        if bounds is None:
            return
        aspect = self.size[0] / self.size[1]
        self.move_camera(lambda orbit: orbit.framing(bounds, aspect))

    def click(self, u: float, v: float) -> None:
        """What a click into the picture does, at parts of the width and height from the upper left corner."""
        document, camera = self.document, self.camera()
        if document is None or camera is None:
            return
        found = pick(self._visible(document.description), camera, u, v, self.size)
        if not self.view.inspecting:
            self.select(document.scene.prim_path(found.path) if found is not None else "")
            return
        lights = [p for p, light in self._visible(document.description).lights.items() if light.kind != "dome"]
        if found is None or not lights:
            self.notify("Nothing there that light reaches: click into a volume or onto a surface", "warning")
            return
        light = self.view.selection if self.view.selection in lights else lights[0]
        self.view.inspection = Inspection(tuple(float(x) for x in found.point), light)

    def copy_camera(self) -> None:
        """Author the free camera as a camera of the stage."""
        camera = self.camera()
        if self.document is None or camera is None:
            return
        names = {Path(p).name for p in self.document.description.cameras}
        number = next(n for n in range(1, 10000) if f"view{n}" not in names)
        path = f"/previs_cameras/view{number}"
        if self.edit(f"Add camera view{number}", lambda scene: scene.copy_camera(path, camera)):
            self.look_through(path)
            self.notify(f"Added {path}; it is saved with the overrides")

    def export_image(self, path: str | os.PathLike[str]) -> None:
        """Write the picture of the view, as soon as it is in full quality."""
        self._export = Path(path)
        if self.view.solo:
            self.notify(f"The picture is lit by {self.view.solo} alone, as the view is", "warning")
        if not self.picture.finished:
            self.notify(f"{self._export.name} is written when the picture is finished")

    # --- between two frames ---------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether frames of the window should follow one another: something is being drawn, read or played."""
        if self.loading is not None or self.view.playing or self.messages or self.dragging:
            return True
        if self.document is None:
            return False
        pending = self.picture.pending(False) or (self.other is not None and self.other.pending(False))
        return pending or self.rest.pending or time.monotonic() - self._moved < REST_SECONDS

    def tick(self) -> None:
        """What happens between two frames of the window. An error of ours is said and printed; the window stays."""
        try:
            self._tick()
        except Exception as error:
            text = traceback.format_exc()
            if text not in self.internal_errors:
                self.internal_errors.append(text)
                print(text, file=sys.stderr)
            self.notify(f"previs made an error, details are in the terminal: {type(error).__name__}: {error}", "error")
            if self.view.compare == "off":
                self.picture.give_up()
            self.view.inspection, self.view.compare = None, "off"

    def _tick(self) -> None:
        now = time.monotonic()
        self.messages = [m for m in self.messages if m.until > now]
        self._take_loaded()
        document = self.document
        if document is None:
            return
        self._follow_files(now)
        self._play(now)
        camera = self.camera()
        if camera is None:
            return
        moving = self._request_pictures(document, camera, now)
        hands_off = now - max(self.touched, self._moved) > HANDS_OFF_SECONDS
        seconds = HANDS_OFF_WORK_SECONDS if hands_off else WORK_SECONDS
        resting = self._may_rest(moving, hands_off)
        # What is finer than what was asked for waits for hands that rest.
        if resting or moving or not self.picture.refining or self.picture.pending(moving):
            if self.picture.work(seconds, moving) or self.picture.serial == 0:
                self._first_look()
        if self.other is not None and not self.picture.pending(moving):
            self._work_on_other(self.other, seconds, moving)
        if resting and not self.picture.refining:
            self.rest.work(seconds)
        self._inspect(document)
        self._show()
        self._write_export()
        if self.recovery.tick(self._recovery_state, now) or self.recovery.problem:
            self._warn_once(self.recovery.problem)

    def _may_rest(self, moving: bool, hands_off: bool) -> bool:
        """Whether the finished picture may be measured and refined now; what was begun is dropped where it is not."""
        self.rest.measuring, self.picture.converging = self.view.measuring, self.view.converging
        # By turns, two pictures take each other's voxels out of the atlas.
        waits = self.other is not None and self.other.pending(False)
        self.rest.check(moving or waits)
        if waits:
            self.picture.drop_refinement()
        return hands_off and not (moving or waits or self.picture.pending(False) or self.loading is not None)

    def _work_on_other(self, other: Picture, seconds: float, moving: bool) -> None:
        try:
            other.work(seconds, moving)
        except Exception:
            # The picture itself has nothing to do with it.
            other.give_up()
            self.view.compare = "off"
            raise

    def _request_pictures(self, document: Document, camera: Camera, now: float) -> bool:
        """Ask for the pictures that the view wants; returns whether something moves."""
        solo = self.view.solo if self.view.solo in document.description.lights else ""
        scene_key = (document.version, solo)
        if self._indexed != scene_key:
            self._index.update(self._visible(document.description))
            self._indexed = scene_key
            if self.orbit is not None:
                self.orbit = self.orbit.with_bounds(document.description.world_bounds())
        key = (scene_key, camera_key(camera), self.size)
        if key != self._camera_state:
            self._camera_state, self._moved = key, now
        self.picture.show(Request(key, self._index, camera, self.size, document.settings))
        if not self.dragging:
            self._held = now
        # What is held but changes nothing, a button or the divider, leaves the picture to its refinement.
        dragged = self.dragging and self._moved > self._held
        moving = dragged or self.view.playing or now - self._moved < REST_SECONDS
        self._request_other(document, camera, key)
        return moving

    def _request_other(self, document: Document, camera: Camera, key: Any) -> None:
        if self.view.compare == "off":
            if self.other is not None:
                self.other.release()
                self.other = None
            return
        if self.other is None:
            self.other = Picture(self.context, share=self.picture)
        settings, index = self.compared_settings(document.settings), self._index
        if self.view.compare_with == "before":
            before, seen = document.before, (document.before, key[0][1])
            if self._other_indexed != seen:
                self._other_index.update(self._visible(before.description))
                self._other_indexed = seen
            index, settings = self._other_index, before.settings
            key = (before, key[0][1], key[1:])
        self.other.show(Request((key, tuple(settings.items())), index, camera, self.size, settings))

    def compared_settings(self, settings: Settings) -> Settings:
        """The settings of the picture that is compared with."""
        if self.view.compare_with == "coefficients":
            return settings.replace(**with_map_values(settings, other_map_values(settings)))
        if self.view.compare_with == "march":
            return settings.replace(transmittance="march")
        return settings

    def _visible(self, description: SceneDescription) -> SceneDescription:
        """The description with only the light that is alone, if one is."""
        if self.view.solo not in description.lights:
            return description
        return replace(description, lights={self.view.solo: description.lights[self.view.solo]})

    def _first_look(self) -> None:
        """Expose for a picture that was never seen."""
        if not self.view.auto_exposure or self.picture.texture is None or not self.picture.current:
            return
        color = self.picture.read()
        self.view.exposure = round(auto_exposure(color), 2)
        self.view.auto_exposure = False

    def _show(self) -> None:
        """Draw the picture for the display if anything of it moved."""
        texture = self.picture.texture
        if texture is None:
            self.shown = None
            return
        other = self.other.texture if self.other is not None else None
        view = self.view
        mode = view.compare if other is not None else "off"
        transform = DisplayTransform(
            view.exposure, view.color_correction, view.ocio_display or None, view.ocio_view or None
        )
        compare = Compare(mode, view.divider)
        serials = (self.picture.serial, self.other.serial if self.other is not None else 0, mode)
        state = (serials, self.size, transform, compare)
        if state == self._displayed:
            return
        try:
            self.shown = self.display.draw(texture, self.size, transform, other, compare)
        except PrevisError as error:
            self.notify(str(error), "error")
            view.color_correction = "sRGB"
            return
        self._displayed = state

    def _inspect(self, document: Document) -> None:
        """Measure transmittance where the user clicked, when it or the scene moved and nothing else is moving."""
        inspection = self.view.inspection
        state = (inspection, document.version, self.view.solo)
        if state == self._probed or self.picture.pending(False):
            return
        self._probed = state
        self.probe = None
        if inspection is None or inspection.light not in self._index.lights:
            return
        try:
            self.probe = probe(
                self.picture.renderer, self._index, document.settings, inspection.light, inspection.point
            )
        except PrevisError as error:
            self.notify(str(error), "error")

    def _follow_files(self, now: float) -> None:
        document = self.document
        assert document is not None
        if self._watched != document.version:
            self._watched = document.version
            self._watch.watch(document.scene.files())
        if self._watch.changed(now):
            document.reload()
            self.notify("Read again from disk; the edits stay")
            self._watched = None

    # --- time -----------------------------------------------------------------------------------------------------

    def set_time(self, code: float) -> None:
        """Show another time code."""
        if self.document is not None:
            self.document.set_time(code)

    def step_time(self, frames: int) -> None:
        """Go some frames on, round the range."""
        document = self.document
        if document is None or document.time_range is None:
            return
        document.set_time(document.time_range.after(document.time, frames))

    @property
    def prefetched(self) -> frozenset[float]:
        """Times whose voxels are in memory already."""
        return self.playback.prefetched if self.playback is not None else frozenset()

    def _play(self, now: float) -> None:
        document = self.document
        assert document is not None
        if not document.animated:
            self.view.playing = False
            return
        if self.playback is None:
            self.playback = Playback(document, self.picture.renderer)
        if not self.view.playing:
            self.playback.pause()
            if self.picture.finished:
                self.playback.prefetch()
            return
        if not (self.picture.current or self.picture.error):
            return
        following = self.playback.advance(now, self.view.frames_per_second)
        if following is not None:
            document.set_time(following)
            self.playback.prefetch()

    def _stop_playback(self) -> None:
        if self.playback is not None:
            self.playback.close()
            self.playback = None

    # --- files ----------------------------------------------------------------------------------------------------

    def save_overrides(self, path: str | os.PathLike[str]) -> bool:
        """Write the edits as a layer; returns whether it was done."""
        if self.document is None:
            return False
        try:
            self.document.save_overrides(path)
        except PrevisError as error:
            self.notify(str(error), "error")
            return False
        self._watch.accept(os.path.abspath(path))
        self.notify(f"Saved {path}")
        return True

    def load_overrides(self, path: str | os.PathLike[str]) -> bool:
        """Put a layer that was saved before in the place of the edits, undoably; returns whether it was done."""
        if not self.edit(f"Load {Path(path).name}", lambda scene: scene.load_overrides(path)):
            return False
        self.notify(f"Loaded {path}")
        return True

    def _write_export(self) -> None:
        if self._export is None:
            return
        image = self.picture.image()
        if image is None:
            return
        path, self._export = self._export, None
        if self.rest.estimate is not None:
            image = image.with_error(self.rest.estimate)
        try:
            image.save(
                path,
                self.view.exposure,
                self.view.color_correction,
                ocio_display=self.view.ocio_display or None,
                ocio_view=self.view.ocio_view or None,
            )
        except (PrevisError, ValueError) as error:
            self.notify(str(error), "error")
        else:
            self.notify(f"Wrote {path}")

    def _recovery_state(self) -> RecoveryState | None:
        """What is kept against a crash: the stage, the edits, and where one was looking."""
        document = self.document
        if document is None or not document.modified:
            return None
        view: dict[str, Any] = {
            "selection": self.view.selection,
            "camera": self.view.camera_path,
            "exposure": self.view.exposure,
            "time": document.time,
        }
        if self.orbit is not None:
            view["orbit"] = self.orbit.state()
        view["options"] = dict(self._opened_with)
        if view["options"].get("session_layer"):
            view["options"]["session_layer"] = os.path.abspath(view["options"]["session_layer"])
        return RecoveryState(document.path, document.scene.snapshot(), view)

    def keep_preferences(self) -> None:
        """Put what belongs to the user, not to the stage, into the preferences and save them."""
        for name in ("color_correction", "ocio_display", "ocio_view", "gate_mask"):
            setattr(self.preferences, name, getattr(self.view, name))
        self.preferences.measure_error, self.preferences.converge = self.view.measuring, self.view.converging
        try:
            self.preferences.save()
        except PrevisError as error:
            self.notify(str(error), "error")

    def save_for_recovery(self) -> None:
        """Write the edits now, for the next session to find: this one ends badly."""
        self.recovery.tick(self._recovery_state, time.monotonic(), force=True)

    def release(self, clean: bool = True) -> None:
        """Free everything; after a clean end the recovery file goes too."""
        if self.loading is not None:
            self.loading.cancel()
            self.loading.wait(2.0)
        self.close_document()
        self.rest.release()
        self.picture.release()
        self.display.release()
        if clean:
            self.recovery.close()

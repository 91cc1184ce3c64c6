"""The status line: what the picture cost, what ran again, how far it is, what the stage holds, and its warnings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome, imgui

from ..description import Note, SceneDescription
from ..render.method import method_of
from ..render.planned import Plan
from .app import App
from .error_text import duration, error_hint, error_words
from .picture import Picture
from .resting import Rest
from .theme import ACCENT, DIM, ERROR, FRAME, GOOD, TEXT, WARNING, Rgba, close_on_escape, em, packed, tooltip

#: Colours and names of the kinds of passes, in the order of a frame.
PASSES: dict[str, tuple[str, Rgba]] = {
    "fields": ("voxels", (0.55, 0.55, 0.60, 1.0)),
    "shadow_map": ("shadow maps", (0.45, 0.50, 0.78, 1.0)),
    "transmittance_map": ("light maps", (0.36, 0.66, 0.88, 1.0)),
    "gbuffer": ("G-buffer", (0.45, 0.72, 0.60, 1.0)),
    "surface": ("surfaces", (0.60, 0.78, 0.42, 1.0)),
    "march": ("march", ACCENT),
    "composite": ("composite", (0.80, 0.48, 0.72, 1.0)),
}
_KINDS: dict[str, str] = {
    "approximated": "shown as an approximation",
    "ignored": "ignored",
    "repaired": "repaired",
    "missing": "missing",
    "empty": "empty",
}


def kind_of(name: str) -> str:
    """The kind of a pass by its name, which begins with it."""
    return name.split(" ", 1)[0]


def seconds_by_kind(times: Mapping[str, float]) -> dict[str, float]:
    """Seconds of a picture summed by kind of pass, in the order of a frame."""
    sums = dict.fromkeys(PASSES, 0.0)
    for name, seconds in times.items():
        kind = kind_of(name)
        sums[kind] = sums.get(kind, 0.0) + seconds
    return {kind: seconds for kind, seconds in sums.items() if seconds > 0.0}


def what_ran(executed: Iterable[str]) -> str:
    """The kinds of passes that ran, in words: what an edit cost."""
    counts: dict[str, int] = {}
    for name in executed:
        counts[kind_of(name)] = counts.get(kind_of(name), 0) + 1
    if set(PASSES) <= set(counts):
        return "everything"
    names = [PASSES[kind][0] for kind in PASSES if kind in counts]
    names += [kind for kind in counts if kind not in PASSES]
    return ", ".join(names) if names else "nothing"


def byte_count(count: int) -> str:
    """Memory to read."""
    mebibytes = count / 2**20
    return f"{mebibytes:.0f} MiB" if mebibytes < 1000.0 else f"{mebibytes / 1024.0:.1f} GiB"


def short_count(number: int) -> str:
    """A count to read: 12.3 M."""
    for size, letter in ((10**9, "G"), (10**6, "M"), (10**3, "k")):
        if number >= size:
            return f"{number / size:.3g} {letter}"
    return str(number)


def level_words(picture: Picture, rest: Rest) -> str:
    """Which level of a finished picture is on the screen."""
    number, count = picture.finer
    if picture.level == "exact":
        return "exact"
    words = f"finer {number} of {count}" if number else "finished"
    return f"{words}, converged" if picture.converging and rest.converged else words


def voxel_count(description: SceneDescription) -> int:
    """Active voxels of all fields, those used more than once counted once."""
    counted: dict[Any, int] = {}
    for volume in description.volumes.values():
        for field in (volume.density, volume.temperature, volume.emission):
            if field is not None:
                counted[field.key] = int(field.grid.active_count)
    return sum(counted.values())


def warnings(app: App) -> tuple[Note, ...]:
    """What stage and plan have to say, each once."""
    notes: list[Note] = list(app.document.description.notes) if app.document is not None else []
    plan: Plan | None = app.picture.plan
    if plan is not None and app.document is not None:
        notes += plan.notes
    return tuple(dict.fromkeys(notes))


def draw_status(app: App) -> None:
    """Draw the content of the status line."""
    if app.document is None:
        imgui.text_disabled("Open a stage (Ctrl+O) or drop one here")
        return
    picture = app.picture
    _draw_bar(picture.times)
    imgui.same_line(0.0, em(0.5))
    total = sum(picture.times.values())
    right = _right(app)
    _part(duration(total) if picture.times else "–", "Time of the picture shown", first=True, room=right)
    _draw_progress(app, right)
    _draw_error(app.rest, right)
    ran = "What ran again for the last change:\n" + "\n".join(picture.executed)
    _part(f"ran: {what_ran(picture.executed)}", ran, room=right)
    if picture.plan is not None:
        memory = sum(p.memory for p in picture.plan.passes)
        lines = "\n".join(f"{p.name}: {byte_count(p.memory)}" for p in picture.plan.passes)
        _part(byte_count(memory), f"Memory on the GPU\n{lines}", room=right)
    _draw_contents(app.document.description, right)
    _draw_right(app, right)


def _part(text: str, hint: str, first: bool = False, room: float = math.inf) -> None:
    """A piece of text after a line; left out where it would reach beyond `room`, a screen position."""
    if imgui.get_item_rect_max().x + imgui.calc_text_size(text).x + em(2.0) > room:
        return
    if not first:
        _separator()
    imgui.text_unformatted(text)
    tooltip(hint)


def _separator() -> None:
    imgui.same_line(0.0, em(0.6))
    at = imgui.get_cursor_screen_pos()
    height = imgui.get_text_line_height()
    imgui.dummy(ImVec2(1.0, height))
    top, bottom = ImVec2(at.x, at.y + 0.1 * height), ImVec2(at.x, at.y + height)
    imgui.get_window_draw_list().add_line(top, bottom, packed(DIM, 0.5))
    imgui.same_line(0.0, em(0.6))


def _draw_bar(times: Mapping[str, float]) -> None:
    """Time per kind of pass as parts of a bar."""
    width, height = em(8.0), imgui.get_text_line_height()
    imgui.invisible_button("pass_times", ImVec2(width, height))
    lo, hi = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    paint = imgui.get_window_draw_list()
    top, bottom = lo.y + 0.18 * height, hi.y - 0.12 * height
    paint.add_rect_filled(ImVec2(lo.x, top), ImVec2(hi.x, bottom), packed(FRAME), em(0.1))
    sums = seconds_by_kind(times)
    total = sum(sums.values())
    x = lo.x
    for kind, seconds in sums.items():
        end = x + width * seconds / total
        color = PASSES[kind][1] if kind in PASSES else DIM
        paint.add_rect_filled(ImVec2(x, top), ImVec2(max(end - 1.0, x), bottom), packed(color))
        x = end
    if not times or not imgui.begin_item_tooltip():
        return
    imgui.text_unformatted("The picture shown")
    for name, seconds in times.items():
        kind = kind_of(name)
        imgui.text_colored(ImVec4(*(PASSES[kind][1] if kind in PASSES else DIM)), icons_fontawesome.ICON_FA_SQUARE)
        imgui.same_line()
        imgui.text_unformatted(f"{duration(seconds):>8}  {name}")
    imgui.end_tooltip()


def _draw_progress(app: App, room: float) -> None:
    picture = app.picture
    if imgui.get_item_rect_max().x + em(8.0) > room:
        return
    _separator()
    if picture.error:
        imgui.text_colored(ImVec4(*ERROR), "cannot be drawn")
        tooltip(picture.error)
    elif picture.finished:
        other = app.other
        if other is not None and not other.finished and not other.error:
            imgui.text_unformatted(f"compared: {other.level or 'first picture'}, {100.0 * other.progress:.0f} %")
            tooltip("The picture has its full quality; the one that it is compared with is still being drawn.")
        else:
            _draw_finished(app)
    else:
        level = picture.level or "first picture"
        imgui.text_unformatted(f"{level}, {100.0 * picture.progress:.0f} %")
        tooltip("The level that is shown, and how far the next one is. Draft and medium use fewer pixels and steps.")


def _draw_finished(app: App) -> None:
    picture = app.picture
    imgui.text_colored(ImVec4(*GOOD), level_words(picture, app.rest))
    if not picture.converging:
        tooltip("The picture has its full quality: what `previs record` writes for these settings.")
        return
    settings = picture.shown_settings
    hint = "The picture converges to the truth while nothing moves (Render > Converge at rest)."
    if settings is not None and picture.finer[0]:
        method = method_of(settings)
        way = f"{settings.slices} slices along every light ray" if method.has_maps else "a brute-force march"
        hint += f"\nShown: {settings.steps} view steps, {way}."
    if picture.refusal:
        hint += f"\nIt ends here: {picture.refusal}"
    tooltip(hint)
    if picture.refining:
        imgui.same_line(0.0, em(0.5))
        imgui.text_disabled(f"next {100.0 * picture.progress:.0f} %")
        tooltip("How far the next, finer picture is. It waits while the mouse moves.")


def _draw_error(rest: Rest, room: float) -> None:
    """The measured error of the picture on the screen, or how far its measurement is."""
    if rest.estimate is not None:
        _part(error_words(rest.estimate), error_hint(rest.estimate), room=room)
    elif rest.problem:
        _part("error unknown", rest.problem, room=room)
    elif rest.wants_measuring:
        imgui.push_style_color(imgui.Col_.text, ImVec4(*DIM))
        _part("error …", f"Being measured while nothing moves: {100.0 * rest.progress:.0f} %", room=room)
        imgui.pop_style_color()


def _draw_contents(description: SceneDescription, room: float) -> None:
    voxels = voxel_count(description)
    volumes = len(description.volumes)
    lines = [f"{len(description.meshes)} meshes, {len(description.lights)} lights, {len(description.cameras)} cameras"]
    for path, volume in list(description.volumes.items())[:12]:
        field = volume.density
        what = f"{field.grid.active_count:,} voxels" if field is not None else type(volume.shape).__name__.lower()
        lines.append(f"{path}: {what}")
    if volumes > 12:
        lines.append(f"and {volumes - 12} more")
    noun = "volume" if volumes == 1 else "volumes"
    text = f"{volumes} {noun}" + (f", {short_count(voxels)} voxels" if voxels else "")
    _part(text, "On the stage\n" + "\n".join(lines), room=room)


def _right_texts(app: App) -> tuple[str, str]:
    """The window's own rate, and the warnings in short."""
    count = len(warnings(app)) + bool(app.document.error)
    label = f"{icons_fontawesome.ICON_FA_EXCLAMATION_TRIANGLE} {count}" if count else "no warnings"
    return duration(app.frames.median), label


def _right(app: App) -> float:
    """Screen position where the right part begins."""
    size = imgui.calc_text_size("".join(_right_texts(app))).x + em(1.4)
    return imgui.get_window_pos().x + imgui.get_window_width() - size - imgui.get_style().window_padding.x


def _draw_right(app: App, begin: float) -> None:
    """At the right end: the window's own rate, and the warnings."""
    notes = warnings(app)
    error = app.document.error
    rate, label = _right_texts(app)
    imgui.same_line(begin - imgui.get_window_pos().x)
    imgui.text_disabled(rate)
    tooltip("Time between two frames of the window")
    imgui.same_line(0.0, em(0.8))
    if not notes and not error:
        imgui.text_disabled(label)
        return
    color = ERROR if error else WARNING
    size = imgui.calc_text_size(label)
    if imgui.invisible_button("warnings", size):
        imgui.open_popup("warnings_list")
    lo = imgui.get_item_rect_min()
    imgui.get_window_draw_list().add_text(lo, packed(TEXT if imgui.is_item_hovered() else color), label)
    tooltip("What the picture does not show as the stage says: click to read")
    imgui.set_next_window_size_constraints(ImVec2(em(26), 0.0), ImVec2(em(46), em(28)))
    if imgui.begin_popup("warnings_list"):
        close_on_escape()
        _draw_warnings(app, notes, error)
        imgui.end_popup()


def _draw_warnings(app: App, notes: tuple[Note, ...], error: str) -> None:
    imgui.push_text_wrap_pos(em(42))
    if error:
        imgui.text_colored(ImVec4(*ERROR), "The stage as it is now cannot be shown; this is its last good state.")
        imgui.text_unformatted(error)
        imgui.separator()
    for i, note in enumerate(notes):
        imgui.push_id(str(i))
        if imgui.text_link(note.path or "stage"):
            app.select(note.path)
            imgui.close_current_popup()
        imgui.same_line()
        imgui.text_disabled(_KINDS.get(note.kind, note.kind))
        imgui.text_unformatted(note.message)
        imgui.spacing()
        imgui.pop_id()
    imgui.pop_text_wrap_pos()

"""Pictures to files and back, through OpenImageIO: EXR with all planes, PNG and JPEG for display."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import PrevisError

# OpenImageIO is loaded by the functions that read or write files or look through OpenColorIO: it takes as long as USD
# takes to open a small stage, and many who ask for a name of this module need none of it.
if TYPE_CHECKING:
    import OpenImageIO as oiio

    from .image import Image

LINEAR_FORMATS = (".exr",)
DISPLAY_FORMATS = (".png", ".jpg", ".jpeg")
COLOR_CORRECTIONS = ("disabled", "sRGB", "openColorIO")

#: Stops beyond this would leave the range of a float.
EXPOSURE_LIMIT = 64.0
#: Share of the light that may clip under automatic exposure, and the level it is put at.
_AUTO_PERCENTILE, _AUTO_LEVEL = 99.0, 0.8
#: Beyond this automatic exposure would lift the rounding errors of a black picture.
_AUTO_LIMIT = 32.0


def preload() -> None:
    """Load OpenImageIO in a thread, for who is about to wait for a drawing and will write it then."""
    # No daemon: a library that is half loaded when the interpreter ends may not end well.
    threading.Thread(target=importlib.import_module, args=("OpenImageIO",), name="previs loading").start()


def check_format(path: str | PathLike[str]) -> str:
    """The lower-case ending of an output path.

    Raises:
        PrevisError: when it is no format that previs writes.
    """
    ending = Path(path).suffix.lower()
    if ending not in LINEAR_FORMATS + DISPLAY_FORMATS:
        known = ", ".join(LINEAR_FORMATS + DISPLAY_FORMATS)
        what = f"no format ends in {ending!r}" if ending else "its name has no ending"
        raise PrevisError(f"{os.fspath(path)}: {what}; use one of {known}")
    return ending


def auto_exposure(color: np.ndarray) -> float:
    """Stops that bring the 99th percentile of the lit pixels' largest channel to 0.8; 0 for a black picture."""
    peak = np.asarray(color).max(axis=-1)
    lit = peak[np.isfinite(peak) & (peak > 0.0)]
    if lit.size == 0:
        return 0.0
    level = float(np.percentile(lit, _AUTO_PERCENTILE))
    return float(np.clip(np.log2(_AUTO_LEVEL / level), -_AUTO_LIMIT, _AUTO_LIMIT)) if level > 0.0 else 0.0


def parse_exposure(value: float | str) -> float | str:
    """A number of stops, or "auto"; accepts text.

    Raises:
        ValueError: with one sentence, for anything else.
    """
    if value == "auto":
        return "auto"
    try:
        stops = float(value)
    except (TypeError, ValueError):
        stops = float("nan")
    if not abs(stops) <= EXPOSURE_LIMIT:
        raise ValueError(
            f"exposure: {value!r} is not a number of stops from {-EXPOSURE_LIMIT:g} to {EXPOSURE_LIMIT:g}, or auto"
        )
    return stops


def display(
    color: np.ndarray,
    exposure: float | str = 0.0,
    color_correction: str = "sRGB",
    ocio_display: str | None = None,
    ocio_view: str | None = None,
) -> np.ndarray:
    """Linear radiance as display values in [0, 1].

    Args:
        color: (H, W, 3) linear Rec.709.
        exposure: stops, or "auto".
        color_correction: "disabled" (values as they are), "sRGB" (the sRGB curve), or "openColorIO" (a view of $OCIO,
            else of the built-in ACES config).
        ocio_display, ocio_view: names of a display and a view of it, see `color_views`; None takes the default.

    Raises:
        PrevisError: when the OpenColorIO config cannot be used, or has no such display or view.
        ValueError: for another exposure or color_correction.
    """
    if color_correction not in COLOR_CORRECTIONS:
        raise ValueError(f"color_correction: {color_correction!r} is not one of {', '.join(COLOR_CORRECTIONS)}")
    stops = parse_exposure(exposure)
    stops = auto_exposure(color) if stops == "auto" else stops
    with np.errstate(over="ignore"):
        linear = np.nan_to_num(np.asarray(color, np.float32) * np.float32(2.0**stops), nan=0.0, posinf=1e6, neginf=0.0)
    if color_correction == "disabled":
        return np.clip(linear, 0.0, 1.0)
    if color_correction == "openColorIO":
        return _open_color_io(linear, *color_views().chosen(ocio_display, ocio_view)).clip(0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1.0 / 2.4) - 0.055).clip(
        0, 1
    )


@dataclass(frozen=True)
class ColorViews:
    """What an OpenColorIO config offers to look through: the views of every display, in the config's order.

    `default_views` has the default view of every display.
    """

    config: str
    displays: Mapping[str, tuple[str, ...]]
    default_display: str
    default_views: Mapping[str, str]

    @property
    def default_view(self) -> str:
        """The default view of the default display."""
        return self.default_views[self.default_display]

    def chosen(self, display: str | None = None, view: str | None = None) -> tuple[str, str]:
        """A display and a view of it, the defaults taking the place of None and of empty names.

        Raises:
            PrevisError: when the config has no such display, or the display no such view.
        """
        display = display or self.default_display
        if display not in self.displays:
            known = ", ".join(self.displays)
            raise PrevisError(f"OpenColorIO config {self.config}: no display {display!r}; it has {known}")
        view = view or self.default_views[display]
        if view not in self.displays[display]:
            known = ", ".join(self.displays[display])
            raise PrevisError(f"OpenColorIO config {self.config}: {display!r} has no view {view!r}; it has {known}")
        return display, view


@dataclass(frozen=True, eq=False)
class DisplayLut:
    """A view baked into a lattice.

    `values` (n, n, n, 3) float32 holds display values at [blue, green, red], beyond [0, 1] where the view leaves it:
    clip after interpolating, which must be tetrahedral. A linear channel x lies at the lattice position
    (n − 1)·log(1 + √(x / `offset`)) / log(1 + √(`maximum` / `offset`)), and is clipped to [0, `maximum`] before.
    """

    values: np.ndarray
    offset: float
    maximum: float


#: Found by measuring: every view of the built-in config is met to 1/255 on colours up to `LUT_MAXIMUM`. ACES 2.0 bends
#: sharply where it compresses the gamut, so a smaller lattice does not do; the root is for displays whose curve is
#: steep at black. Only where a saturated colour meets the edge of the display's gamut steeply within one cell, as
#: pure blue does, its dark channels can be 11/255 off.
LUT_SIZE, LUT_OFFSET, LUT_MAXIMUM = 85, 0.03, 256.0


def config_name() -> str:
    """The OpenColorIO config in use: $OCIO, else the built-in ACES config."""
    return os.environ.get("OCIO") or "ocio://default"


def color_views() -> ColorViews:
    """The displays and views of $OCIO, else of the built-in ACES config.

    Raises:
        PrevisError: when the config cannot be used.
    """
    return _color_views(config_name())


@functools.lru_cache(maxsize=4)
def _color_views(name: str) -> ColorViews:
    import OpenImageIO as oiio

    config = oiio.ColorConfig(name)
    shown = config.getDefaultDisplayName()
    cause = " ".join(config.geterror().split())
    if cause or not shown:
        raise PrevisError(f"OpenColorIO config {name}: {cause or 'it has no display'}")
    displays = {d: tuple(config.getViewNames(d)) for d in config.getDisplayNames()}
    return ColorViews(name, displays, shown, {d: config.getDefaultViewName(d) for d in displays})


def bake_lut(ocio_display: str | None = None, ocio_view: str | None = None, size: int = LUT_SIZE) -> DisplayLut:
    """A view as a lattice of `size`³ colours, kept for the next time; None takes the default display and view.

    Raises:
        PrevisError: when the OpenColorIO config cannot be used, or has no such display or view.
    """
    views = color_views()
    return _bake_lut(views.config, *views.chosen(ocio_display, ocio_view), size)


@functools.lru_cache(maxsize=4)
def _bake_lut(name: str, shown: str, view: str, size: int) -> DisplayLut:
    position = np.linspace(0.0, 1.0, size)
    level = LUT_OFFSET * np.expm1(position * np.log1p(np.sqrt(LUT_MAXIMUM / LUT_OFFSET))) ** 2
    blue, green, red = np.meshgrid(level, level, level, indexing="ij")
    colors = np.stack([red, green, blue], axis=-1).astype(np.float32)
    values = _open_color_io(colors.reshape(size, size * size, 3), shown, view, name).reshape(colors.shape)
    values.flags.writeable = False
    return DisplayLut(values, LUT_OFFSET, LUT_MAXIMUM)


def _open_color_io(linear: np.ndarray, shown: str, view: str, name: str | None = None) -> np.ndarray:
    import OpenImageIO as oiio

    name = name or config_name()
    source = "lin_rec709"
    buffer = oiio.ImageBuf(np.ascontiguousarray(linear, np.float32))
    result = oiio.ImageBufAlgo.ociodisplay(buffer, shown, view, fromspace=source, colorconfig=name)
    if result.has_error:
        raise PrevisError(f"OpenColorIO config {name}: {' '.join(result.geterror().split())}")
    return result.get_pixels(oiio.FLOAT)


def save_image(
    image: Image,
    path: str | PathLike[str],
    exposure: float | str = 0.0,
    color_correction: str = "sRGB",
    ocio_display: str | None = None,
    ocio_view: str | None = None,
) -> None:
    """Write a picture; see `Image.save`, and `display` for `ocio_display` and `ocio_view`."""
    import OpenImageIO as oiio

    ending = check_format(path)
    if ending in LINEAR_FORMATS:
        planes = [("R", image.color[..., 0]), ("G", image.color[..., 1]), ("B", image.color[..., 2])]
        planes += [("A", image.alpha), ("Z", image.depth)]
        for name in ("albedo", "normal", "transmittance", "volume", "emission"):
            if name in image.aovs:
                suffixes = "XYZ" if name == "normal" else "RGB"
                planes += [(f"{name}.{s}", image.aovs[name][..., i]) for i, s in enumerate(suffixes)]
        pixels = np.stack([p for _, p in planes], axis=-1)
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(planes), oiio.FLOAT)
        spec.channelnames = tuple(n for n, _ in planes)
        spec.alpha_channel, spec.z_channel = 3, 4
        spec.attribute("oiio:ColorSpace", "lin_rec709")
        spec.attribute("compression", "zip")
        spec.attribute("Software", "previs")
        for name, value in dict(image.stats.get("settings", {})).items():
            spec.attribute(f"previs:{name}", value if not isinstance(value, bool) else int(value))
        if image.error is not None:
            for name, value in _flat(image.error.to_dict()):
                spec.attribute(f"previs:error:{name}", value)
    else:
        shown = display(image.color, exposure, color_correction, ocio_display, ocio_view)
        # Over black, without alpha: colour is multiplied by coverage already, and readers of PNG would do it again.
        pixels = (shown * 255.0 + 0.5).astype(np.uint8)
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.UINT8)
        spec.attribute("oiio:ColorSpace", "srgb_rec709_scene")
    _write(Path(path), pixels, spec)


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, int | float]]:
    """Numbers of nested mappings by their names joined with colons; what is None is left out."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}:")
        elif value is not None:
            yield before + name, value


@contextlib.contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that takes its place when the block ends without an exception.

    A reader never sees half a file, and an existing good one is not lost.

    Raises:
        PrevisError: when the folder cannot be written to.
    """
    # Named before it is made: whatever interrupts the making, it is known what to remove.
    beside = path.with_name(f".{path.stem}.{os.urandom(6).hex()}{path.suffix.lower()}")
    try:
        try:
            beside.touch(exist_ok=False)
        except OSError as error:
            raise PrevisError(f"{path}: cannot be written: {error.strerror}") from None
        yield beside
        try:
            os.replace(beside, path)
        except OSError as error:
            raise PrevisError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, beside and renamed.

    Raises:
        PrevisError: when it cannot be written.
    """
    with written_beside(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _write(path: Path, pixels: np.ndarray, spec: oiio.ImageSpec) -> None:
    import OpenImageIO as oiio

    with written_beside(path) as beside:
        output = oiio.ImageOutput.create(str(beside))
        if output is None or not output.open(str(beside), spec):
            raise PrevisError(f"{path}: cannot be written: {output.geterror() if output else oiio.geterror()}")
        written = output.write_image(np.ascontiguousarray(pixels))
        closed = output.close()
        if not (written and closed):
            raise PrevisError(f"{path}: cannot be written: {output.geterror()}")


def load_color(path: str | PathLike[str]) -> tuple[np.ndarray, bool]:
    """The colour of a picture file: (H, W, 3) float32, and whether it is linear.

    Grey pictures are repeated over the channels; display formats come as they are stored, in [0, 1].

    Raises:
        PrevisError: when the file is missing or cannot be read.
    """
    import OpenImageIO as oiio

    name = os.fspath(path)
    if not os.path.isfile(name):
        raise PrevisError(f"{name}: no such file")
    buffer = oiio.ImageBuf(name)
    if buffer.has_error or not buffer.read(force=True, convert=oiio.FLOAT):
        raise PrevisError(f"{name}: cannot be read as a picture: {buffer.geterror()}")
    pixels = buffer.get_pixels(oiio.FLOAT)
    names = list(buffer.spec().channelnames)
    if all(c in names for c in "RGB"):
        pixels = pixels[..., [names.index(c) for c in "RGB"]]
    elif pixels.shape[2] < 3:
        pixels = np.repeat(pixels[..., :1], 3, axis=-1)
    return np.ascontiguousarray(pixels[..., :3], np.float32), Path(name).suffix.lower() not in DISPLAY_FORMATS

"""Pictures to files and back, through OpenImageIO: EXR with all planes, PNG and JPEG for display."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .errors import PrevisError
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


def display(color: np.ndarray, exposure: float | str = 0.0, color_correction: str = "sRGB") -> np.ndarray:
    """Linear radiance as display values in [0, 1].

    Args:
        color: (H, W, 3) linear Rec.709.
        exposure: stops, or "auto".
        color_correction: "disabled" (values as they are), "sRGB" (the sRGB curve), or "openColorIO" (the default
            display and view of $OCIO, else of the built-in ACES config).

    Raises:
        PrevisError: when the OpenColorIO config cannot be used.
        ValueError: for another exposure or color_correction.
    """
    if color_correction not in COLOR_CORRECTIONS:
        raise ValueError(f"color_correction: {color_correction!r} is not one of {', '.join(COLOR_CORRECTIONS)}")
    stops = parse_exposure(exposure)
    stops = auto_exposure(color) if stops == "auto" else stops
    linear = np.nan_to_num(np.asarray(color, np.float32) * np.float32(2.0**stops), nan=0.0, posinf=1e6, neginf=0.0)
    if color_correction == "disabled":
        return np.clip(linear, 0.0, 1.0)
    if color_correction == "openColorIO":
        return _open_color_io(linear)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1.0 / 2.4) - 0.055).clip(
        0, 1
    )


def _open_color_io(linear: np.ndarray) -> np.ndarray:
    name = os.environ.get("OCIO") or "ocio://default"
    config = oiio.ColorConfig(name)
    shown = config.getDefaultDisplayName()
    cause = " ".join(config.geterror().split())
    if cause or not shown:
        raise PrevisError(f"OpenColorIO config {name}: {cause or 'it has no display'}")
    view = config.getDefaultViewName(shown)
    source = "lin_rec709"
    buffer = oiio.ImageBuf(np.ascontiguousarray(linear, np.float32))
    result = oiio.ImageBufAlgo.ociodisplay(buffer, shown, view, fromspace=source, colorconfig=name)
    if result.has_error:
        raise PrevisError(f"OpenColorIO config {name}: {result.geterror()}")
    return result.get_pixels(oiio.FLOAT).clip(0.0, 1.0)


def save_image(
    image: Image, path: str | PathLike[str], exposure: float | str = 0.0, color_correction: str = "sRGB"
) -> None:
    """Write a picture; see `Image.save`."""
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
    else:
        shown = display(image.color, exposure, color_correction)
        # Over black, without alpha: colour is multiplied by coverage already, and readers of PNG would do it again.
        pixels = (shown * 255.0 + 0.5).astype(np.uint8)
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.UINT8)
        spec.attribute("oiio:ColorSpace", "srgb_rec709_scene")
    _write(Path(path), pixels, spec)


@contextlib.contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that takes its place when the block ends without an exception.

    A reader never sees half a file, and an existing good one is not lost.

    Raises:
        PrevisError: when the folder cannot be written to.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix.lower(), dir=path.parent)
    except OSError as error:
        raise PrevisError(f"{path}: cannot be written: {error.strerror}") from None
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        umask = os.umask(0)
        os.umask(umask)
        beside.chmod(0o666 & ~umask)
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

"""Two pictures of 8 bits, level by level."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

#: Levels that any value may be off, and that a few values may be: other processors round the last bit otherwise.
TOLERANCE, OUTLIER_TOLERANCE = 1, 3
OUTLIERS = 1e-3


def read_levels(path: Path) -> np.ndarray:
    buffer = oiio.ImageBuf(str(path))
    assert not buffer.has_error, f"{path}: {buffer.geterror()}"
    return buffer.get_pixels(oiio.UINT8).copy()


def write_levels(path: Path, levels: np.ndarray) -> None:
    buffer = oiio.ImageBuf(oiio.ImageSpec(levels.shape[1], levels.shape[0], 3, oiio.UINT8))
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(levels, np.uint8))
    # The strongest compression: these files live in the repository.
    buffer.specmod().attribute("png:compressionLevel", 9)
    assert buffer.write(str(path)), buffer.geterror()


def difference(image: np.ndarray, reference: np.ndarray) -> str:
    """What is wrong with an image, in words; empty when it is within the tolerance."""
    if image.shape != reference.shape:
        return f"is {image.shape[1]}×{image.shape[0]} pixels, the reference {reference.shape[1]}×{reference.shape[0]}"
    levels = np.abs(image.astype(int) - reference.astype(int))
    share, largest = float((levels > TOLERANCE).mean()), int(levels.max())
    if share <= OUTLIERS and largest <= OUTLIER_TOLERANCE:
        return ""
    return f"{100 * share:.2f} % of the values are off by more than {TOLERANCE} level, the worst by {largest}"


def write_failure(folder: Path, name: str, image: np.ndarray, reference: np.ndarray) -> None:
    """The image, the reference and their difference, 32 times as strong, side by side in a folder."""
    folder.mkdir(exist_ok=True)
    write_levels(folder / f"{name}_image.png", image)
    write_levels(folder / f"{name}_reference.png", reference)
    if image.shape == reference.shape:
        levels = np.abs(image.astype(int) - reference.astype(int))
        write_levels(folder / f"{name}_error.png", np.minimum(levels * 32, 255))

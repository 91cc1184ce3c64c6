"""Render the picture at the head of README, the six scenes: ``python scenes/render_pictures.py OUTPUT.jpg``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import previs

NAMES = ("plume", "pyroclastic", "sandstorm", "cloud", "shaft", "duo")


def main(output: str) -> None:
    """Render and write."""
    tiles = []
    for name in NAMES:
        with previs.open(Path(__file__).with_name(f"{name}.usda")) as scene:
            tiles.append(previs.render(scene, size=(480, 270), coefficients=14, antialias=3).color)
    sheet = np.concatenate([np.concatenate(tiles[:3], axis=1), np.concatenate(tiles[3:], axis=1)])
    shape = sheet.shape[:2]
    previs.Image(sheet, np.ones(shape, np.float32), np.full(shape, np.inf, np.float32)).save(output)


if __name__ == "__main__":
    main(sys.argv[1])

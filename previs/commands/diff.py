"""``previs diff``: how far one picture is from another, in numbers and as a picture."""

from __future__ import annotations

import argparse
import json

import numpy as np

from .. import metrics
from ..errors import PrevisError
from ..image import Image
from ..io import load_color


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("test", metavar="A", help="picture to judge")
    parser.add_argument("reference", metavar="B", help="picture it is compared with")
    parser.add_argument(
        "--output", "-o", metavar="PICTURE", help="write |A - B|; for .png and .jpg scaled to its own range"
    )
    parser.add_argument("--json", action="store_true", help="machine-readable")


def run(arguments: argparse.Namespace) -> int:
    """Print the metrics; 0 whether or not the pictures differ."""
    test, linear = load_color(arguments.test)
    reference, linear_reference = load_color(arguments.reference)
    if test.shape != reference.shape:
        raise PrevisError(
            f"{arguments.test} is {test.shape[1]}×{test.shape[0]} and {arguments.reference} "
            f"{reference.shape[1]}×{reference.shape[0]} pixels; only pictures of one size can be compared"
        )
    if linear != linear_reference:
        raise PrevisError(
            f"{arguments.test} and {arguments.reference}: one is linear and one for display; compare two of a kind"
        )
    for name, picture in ((arguments.test, test), (arguments.reference, reference)):
        if not np.isfinite(picture).all():
            raise PrevisError(f"{name}: {int((~np.isfinite(picture)).sum())} values are not finite")
    small = min(test.shape[:2]) < 11
    values = {
        "rmse": metrics.rmse(test, reference),
        "relative_rmse": metrics.relative_rmse(test, reference),
        "mean_relative_error": metrics.mean_relative_error(test, reference),
        "psnr": metrics.psnr(test, reference),
        "ssim": None if small else metrics.ssim(test, reference),
        "flip": metrics.flip(test, reference, "HDR" if linear else "LDR"),
    }
    if arguments.json:
        print(json.dumps({k: v if v is None or np.isfinite(v) else str(v) for k, v in values.items()}, indent=2))
    else:
        rows = (
            ("RMSE", f"{values['rmse']:.6g}"),
            ("relative RMSE", f"{100 * values['relative_rmse']:.4g} %"),
            ("mean relative error", f"{100 * values['mean_relative_error']:.4g} %"),
            ("PSNR", f"{values['psnr']:.2f} dB"),
            ("SSIM", "needs 11×11 pixels" if small else f"{values['ssim']:.6f}"),
            ("FLIP", f"{values['flip']:.6f} ({'HDR' if linear else 'LDR'})"),
        )
        print("\n".join(f"{name:<20} {value}" for name, value in rows))
    if arguments.output:
        difference = np.abs(test - reference)
        peak = float(difference.max())
        stops = float(np.log2(1.0 / peak)) if peak > 0.0 else 0.0
        shape = difference.shape[:2]
        picture = Image(difference, np.ones(shape, np.float32), np.full(shape, np.inf, np.float32))
        picture.save(arguments.output, exposure=stops, color_correction="disabled")
    return 0

"""Measured errors and times in words. Nothing here draws."""

from __future__ import annotations

import math

from ..meter import ErrorEstimate, Estimate


def duration(seconds: float) -> str:
    """A time to read."""
    if seconds < 0.0095:
        return f"{1e3 * seconds:.1f} ms"
    return f"{1e3 * seconds:.0f} ms" if seconds < 0.9995 else f"{seconds:.1f} s"


def percent(value: float) -> str:
    """A relative error to read, without the sign: two digits, and no more than four after the point."""
    found = 100.0 * value
    if not math.isfinite(found):
        return "–"
    if 0.0 < found < 1e-4:
        return "<0.0001"
    places = max(0, min(4, 1 - math.floor(math.log10(found)))) if found > 0.0 else 0
    text = f"{found:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def error_words(estimate: ErrorEstimate) -> str:
    """The measured error in short: its mean with the ends of its interval, and the PSNR."""
    mean, level = estimate.mean_relative_error, estimate.psnr.value
    if mean.high <= 0.0:
        return "error 0 %"
    decibels = f", {level:.0f} dB" if math.isfinite(level) else ""
    return f"error {percent(mean.value)} % ({percent(mean.low)}–{percent(mean.high)}){decibels}"


def error_hint(estimate: ErrorEstimate) -> str:
    """What the measured error is made of, and how it was found."""

    def ends(found: Estimate) -> str:
        return f"{percent(found.value)} % ({percent(found.low)} to {percent(found.high)})"

    light, view, whole = (p.mean_relative_error for p in (estimate.light, estimate.view, estimate))
    lines = [
        f"Mean error of the picture: {ends(whole)}",
        f"    light on its way in: {ends(light)}",
        f"    steps of the view: {ends(view)}",
    ]
    if math.isfinite(estimate.psnr.value):
        psnr = estimate.psnr
        lines.append(f"PSNR {psnr.value:.1f} dB ({psnr.low:.1f} to {psnr.high:.1f})")
    way = f"{estimate.light_steps} steps" if estimate.light_steps else "from voxel to voxel"
    lines += [
        "In brackets: its 95 % interval.",
        "",
        f"Measured at {estimate.pixels} random pixels in {duration(estimate.seconds)},",
        f"against a brute-force march: {estimate.steps} steps",
        f"across a volume, {way} to a light.",
        "More map values lower the light's part,",
        "more view steps the view's.",
    ]
    return "\n".join(lines)

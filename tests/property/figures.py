"""What the property tests measured, by name; printed at the end of a run with -v."""

from collections import defaultdict

import numpy as np

FIGURES: dict[str, list[float]] = defaultdict(list)

QUANTILES = (0.5, 0.9, 0.95, 0.99)


def summary() -> list[str]:
    """A line per figure: how many, quantiles, the extremes."""
    lines = []
    for name, values in sorted(FIGURES.items()):
        quantiles = "  ".join(
            f"{q:.0%} {v:.3g}" for q, v in zip(QUANTILES, np.quantile(values, QUANTILES), strict=True)
        )
        lines.append(f"{name:<44} {len(values):>6}  least {min(values):.3g}  {quantiles}  most {max(values):.3g}")
    return lines

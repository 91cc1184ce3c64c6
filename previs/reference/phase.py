"""Phase functions: how likely light is to turn by a given angle when it scatters."""

from __future__ import annotations

import numpy as np

_SCHLICK_LIMIT = 0.999


def _henyey_greenstein(cos_theta: np.ndarray, g: float) -> np.ndarray:
    # |1 − g| enters squared: written this way nothing cancels near the forward peak.
    return (1.0 - g * g) / (4.0 * np.pi * ((1.0 - g) ** 2 + 2.0 * g * (1.0 - cos_theta)) ** 1.5)


def phase_function(
    phase: str,
    cos_theta: np.ndarray | float,
    anisotropy: float = 0.0,
    anisotropy2: float = 0.0,
    lobe_mix: float = 0.0,
) -> np.ndarray:
    """Value of a phase function in 1/sr; every one integrates to 1 over the sphere.

    `cos_theta` (any shape) is the cosine between the direction in which light travels before the event and the one
    in which it travels after it, so a positive `anisotropy` g (in (−1, 1), default 0) scatters forward.
    `phase` is one of

    - ``isotropic``: 1/4π [RTR4 eq. 14.6]
    - ``hg``: Henyey–Greenstein [RTR4 eq. 14.10]
    - ``schlick``: [RTR4 eq. 14.11], k = 1.55g − 0.55g³, the sign of k turned for this angle; the fit
      exceeds 1 for g in (0.938, 1), where the function would turn negative, so |k| is kept at or below 0.999
    - ``rayleigh``: 3/(16π)·(1 + cos²θ) [RTR4 eq. 14.8]
    - ``two_lobe``: lerp(HG(anisotropy), HG(anisotropy2), lobe_mix), `lobe_mix` in [0, 1] [RTR4 eq. 14.17]

    Raises ValueError for any other name.
    """
    cos_theta = np.asarray(cos_theta, float)
    if phase == "isotropic":
        return np.full(cos_theta.shape, 0.25 / np.pi)
    if phase == "hg":
        return _henyey_greenstein(cos_theta, anisotropy)
    if phase == "schlick":
        k = float(np.clip(1.55 * anisotropy - 0.55 * anisotropy**3, -_SCHLICK_LIMIT, _SCHLICK_LIMIT))
        return (1.0 - k * k) / (4.0 * np.pi * (1.0 - k * cos_theta) ** 2)
    if phase == "rayleigh":
        return 3.0 / (16.0 * np.pi) * (1.0 + cos_theta**2)
    if phase == "two_lobe":
        first, second = _henyey_greenstein(cos_theta, anisotropy), _henyey_greenstein(cos_theta, anisotropy2)
        return (1.0 - lobe_mix) * first + lobe_mix * second
    raise ValueError(f"There is no phase function {phase!r}; known are isotropic, hg, schlick, rayleigh, two_lobe.")

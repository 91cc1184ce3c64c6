"""Adaptive Gauss–Kronrod quadrature of many integrals at once, one per ray, each a sum over pieces of that ray."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# The (3, 7) Gauss–Kronrod pair on [−1, 1] (Kronrod 1965): the seven-point rule is exact to degree 11, and its
# difference from the embedded three-point Gauss rule is the error estimate.
_HALF_NODES = (0.9604912687080202, 0.7745966692414834, 0.4342437493468026)
_HALF_WEIGHTS = (0.1046562260264673, 0.2684880898683334, 0.4013974147759622)
NODES = np.array([-x for x in _HALF_NODES] + [0.0] + list(reversed(_HALF_NODES)))
KRONROD = np.array([*_HALF_WEIGHTS, 0.4509165386584741, *reversed(_HALF_WEIGHTS)])
GAUSS = np.array([0.0, 5.0 / 9.0, 0.0, 8.0 / 9.0, 0.0, 5.0 / 9.0, 0.0])
# A jump halves its piece each round: 40 rounds leave 1e-12 of it.
_MAX_ROUNDS = 40
# Integrand evaluations handled at once.
_CHUNK = 60_000


@dataclass
class Pieces:
    """Parts of rays that are integrated separately: ray index (I,), from and to (I,) in stage units along the ray,
    and the column density of every volume from the start of the ray to the start of the piece (I, V)."""

    ray: np.ndarray
    start: np.ndarray
    end: np.ndarray
    column: np.ndarray

    def __len__(self) -> int:
        return len(self.ray)

    def take(self, rows: np.ndarray) -> Pieces:
        """The pieces of the given indices or mask."""
        return Pieces(self.ray[rows], self.start[rows], self.end[rows], self.column[rows])


@dataclass
class Warp:
    """A change of variable t = centre + width·tan(s), one per ray (R,): equiangular sampling about a point light.

    In s the 1/d² of a light at distance `width` from the ray is constant (Kulla and Fajardo 2012, eq. 5 to 7).
    """

    centre: np.ndarray
    width: np.ndarray

    def inverse(self, ray: np.ndarray, t: np.ndarray) -> np.ndarray:
        """s of the distances t on the given rays."""
        return np.arctan((t - self.centre[ray]) / self.width[ray])

    def distance(self, ray: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """t and dt/ds."""
        tangent = np.tan(s)
        return self.centre[ray] + self.width[ray] * tangent, self.width[ray] * (1.0 + tangent * tangent)


def integrate(
    pieces: Pieces,
    rays: int,
    integrand: Callable[[Pieces, np.ndarray], np.ndarray],
    column_to: Callable[[Pieces, np.ndarray], np.ndarray],
    warp: Warp | None,
    max_error: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate RGB over all pieces and sum per ray: values (R, 3) and estimated absolute errors (R, 3).

    `integrand(pieces, t)` gives (I, 3) at one distance per piece; `column_to(pieces, t)` the column densities (I, V)
    from the start of the ray to there, which halved pieces need. A piece is halved until its estimated error is below
    `max_error` of its ray's total, shared among the pieces of the ray. Totals below a thousandth of the mean
    over the rays are held to that instead: a pixel in deep shadow needs no relative accuracy of its own.
    """
    done, error = np.zeros((rays, 3)), np.zeros((rays, 3))
    if len(pieces) == 0:
        return done, error
    share = np.sqrt(np.maximum(np.bincount(pieces.ray, minlength=rays), 1.0))
    lit = max(np.count_nonzero(np.bincount(pieces.ray, minlength=rays)), 1)
    s0, s1 = (
        (pieces.start, pieces.end)
        if warp is None
        else (warp.inverse(pieces.ray, t) for t in (pieces.start, pieces.end))
    )
    for level in range(_MAX_ROUNDS + 1):
        value, spread = np.empty((len(pieces), 3)), np.empty((len(pieces), 3))
        rows_at_once = max(_CHUNK // len(NODES), 1)
        for i in range(0, len(pieces), rows_at_once):
            part = slice(i, i + rows_at_once)
            value[part], spread[part] = _rule(pieces.take(part), s0[part], s1[part], integrand, warp)
        total = done + _per_ray(pieces.ray, value, rays)
        floor = 1e-3 * total.sum(axis=0) / lit
        allowed = max_error * np.maximum(total, floor) / share[:, None]
        middle = 0.5 * (s0 + s1)
        failed = np.any(spread > allowed[pieces.ray], axis=1) & (s0 < middle) & (middle < s1)
        if level == _MAX_ROUNDS:
            failed[:] = False
        done += _per_ray(pieces.ray[~failed], value[~failed], rays)
        error += _per_ray(pieces.ray[~failed], spread[~failed], rays)
        if not failed.any():
            break
        pieces, s0, s1, middle = pieces.take(failed), s0[failed], s1[failed], middle[failed]
        t = middle if warp is None else warp.distance(pieces.ray, middle)[0]
        column = column_to(pieces, t)
        pieces = Pieces(
            np.concatenate([pieces.ray, pieces.ray]),
            np.concatenate([pieces.start, t]),
            np.concatenate([t, pieces.end]),
            np.concatenate([pieces.column, column]),
        )
        s0, s1 = np.concatenate([s0, middle]), np.concatenate([middle, s1])
    return done, error


def _rule(
    pieces: Pieces,
    s0: np.ndarray,
    s1: np.ndarray,
    integrand: Callable[[Pieces, np.ndarray], np.ndarray],
    warp: Warp | None,
) -> tuple[np.ndarray, np.ndarray]:
    """The seven-point integral of each piece and its error estimate, (I, 3) each."""
    count = len(pieces)
    half = 0.5 * (s1 - s0)
    s = ((0.5 * (s0 + s1))[:, None] + half[:, None] * NODES).ravel()
    repeated = pieces.take(np.repeat(np.arange(count), len(NODES)))
    if warp is None:
        f = integrand(repeated, s)
    else:
        t, slope = warp.distance(repeated.ray, s)
        f = integrand(repeated, t) * slope[:, None]
    f = f.reshape(count, len(NODES), 3)
    value = half[:, None] * np.einsum("n,inc->ic", KRONROD, f)
    difference = np.abs(half[:, None] * np.einsum("n,inc->ic", KRONROD - GAUSS, f))
    # QUADPACK's scaling (Piessens et al. 1983, routine qk15): the difference is the error of the three-point rule; that
    # of the seven-point rule is far smaller where the integrand is smooth, and the same where it jumps.
    mean = 0.5 * np.einsum("n,inc->ic", KRONROD, f)
    variation = np.abs(half)[:, None] * np.einsum("n,inc->ic", KRONROD, np.abs(f - mean[:, None, :]))
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = variation * np.minimum(1.0, (200.0 * difference / variation) ** 1.5)
    return value, np.where(variation > 0.0, scaled, difference)


def _per_ray(ray: np.ndarray, values: np.ndarray, rays: int) -> np.ndarray:
    return np.stack([np.bincount(ray, values[:, c], rays) for c in range(3)], axis=-1)

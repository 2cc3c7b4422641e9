"""Distributions of N points in three dimensions, (R, 3, N): with one mode, all round a ring, and with two modes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]
Law = Callable[[np.random.Generator, int, int], Array]


def _noise(random: np.random.Generator, R: int, N: int, *scales: float) -> Array:
    return random.normal(size=(R, 3, N)) * np.array(scales or (1, 1, 1))[:, None]


def _student(random: np.random.Generator, R: int, N: int) -> Array:
    return _noise(random, R, N) / np.sqrt(random.chisquare(3, (R, 1, N)) / 3)


def _along_an_axis(draw: Callable[[np.random.Generator, tuple[int, int]], Array]) -> Law:
    def law(random: np.random.Generator, R: int, N: int) -> Array:
        x = _noise(random, R, N, 0.3, 0.3, 0.3)
        x[:, 0] += draw(random, (R, N))
        return x

    return law


def _round(width: float, extent: float = np.pi, long: float = 1.0) -> Law:
    def law(random: np.random.Generator, R: int, N: int) -> Array:
        angle = random.uniform(-extent, extent, (R, N))
        return np.stack([long * np.cos(angle), np.sin(angle), 0 * angle], axis=1) + width * _noise(random, R, N)

    return law


def _shell(random: np.random.Generator, R: int, N: int) -> Array:
    x = _noise(random, R, N)
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


UNIMODAL: dict[str, Law] = {
    "Gaussian": _noise,
    "Gaussian, 3 : 1 : 1": lambda random, R, N: _noise(random, R, N, 3, 1, 1),
    "t, 3 degrees of freedom": _student,
    "exponential": _along_an_axis(lambda random, shape: random.exponential(1, shape)),
    "log-normal": _along_an_axis(lambda random, shape: random.lognormal(0, 0.8, shape)),
    "uniform": _along_an_axis(lambda random, shape: random.uniform(-3, 3, shape)),
    "sphere": _shell,
    "half ring": _round(0.05, np.pi / 2),
    "ring": _round(0.15),
    "ellipse, 2 : 1": _round(0.15, long=2.0),
    "thin ring": _round(0.02),
}
"""Without two modes."""


def two_modes(random: np.random.Generator, R: int, N: int, apart: float, share: float = 0.5) -> Array:
    """Centres at two points on the first axis, (R, 3, N), the second with a share of the points."""
    x = np.zeros((R, 3, N))
    x[:, 0] = apart * (random.random((R, N)) < share)
    return x

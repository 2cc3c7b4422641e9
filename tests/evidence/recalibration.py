"""Recalibration: what is said of new sequences, modes that are and are not there, and a factor where none helps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

import posecal
from posecal.calibration import joint_modes
from posecal.recalibration import judge_spread
from tests.evidence import Table
from tests.helpers.flips import depth_flips
from tests.helpers.laws import UNIMODAL, Law, two_modes

Array = npt.NDArray[np.floating]
JOINTS = ("Head", "LWrist", "RKnee")


@dataclass(frozen=True)
class Setting:
    """S sequences of F frames; the truth remembers itself, and its width differs from sequence to sequence."""

    sequences: int
    frames: int
    spread: float
    differ: float = 0.2
    memory: float = 0.8
    n_hypotheses: int = 12

    def draw(self, random: np.random.Generator, number: int | None = None) -> tuple[Array, Array, Array]:
        """Hypotheses, truth, and hypotheses of a perfect sampler."""
        S, F, K, N = number or self.sequences, self.frames, len(JOINTS), self.n_hypotheses
        width = 40 * np.exp(random.normal(0, self.differ, S))
        noise = random.normal(size=(S, F, K, 3))
        for frame in range(1, F):
            noise[:, frame] = self.memory * noise[:, frame - 1] + np.sqrt(1 - self.memory**2) * noise[:, frame]
        of_frame = np.repeat(width, F)[:, None, None]
        x, perfect = random.normal(size=(2, N, S * F, K, 3))
        return 40 * self.spread * x, of_frame * noise.reshape(-1, K, 3), of_frame * perfect


SETTINGS = (Setting(8, 15, 0.5), Setting(20, 6, 0.5), Setting(20, 6, 1.5))


@cache
def variance_of_median(N: int) -> float:
    """Variance of the median of N standard normal numbers."""
    return float(np.median(np.random.default_rng(0).normal(size=(N, 200_000)), axis=0).var())


def expected_change(setting: Setting, factor: float) -> float:
    r"""Expected change of the energy score by a factor s, by quadrature over the widths w of the sequences.

    A hypothesis c + s (x - c) is normal but for the median's shape, and two of them are s times as far apart:
    E s = a (E √(v(s) + w²) - s σ / √2), v: its variance, a: the mean length of a standard normal vector.
    """
    dimensions, N, sigma = 3 * len(JOINTS), setting.n_hypotheses, 40 * setting.spread
    of_median = variance_of_median(N)
    length = math.sqrt(2) * math.exp(math.lgamma((dimensions + 1) / 2) - math.lgamma(dimensions / 2))
    points, weights = np.polynomial.hermite_e.hermegauss(40)
    width = 40 * np.exp(setting.differ * points)

    def score(s: float) -> float:
        variance = sigma**2 * (s**2 + 2 * s * (1 - s) / N + (1 - s) ** 2 * of_median)
        apart = np.average(np.sqrt(variance + width**2), weights=weights)
        return length * float(apart - s * sigma / math.sqrt(2))

    return score(factor) - score(1)


def one_run(setting: Setting, seed: int) -> dict[str, float]:
    """Fit and judge on some sequences, and apply to as many new ones."""
    random = np.random.default_rng([seed, setting.sequences])
    x, y, perfect = setting.draw(random)
    described: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "joints": JOINTS}
    labels = {"sequence": np.repeat(np.arange(setting.sequences), setting.frames).astype(str)}
    how = {
        "protocol": posecal.Protocol(metrics="ece, signed_area, energy_score, crps, min_mpjpe"),
        "threads": 1,
        "folds": 4,
    }
    judged = judge_spread(x, y, labels=labels, **described, **how)
    new_x, new_y, _ = setting.draw(random)
    expected = expected_change(setting, float(judged.fitted.factors[0]))
    energy = judged.difference("energy_score")
    return {
        "pooled": judged.after["ece"],
        "in sample": judged.fitted.changes["ece"][1],
        "new": posecal.ece(judged.fitted.apply(new_x), new_y, axes="NMKD"),
        "perfect": posecal.ece(perfect, y, axes="NMKD"),
        "bound": judged.new_ece,
        "energy within": float(energy.low <= expected <= energy.high),
    }


def held_out_rows(replicates: int) -> list[tuple[str, ...]]:
    rows = []
    for setting in SETTINGS:
        runs = [one_run(setting, seed) for seed in range(replicates)]
        mean = {name: np.mean([run[name] for run in runs]) for name in runs[0]}
        within = np.mean([run["new"] <= run["bound"] for run in runs])
        rows.append(
            (
                f"{setting.sequences} × {setting.frames} frames, spread × {setting.spread:g}",
                *(f"{mean[name]:.3f}" for name in ("pooled", "in sample", "new", "perfect", "bound")),
                f"{within:.0%}",
                f"{mean['energy within']:.0%}",
            )
        )
    return rows


SIZES = (10, 20, 50, 200)
POSES = 60


def called(law: Law, N: int, replicates: int, seed: int = 0) -> float:
    """Share of joints that are said to have several modes, each over 60 poses."""
    random = np.random.default_rng([seed, N])
    x = law(random, replicates * POSES, N).reshape(replicates, POSES, 3, N)
    return float(joint_modes(x.transpose(3, 1, 0, 2), np.zeros((POSES, replicates, 3)), axes="NMKD").several.mean())


def two(apart: float, share: float) -> Law:
    """Two Gaussian modes, so many deviations apart, one with a share of the hypotheses."""
    return lambda random, R, N: UNIMODAL["Gaussian"](random, R, N) + two_modes(random, R, N, apart, share)


def modes_rows(replicates: int) -> list[tuple[str, ...]]:
    pairs = ((4, 0.5), (5, 0.5), (6, 0.5), (8, 0.5), (8, 0.25))
    several = {f"two modes, {apart} deviations apart, {share:.0%} in one": two(apart, share) for apart, share in pairs}
    return [(name, *(f"{called(law, N, replicates):.1%}" for N in SIZES)) for name, law in (UNIMODAL | several).items()]


def flip_rows(replicates: int) -> list[tuple[str, ...]]:
    """What is fitted on some sequences with depth flips does to new ones; the mean over so many draws."""
    found: dict[str, list[list[float]]] = {"as they are": [], "about the median": [], "about the modes": []}
    said: dict[str, set[str]] = {name: set() for name in found}
    for seed in range(replicates):
        x, y = depth_flips(2 * seed, 50, 200, 4)
        new = depth_flips(2 * seed + 1, 50, 200, 4)
        for name, about in (("as they are", None), ("about the median", "median"), ("about the modes", "modes")):
            moved, factor = new[0], 1.0
            if about is not None:
                fitted = posecal.fit_spread(x, y, unit="mm", about=about, threads=1)
                moved, factor = fitted.apply(new[0]), float(fitted.factors[0])
                said[name].add("not recommended, not written" if fitted.objections else "written")
            report = posecal.evaluate(moved, new[1], unit="mm", metrics=METRICS, threads=1)
            found[name].append([factor, *(report[metric] for metric in METRICS)])
    rows = []
    for name, values in found.items():
        factor, ece, *lengths = np.mean(values, axis=0)
        shown = f"{factor:.2f}", f"{ece:.3f}", *(f"{length:.1f}" for length in lengths)
        rows.append((name, *shown, "; ".join(sorted(said[name])) or "–"))
    return rows


METRICS = ("ece", "energy_score", "crps", "min_mpjpe")

TABLES = [
    Table(
        "recalibration-held-out",
        (
            "sequences",
            "held out, pooled (0.1.0)",
            "in sample",
            "new sequences",
            "perfect sampler",
            "bound on the sheet",
            "new within bound (right: 90 %)",
            "energy within interval (right: 95 %)",
        ),
        held_out_rows,
        100,
    ),
    Table("recalibration-modes", ("hypotheses", *(f"N = {N}" for N in SIZES)), modes_rows, 200),
    Table(
        "recalibration-flips",
        ("hypotheses", "factor", "ECE", "energy score, mm", "CRPS, mm", "minMPJPE, mm", "the map"),
        flip_rows,
        3,
    ),
]

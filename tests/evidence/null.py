"""What a calibrated sampler would show, degenerate data, few hypotheses and floors."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import posecal
from posecal.calibration import LEVELS, perfect_sampler
from posecal.calibration.expected import ece_range
from posecal.calibration.ranks import rank_weights
from posecal.engine.metric import Deviation
from posecal.stats.resampling import Null, _signs, sign_flips
from tests.evidence import Table
from tests.helpers.sequences import Ranks, deviations

Array = np.ndarray

DATA = tuple(Ranks(S, F, K, c) for S, F, K in ((12, 100, 8), (40, 50, 8), (12, 100, 1)) for c in (0.0, 0.95))
"""Sequences × frames, joints, and the correlation of neighbouring frames."""

MIXED = "spread × 0.5 in every other sequence, × 2 in the others"
MODELS: dict[str, dict[str, Any]] = {
    **{f"spread × {spread:g}": {"spread": spread} for spread in (0.1, 0.5, 1.0, 2.0, 10.0)},
    "shifted by 1.5 sd": {"shift": 1.5},
    "one mode for two at ± 2 sd": {"modes": 2.0},
    MIXED: {"spread": np.array([0.5, 2.0])},
}
MEDIAN = Deviation(over="median")


def ece_of(curves: Array) -> Array:
    """ECE of the median over joints of curves (…, K, Q)."""
    return np.asarray(np.abs(np.median(curves, axis=-2) - LEVELS).mean(axis=-1))


@cache
def calibrated(ranks: Ranks, replicates: int) -> tuple[float, float]:
    """Mean and 95 % quantile of the ECE of a sampler that is calibrated, on new data of this size."""
    random, poses = np.random.default_rng(1), ranks.sequences * ranks.frames
    eces = [ece_of(ranks.sums(random)[0].sum(axis=0) / poses) for _ in range(10 * replicates)]
    return float(np.mean(eces)), float(np.quantile(eces, 0.95))


def nulls(ranks: Ranks, model: str, replicates: int) -> tuple[list[Null], list[float]]:
    """What is printed for a model, and the mean that flips of its own deviations gave (posecal 0.1.0)."""
    random, found, before = np.random.default_rng(2), [], []
    signs = _signs(ranks.sequences, 500, 0).astype(float)
    changes = {name: np.resize(value, ranks.sequences) for name, value in MODELS[model].items() if name == "spread"}
    for _ in range(replicates):
        inside, errors = ranks.sums(random, **MODELS[model] | changes)
        own, counts = deviations(ranks, inside)
        found.append(sign_flips(own, counts, MEDIAN, errors=errors, n=ranks.hypotheses, draws=500))
        means = np.einsum("bs,skq->bkq", signs, own) / (ranks.sequences * ranks.frames)
        before.append(float(ece_of(means + LEVELS).mean()))
    return found, before


def null_rows(replicates: int) -> list[tuple[str, ...]]:
    """A row for each model: mean and 95 % quantile on each data set, after the mean before."""
    rows = []
    for model in MODELS:
        cells = []
        for ranks in DATA:
            found, before = nulls(ranks, model, replicates)
            mean, high = (np.mean([getattr(null, name) for null in found]) for name in ("mean", "high"))
            cells.append(f"{np.mean(before):.4f} → {mean:.4f}, {high:.4f}")
        rows.append((model, *cells))
    rows.append(("a calibrated sampler", *("{:.4f}, {:.4f}".format(*calibrated(ranks, replicates)) for ranks in DATA)))
    return rows


# --- numbers of hypotheses --------------------------------------------------------------------------------------------

NUMBERS = 2, 5, 10, 20, 50, 200
NUMBERED = {(12, 100, 0.0): (0.1, 0.5, 2, 10), (12, 100, 0.95): (0.1, 0.5, 2, 10), (40, 50, 0.95): (0.1, 2, 5, 10)}
"""Sequences, frames and the correlation of neighbouring ones, with factors of the spread."""


def ratio_to_calibrated(ranks: Ranks, spread: float, replicates: int) -> tuple[float, float]:
    """Mean over a calibrated sampler's, as it was without N, and now; NaN where it is not known in half of the sets."""
    random, found = np.random.default_rng(4), []
    for _ in range(replicates):
        inside, errors = ranks.sums(random, spread)
        own, counts = deviations(ranks, inside)
        known = (np.inf, ranks.hypotheses)
        found.append([sign_flips(own, counts, MEDIAN, errors=errors, n=n, draws=500).mean for n in known])
    before, now = np.transpose(found) / calibrated(ranks, replicates)[0]
    known = now[~np.isnan(now)]
    return float(np.mean(before)), float(np.mean(known)) if 2 * len(known) > replicates else np.nan


def number_rows(replicates: int) -> list[tuple[str, ...]]:
    """A row for each number of hypotheses: the ratio of the null's mean to what a calibrated sampler shows."""
    rows = []
    for n in NUMBERS:
        cells = []
        for (sequences, frames, correlation), spreads in NUMBERED.items():
            ranks = Ranks(sequences, frames, 8, correlation, hypotheses=n)
            pairs = (ratio_to_calibrated(ranks, spread, replicates) for spread in spreads)
            cells += [f"{before:.2f} → {'not known' if np.isnan(now) else f'{now:.2f}'}" for before, now in pairs]
        rows.append((str(n), *cells))
    return rows


# --- degenerate data --------------------------------------------------------------------------------------------------


def degenerate_rows(replicates: int) -> list[tuple[str, ...]]:
    """What was and is printed where there is nothing to be calibrated."""
    random = np.random.default_rng(replicates)
    truth = random.normal(0, 300, (96, 5, 3))
    labels = {"sequence": np.arange(96) // 12}
    drawn = truth + random.normal(0, 40, (20, 96, 5, 3)) + random.normal(0, 40, (96, 5, 3))
    resting = drawn.copy()
    resting[:, :, 3] = truth[:, 3]
    one_sequence = {"sequence": np.zeros(96, dtype=int)}
    cases = (
        ("all hypotheses equal the truth", np.repeat(truth[None], 20, axis=0), labels, "ece", "2.9e-17 (p = .002)"),
        ("20 copies of one pose", np.repeat(truth[None] + 30, 20, axis=0), labels, "ece", "0.452 (p < .01)"),
        ("one joint equals the truth", resting, labels, "joint 3", "0.000 (p < .01)"),
        ("one sequence, TARP's box", drawn, one_sequence, "tarp_box", "2e-17 (p = .004)"),
    )
    rows = []
    for name, hypotheses, chosen, number, before in cases:
        report = posecal.evaluate(hypotheses, truth, unit="mm", labels=chosen, metrics="all")
        value = report.value("ece", joint=number) if number.startswith("joint") else report[number]
        p = report.joint_tests().get(number, (0, np.nan))[1] if number.startswith("joint") else report[f"{number}_p"]
        said = [text for text in (*report.summary, *report.remarks) if "equal the truth" in text or "same:" in text]
        said += [remark for remark in report.remarks if remark.startswith("tarp_box")]
        shown = ["none" if np.isnan(x) else f"{x:.3f}" for x in (value, p)]
        rows.append((name, before, f"{shown[0]} (p: {shown[1]})", said[0]))
    return rows


# --- few hypotheses ---------------------------------------------------------------------------------------------------


def few_rows(replicates: int) -> list[tuple[str, ...]]:
    """Coverage at 90 % of hypotheses that never hold a truth, and the range of the ECE."""
    truth, random = np.zeros((replicates, 1, 3)), np.random.default_rng(0)
    rows = []
    for n in (2, 5, 8, 9, 20, 200):
        curve = posecal.calibration_curve(random.normal(size=(n, replicates, 1, 3)), truth + 100)
        before, (low, high) = float(curve.median[18]), ece_range(n)
        paper = " to ".join(f"{end:.3f}" for end in ece_range(n, "paper"))
        now = "not reported" if np.isnan(curve.coverage(0.9)) else f"{curve.coverage(0.9):.2f}"
        rows.append((str(n), f"{before:.2f}", now, "0.00", f"{low:.3f} to {high:.3f}", paper))
    return rows


# --- floors -----------------------------------------------------------------------------------------------------------

FLOORS = ((50, 300, 1), (20, 60, 3), (20, 40, 16), (50, 1200, 16), (200, 500, 60))


def simulated_floor(n: int, M: int, K: int, sets: int, draws: int = 100) -> tuple[float, float]:
    """Mean and 95 % quantile of the ECE of so many test sets whose ranks are drawn one by one."""
    random, eces = np.random.default_rng(7), []
    weights = rank_weights(n, np.arange(n + 1))
    for _ in range(max(1, sets // draws)):
        counts = random.multinomial(M, np.full(n + 1, 1 / (n + 1)), size=(draws, K))
        eces.append(ece_of(counts @ weights / M))
    return float(np.mean(eces)), float(np.quantile(eces, 0.95))


def floor_rows(replicates: int) -> list[tuple[str, ...]]:
    """Floors as 200 draws gave them, as they are, and from a long simulation."""
    rows = []
    for n, M, K in FLOORS:
        floor = perfect_sampler(n, M, K)
        numbers = zip(
            simulated_floor(n, M, K, 200), (floor.mean, floor.high), simulated_floor(n, M, K, replicates), strict=True
        )
        cells = [" / ".join(f"{number:.4f}" for number in three) for three in numbers]
        rows.append((f"N = {n}, M = {M}, K = {K}", *cells))
    return rows


TABLES = [
    Table(
        "null",
        (
            "mean before → now, 95 %",
            *(f"{d.sequences} × {d.frames}, K = {d.joints}{', AR(1) .95' * (d.correlation > 0)}" for d in DATA),
        ),
        null_rows,
        40,
    ),
    Table(
        "null-hypotheses",
        (
            "N",
            *(
                f"× {s:g}, {S} × {F}{', AR(1) .95' * (c > 0)}"
                for (S, F, c), spreads in NUMBERED.items()
                for s in spreads
            ),
        ),
        number_rows,
        40,
    ),
    Table("degenerate", ("data", "before (quoted)", "now", "remark"), degenerate_rows, 1),
    Table(
        "few-hypotheses",
        ("N", "coverage at 90 %, before", "now", "right", "range of the ECE", "of the ECE (paper)"),
        few_rows,
        500,
    ),
    Table("floors", ("test set", "mean: before / now / right", "95 %: before / now / right"), floor_rows, 20_000),
]

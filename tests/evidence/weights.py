"""Weighted hypotheses whose right numbers are known: draws with importance weights, components of mixtures, copies."""

from __future__ import annotations

from typing import Any
from unittest import mock

import numpy as np

import posecal
from posecal.metrics import crps, energy_score
from posecal.stats import uncertainty
from posecal.stats.resampling import LEVEL, holm
from posecal.stats.uncertainty import BIAS
from tests.evidence import Table
from tests.helpers.clip_worlds import autoregressive

Array = np.ndarray[Any, Any]

SCALE = 50.0
"""Standard deviation of the truth about its centre along each axis, mm."""

SIZES = (20, 50, 200)


def importance_draws(seed: int, N: int, M: int, width: float, K: int = 2) -> tuple[Array, Array, Array]:
    """Draws (N, M, K, 3) of a proposal so many times as wide as the truth's law, truths (M, K, 3), weights (N, M)."""
    random = np.random.default_rng(seed)
    centre = random.normal(0, 300, (M, K, 3))
    truth, draws = random.standard_normal((M, K, 3)), width * random.standard_normal((N, M, K, 3))
    logarithm = (draws**2).sum(axis=(2, 3)) * (1 / width**2 - 1) / 2
    ratio = np.exp(logarithm - logarithm.max(axis=0))
    return centre + SCALE * draws, centre + SCALE * truth, ratio / ratio.sum(axis=0)


def mixture(seed: int, N: int, M: int, width: float) -> tuple[Array, Array, Array]:
    """Centres of N components (N, M, 1, 3), truths of their mixture (M, 1, 3), weights; widths against their spread."""
    random = np.random.default_rng(seed)
    centres, weights = SCALE * random.standard_normal((N, M, 1, 3)), random.dirichlet(np.ones(N), M).T
    which = (random.random(M) > np.cumsum(weights, axis=0)).sum(axis=0).clip(0, N - 1)
    truth = centres[which, np.arange(M)] + width * SCALE * random.standard_normal((M, 1, 3))
    return centres, truth, weights


def _ece(x: Array, y: Array, weights: Array | None = None) -> str:
    return f"{posecal.ece(x, y, unit='mm', axes='NMKD', weights=weights):.4f}"


def _number(weights: Array) -> str:
    return f"{(1 / (weights**2).sum(axis=0)).mean():.1f}"


def calibration(replicates: int) -> list[tuple[str, ...]]:
    """The ECE where it is 0: of weighted draws, and of components."""
    rows = []
    for width in (1.2, 1.5, 2.0):
        for N in SIZES:
            x, y, w = importance_draws(N, N, replicates * 50 // max(N, 50), width)
            found = _number(w), _ece(x, y), _ece(x, y, w), "0"
            rows.append((f"draws of a proposal × {width:g}, N = {N}", *found))
    for width in (0.0, 0.1, 0.3):
        for N in SIZES:
            x, y, w = mixture(N, N, replicates * 50 // max(N, 50), width)
            found = _number(w), _ece(x, y), _ece(x, y, w), "0" if not width else "above 0"
            rows.append((f"components of width {width:g}, N = {N}", *found))
    return rows


def scores(replicates: int) -> list[tuple[str, ...]]:
    """Fair scores of weighted draws against those of a perfect sampler, with its standard error."""
    rows = []
    for width in (1.2, 1.5, 2.0):
        for N in SIZES:
            x, y, w = importance_draws(N, N, replicates * 50 // max(N, 50), width)
            perfect = importance_draws(N, N, len(y), 1.0)[:2]
            for name, score in (("energy score", energy_score), ("CRPS", crps)):
                plain, now = (score(x, y, unit="mm", axes="NMKD", weights=some) for some in (None, w))
                right = score(*perfect, unit="mm", axes="NMKD")
                error = f"{right.mean():.2f} ± {right.std() / np.sqrt(len(right)):.2f}"
                what = f"{name}, proposal × {width:g}, N = {N}"
                rows.append((what, f"{plain.mean():.2f}", f"{np.nanmean(now):.2f}", error))
    return rows


def copies(replicates: int) -> list[tuple[str, ...]]:
    """Ten draws of a perfect sampler in 200 places each: as they stand, collapsed, and the ten alone."""
    x, y, _ = importance_draws(1, 10, replicates, 1.0)
    copied = np.repeat(x, 20, axis=0)
    collapsed, weights = posecal.collapse_copies(copied)
    labels = {"sequence": (np.arange(replicates) * 40 // replicates).astype(str)}
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "labels": labels}
    options["metrics"] = "ece, energy_score"
    found = [
        posecal.evaluate(copied, y, **options),
        posecal.evaluate(collapsed, y, weights=weights, **options),
        posecal.evaluate(x, y, **options),
    ]
    return [
        ("ECE", *(f"{report['ece']:.4f}" for report in found)),
        ("its p", *(f"{report.test('ece').p:.3f}" for report in found)),
        ("energy score, mm", *(f"{report['energy_score']:.3f}" for report in found)),
    ]


DESIGNS = {"8 × 20, AR(1) .95": (8, 20, True), "20 × 20, AR(1) .95": (20, 20, True), "20 × 100": (20, 100, False)}
"""Sequences, frames of each, and whether these are correlated."""

BATCH = 20
"""So many data sets are evaluated at once."""


def p_values(
    sequences: int, frames: int, correlated: bool, width: float, N: int, metrics: str, seed: int
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Give the p-values of some data sets of weighted draws of a proposal, (data sets,) by metric.

    Without what posecal allows for, and with it.
    """
    x, y, w = importance_draws(seed, N, BATCH * sequences * frames, width)
    if correlated:
        centre = np.random.default_rng(seed).normal(0, 300, y.shape)
        other = np.random.default_rng([seed, 1])  # the first draws of one generator are the centres
        y = centre + SCALE * autoregressive([frames] * BATCH * sequences, y.shape[1:], other)
    number = np.arange(BATCH * sequences).repeat(frames)
    labels = {"sequence": number, "set": number // sequences}
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "threads": 1}
    totals = posecal.evaluate(x, y, weights=w, labels=labels, by=["set"], metrics=metrics, **options).totals
    found = []
    for allowed in (0.0, BIAS):
        with mock.patch.object(uncertainty, "BIAS", allowed):
            report = posecal.Report(totals, by=["set"])
            tested = [name for name, metric in report.metrics.items() if metric.deviation is not None]
            sets = [group for group in report.groups if group is not None]
            found.append({name: np.array([report.test(name, group).p for group in sets]) for name in tested})
    return found[0], found[1]


def levels(replicates: int) -> list[tuple[str, ...]]:
    """How often weighted draws of a proposal, which are calibrated, are rejected at 5 %, before and now."""
    rows = []
    for width, N in ((1.2, 50), (1.5, 100)):
        cells: list[list[str]] = [[], []]
        for design in DESIGNS.values():
            each = [p_values(*design, width, N, "ece, rank_tests", seed) for seed in range(replicates // BATCH)]
            shares = []
            for found in zip(*each, strict=True):
                p = {name: np.concatenate([some[name] for some in found]) for name in found[0]}
                ranks = np.array([p[name] for name in p if not name.startswith("ece")])
                adjusted = np.min([holm(column.tolist()) for column in ranks.T], axis=1)
                shares.append([f"{(values < LEVEL).mean():.0%}" for values in (p["ece"], adjusted)])
            for row, (before, now) in zip(cells, zip(*shares, strict=True), strict=True):
                row.append(f"{before} → {now}")
        about = f"proposal × {width:g}, N = {N}, effective {_number(importance_draws(0, N, 2000, width)[2])}"
        rows += [(f"{what}, {about}", *row) for what, row in zip(("ECE", "any of 7 rank tests"), cells, strict=True)]
    return rows


_BEFORE = "weights ignored (0.1.0)"
TABLES = [
    Table(
        "weights-calibration", ("hypotheses", "effective N", f"ECE, {_BEFORE}", "ECE now", "right"), calibration, 20_000
    ),
    Table("weights-scores", ("score", _BEFORE, "now", "perfect sampler"), scores, 10_000),
    Table(
        "weights-copies",
        ("10 draws in 200 places", "as they stand (0.1.0)", "collapsed", "the 10 draws"),
        copies,
        4_000,
    ),
    Table("weights-levels", ("rejected at 5 %, before → now", *DESIGNS), levels, 100),
]

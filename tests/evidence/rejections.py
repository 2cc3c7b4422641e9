"""How often tests reject where nothing is wrong: rank tests, rare bad sequences, comparisons with skewed effects."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt
from scipy import stats

from posecal.registry import metrics_of
from posecal.stats.jackknife import Interval, jackknife_columns, paired_p
from posecal.stats.resampling import LEVEL, holm
from posecal.stats.uncertainty import null
from tests.evidence import Table
from tests.helpers.clip_worlds import autoregressive
from tests.helpers.samplers import pairs_of, report_of

Array = npt.NDArray[np.floating]

SEQUENCES = 8, 20, 40
FRAMES = 20
"""Of a sequence, correlated by 0.95 from one to the next; where some sequences are bad, independent and more."""

INDEPENDENT_FRAMES = 60
BAD, SCALE = 0.1, 2.5
"""Share of bad sequences, and their scale over that of the others."""


def exchangeable(sequences: int, bad: float, seed: int, N: int = 9, K: int = 3) -> tuple[Array, Array]:
    """Draw truths that lie among hypotheses of their own law, correlated by 0.95 from frame to frame.

    With ``bad``, frames are independent, all truths of such a share of the sequences are :data:`SCALE` times as far
    off, and so is each hypothesis with that probability, which does not know its sequence.
    """
    random, frames = np.random.default_rng(seed), INDEPENDENT_FRAMES if bad else FRAMES
    M = sequences * frames
    truth = random.standard_normal((M, K, 3)) if bad else autoregressive([frames] * sequences, (K, 3), random)
    truth *= np.repeat(np.where(random.random(sequences) < bad, SCALE, 1), frames)[:, None, None]
    scale = np.where(random.random((N, M)) < bad, SCALE, 1)[..., None, None]
    return 40 * scale * random.standard_normal((N, M, K, 3)), 40 * truth


def p_values(sequences: int, replicates: int, bad: float, metrics: str, seed: int = 0) -> dict[str, Array]:
    """Give the p-values of calibration errors in so many data sets, by metric, (replicates,)."""
    number = np.arange(sequences * replicates).repeat(INDEPENDENT_FRAMES if bad else FRAMES)
    labels = {
        "sequence": np.char.mod("%06d", number),
        "replicate": np.char.mod("%04d", number // sequences),
    }
    pairs = pairs_of(*exchangeable(sequences * replicates, bad, seed), labels=labels)
    report = report_of(pairs, metrics, by=["replicate"])
    data = [cells for group, cells in report.groups.items() if group is not None]
    tested = {n: m for n, m in metrics_of(report.totals.protocol, report.totals.spec).items() if m.deviation}
    return {n: np.array([null(report.totals, m, cells).p for cells in data]) for n, m in tested.items()}


def _rejected(p: Iterable[float]) -> str:
    values = np.asarray(p)
    return f"{(values < LEVEL).mean():.1%}"


def _of_sequences(replicates: int) -> list[tuple[str, ...]]:
    errors = [p_values(S, replicates, 0, "ece") for S in SEQUENCES]
    bad = [p_values(S, replicates, BAD, "ece") for S in SEQUENCES]
    ranks = [p_values(S, replicates // 2, 0, "rank_tests") for S in SEQUENCES]
    names = [name for name in ranks[0] if name in {"coordinate_pit", "mahalanobis", "tarp", "band_depth"}]
    together = (np.min([holm(column.tolist()) for column in np.array([*p.values()]).T], axis=1) for p in ranks)
    return [
        ("ECE, 10 % of the sequences × 2.5, 60 independent frames", *(_rejected(p["ece"]) for p in bad)),
        ("ECE, all sequences alike", *(_rejected(p["ece"]) for p in errors)),
        *((f"rank test `{name}`, alike", *(_rejected(p[name]) for p in ranks)) for name in names),
        (f"any of {len(ranks[0])} rank tests, adjusted, alike", *map(_rejected, together)),
    ]


# --- comparisons ----------------------------------------------------------------------------------------------------

EFFECTS: dict[str, Callable[[np.random.Generator, tuple[int, int]], Array]] = {
    "both models log-normal, alike": lambda random, shape: (
        np.exp(0.5 * random.standard_normal(shape)) - np.exp(0.5 * random.standard_normal(shape))
    ),
    "difference log-normal about its mean, sd .5": lambda random, shape: (
        np.exp(0.5 * random.standard_normal(shape)) - np.exp(0.125)
    ),
    "difference log-normal about its mean, sd 1": lambda random, shape: (
        np.exp(random.standard_normal(shape)) - np.exp(0.5)
    ),
}
"""Differences of two equally good models at each sequence."""


def comparison_p(effects: Array, sizes: npt.NDArray[np.int_]) -> tuple[Array, Array]:
    """Give the p-values of differences (replicates, S): with S - 1 degrees of freedom, and posecal's."""
    total = effects @ sizes
    values, without = total / sizes.sum(), (total[:, None] - effects * sizes).T / (sizes.sum() - sizes)[:, None]
    found = jackknife_columns(values, without, np.broadcast_to(sizes[:, None], without.shape))
    intervals = (Interval(*numbers) for numbers in zip(*vars(found).values(), strict=True))
    return 2 * stats.t(len(sizes) - 1).sf(abs(values) / found.error), np.array([paired_p(each) for each in intervals])


def _of_comparisons(replicates: int) -> list[tuple[str, ...]]:
    rows = []
    for name, draw in EFFECTS.items():
        cells = []
        for S, half in COMPARED:
            sizes = np.ones(S, dtype=int)
            sizes[0] = S - 1 if half else 1
            before, now = comparison_p(draw(np.random.default_rng(S), (replicates, S)), sizes)
            cells.append(f"{_rejected(before)} → {_rejected(now)}")
        rows.append((name, *cells))
    return rows


COMPARED = [(S, half) for half in (False, True) for S in (6, 10, 40)]

TABLES = [
    Table("rejections", ("rejected at 5 %", *(f"{S} sequences" for S in SEQUENCES)), _of_sequences, 300),
    Table(
        "comparison-levels",
        ("rejected at 5 %", *(f"{S}{', one holds half' * half}" for S, half in COMPARED)),
        _of_comparisons,
        4000,
    ),
]

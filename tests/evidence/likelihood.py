"""Likelihood: units, climatology's Gaussian, constraints of true poses, and worlds that are stated rightly."""

from __future__ import annotations

import math
import re

import numpy as np
import numpy.typing as npt

import posecal
from posecal.evaluation import evaluate
from posecal.metrics import climatology_log_prob
from tests.evidence import Table

Array = npt.NDArray[np.float64]

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
DESIGNS = (
    *((20, 100, 0.0, 12), (100, 100, 0.95, 12), (20, 100, 0.95, 12), (8, 100, 0.95, 12)),
    *((236, 100, 0.95, 48), (60, 100, 0.95, 48), (20, 100, 0.95, 48)),
)
"""Sequences, frames of each, the correlation of a frame with the next, and coordinates."""

WIDTHS = (10.0, 1.0, 0.1, 0.01)
FAR = "mixture of 2, 1 km apart, and of one of weight 0"


def half_log_2_pi_e() -> float:
    """Entropy of a coordinate of standard deviation 1."""
    return math.log(2 * math.pi * math.e) / 2


def mean_and_error(values: list[float]) -> str:
    """Write a mean with its standard error."""
    array = np.array(values)
    return f"{array.mean():.3f} ± {array.std(ddof=1) / math.sqrt(len(array)):.3f}"


# --- units


def nll_by_unit(replicates: int) -> list[tuple[str, ...]]:
    """The NLL of one right Gaussian whose log density is stored in three units; 4 joints beside the root, 40 mm."""
    found: dict[str, list[tuple[float, float]]] = {unit: [] for unit in UNITS}
    for replicate in range(replicates):
        random = np.random.default_rng([replicate, 1])
        mean = random.normal(0, 300, (400, 5, 3))
        mean[:, 0] = 0
        moves = np.arange(5)[:, None] > 0
        truth, x = (mean + 40 * moves * random.normal(size=(*n, *mean.shape)) for n in ((), (4,)))
        for unit, factor in UNITS.items():
            z = (truth - mean)[:, 1:].reshape(400, -1) / 40
            log_prob = -(z**2 / 2 + math.log(40 / factor) + math.log(2 * math.pi) / 2).sum(axis=1)
            report = evaluate(x / factor, truth / factor, unit=unit, log_prob=log_prob, metrics="nll")
            found[unit].append((-log_prob.mean(), report["nll"]))
    right = 12 * (math.log(40) + half_log_2_pi_e())
    return [
        (unit, *(mean_and_error([pair[column] for pair in pairs]) for column in (0, 1)), f"{right:.3f}")
        for unit, pairs in found.items()
    ]


# --- climatology


def chains(random: np.random.Generator, sequences: int, frames: int, correlation: float, d: int) -> Array:
    """Stationary first-order chains of coordinates of standard deviation 1, (S, n, d)."""
    x = np.empty((sequences, frames, d))
    x[:, 0] = random.normal(size=(sequences, d))
    for frame in range(1, frames):
        x[:, frame] = correlation * x[:, frame - 1]
        x[:, frame] += math.sqrt(1 - correlation**2) * random.normal(size=(sequences, d))
    return x


def skill_of_the_population(replicates: int, designs: tuple[tuple[int, int, float, int], ...] = DESIGNS) -> list[Array]:
    """The log-likelihood skill of the Gaussian that the truths are drawn from, by baseline, (replicates, 2).

    The first is relative to the Gaussian of the poses themselves, the second to that of the other sequences.
    """
    found = []
    for sequences, frames, correlation, d in designs:
        skills = []
        for replicate in range(replicates):
            x = chains(np.random.default_rng([replicate, 2]), sequences, frames, correlation, d).reshape(-1, d)
            population = -(x**2).sum(axis=1) / 2 - d * math.log(2 * math.pi) / 2
            covariance = np.cov(x.T, bias=True)
            own = -d * half_log_2_pi_e() - np.linalg.slogdet(covariance)[1] / 2
            others = climatology_log_prob(x, np.repeat(np.arange(sequences), frames))
            skills.append((population.mean() - own, (population - others).mean()))
        found.append(np.array(skills))
    return found


def skill_rows(replicates: int) -> list[tuple[str, ...]]:
    """The table of :func:`skill_of_the_population`."""
    return [
        (
            f"{sequences} × {frames}, " + (f"correlation {correlation}" if correlation else "independent"),
            str(d),
            *(mean_and_error(skills[:, column].tolist()) for column in (0, 1)),
            "0",
        )
        for (sequences, frames, correlation, d), skills in zip(
            DESIGNS, skill_of_the_population(replicates), strict=True
        )
    ]


# --- constraints


def planar_models(width: float, seed: int = 0) -> posecal.Report:
    """A model of planar truths, too narrow by 2.5 in the plane, and of a width across it, mm."""
    random = np.random.default_rng([seed, 3])
    mean = random.normal(0, 200, (1500, 5, 3))
    mean[..., 2] = 0
    across = np.array([0.0, 0.0, 1.0])
    truth = mean + 50 * (1 - across) * random.normal(size=mean.shape)
    sigma = np.broadcast_to(20 * (1 - across) + width * across, mean.shape)
    options = {"unit": "mm", "root_joint": "none", "draws": 50, "metrics": "nll, energy_score, ece"}
    labels = {"sequence": np.arange(1500) // 75}
    return evaluate(posecal.GaussianPrediction(mean, sigma=sigma), truth, labels=labels, **options)


def right_model(width: float = 10.0) -> posecal.Report:
    """The right width in the plane, and 10 mm across it."""
    random = np.random.default_rng([0, 3])
    mean = random.normal(0, 200, (1500, 5, 3))
    mean[..., 2] = 0
    across = np.array([0.0, 0.0, 1.0])
    truth = mean + 50 * (1 - across) * random.normal(size=mean.shape)
    sigma = np.broadcast_to(50 * (1 - across) + width * across, mean.shape)
    options = {"unit": "mm", "root_joint": "none", "draws": 50, "metrics": "nll, energy_score, ece"}
    labels = {"sequence": np.arange(1500) // 75}
    return evaluate(posecal.GaussianPrediction(mean, sigma=sigma), truth, labels=labels, **options)


def planar_rows(_: int) -> list[tuple[str, ...]]:
    """NLL, energy score and ECE of models of planar truths."""
    models = {"right in the plane, 10 mm across": right_model()}
    models |= {f"2.5 × too narrow in the plane, {width:g} mm across": planar_models(width) for width in WIDTHS}
    rows = []
    for name, report in models.items():
        remark = any("don't vary in 5 of 15 directions" in text for text in report.remarks)
        numbers = f"{report['nll']:.1f}", f"{report['energy_score']:.1f}", f"{report['ece']:.3f}"
        rows.append((name, *numbers, "yes" if remark else "no"))
    return rows


BONES = np.array([120.0, 440.0, 430.0])


def places(random: np.random.Generator, far: float, varies: float) -> Array:
    """True poses (800, 4, 3) of chains of three bones, whose lengths vary and whose root moves, mm."""
    directions = random.normal(size=(800, 3, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    offsets = directions * (BONES + varies * random.normal(size=(800, 3)))[..., None]
    root = random.normal(0, 60 + far, (800, 1, 3))
    return np.concatenate([root, root + np.cumsum(offsets, axis=1)], axis=1)


def places_rows(_: int) -> list[tuple[str, ...]]:
    """How many bones and directions a remark says not to vary, and how many do not."""
    rows = []
    for far in (0.0, 1e4, 1e6):
        for varies in (0.01, 2.0):
            truth = places(np.random.default_rng(0), far, varies)
            sequence = np.arange(800) // 40
            labels = {"sequence": sequence}
            names = ("Hip", "RHip", "RKnee", "RFoot")
            options = {"unit": "mm", "root_joint": "none", "joints": names, "metrics": "nll", "labels": labels}
            report = evaluate(truth[None], truth, log_prob=np.zeros(800), **options)
            remark = " ".join(text for text in report.remarks if text.startswith("NLL"))
            now = [re.search(rf"(\d+) of \d+ {word}", remark) for word in ("bones", "directions")]
            lengths = np.linalg.norm(np.diff(truth, axis=1), axis=-1).reshape(20, 40, 3)
            variances = np.linalg.eigvalsh(np.cov(truth.reshape(800, -1).T))
            least = max(0.1**2, 1e-8 * variances[-1])
            before = (lengths.var(axis=1).mean(axis=0) < least).sum(), (variances < least).sum()
            shown = (f"{a}, {b}" for a, b in (before, [match[1] if match else 0 for match in now]))
            rows.append((f"{60 + far:,.0f} mm", f"{varies:g} mm", *shown, "3, 0" if varies < 0.1 else "0, 0"))
    return rows


# --- distributions that are stated rightly


def stated_rightly(draws: int, seed: int, kind: str) -> tuple[float, float, float]:
    """The NLL less the negative log density of the truth, the ECE, and the coverage of 90 % balls."""
    random = np.random.default_rng([seed, 4])
    m, k = 1000, 5
    mean, sigma = random.normal(0, 300, (2, m, k, 3)), random.uniform(20, 60, (2, m, k))
    mean[1] += 1e6 * (kind == FAR)
    component = (random.random(m) < 0.3).astype(int)
    if kind == "Gaussian":
        component[:] = 0
    rows = np.arange(m)
    truth = mean[component, rows] + sigma[component, rows][..., None] * random.normal(size=(m, k, 3))
    log_terms = -(((truth - mean) / sigma[..., None]) ** 2).sum(axis=(2, 3)) / 2 - 3 * np.log(sigma).sum(axis=2)
    log_terms -= 3 * k * math.log(2 * math.pi) / 2
    weights = np.repeat([[0.7], [0.3]], m, axis=1)
    prediction, expected = posecal.GaussianPrediction(mean[0], sigma=sigma[0]), log_terms[0]
    if kind != "Gaussian":
        expected = np.logaddexp(*(log_terms + np.log(weights)))
        if kind == FAR:
            mean, sigma, weights = (np.concatenate([of, of[:1] * np.nan]) for of in (mean, sigma, weights))
            weights[2] = 0
        prediction = posecal.GaussianPrediction(mean, sigma=sigma, mixture_weights=weights)
    options = {"unit": "mm", "root_joint": "none", "draws": draws, "seed": seed, "metrics": "nll, ece, coverage_90"}
    report = evaluate(prediction, truth, labels={"sequence": rows // 50}, **options)
    return report["nll"] + expected.mean(), report["ece"], report["coverage_90"]


def stated_rows(replicates: int) -> list[tuple[str, ...]]:
    """The table of :func:`stated_rightly`."""
    rows = []
    for kind in ("Gaussian", "mixture of 2", FAR):
        for draws in (20, 200):
            found = np.array([stated_rightly(draws, seed, kind) for seed in range(replicates)])
            ece, coverage = (mean_and_error(found[:, column].tolist()) for column in (1, 2))
            rows.append((kind, str(draws), f"{np.abs(found[:, 0]).max():.0e}", ece, coverage, "0.900"))
    return rows


TABLES = [
    Table(
        "likelihood-units",
        ("unit of the stored density", "its own NLL, nats", "NLL that is printed, nats", "right, in mm"),
        nll_by_unit,
        20,
    ),
    Table(
        "likelihood-climatology",
        (
            "sequences × frames",
            "coordinates",
            "against the Gaussian of the same poses",
            "against that of other sequences",
            "right",
        ),
        skill_rows,
        40,
    ),
    Table(
        "likelihood-constraints",
        ("model of planar truths", "NLL, nats", "energy score, mm", "ECE", "remark"),
        planar_rows,
        1,
    ),
    Table(
        "likelihood-places",
        (
            "deviation of the place",
            "of the length of bones",
            "bones and directions that are said not to vary, before",
            "now",
            "right",
        ),
        places_rows,
        1,
    ),
    Table(
        "likelihood-stated",
        ("stated", "draws", "largest error of the NLL", "ECE", "coverage of 90 % balls", "right"),
        stated_rows,
        20,
    ),
]

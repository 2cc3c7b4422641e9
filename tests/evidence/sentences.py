"""Sentences of the summary against worlds in which the truth is known.

Each world has a law of the model's error (a factor of the spread, a bias, a mixture of sequences, modes), from 2 to 40
sequences of correlated frames, from 2 to 200 hypotheses and several joints. Whatever the summary says of it is held
against the law, and against the rows of the same report:

right
    what is said is true of the law: a side, a joint, sequences that differ; nothing shown of a calibrated model.
cautious
    nothing untrue is said, and less than the law has: nothing shown of a model that is miscalibrated by no more than
    the ECE that the sentence does not exclude; weak evidence, or what can't be tested, where the model is calibrated.
wrong
    something untrue is said: a side or a fault without reserve where there is none, the other side, a joint that is
    calibrated, an ECE excluded that the model has; or a row of the same report says otherwise.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy import signal

import posecal
from posecal.calibration import LEVELS
from posecal.report.report import Report
from tests.evidence import Table

Floats = npt.NDArray[np.floating]

JOINTS = ("Head", "LWrist", "RKnee", "LFoot", "RElbow")
METRICS = "ece,ece_mean,signed_area,coverage_50,coverage_80,coverage_90,coverage_95,spread_error_correlation"
WIDTHS = np.array([25.0, 40.0, 60.0, 30.0, 50.0])
MOST = 60_000
"""At most so many poses × hypotheses."""
SMALL = 0.01
"""Curves of a law that are nearer to the diagonal than this are called neither right nor wrong in their side."""


@dataclass(frozen=True)
class World:
    """A law of the model's error, and the size of the data.

    Attributes
    ----------
    spread : tuple of float
        The hypotheses' spread over the right one, by joint.
    of_sequences : tuple of float
        Another such factor: each of these for as many sequences as the others.
    bias : float
        Of the hypotheses, in standard deviations, along one axis.
    modes : str
        ``one``; ``both``: truth and hypotheses are in either of two modes; ``frames`` and ``sequences``: all hypotheses
        are in one mode, the truth is in the other one in a share of the frames, or of the sequences.
    wrong_mode : float
        That share.
    rare : float
        Share of the sequences in which the truth varies 2.5 times as much. The model knows the share, and so do its
        hypotheses, but not which sequences these are: it is calibrated.
    sequences, frames, hypotheses, likeness, together
        S, F and N; the correlation of neighbouring frames and of joints.
    """

    spread: tuple[float, ...] = (1.0, 1.0, 1.0)
    of_sequences: tuple[float, ...] = (1.0,)
    bias: float = 0.0
    modes: str = "one"
    wrong_mode: float = 0.0
    rare: float = 0.0
    sequences: int = 12
    frames: int = 20
    hypotheses: int = 20
    likeness: float = 0.0
    together: float = 0.3

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the joints."""
        return JOINTS[: len(self.spread)]

    @property
    def calibrated(self) -> bool:
        """Whether all joints of all sequences are calibrated."""
        same = set(self.spread) == {1.0} == set(self.of_sequences)
        return same and not self.bias and not self.wrong_mode

    @property
    def uneven(self) -> bool:
        """Whether sequences differ."""
        return len(set(self.of_sequences)) > 1 or bool(self.rare) or self.modes == "sequences"

    def draw(self, random: np.random.Generator) -> tuple[Floats, Floats, Floats]:
        """Draw hypotheses (N, M, K, 3) and truths (M, K, 3) in mm, and the sequence of each pose (M,)."""
        S, F, N, K = self.sequences, self.frames, self.hypotheses, len(self.spread)
        z = self._alike(random.standard_normal((S, F, K + 1, 3)))
        z = np.sqrt(self.together) * z[:, :, :1] + np.sqrt(1 - self.together) * z[:, :, 1:]
        e = np.sqrt(self.together) * random.standard_normal((N, S, F, 1, 3))
        e = e + np.sqrt(1 - self.together) * random.standard_normal((N, S, F, K, 3))
        if self.rare:
            z = z * np.where(random.random(S) < self.rare, 2.5, 1.0)[:, None, None, None]
            e = e * np.where(random.random((N, S, F)) < self.rare, 2.5, 1.0)[..., None, None]
        factor = random.permutation(np.resize(self.of_sequences, S))[:, None, None, None]
        e = e * np.array(self.spread)[:, None] * factor
        e[..., 0] += self.bias
        if self.modes == "both":
            z[..., 2] += 4.0 * (random.random((S, F, 1)) < 0.5)
            e[..., 2] += 4.0 * (random.random((N, S, F, 1)) < 0.5)
        elif self.modes != "one":
            z[..., 2] += 6.0 * (random.random((S, F if self.modes == "frames" else 1, 1)) < self.wrong_mode)
        scale = WIDTHS[:K, None]
        centre = random.normal(0, 300, (S, F, K, 3))
        x, y = (centre + scale * e).reshape(N, S * F, K, 3), (centre + scale * z).reshape(S * F, K, 3)
        return x, y, np.repeat(np.arange(S), F)

    def _alike(self, noise: Floats) -> Floats:
        noise[:, 1:] *= np.sqrt(1 - self.likeness**2)
        return np.asarray(signal.lfilter([1.0], [1.0, -self.likeness], noise, axis=1))


# --- the worlds ---------------------------------------------------------------------------------------------------


def _factor(random: np.random.Generator, least: float, most: float) -> float:
    return float(np.exp(random.uniform(np.log(least), np.log(most))))


def _one_spread(random: np.random.Generator, least: float, most: float) -> dict[str, object]:
    return {"spread": (_factor(random, least, most),) * int(random.integers(2, 6))}


def _mixed(random: np.random.Generator) -> dict[str, object]:
    return {"of_sequences": (_factor(random, 0.3, 0.8), _factor(random, 1.25, 3))}


def _some_joints(random: np.random.Generator) -> dict[str, object]:
    K = int(random.integers(2, 6))
    off = random.random(K) < 0.5
    off[random.integers(K)] = True
    return {"spread": tuple(_factor(random, 0.3, 3) if each else 1.0 for each in off)}


def _modes(random: np.random.Generator) -> dict[str, object]:
    modes = str(random.choice(["frames", "sequences"]))
    return {"modes": modes, "wrong_mode": float(random.uniform(0.05, 0.5))}


KINDS: dict[str, Callable[[np.random.Generator], dict[str, object]]] = {
    "calibrated": lambda random: {"spread": (1.0,) * int(random.integers(2, 6))},
    "calibrated, two modes": lambda _: {"modes": "both"},
    "calibrated, rare hard sequences": lambda _: {"rare": 0.1},
    "too narrow, × 0.3 to 1": partial(_one_spread, least=0.3, most=1),
    "too wide, × 1 to 3": partial(_one_spread, least=1, most=3),
    "biased by 0.3 to 2 standard deviations": lambda random: {"bias": float(random.uniform(0.3, 2))},
    "some sequences too narrow, others too wide": _mixed,
    "some joints too narrow or too wide": _some_joints,
    "wrong mode in 5 to 50 %": _modes,
}


def world_of(kind: str, random: np.random.Generator) -> World:
    """Draw a world."""
    S, F = int(round(_factor(random, 2, 40))), int(round(_factor(random, 4, 60)))
    N = int(round(_factor(random, 2, 200)))
    data = {"sequences": S, "frames": F, "hypotheses": max(2, min(N, MOST // (S * F)))}
    likeness, together = random.choice([0, 0.5, 0.9, 0.95]), random.choice([0, 0.3, 0.7])
    world = World(**data, likeness=float(likeness), together=float(together))
    return replace(world, **KINDS[kind](random))  # type: ignore[arg-type]


def report_of(world: World, random: np.random.Generator, *, rank_tests: bool = False) -> Report:
    """Evaluate a world."""
    x, y, sequence = world.draw(random)
    return posecal.evaluate(
        x,
        y,
        axes="NMKD",
        unit="mm",
        joints=world.joints,
        root_joint="none",
        labels={"sequence": sequence},
        metrics=METRICS + ",rank_tests" * rank_tests,
        threads=1,
    )


# --- what is true -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Law:
    """Calibration errors and signed areas of a world for endless data: of the median curve and of each joint."""

    error: float
    area: float
    joints: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def mean_of_joints(self) -> float:
        """The mean of the joints' errors."""
        return float(np.mean([error for error, _ in self.joints.values()]))


def law_of(world: World, random: np.random.Generator) -> Law:
    """Find the law of a world from 4,000 independent frames; exactly 0 where it is calibrated."""
    if world.calibrated:
        return Law(0, 0, dict.fromkeys(world.joints, (0.0, 0.0)))
    large = replace(world, sequences=4000, frames=1, likeness=0.0, hypotheses=min(world.hypotheses, 50))
    curve = posecal.calibration_curve(*large.draw(random)[:2], axes="NMKD", root=None)
    areas, errors = curve.joint_signed_area(), np.abs(curve.joints - LEVELS).mean(axis=-1)
    joints = {joint: (float(e), float(a)) for joint, e, a in zip(world.joints, errors, areas, strict=True)}
    if not world.bias and world.modes == "one" and len(set(world.of_sequences)) == 1:
        joints |= {joint: (0.0, 0.0) for joint, f in zip(world.joints, world.spread, strict=True) if f == 1}
    return Law(curve.ece(), curve.signed_area(), joints)


RIGHT, CAUTIOUS, WRONG = "right", "cautious", "wrong"


def _of_side(said: str, error: float, area: float) -> str:
    """Judge that a curve is over- or underconfident, or off at all."""
    if error == 0:
        return WRONG
    if abs(area) < min(SMALL, error / 2) or "neither" in said:
        return RIGHT
    over = "more over-" in said or said.lower().startswith(("overconfident", "looks overconfident"))
    return RIGHT if over == (area < 0) else WRONG


def judge(sentence: str, world: World, law: Law, report: Report) -> str:
    """Say whether a sentence is right, cautious or wrong."""
    off = not world.calibrated
    if "beyond chance" in sentence or sentence.startswith(("Looks", "Weak evidence of miscalibration")):
        side = _of_side(sentence.partition(":")[0], law.error, law.area)
        reserve = "beyond chance" not in sentence
        return CAUTIOUS if reserve and law.error == 0 else side
    if sentence.startswith("No miscalibration shown"):
        most = float(re.findall(r"up to ([\d.]+)", sentence)[-1]) if "up to" in sentence else np.inf
        return RIGHT if not off else CAUTIOUS if law.error <= most else WRONG
    if sentence.startswith("Not tested"):
        return CAUTIOUS
    if sentence.startswith("Hypotheses have two modes"):
        return RIGHT if world.modes == "both" else WRONG
    if sentence.startswith("Yet"):
        return RIGHT if off else CAUTIOUS
    if sentence.startswith("Some sequences"):
        return RIGHT if world.uneven else WRONG
    if sentence.startswith("Single sequences"):
        return _of_range(sentence, world)
    if sentence.startswith("Joint by joint"):
        return _of_joints(sentence, law)
    if "median over joints" in sentence:
        return RIGHT if law.mean_of_joints > 0 else WRONG if sentence.startswith("The median") else CAUTIOUS
    if sentence.startswith(("Rank tests", "Weak evidence from")):
        return RIGHT if off else CAUTIOUS if sentence.startswith("Weak") else WRONG
    if sentence.startswith("No rank test"):
        return RIGHT if not off else CAUTIOUS
    assert "too few for" in sentence, sentence
    return RIGHT if all(np.isnan(p) or p >= 0.05 for _, p in report.rank_tests().values()) else WRONG


def _of_range(sentence: str, world: World) -> str:
    """Wrong where frames count as more independent ones and only chance is at work."""
    if world.uneven:
        return RIGHT
    (most,) = re.findall(r"no more than ([\d,]+)", sentence)
    lag = np.abs(np.subtract.outer(np.arange(world.frames), np.arange(world.frames)))
    independent = 1 / float((world.likeness ** (2 * lag)).mean())  # distances correlate as squares do
    return CAUTIOUS if world.calibrated is False or independent <= int(most.replace(",", "")) else WRONG


def _of_joints(sentence: str, law: Law) -> str:
    named, _, _ = sentence.removeprefix("Joint by joint: ").partition(" (adjusted")
    parts = re.split(r"(overconfident at|underconfident at|miscalibrated, on neither side throughout, at)", named)
    judged = [
        _of_side(side, *law.joints[joint])
        for side, joints in zip(parts[1::2], parts[2::2], strict=True)
        for joint in re.findall("|".join(JOINTS), joints)
    ]
    return WRONG if WRONG in judged else RIGHT


def contradictions(report: Report) -> Iterator[str]:
    """Give the rows of a report that its summary contradicts."""
    first, *rest = sorted(report.summary, key=lambda sentence: not sentence.startswith("No miscalibration"))
    best = {"signed_area": 0.0} | {f"coverage_{n}": n / 100 for n in (50, 80, 90, 95)}
    for name, value in best.items():
        low, high = report.interval(name)
        below, above = high < value, low > value
        if first.startswith("No") and (below or above) and not any(report.metrics[name].label in s for s in rest):
            yield f"{name}: not mentioned"
        if (first.startswith("Overconfident") and above) or (first.startswith("Underconfident") and below):
            yield f"{name}: on the other side"
        if name == "signed_area" and first.startswith(("Overconfident", "Underconfident")) and low <= 0 <= high:
            yield f"{name}: on no side"
    rejected = any(p < 0.05 for _, p in report.rank_tests().values())
    if rejected and any("No rank test" in s or "too few for" in s for s in rest):
        yield "rank tests: one rejects"
    if first.startswith("No ") and report["ece_p"] < 0.05:
        yield "ece_p: rejects"


# --- the table ----------------------------------------------------------------------------------------------------


def worlds(kind: str, number: int) -> Iterator[tuple[World, Law, Report]]:
    """Draw worlds of a kind with their reports, every fourth with rank tests."""
    for n in range(number):
        random = np.random.default_rng([*KINDS].index(kind) * 100_003 + n)
        world = world_of(kind, random)
        yield world, law_of(world, random), report_of(world, random, rank_tests=n % 4 == 3)


def judged(kind: str, number: int) -> Iterator[list[tuple[str, str]]]:
    """Judge all sentences of each world, and the rows that they contradict."""
    for world, law, report in worlds(kind, number):
        verdicts = [(judge(sentence, world, law, report), sentence) for sentence in report.summary]
        yield verdicts + [(WRONG, f"contradicts {row}") for row in contradictions(report)]


BEFORE = (13.3, 8.3, 21.7, 6.7, 1.7, 10.0, 35.0, 15.0, 15.0, 14.1)
"""Reports of posecal 0.1.0 with a wrong sentence, in % of 60 such worlds of each kind and of all. Its "Not
miscalibrated beyond chance" counts as wrong where the law's ECE is above the quantile that the sentence names."""


def rows(number: int) -> list[tuple[str, ...]]:
    """Count right, cautious and wrong sentences by kind of world, and over all."""
    counted = {kind: list(judged(kind, number)) for kind in KINDS}
    counted["all"] = [world for of_kind in counted.values() for world in of_kind]
    table = []
    for (kind, of_kind), before in zip(counted.items(), BEFORE, strict=True):
        verdicts = Counter(verdict for world in of_kind for verdict, _ in world)
        shares = (f"{verdicts[verdict] / verdicts.total():.1%}" for verdict in (RIGHT, CAUTIOUS, WRONG))
        reports = sum(any(verdict == WRONG for verdict, _ in world) for world in of_kind) / len(of_kind)
        table.append((kind, f"{len(of_kind)}", f"{verdicts.total()}", *shares, f"{before:.1f}%", f"{reports:.1%}"))
    return table


TABLES = [
    Table(
        "sentences",
        (
            *("the model is", "worlds", "sentences", "right", "cautious", "wrong"),
            *("reports with a wrong one, 0.1.0 (quoted)", "reports with a wrong one, now"),
        ),
        rows,
        60,
    )
]

"""ADE, FDE, APD and the energy score of clips are what plain loops give, for whole clips alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.metrics import ade, apd, clip_energy_score, fde

Array = npt.NDArray[np.float64]
METRICS = ["ade", "fde", "apd", "clip_energy_score"]


@dataclass
class Motion:
    """Hypotheses (N, C, T, K, 3) and truth (C, T, K, 3) that wander from observed poses (C, K, 3), mm."""

    x: Array
    y: Array
    observed: Array


def motion(seed: int = 0, N: int = 5, C: int = 7, T: int = 4, K: int = 4) -> Motion:
    random = np.random.default_rng(seed)
    observed = random.normal(0, 120, (C, K, 3))
    y = observed[:, None] + np.cumsum(random.normal(0, 50, (C, T, K, 3)), axis=1)
    return Motion(observed[:, None] + np.cumsum(random.normal(0, 70, (N, C, T, K, 3)), axis=2), y, observed)


def distance(one: Array, other: Array) -> float:
    return math.sqrt(sum(float(d) ** 2 for d in (one - other).ravel()))


def apart(points: Array) -> float:
    pairs = list(combinations(range(len(points)), 2))
    return sum(distance(points[i], points[j]) for i, j in pairs) / len(pairs)


def plain(x: Array, y: Array) -> dict[str, float]:
    """The four numbers of one clip (N, T, K, D) and (T, K, D), in loops."""
    T = len(y)
    of_each = [sum(distance(h[t], y[t]) for t in range(T)) / T for h in x]
    error = sum(distance(h, y) for h in x) / len(x)
    energy = error - apart(x) / 2
    return {
        "ade": min(of_each),
        "fde": min(distance(h[-1], y[-1]) for h in x),
        "apd": apart(x),
        "clip_energy_score": energy,
    }


WORLD = motion()
EXPECTED = {name: [plain(WORLD.x[:, c], WORLD.y[c])[name] for c in range(len(WORLD.y))] for name in METRICS}


def report_of(world: Motion, **options: object) -> posecal.Report:
    declared = {"axes": "NMTKD", "unit": "mm", "root_joint": "none", "metrics": METRICS, **options}
    return posecal.evaluate(world.x, world.y, **declared)  # type: ignore[arg-type]


@pytest.mark.parametrize("function", [ade, fde, apd, clip_energy_score])
def test_each_clip_has_what_plain_loops_give(function: object) -> None:
    found = function(WORLD.x, WORLD.y, axes="NMTKD", unit="mm")  # type: ignore[operator]
    np.testing.assert_allclose(found, EXPECTED[function.__name__], rtol=1e-9)  # type: ignore[attr-defined]


def test_clips_are_those_of_the_axes_or_of_labels() -> None:
    x, y = WORLD.x.reshape(5, 28, 4, 3), WORLD.y.reshape(28, 4, 3)
    np.testing.assert_allclose(ade(x, y, clip=np.repeat(np.arange(7), 4), unit="mm"), EXPECTED["ade"])
    (one,) = ade(x, y, unit="mm")
    assert one == pytest.approx(np.linalg.norm((x - y).reshape(5, 28, 12), axis=2).mean(axis=1).min())


def test_the_report_holds_their_means_over_clips() -> None:
    report = report_of(WORLD)
    for name in METRICS:
        assert report[name] == pytest.approx(np.mean(EXPECTED[name]), rel=1e-9)
    assert report.count("fde") == 7
    assert report.count("ade") == 28


def test_at_a_horizon_ade_is_of_the_hypothesis_that_is_best_over_the_clip() -> None:
    """The choice is made once for a clip: numbers at the horizons average to that of all."""
    report = report_of(WORLD, by="horizon", fps=25)
    distances = np.linalg.norm((WORLD.x - WORLD.y).reshape(5, 7, 4, 12), axis=3)
    best = distances.mean(axis=2).argmin(axis=0)
    of_best = distances[best, np.arange(7)].mean(axis=0)
    found = [report.value("ade", f"horizon={ms} ms") for ms in (40, 80, 120, 160)]
    np.testing.assert_allclose(found, of_best)
    assert np.mean(found) == pytest.approx(report["ade"])
    assert np.isnan(report.value("fde", "horizon=120 ms"))
    assert report.value("fde", "horizon=160 ms") == report["fde"]


def test_a_clip_with_a_frame_missing_is_left_out_with_a_remark() -> None:
    known = np.ones((7, 4), dtype=bool)
    known[2, 1] = False
    labels = {"clip": np.repeat([*"abcdefg"], 4)[known.ravel()]}
    x, y = (a.reshape(*a.shape[:-4], 28, 4, 3)[..., known.ravel(), :, :] for a in (WORLD.x, WORLD.y))
    report = posecal.evaluate(x, y, axes="NMKD", unit="mm", root_joint="none", labels=labels, metrics=METRICS)
    for name in METRICS:
        assert report[name] == pytest.approx(np.mean(np.delete(EXPECTED[name], 2)))
    assert any("1 of 7 clips of fewer than T = 4 frames (first: c)" in remark for remark in report.remarks)


def test_a_frame_without_a_joint_that_counts_leaves_its_clip_out() -> None:
    where = np.ones((28, 4), dtype=bool)
    where[9] = False  # frame 1 of clip 2
    found = ade(WORLD.x, WORLD.y, where=where, axes="NMTKD", unit="mm")
    assert np.isnan(found).tolist() == [c == 2 for c in range(7)]


def test_distances_are_over_the_joints_that_count() -> None:
    where = np.ones((28, 4), dtype=bool)
    where[:, 1] = False
    x, y = WORLD.x[..., [0, 2, 3], :], WORLD.y[..., [0, 2, 3], :]
    for function in (ade, fde, apd, clip_energy_score):
        found = function(WORLD.x, WORLD.y, where=where, axes="NMTKD", unit="mm")
        np.testing.assert_allclose(found, function(x, y, axes="NMTKD", unit="mm"), rtol=1e-12)


def test_clips_of_one_frame_have_one_error() -> None:
    x, y = WORLD.x[:, :, :1], WORLD.y[:, :1]
    np.testing.assert_allclose(ade(x, y, axes="NMTKD", unit="mm"), fde(x, y, axes="NMTKD", unit="mm"))
    np.testing.assert_allclose(
        report_of(Motion(x, y, WORLD.observed))["ade"], ade(x, y, axes="NMTKD", unit="mm").mean()
    )


def test_numbers_do_not_depend_on_the_batches_and_clips_of_batches_are_not_one() -> None:
    evaluation = posecal.Evaluation(axes="NMTKD", unit="mm", root_joint="none", metrics=METRICS)
    for part in (slice(0, 2), slice(2, 3), slice(3, 7)):
        evaluation.update(WORLD.x[:, part], WORLD.y[part])
    report = evaluation.compute()
    assert report.totals.n_sequences == 7
    for name in METRICS:
        assert report[name] == pytest.approx(report_of(WORLD)[name], rel=1e-12)
        assert report.interval(name) == pytest.approx(report_of(WORLD).interval(name), rel=1e-9)


def test_without_clips_they_are_refused_by_name_and_absent_by_default() -> None:
    x, y = WORLD.x.reshape(5, 28, 4, 3), WORLD.y.reshape(28, 4, 3)
    with pytest.raises(PoseDataError, match=r"^metrics: ade needs clips\. Declare axes with a T, such as NMTKD, or"):
        posecal.evaluate(x, y, unit="mm", metrics="ade")
    assert not {"ade", "fde", "apd"} & posecal.evaluate(x, y, unit="mm").metrics.keys()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"clip": [0] * 27}, r"^clip \(27,\): expected \(M,\) = \(28,\)\."),
        ({"clip": [0, 1] * 14}, "^clip: one comes back after another; expected the poses of each clip one after"),
        ({"unit": "deg"}, "^unit: deg; expected positions, not angles"),
    ],
)
def test_what_does_not_fit_is_refused(options: dict[str, object], message: str) -> None:
    x, y = WORLD.x.reshape(5, 28, 4, 3), WORLD.y.reshape(28, 4, 3)
    with pytest.raises(PoseDataError, match=message):
        ade(x, y, **{"unit": "mm", **options})  # type: ignore[arg-type]


def test_clips_that_come_back_are_refused() -> None:
    x, y = WORLD.x.reshape(5, 28, 4, 3), WORLD.y.reshape(28, 4, 3)
    labels = {"clip": np.array(["a", "b"] * 14)}
    with pytest.raises(PoseDataError, match=r"^clip: a comes back after another one, and metrics of whole clips need"):
        posecal.evaluate(x, y, unit="mm", labels=labels, metrics="ade")


def test_one_hypothesis_has_no_energy_score_and_an_apd_of_zero() -> None:
    with pytest.raises(PoseDataError, match=r"^hypotheses: N = 1; fair scores need at least 2\."):
        clip_energy_score(WORLD.x[:1], WORLD.y, axes="NMTKD", unit="mm")
    assert apd(WORLD.x[:1], WORLD.y, axes="NMTKD", unit="mm").tolist() == [0.0] * 7

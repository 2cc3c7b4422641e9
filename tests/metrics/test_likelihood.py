"""The NLL of log densities, its skill over climatology's Gaussian, and remarks on what makes it meaningless."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import multivariate_normal, norm

import posecal
from posecal.errors import PoseDataError
from posecal.metrics import climatology_log_prob, nll

N, M, K = 5, 120, 5
JOINTS = ("Hip", "RHip", "RKnee", "LHip", "LKnee")
SEQUENCE = np.repeat([f"clip {s}" for s in range(8)], [9, 21, 15, 15, 10, 20, 12, 18])
Array = npt.NDArray[np.float64]


def world(seed: int = 0) -> dict[str, Any]:
    """Hypotheses, truth relative to the hip, and log densities of Gaussians of 40 mm about the truth plus 40 mm."""
    random = np.random.default_rng(seed)
    truth = random.normal(0, 200, (M, K, 3))
    truth[:, 0] = 0
    mean = truth + random.normal(0, 40, truth.shape)
    log_prob = norm.logpdf(truth[:, 1:], mean[:, 1:], 40).sum(axis=(1, 2))
    return {"x": mean + random.normal(0, 40, (N, M, K, 3)), "y": truth, "log_prob": log_prob}


WORLD = world()


def report(**options: Any) -> posecal.Report:
    given = {**WORLD, "unit": "mm", "joints": JOINTS, "labels": {"sequence": SEQUENCE}, **options}
    return posecal.evaluate(given.pop("x"), given.pop("y"), **given)


def climatology(truth: Array, sequence: Array) -> Array:
    """Log density of each pose (M, d) under the Gaussian of other sequences, by SciPy."""
    others = [truth[sequence != own] for own in sequence]
    return np.array([multivariate_normal(o.mean(0), np.cov(o.T)).logpdf(y) for o, y in zip(others, truth, strict=True)])


CLIMATOLOGY = climatology(WORLD["y"][:, 1:].reshape(M, -1), SEQUENCE)


# --- numbers


def test_the_nll_is_the_mean_of_the_negative_log_densities() -> None:
    found = report()
    assert found["nll"] == pytest.approx(-WORLD["log_prob"].mean())
    assert found["nll_per_dimension"] == pytest.approx(-WORLD["log_prob"].mean() / 12)


def test_the_skill_is_relative_to_the_gaussian_of_other_sequences() -> None:
    assert report()["log_likelihood_skill"] == pytest.approx((WORLD["log_prob"] - CLIMATOLOGY).mean())


def test_the_function_of_arrays_gives_climatology_s_log_density_of_each_pose() -> None:
    np.testing.assert_allclose(climatology_log_prob(WORLD["y"][:, 1:], SEQUENCE), CLIMATOLOGY)
    alone = climatology(WORLD["y"][:, 1:].reshape(M, -1), np.arange(M))
    np.testing.assert_allclose(climatology_log_prob(WORLD["y"][:, 1:]), alone)
    with pytest.raises(PoseDataError, match=r"^sequence: \(3,\); expected one per pose, \(120,\)\.$"):
        climatology_log_prob(WORLD["y"], SEQUENCE[:3])


def test_the_nll_moves_with_the_unit_and_the_skill_does_not() -> None:
    metres = {"x": WORLD["x"] / 1000, "y": WORLD["y"] / 1000, "unit": "m"}
    same = report(**metres, log_prob=WORLD["log_prob"] + 12 * math.log(1000))
    for name in ("nll", "nll_per_dimension", "log_likelihood_skill"):
        assert same[name] == pytest.approx(report()[name])
    np.testing.assert_allclose(
        nll([-3.0, 2.0], dimensions=4, unit="m"), [3 + 4 * math.log(1000), 4 * math.log(1000) - 2]
    )
    assert nll([-3.0], dimensions=4, unit="rad") == pytest.approx(3 + 4 * math.log(180 / math.pi))


def test_a_right_gaussian_has_its_entropy() -> None:
    # −log p of 12 coordinates has the mean 12 (log 40 + log(2πe)/2) and a variance of 6
    expected = 12 * (math.log(40) + math.log(2 * math.pi * math.e) / 2)
    assert report()["nll"] == pytest.approx(expected, abs=4 * math.sqrt(6 / M))


def test_the_interval_is_that_of_a_mean_over_sequences() -> None:
    low, high = report().interval("nll")
    one = report(log_prob=WORLD["log_prob"] - 5.0)
    assert low < report()["nll"] < high
    assert one.interval("nll") == pytest.approx((low + 5, high + 5))


def test_groups_are_judged_by_the_gaussian_of_all_other_sequences() -> None:
    action = np.where(np.isin(SEQUENCE, ["clip 1", "clip 5"]), "sit", "walk")
    found = report(labels={"sequence": SEQUENCE, "action": action}, by="action")
    sit = action == "sit"
    assert found.value("nll", "action=sit") == pytest.approx(-WORLD["log_prob"][sit].mean())
    expected = (WORLD["log_prob"] - CLIMATOLOGY)[sit].mean()
    assert found.value("log_likelihood_skill", "action=sit") == pytest.approx(expected)


def test_one_hypothesis_and_absent_ones_have_an_nll() -> None:
    expected = report()["nll"]
    assert report(x=WORLD["x"][:1])["nll"] == pytest.approx(expected)
    ragged = WORLD["x"].copy()
    ragged[3:, ::4] = np.nan
    assert report(x=ragged)["nll"] == pytest.approx(expected)
    assert report(x=ragged)["log_likelihood_skill"] == pytest.approx(report()["log_likelihood_skill"])


def test_poses_that_lack_a_joint_are_left_out() -> None:
    where = np.ones((M, K), dtype=bool)
    where[::7, 2] = False
    found, kept = report(where=where), where.all(axis=1)
    assert found["nll"] == pytest.approx(-WORLD["log_prob"][kept].mean())
    assert f"NLL: {(~kept).sum()} poses lack a joint; left out of it." in found.remarks
    expected = climatology(WORLD["y"][kept][:, 1:].reshape(kept.sum(), -1), SEQUENCE[kept])
    assert found["log_likelihood_skill"] == pytest.approx((WORLD["log_prob"][kept] - expected).mean())


def test_without_a_density_nothing_is_added() -> None:
    found = report(log_prob=None)
    assert not {"nll", "nll_per_dimension", "log_likelihood_skill"} & found.metrics.keys()
    assert not [name for name in found.totals.sums if "nll" in name or "moments" in name]
    assert "NLL" not in str(found)
    with pytest.raises(PoseDataError, match=r"metrics: nll needs the model's log densities\. Store log_prob beside"):
        report(log_prob=None, metrics="nll")


def test_the_printed_report_shows_them() -> None:
    text = report().render(all=True)
    for words in ("NLL per dimension", "log-likelihood skill", "over d=12 coordinates in mm", "nats"):
        assert words in text
    assert "coordinates in px" in report(unit="px").metrics["nll"].definition
    for name in ("nll", "nll_per_dimension", "log_likelihood_skill"):
        assert (
            report(unit="none", root_joint="Hip")
            .metrics[name]
            .definition.endswith("over d=12 coordinates in their own unit")
        )


def test_wrong_arguments_of_the_functions_are_refused() -> None:
    for wrong in ("a", None, 3.0, np.zeros((0, 3)), np.zeros(4), np.full((4, 3), np.nan), WORLD["y"] * 1j):
        with pytest.raises(PoseDataError, match=r"^truth"):
            climatology_log_prob(wrong)
    for wrong in ("a", [0.5] * M, np.zeros((M, 1), int)):
        with pytest.raises(PoseDataError, match=r"^sequence"):
            climatology_log_prob(WORLD["y"], wrong)
    for wrong in ("a", None, 3.0, [[1.0]], [1j]):
        with pytest.raises(PoseDataError, match=r"^log_prob"):
            nll(wrong, dimensions=3, unit="mm")
    for wrong in (0, 1.5, "a", None, [1, 2], float("nan")):
        with pytest.raises(PoseDataError, match=r"^dimensions"):
            nll([1.0], dimensions=wrong, unit="mm")
    with pytest.raises(PoseDataError, match=r"^unit"):
        nll([1.0], dimensions=3, unit="inch")


# --- batches, shards, saved results, comparison


def test_batches_shards_and_files_give_the_numbers_of_one_call(tmp_path: Path) -> None:
    expected = report().scalars()
    evaluation = posecal.Evaluation(unit="mm", joints=JOINTS, axes="NMKD")
    for start in range(0, M, 17):
        part = slice(start, start + 17)
        beside = {"log_prob": WORLD["log_prob"][part], "sequence": SEQUENCE[part]}
        evaluation.update(WORLD["x"][:, part], WORLD["y"][part], **beside)
    assert evaluation.compute().scalars() == pytest.approx(expected, rel=1e-9, nan_ok=True)
    shards = []
    for number, names in enumerate((["clip 2", "clip 7"], [f"clip {s}" for s in (0, 1, 3, 4, 5, 6)])):
        part = np.isin(SEQUENCE, names)
        of_part = {"x": WORLD["x"][:, part], "y": WORLD["y"][part], "log_prob": WORLD["log_prob"][part]}
        report(**of_part, labels={"sequence": SEQUENCE[part]}).save(tmp_path / f"{number}.npz")
        shards.append(posecal.load_totals(tmp_path / f"{number}.npz"))
    merged = posecal.Report(posecal.merge_totals(shards))
    assert merged.scalars() == pytest.approx(expected, rel=1e-9, nan_ok=True)


def test_every_batch_has_a_density_or_none() -> None:
    evaluation = posecal.Evaluation(unit="mm", joints=JOINTS, axes="NMKD")
    evaluation.update(WORLD["x"][:, :50], WORLD["y"][:50], log_prob=WORLD["log_prob"][:50], sequence="a")
    with pytest.raises(PoseDataError, match=r"batch 2: dimensions 0 against 12; expected the same in every batch"):
        evaluation.update(WORLD["x"][:, 50:], WORLD["y"][50:], sequence="b")


def test_densities_over_different_numbers_of_coordinates_do_not_merge() -> None:
    half = np.isin(SEQUENCE, ["clip 0", "clip 1", "clip 2", "clip 3"])
    parts = []
    for part, dimensions in ((half, 12), (~half, 11)):
        of_part = {"x": WORLD["x"][:, part], "y": WORLD["y"][part], "log_prob": WORLD["log_prob"][part]}
        parts.append(report(**of_part, labels={"sequence": SEQUENCE[part]}, dimensions=dimensions).totals)
    with pytest.raises(PoseDataError, match=r"were asked for different metrics \(sums in one only: .*nll_11"):
        posecal.merge_totals(parts)


def test_the_lower_nll_and_the_higher_skill_are_better() -> None:
    noise = np.random.default_rng(3).normal(2, 1, M)
    comparison = posecal.compare({"a": report(), "b": report(log_prob=WORLD["log_prob"] - noise)})
    for name, sign in (("nll", 1), ("log_likelihood_skill", -1)):
        (difference,) = comparison.differences_of(name)
        assert sign * difference.value == pytest.approx(-noise.mean())
        assert difference.better == "a"


# --- remarks


def remarks(**options: Any) -> list[str]:
    return [r for r in report(**options).remarks if r.startswith(("NLL", "log_likelihood_skill"))]


def test_poses_without_constraints_have_no_remark() -> None:
    assert remarks() == []


def test_a_hip_that_follows_from_the_other_is_found() -> None:
    truth = WORLD["y"].copy()
    truth[:, 3] = -truth[:, 1]
    found = remarks(y=truth)
    assert found[0].startswith(
        "NLL: the true poses don't vary in 3 of 12 directions (standard deviation below 0.1 mm). A density has no bound"
    )
    assert found[1:] == ["log_likelihood_skill: no value, because climatology's Gaussian is singular."]
    assert math.isnan(report(y=truth)["log_likelihood_skill"])
    assert math.isnan(report(y=truth).interval("log_likelihood_skill")[0])


def test_constraints_are_searched_for_whichever_likelihood_is_asked_for() -> None:
    truth = WORLD["y"].copy()
    truth[:, 3] = -truth[:, 1]
    for name in ("nll", "nll_per_dimension", "log_likelihood_skill"):
        assert "don't vary in 3 of 12 directions" in remarks(y=truth, metrics=name)[0]
    assert remarks(y=truth, metrics="ece") == []


def test_planar_poses_are_found() -> None:
    truth = WORLD["y"].copy()
    truth[..., 2] = 0
    assert "don't vary in 4 of 12 directions" in remarks(y=truth)[0]


def test_rigid_bones_are_found() -> None:
    truth = WORLD["y"].copy()
    bone = truth[:, 2] - truth[:, 1]
    size = 400 + 10 * np.unique(SEQUENCE, return_inverse=True)[1]  # of another person in each sequence
    truth[:, 2] = truth[:, 1] + size[:, None] * bone / np.linalg.norm(bone, axis=-1, keepdims=True)
    found = remarks(y=truth)
    assert found == [
        "NLL: the true poses have 1 of 4 bones of constant length within each sequence. A density has no bound there, "
        "so that the NLL does not rank models: take a score of samples, such as the energy score."
    ]
    assert np.isfinite(report(y=truth)["log_likelihood_skill"])


@pytest.mark.parametrize("is_planar", [True, False])
def test_models_are_ranked_by_a_likelihood_only_where_it_has_a_bound(is_planar: bool) -> None:
    """Two models that differ by a nat in each pose; of planar poses that says nothing."""
    truth = WORLD["y"] * [1, 1, 0 if is_planar else 1]
    models = {
        name: posecal.PoseData(
            WORLD["x"],
            truth,
            unit="mm",
            joints=JOINTS,
            labels={"sequence": SEQUENCE},
            log_prob=WORLD["log_prob"] + nats,
        )
        for name, nats in (("low", np.zeros(M)), ("high", 1 + 0.1 * np.cos(np.arange(M))))
    }
    comparison = posecal.compare(models, metrics=["nll", "energy_score"])
    (difference,) = comparison.differences_of("nll")
    assert difference.value == pytest.approx(1, abs=0.02)
    assert [comparison.rank("nll", name) for name in models] == ([1, 1] if is_planar else [2, 1])
    assert difference.better == (None if is_planar else "high")
    assert math.isnan(difference.p) == is_planar
    assert any(remark.startswith("no p-values of likelihoods") for remark in comparison.remarks) == is_planar


def test_another_number_of_coordinates_has_no_climatology() -> None:
    declared, skill = remarks(dimensions=9)
    assert declared.startswith("NLL: dimensions = 9 is declared, and the poses have 12 coordinates without the root")
    assert skill == "log_likelihood_skill: no value, because the density is over 9 coordinates and the poses have 12."
    assert math.isnan(report(dimensions=9)["log_likelihood_skill"])


def test_too_few_poses_have_no_climatology() -> None:
    few = {"x": WORLD["x"][:, :11], "y": WORLD["y"][:11], "log_prob": WORLD["log_prob"][:11]}
    (line,) = remarks(**few, labels={"sequence": SEQUENCE[:11]})
    assert line.startswith("NLL: 11 complete poses are too few to estimate climatology's Gaussian of 12 coordinates")


def test_a_skill_that_gains_by_errors_of_the_estimate_has_a_remark() -> None:
    assert remarks() == []  # 120 independent poses of 12 coordinates
    few = np.isin(SEQUENCE, ["clip 0", "clip 1", "clip 2"])
    of_few = {"x": WORLD["x"][:, few], "y": WORLD["y"][few], "log_prob": WORLD["log_prob"][few]}
    truth = WORLD["y"][few][:, 1:].reshape(few.sum(), -1)
    own = multivariate_normal(truth.mean(axis=0), np.cov(truth.T, bias=True)).logpdf(truth).mean()
    gain = (own - climatology(truth, SEQUENCE[few]).mean()) / 2
    assert remarks(**of_few, labels={"sequence": SEQUENCE[few]}) == [
        f"log_likelihood_skill: about {gain:.1f} nats of it are because the 12 coordinates of climatology's Gaussian "
        "are estimated from too few independent poses."
    ]


def test_a_sequence_that_holds_nearly_all_poses_has_no_others() -> None:
    (line,) = remarks(labels={"sequence": np.where(np.arange(M) < 110, "a", "b")})
    assert line.startswith("log_likelihood_skill: no value, because the poses of some sequence can't be judged")


def test_meshes_are_not_searched() -> None:
    random = np.random.default_rng(5)
    truth = random.normal(0, 300, (6, 40, 3))
    found = posecal.evaluate(truth + random.normal(0, 9, (3, *truth.shape)), truth, unit="mm", log_prob=np.zeros(6))
    assert found["nll"] == 0
    assert "log_likelihood_skill" not in found.metrics
    with pytest.raises(PoseDataError, match=r"log_likelihood_skill needs poses of at most 96 coordinates"):
        posecal.evaluate(truth[None], truth, unit="mm", log_prob=np.zeros(6), metrics="log_likelihood_skill")
    assert [r for r in found.remarks if r.startswith("NLL: poses of 120 coordinates are not searched for constraints")]


@pytest.mark.parametrize("scored", [{"where": "occluded"}, {"where": "visible"}, {"joints": "RHip, LHip"}])
def test_scored_joints_alone_have_no_likelihood(scored: dict[str, str]) -> None:
    occluded = np.random.default_rng(6).random((M, K)) < 0.5
    found = report(occluded=occluded, protocol=posecal.Protocol(**scored))
    assert not {"nll", "nll_per_dimension", "log_likelihood_skill"} & found.metrics.keys()
    names = "nll, nll_per_dimension, log_likelihood_skill"
    reason = "which need where = all and joints = all, because a log density is of the whole pose"
    assert [r for r in found.remarks if r.startswith("left out: ") and f"{names}, {reason}" in r]
    with pytest.raises(PoseDataError, match=r"metrics: nll needs where = all and joints = all, because"):
        report(occluded=occluded, protocol=posecal.Protocol(**scored, metrics="nll"))


def test_the_root_is_no_part_of_a_likelihood() -> None:
    assert report(protocol=posecal.Protocol(joints="all but Hip"))["nll"] == pytest.approx(report()["nll"])

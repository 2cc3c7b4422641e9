"""Files and objects that state Gaussians are evaluated by draws from them, and by their exact density."""

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.engine import chunks
from posecal.errors import PoseDataError
from posecal.evaluation import evaluate
from tests.helpers.shell import done, rows

M, K, D = 60, 5, 3
JOINTS = ("Hip", "RHip", "RKnee", "LHip", "LKnee")
Array = npt.NDArray[np.float64]


def world(seed: int = 0) -> tuple[Array, Array, Array]:
    """True poses (M, K, D), means and deviations (M, K) of Gaussians that state them rightly, mm; the root rests."""
    random = np.random.default_rng(seed)
    sigma, mean = random.uniform(15, 60, (M, K)), random.normal(0, 300, (M, K, D))
    sigma[:, 0] = mean[:, 0] = 0
    return mean + sigma[..., None] * random.normal(size=mean.shape), mean, sigma


TRUTH, MEAN, SIGMA = world()
SEQUENCE = np.repeat([f"clip {s}" for s in range(6)], 10)
LOG_PROB = posecal.GaussianPrediction(MEAN, sigma=SIGMA).log_prob(TRUTH, root=0)


def stated(**options: Any) -> posecal.Report:
    prediction = posecal.GaussianPrediction(MEAN, sigma=SIGMA)
    labels = {"sequence": SEQUENCE}
    return evaluate(prediction, TRUTH, **{"unit": "mm", "joints": JOINTS, "draws": 20, "labels": labels, **options})


def write(folder: Path, **members: Any) -> tuple[Path, Path]:
    """Files of distributions and truth, in metres."""
    given = {"mean": MEAN / 1000, "sigma": SIGMA / 1000, "unit": "m", "joints": JOINTS, **members}
    np.savez(folder / "h.npz", **{name: value for name, value in given.items() if value is not None})
    np.savez(folder / "t.npz", truth=TRUTH / 1000, unit="m", joints=JOINTS, sequence=SEQUENCE)
    return folder / "h.npz", folder / "t.npz"


def test_the_nll_is_exact_and_the_rest_is_of_the_draws() -> None:
    drawn = posecal.GaussianPrediction(MEAN, sigma=SIGMA).sample(20)
    options = {"unit": "mm", "joints": JOINTS, "labels": {"sequence": SEQUENCE}}
    one, other = stated(), evaluate(drawn, TRUTH, log_prob=LOG_PROB, **options)
    assert one["nll"] == pytest.approx(-LOG_PROB.mean())
    assert one.scalars() == pytest.approx(other.scalars(), nan_ok=True)


def test_the_report_says_that_they_are_drawn() -> None:
    assert "N = 20 draws from the Gaussian that the model states for each pose, seed 3." in stated(seed=3).remarks
    weights = np.full((2, M), 0.5)
    mixture = posecal.GaussianPrediction([MEAN, MEAN], sigma=[SIGMA, SIGMA], mixture_weights=weights)
    report = evaluate(mixture, TRUTH, unit="mm", joints=JOINTS)
    assert (
        "N = 200 draws from the mixture of 2 Gaussians that the model states for each pose, seed 0." in report.remarks
    )
    assert report["nll"] == pytest.approx(-LOG_PROB.mean())


def test_two_runs_are_equal_and_another_seed_is_not() -> None:
    assert stated(seed=5).scalars() == pytest.approx(stated(seed=5).scalars(), rel=0, nan_ok=True)
    assert stated(seed=6)["ece"] != stated(seed=5)["ece"]
    assert stated(seed=6)["nll"] == stated(seed=5)["nll"]


def test_nothing_depends_on_blocks_or_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = stated(threads=1).scalars()
    assert stated(threads=3).scalars() == pytest.approx(expected, rel=0, nan_ok=True)
    monkeypatch.setattr(chunks, "WINDOW_BYTES", 7 * 20 * K * D * 8)
    assert stated().scalars() == pytest.approx(expected, rel=1e-12, nan_ok=True)


@pytest.mark.parametrize("size", [1, 17])
def test_batches_give_the_numbers_of_one_call(size: int) -> None:
    evaluation = posecal.Evaluation(unit="mm", joints=JOINTS, draws=20, axes="NMKD")
    for start in range(0, M, size):
        part = slice(start, start + size)
        prediction = posecal.GaussianPrediction(MEAN[part], sigma=SIGMA[part])
        evaluation.update(prediction, TRUTH[part], sequence=SEQUENCE[part])
    assert evaluation.compute().scalars() == pytest.approx(stated().scalars(), rel=1e-9, nan_ok=True)


def test_shards_merge_into_the_nll_of_one_run() -> None:
    parts = [evaluate(stated_data().select(np.flatnonzero(np.isin(SEQUENCE, names)))) for names in SHARDS]
    merged = posecal.Report(posecal.merge_totals([part.totals for part in parts]))
    assert merged.scalars() == pytest.approx(evaluate(stated_data()).scalars(), rel=1e-9, nan_ok=True)


SHARDS = (["clip 0", "clip 3"], ["clip 1", "clip 2", "clip 4", "clip 5"])


def stated_data() -> posecal.PoseData:
    prediction = posecal.GaussianPrediction(MEAN, sigma=SIGMA)
    labels = {"sequence": SEQUENCE}
    return posecal.PoseData(prediction, TRUTH, unit="mm", joints=JOINTS, labels=labels, draws=20)


def test_files_and_arrays_give_the_same(tmp_path: Path) -> None:
    report = evaluate(*write(tmp_path), draws=20)
    assert report.scalars() == pytest.approx(stated().scalars(), rel=1e-6, nan_ok=True)
    data = posecal.PoseData(*write(tmp_path), draws=20)
    assert evaluate(pickle.loads(pickle.dumps(data)))["ece"] == report["ece"]


def test_compressed_files_and_mixtures_are_read(tmp_path: Path) -> None:
    members = {"mean": np.stack([MEAN, MEAN + 5]), "sigma": np.stack([SIGMA, SIGMA]), "unit": "mm"}
    weights = np.stack([np.full(M, 0.25), np.full(M, 0.75)])
    np.savez_compressed(tmp_path / "c.npz", **members, mixture_weights=weights, joints=JOINTS)
    prediction = posecal.GaussianPrediction(members["mean"], sigma=members["sigma"], mixture_weights=weights)
    report = evaluate(tmp_path / "c.npz", write(tmp_path)[1], draws=20)
    assert report["nll"] == pytest.approx(-prediction.log_prob(TRUTH, root=0).mean())


def test_frames_and_joints_are_matched_by_name(tmp_path: Path) -> None:
    frames, order, joints = np.arange(M).astype(str), np.random.default_rng(1).permutation(M), [3, 0, 4, 1]
    np.savez(tmp_path / "h.npz", mean=MEAN, sigma=SIGMA, unit="mm", joints=JOINTS, frame_id=frames)
    truth, names = TRUTH[order][:, joints], np.array(JOINTS)[joints]
    np.savez(tmp_path / "t.npz", truth=truth, unit="mm", joints=names, frame_id=frames[order])
    report = evaluate(tmp_path / "h.npz", tmp_path / "t.npz", shared_joints="common", draws=20)
    some = posecal.GaussianPrediction(MEAN[:, joints], sigma=SIGMA[:, joints])
    assert report["nll"] == pytest.approx(-some.log_prob(TRUTH[:, joints], root=1).mean())
    assert report.totals.spec.dimensions == 9


def test_the_command_line_gives_the_numbers_of_python(tmp_path: Path) -> None:
    hypotheses, truth = write(tmp_path)
    found = rows(done("evaluate", hypotheses, truth, "--draws", "20", "--seed", "2", "--format", "json"))
    expected = evaluate(hypotheses, truth, draws=20, seed=2)
    for name in ("nll", "log_likelihood_skill", "ece", "min_mpjpe"):
        assert found[name, None, None] == pytest.approx(expected[name])


def test_a_stated_and_a_sampled_model_are_compared_and_share_the_nll_where_both_have_one(tmp_path: Path) -> None:
    drawn = posecal.GaussianPrediction(MEAN, sigma=SIGMA).sample(20, seed=8)
    described = {"unit": "mm", "joints": JOINTS, "labels": {"sequence": SEQUENCE}}
    models = {"stated": stated(), "sampled": evaluate(drawn, TRUTH, **described)}
    comparison = posecal.compare(models)
    assert "nll" not in comparison.metrics
    assert comparison.value("mpjpe", "stated") == pytest.approx(comparison.value("mpjpe", "sampled"), rel=0.02)
    models["sampled"] = evaluate(drawn, TRUTH, log_prob=LOG_PROB - 3, **described)
    (difference,) = posecal.compare(models).differences_of("nll")
    assert difference.value == pytest.approx(-3)
    assert difference.better == "stated"
    models["sampled"] = evaluate(drawn, TRUTH, log_prob=LOG_PROB, dimensions=11, **described)
    assert "nll" not in posecal.compare(models).metrics  # of another number of coordinates


def test_draws_are_asked_for_where_there_is_a_distribution() -> None:
    drawn = posecal.GaussianPrediction(MEAN, sigma=SIGMA).sample(20)
    report = evaluate(drawn, TRUTH, unit="mm", joints=JOINTS, draws=30)
    assert "hypotheses holds hypotheses: none are drawn, whatever draws and seed are." in report.remarks
    for wrong in ({"draws": 0}, {"draws": 2.5}, {"seed": -1}):
        with pytest.raises(PoseDataError, match=rf"^{next(iter(wrong))}: "):
            stated(**wrong)


def test_a_density_beside_a_distribution_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^h\.npz: log_prob beside distributions, which give it; expected one"):
        posecal.PoseData(*write(tmp_path, log_prob=LOG_PROB))


def test_wrong_covariances_are_counted_over_the_whole_file(tmp_path: Path) -> None:
    sigma = SIGMA.copy()
    sigma[[7, 31, 55], 2] = -1
    with pytest.raises(PoseDataError, match=r"^h\.npz: sigma: not above 0 in 3 of 60 frames \(first: 7, 31, 55\)"):
        posecal.PoseData(*write(tmp_path, sigma=sigma))


def test_poses_that_lack_a_joint_are_left_out_of_the_nll() -> None:
    where = np.ones((M, K), dtype=bool)
    where[[3, 8], 2] = False
    report = stated(where=where)
    assert report["nll"] == pytest.approx(-np.delete(LOG_PROB, [3, 8]).mean())
    assert "NLL: 2 poses lack a joint; left out of it." in report.remarks


@pytest.mark.parametrize("root", ["Hip", "none", "LHip+RHip"])
@pytest.mark.parametrize("kind", ["sigma", "covariance", "full"])
@pytest.mark.parametrize("wrong", [np.nan, -1.0, np.inf])
def test_what_is_stated_of_joints_that_do_not_count_may_be_anything(kind: str, wrong: float, root: str) -> None:
    deviations = SIGMA + 5.0
    variances = deviations[:, :, None, None] ** 2 * np.eye(D)
    full = np.einsum("mkij,kl->mkilj", variances, np.eye(K)).reshape(M, K * D, K * D)
    spread = {"sigma": deviations, "covariance": variances, "full": full}[kind].copy()
    where = np.ones((M, K), dtype=bool)
    where[7] = where[9, 2] = False
    options = {"unit": "mm", "joints": JOINTS, "root_joint": root, "draws": 20, "where": where, "threads": 1}

    def report() -> posecal.Report:
        given = {"sigma": spread} if kind == "sigma" else {"covariance": spread}
        return evaluate(posecal.GaussianPrediction(MEAN, **given), TRUTH, metrics="default, scores", **options)

    right = report()
    places = np.ix_(range(2 * D, 3 * D), range(K * D)) if kind == "full" else (2,)
    spread[7], spread[9][places] = wrong, wrong
    assert report().scalars() == pytest.approx(right.scalars(), nan_ok=True)
    spread[8][places] = -1
    with pytest.raises(PoseDataError, match=r" in 1 of \d+ frames \(first: 8\)"):
        report()


def test_relative_to_a_midpoint_and_of_angles_there_is_no_density() -> None:
    report = stated(root_joint="LHip+RHip")
    assert "nll" not in report.metrics
    assert [r for r in report.remarks if "relative to the midpoint LHip+RHip have no density. root_joint names" in r]
    angles = posecal.GaussianPrediction(MEAN[..., :1] / 9, sigma=SIGMA / 9 + 1)
    report = evaluate(angles, TRUTH[..., :1] / 9, unit="deg", draws=20)
    assert "nll" not in report.metrics
    assert "NLL: left out, because a Gaussian does not repeat as angles do." in report.remarks


def test_a_world_that_is_stated_rightly_is_calibrated() -> None:
    random = np.random.default_rng(9)
    m = 3000
    sigma, mean = random.uniform(15, 60, (m, K)), random.normal(0, 300, (m, K, D))
    truth = mean + sigma[..., None] * random.normal(size=mean.shape)
    options = {"unit": "mm", "root_joint": "none", "draws": 50, "labels": {"sequence": np.arange(m) // 100}}
    report = evaluate(posecal.GaussianPrediction(mean, sigma=sigma), truth, metrics="ece, coverage_90, nll", **options)
    assert report.test("ece").p > 0.001
    assert report["ece"] < 0.02
    # the entropy of each coordinate is log σ + log(2πe) / 2, and −log p has a variance of 1/2
    entropy = D * (np.log(sigma) + math.log(2 * math.pi * math.e) / 2).sum(axis=1).mean()
    assert report["nll"] == pytest.approx(entropy, abs=4.5 * math.sqrt(K * D / 2 / m))


@pytest.mark.parametrize("name", ["mean", "sigma"])
def test_a_part_of_a_distribution_is_no_hypothesis(name: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "h.npz", **{name: MEAN}, unit="mm")
    with pytest.raises(PoseDataError, match=rf"^h.npz holds {name}; expected mean and covariance, or mean and sigma"):
        posecal.PoseData(tmp_path / "h.npz", np.asarray(TRUTH), unit="mm")


def test_a_density_that_is_beyond_all_numbers_is_refused() -> None:
    sigma = SIGMA.copy()
    sigma[7, 1:] = 1e-200
    with pytest.raises(PoseDataError, match=r"the stated log density of the truth is not finite in 1 of 60 frames"):
        evaluate(posecal.GaussianPrediction(MEAN, sigma=sigma), TRUTH, unit="mm", joints=JOINTS, draws=5)

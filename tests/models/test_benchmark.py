"""The benchmark on held-out motion capture: its numbers against plain formulas, and its output files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from posecal.engine.storage import load_totals
from posecal.errors import PoseDataError
from posecal.report.report import Report
from posecal_models import benchmark
from posecal_models.benchmark_report import run_benchmark
from posecal_models.checkpoint import save_estimator
from posecal_models.estimators.cgnf.flow import SIZES
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.figures import model_sizes


@pytest.fixture(scope="module")
def images(motion_file):
    return benchmark.held_out_poses(motion_file, ["S3", "S4"], every=5, views=2)


@pytest.fixture(scope="module")
def baseline(images):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        estimator = SimpleBaseline(width=8).eval()
    ordered = images.in_order_of(estimator.joints, estimator.keypoints)
    estimator.standardizer.fit(torch.from_numpy(ordered.poses), torch.from_numpy(ordered.keypoints))
    return estimator


@pytest.fixture(scope="module")
def noisy(baseline):
    estimator = GaussianNoise(baseline).eval()
    estimator.log_sigma.data.fill_(float(np.log(100.0)))
    return estimator


def test_the_images_are_those_of_the_held_out_people(images):
    assert set(images.subject) == {"S3", "S4"}
    assert len(images) == 2 * 2 * 4 * 2  # people, clips, every fifth of 20 frames, views


def test_the_columns_are_the_plain_formulas(images, noisy):
    row = benchmark.evaluate_estimator("noise", noisy, images, n=30, seeds=(0, 7))
    ordered = images.in_order_of(noisy.joints, noisy.keypoints)
    for index, seed in enumerate((0, 7)):
        drawn = benchmark.draw_hypotheses(noisy, images, 30, seed=seed)
        errors = np.linalg.norm(drawn - ordered.poses, axis=-1)  # (N, M, K)
        best = (errors.sum(-1) / 17).min(0)  # the root counts, with error 0
        np.testing.assert_allclose(row.values["min_mpjpe"][index], best.mean(), rtol=1e-5)
        hard = (~ordered.observed).sum(1) >= benchmark.HARD
        assert 0 < hard.sum() < len(hard)
        np.testing.assert_allclose(row.values["hard_min_mpjpe"][index], best[hard].mean(), rtol=1e-5)
        distances = np.linalg.norm(drawn[:, None] - drawn[None], axis=-1) if index == 0 else None
        if distances is not None:
            distances_to_truth = np.sqrt((np.square(drawn - ordered.poses)).sum((-1, -2)))
            pairs = np.sqrt(np.square(drawn[:, None] - drawn[None]).sum((-1, -2)))
            energy = (distances_to_truth.mean(0) - pairs.sum((0, 1)) / (2 * 30 * 29)).mean()
            np.testing.assert_allclose(row.values["energy_score"][0], energy, rtol=1e-4)
    assert row.values["n"] == [30]
    assert row.values["min_mpjpe"][0] != row.values["min_mpjpe"][1]


def test_a_point_has_one_hypothesis_and_no_calibration(images, baseline):
    row = benchmark.evaluate_estimator("point", baseline, images, n=30, seeds=(0, 1))
    ordered = images.in_order_of(baseline.joints, baseline.keypoints)
    errors = np.linalg.norm(benchmark.draw_hypotheses(baseline, images, 1)[0] - ordered.poses, axis=-1)
    np.testing.assert_allclose(row.values["min_mpjpe"], [errors.sum(-1).mean() / 17], rtol=1e-5)
    assert row.values["ece"] == []
    assert row.report is None


def test_a_cell_is_mean_and_standard_deviation():
    row = benchmark.BenchmarkRow("a", {name: [] for name in benchmark.COLUMNS} | {"min_mpjpe": [1.0, 2, 3]}, None, 0.0)
    assert "| a | 2.0 ± 1.00 | – |" in benchmark.markdown([row])
    assert r"| a\x1b[31m\udce9 | 2.0" in benchmark.markdown([replace(row, name="a\x1b[31m\udce9")])


@pytest.mark.slow
def test_table_numbers_and_figures_are_written_to_the_folder(motion_file, baseline, noisy, tmp_path):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        flow = CGNF(SIZES["tiny"])
    flow.standardizer.load_state_dict(baseline.standardizer.state_dict())
    for name, estimator in (("point", baseline), ("noise", noisy), ("flow", flow)):
        save_estimator(tmp_path / f"{name}.safetensors", estimator)
    models = {name: str(tmp_path / f"{name}.safetensors") for name in ("point", "noise", "flow")}
    table = run_benchmark(motion_file, models, ["S4"], tmp_path / "out", n=4, every=5, seeds=2)
    names = ["benchmark.json", "flow-hypotheses.png", "flow-prior.png", "flow.npz", "noise.npz", "reliability.png"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [*names, "sizes.png", "table.md"]
    assert (tmp_path / "out" / "table.md").read_text() == table + "\n"
    about = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert len(about["rows"]["flow"]["min_mpjpe"]) == 2
    for name in ("flow", "noise"):
        saved = Report(load_totals(tmp_path / "out" / f"{name}.npz"))
        assert saved.value("min_mpjpe") == about["rows"][name]["min_mpjpe"][0]


@pytest.mark.parametrize("names", [("G (x)", "G-x"), ("***",)])
def test_names_that_would_share_a_file_are_refused_before_any_work(tmp_path, names):
    with pytest.raises(PoseDataError, match="give files of the same name"):
        run_benchmark(tmp_path / "no.npz", dict.fromkeys(names, "no.safetensors"), ["S4"], tmp_path / "out")


def test_a_model_that_can_t_read_the_images_is_refused_before_any_is_drawn(motion_file, noisy, tmp_path):
    flow = CGNF(SIZES["tiny"], origin="root")
    for name, estimator in (("noise", noisy), ("flow", flow)):
        save_estimator(tmp_path / f"{name}.safetensors", estimator)
    models = {name: str(tmp_path / f"{name}.safetensors") for name in ("noise", "flow")}
    with pytest.raises(PoseDataError, match="no Hip in"):
        run_benchmark(motion_file, models, ["S4"], tmp_path / "out", n=4, every=5)
    assert not (tmp_path / "out").exists()


def test_calibration_and_error_stand_over_the_number_of_parameters():
    rows = {
        "large": {"parameters": [1000], "ece": [0.04, 0.06], "min_mpjpe": [70.0, 80.0]},
        "small": {"parameters": [10], "ece": [0.01, 0.03], "min_mpjpe": [90.0, 90.0]},
    }
    calibration, error = model_sizes(rows).axes
    for ax, means in ((calibration, [0.02, 0.05]), (error, [90, 75])):
        (line,) = (line for line in ax.lines if line.get_linestyle() == "-")
        np.testing.assert_allclose(line.get_xydata(), np.transpose([[10, 1000], means]))
        assert [text.get_text() for text in ax.texts] == ["small", "large"]

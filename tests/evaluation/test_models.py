"""Comparison of models, each given as a report, its sums, a saved result, pose data, arrays or files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.report.comparison import Comparison
from tests.helpers.samplers import gaussian, sequences

N, M, K = 6, 24, 4
HOW: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "labels": {"sequence": sequences(M, 8)}}
X, Y = gaussian(0, N, M, K)
MODELS = {"right": X, "off": X + 60.0}
METRICS = "mpjpe, ece"


def evaluated(x: np.ndarray, **options: Any) -> posecal.Report:
    return posecal.evaluate(x, Y, **HOW, **options)


FORMS: dict[str, Callable[[np.ndarray, Path], Any]] = {
    "report": lambda x, _: evaluated(x, metrics=METRICS),
    "totals": lambda x, _: evaluated(x, metrics=METRICS).totals,
    "pose data": lambda x, _: posecal.PoseData(x, Y, **HOW),
}


@pytest.fixture(scope="module")
def expected() -> Comparison:
    return posecal.compare(MODELS, Y, metrics=METRICS, **HOW)


def same(one: Comparison, other: Comparison) -> bool:
    return one.names == other.names and one.render("json") == other.render("json")


@pytest.mark.parametrize("form", FORMS)
def test_models_may_be_given_in_several_forms(form: str, expected: Comparison, tmp_path: Path) -> None:
    models = {name: FORMS[form](x, tmp_path) for name, x in MODELS.items()}
    assert same(posecal.compare(models, metrics=METRICS), expected)
    assert expected.value("mpjpe", "right") == evaluated(X, metrics=METRICS)["mpjpe"]
    assert expected.names == ("right", "off")


def test_forms_may_be_mixed_and_keep_their_order(expected: Comparison) -> None:
    models = {"right": posecal.PoseData(X, Y, **HOW), "off": evaluated(MODELS["off"], metrics=METRICS)}
    assert same(posecal.compare(models, metrics=METRICS), expected)


@pytest.mark.parametrize("kind", [str, Path])
def test_a_path_is_a_saved_result_or_with_a_truth_hypotheses(
    kind: Callable[[Path], Any], expected: Comparison, tmp_path: Path
) -> None:
    results, files = {}, {}
    for name, x in MODELS.items():
        evaluated(x, metrics=METRICS).save(tmp_path / f"{name}.npz")
        np.save(tmp_path / f"{name}.npy", x)
        results[name], files[name] = kind(tmp_path / f"{name}.npz"), kind(tmp_path / f"{name}.npy")
    assert same(posecal.compare(results), expected)
    assert same(posecal.compare(files, Y, metrics=METRICS, **HOW), expected)


def test_models_are_compared_by_the_default_metrics_and_scores_unless_others_are_asked_for() -> None:
    assert {"min_mpjpe", "ece", "energy_score"} <= posecal.compare(MODELS, Y, **HOW).metrics.keys()
    assert posecal.compare(MODELS, Y, metrics="mpjpe", **HOW).metrics.keys() == {"mpjpe"}
    default = posecal.compare(MODELS, Y, protocol=Protocol(), **HOW).metrics
    assert "min_mpjpe" in default
    assert "energy_score" not in default
    both = posecal.compare(MODELS, Y, protocol=Protocol(align="rigid"), metrics="mpjpe", **HOW)
    assert both.metrics.keys() == {"mpjpe"}
    assert "align=rigid" in both.totals[0].signature


def test_primary_metrics_are_measured_and_checked_before_the_models_are() -> None:
    found = posecal.compare(MODELS, Y, primary=["mahalanobis", "ece"], **HOW)
    assert found.primary == ("mahalanobis", "ece")
    assert "energy_score" in found.metrics
    assert posecal.compare(MODELS, Y, metrics="mpjpe, pck", **HOW).primary == ("mpjpe", "pck")
    counted: list[str] = []
    for primary, words in (
        ("crp", r"^primary: crp not known\. Did you mean crps\?"),
        (5, r"^primary: 5; expected names of metrics\.$"),
    ):
        with pytest.raises(PoseDataError, match=words):
            posecal.compare(MODELS, Y, primary=primary, progress=counted.append, **HOW)  # type: ignore[arg-type]
    assert counted == []
    reports = {name: evaluated(x, metrics=METRICS) for name, x in MODELS.items()}
    assert posecal.compare(reports, primary="mpjpe").primary == ("mpjpe",)
    with pytest.raises(PoseDataError, match=r"^primary: crps was not measured\. Evaluate with metrics="):
        posecal.compare(reports, primary="crps")


@pytest.mark.parametrize("n", [1, 2])
def test_of_one_hypothesis_there_are_no_scores(n: int) -> None:
    found = posecal.compare({name: x[:n] for name, x in MODELS.items()}, Y, **HOW).metrics
    assert "min_mpjpe" in found
    assert ("energy_score" in found) == (n > 1)


def test_a_model_of_one_hypothesis_is_compared_with_no_other() -> None:
    with pytest.raises(PoseDataError, match=r"^many and one were not made alike: N 6 against 1\. Evaluate both"):
        posecal.compare({"many": X, "one": X[:1]}, Y, **HOW)


def test_what_depends_on_all_poses_is_known_for_each_model() -> None:
    found = posecal.compare(MODELS, Y, metrics="tarp_box", **HOW)
    assert found.value("tarp_box", "off") == evaluated(MODELS["off"], metrics="tarp_box")["tarp_box"]


def test_progress_is_of_each_model_by_name() -> None:
    done: dict[str, list[int]] = {}

    def progress(name: str) -> Callable[[int], object] | None:
        return done.setdefault(name, []).append if name == "off" else None

    posecal.compare(MODELS, Y, metrics="mpjpe", progress=progress, **HOW)
    assert done == {"off": [M]}


@pytest.mark.parametrize("reports", [True, False])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"unti": "mm"}, r"^option: 'unti' is not known\. Did you mean unit\?"),
        ({"progress": 5}, r"^progress: 5; expected a callable\.$"),
    ],
)
def test_options_that_are_none_are_refused_whatever_the_models(
    options: dict[str, Any], words: str, reports: bool
) -> None:
    models = {name: evaluated(x, metrics="mpjpe") if reports else x for name, x in MODELS.items()}
    with pytest.raises(PoseDataError, match=words):
        posecal.compare(models, None if reports else Y, **options)  # type: ignore[arg-type]


def test_models_are_two_or_more_by_name() -> None:
    with pytest.raises(
        PoseDataError, match=r"^models: list; expected a mapping from names to reports or hypotheses\.$"
    ):
        posecal.compare([X, X], Y)  # type: ignore[arg-type]
    with pytest.raises(PoseDataError, match=r"^compare: 1 model; expected at least 2\.$"):
        posecal.compare({"one": X}, Y, **HOW)

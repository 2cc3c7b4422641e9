"""``posecal compare``: models on the same poses, from files or saved results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.shell import MODELS_JOINTS, done, refused

COMPARE = ("compare", "right.npz", "narrow.npz", "true.npz")


def copied(name: str, copy: str) -> None:
    Path(copy).parent.mkdir(exist_ok=True)
    Path(copy).write_bytes(Path(name).read_bytes())


def test_two_models_are_compared_with_intervals_and_p_values() -> None:
    text = done(*COMPARE)
    assert "right against narrow" in text
    assert "paired by 12 sequences" in text
    assert "signature:" in text
    assert "energy score: right is best beyond chance." in text
    assert "No miscalibration shown on average: right." in " ".join(text.split())


def test_saved_results_compare_as_their_files_do() -> None:
    for name in ("right", "narrow"):
        done("evaluate", f"{name}.npz", "true.npz", "--scores", "--save", f"{name}-result.npz")
    text = done("compare", "right-result.npz", "narrow-result.npz", "--format", "json")
    files = json.loads(done(*COMPARE, "--format", "json"))
    saved = json.loads(text.replace("-result", ""))
    assert saved == files


def test_three_models_are_ranked() -> None:
    copied("narrow.npz", "same.npz")
    text = done("compare", "right.npz", "narrow.npz", "same.npz", "true.npz", "--format=markdown")
    assert text.startswith("right against narrow against same")
    row = next(line for line in text.splitlines() if line.startswith("| energy score "))
    assert re.findall(r"\((\d)\)", row) == ["1", "2", "2"]


def test_three_models_stand_with_the_p_and_interval_of_each_pair() -> None:
    copied("narrow.npz", "same.npz")
    text = done("compare", "right.npz", "narrow.npz", "same.npz", "true.npz", "--format=markdown")
    rows = [line for line in text.splitlines() if line.startswith("| energy score ") and " − " in line]
    assert [re.findall(r"\w+ − \w+", row)[0] for row in rows] == ["right − narrow", "right − same", "narrow − same"]
    assert all(re.search(r"[+-][\d.]+ to [+-][\d.]+", row) for row in rows[:2])
    assert [row.split("|")[-2].strip() for row in rows] == ["right", "right", ""]


def test_primary_metrics_are_chosen_by_name() -> None:
    found = json.loads(done(*COMPARE, "--primary=mahalanobis, crps", "--format=json"))
    assert found["primary"] == ["mahalanobis", "crps"]
    assert {d["metric"] for d in found["differences"] if d["primary"]} == {"mahalanobis", "crps"}
    assert "primary: crp not known. Did you mean crps?" in refused(*COMPARE, "--primary=crp")
    said = refused(*COMPARE, "--primary=crps", "--metrics=ece")
    assert "primary: crps was not measured. Evaluate with --metrics 'ece, scores'." in said


@pytest.mark.parametrize("words", [(), ("--where=all",), ("--rank-tests",)])
def test_scores_are_compared_unless_metrics_are_chosen(words: tuple[str, ...]) -> None:
    found = json.loads(done(*COMPARE, *words, "--format=json"))
    assert found["primary"] == ["energy_score", "ece"]
    assert json.loads(done(*COMPARE, *words, "--metrics=default", "--format=json"))["primary"] == ["min_mpjpe", "ece"]


def test_results_without_scores_say_so_once() -> None:
    for name in ("right", "narrow"):
        done("evaluate", f"{name}.npz", "true.npz", "--save", f"{name}-result.npz")
    text = done("compare", "right-result.npz", "narrow-result.npz")
    words = "note: primary metrics: min_mpjpe, ece; energy_score was not measured. Evaluate with --metrics 'default, "
    assert " ".join(text.split()).count(words) == 1


def test_single_poses_are_compared_by_their_accuracy() -> None:
    for name in ("right", "narrow"):
        with np.load(f"{name}.npz") as file:
            np.savez(f"one-{name}.npz", hypotheses=file["hypotheses"][:1], axes="NMKD", joints=MODELS_JOINTS)
    text = done("compare", "one-right.npz", "one-narrow.npz", "true.npz", "--format=markdown")
    assert "| MPJPE " in text
    assert "energy" not in text


@pytest.mark.parametrize("words", [("--set", "metrics=mean_pose_mpjpe"), ("--metrics", "mean_pose_mpjpe")])
def test_an_option_says_what_is_compared(words: tuple[str, str]) -> None:
    values = json.loads(done(*COMPARE, *words, "--format=json"))["values"]
    assert {value["metric"] for value in values} == {"mean_pose_mpjpe"}


def test_options_of_evaluate_are_those_of_compare() -> None:
    values = json.loads(done(*COMPARE, "--rank-tests", "--scores", "--joints=Head,LFoot", "--format=json"))
    names = {value["metric"] for value in values["values"]}
    assert {"min_mpjpe", "ece", "mahalanobis", "energy_score"} <= names
    assert "joints=Head,LFoot" in values["signature"]


@pytest.mark.parametrize("form", ["csv", "latex"])
def test_a_comparison_is_written_as_a_table(form: str) -> None:
    text = done(*COMPARE, "--format", form, "--metrics=mpjpe")
    first = {"csv": "metric,first,second,", "latex": "% right against narrow · the same M = 48 poses"}
    assert text.startswith(first[form])
    assert ("\\bottomrule" in text) == (form == "latex")


def test_labels_name_the_models() -> None:
    text = done(*COMPARE, "--metrics=mpjpe", "--labels=ours,theirs")
    assert text.startswith("ours against theirs")
    assert "expected 2 different names" in refused(*COMPARE, "--labels=ours", code=2)


def test_a_comparison_without_its_truth_is_a_wrong_call() -> None:
    assert "and, last, the truth" in refused("compare", "right.npz", "narrow.npz", code=2)


@pytest.mark.parametrize("length", [0, 1000, None])
def test_a_damaged_result_is_no_wrong_call(length: int | None) -> None:
    """Cut off anywhere, or not there at all."""
    done("evaluate", "right.npz", "true.npz", "--metrics=ece", "--save=a.npz")
    if length is not None:
        Path("b.npz").write_bytes(Path("a.npz").read_bytes()[:length])
    words = "no such file" if length is None else "no result of posecal evaluate --save, or not a whole one"
    for files in (["a.npz", "b.npz"], ["b.npz", "a.npz"], ["b.npz", "b.npz"], ["a.npz", "a.npz", "b.npz"]):
        assert f"b.npz: {words}." in refused("compare", *files)


def test_results_beside_other_files_are_refused_by_name() -> None:
    done("evaluate", "right.npz", "true.npz", "--metrics=ece", "--save=a.npz")
    said = refused("compare", "a.npz", "a.npz", "true.npz")
    assert "true.npz: no result of posecal evaluate --save, or a damaged one; a.npz is one. Expected results" in said


def test_files_of_one_name_are_called_by_their_paths() -> None:
    copied("narrow.npz", "b/right.npz")
    text = done("compare", "right.npz", "b/right.npz", "true.npz", "--format=markdown")
    assert text.startswith("right against b/right ")
    copied("narrow.npz", "right.npy.npz")
    text = done("compare", "right.npz", "right.npz", "narrow.npz", "true.npz", "--format=markdown")
    assert text.startswith("right against right #2 against narrow ")


def test_a_comparison_is_drawn() -> None:
    done(*COMPARE, "--plot=axes.svg")
    assert Path("axes.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert "axes.jpg: .jpg; expected a name that ends with" in refused(*COMPARE, "--plot=axes.jpg", code=2)


def test_models_that_were_not_made_alike_are_refused() -> None:
    words = ("compare", "right.npz", "fewer.npz", "true.npz")
    said = refused(*words)
    assert "N 9 against 5" in said
    assert "--hypotheses takes as many hypotheses of each." in said
    assert "right against fewer" in done(*words, "--hypotheses=5")

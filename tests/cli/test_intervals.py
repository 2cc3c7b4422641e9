"""Comparing, recalibrating, the battery, skills and explanations at the command line."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from posecal.cli import app
from posecal.recalibration import read_map
from posecal.recalibration.dispersion import stretched
from tests.helpers.samplers import gaussian, sequences

N, M, K, S = 9, 48, 4, 12
JOINTS = np.array(["Head", "LWrist", "RKnee", "LFoot"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A right and a narrow model, a second truth, and a pre-rank."""
    path = tmp_path_factory.mktemp("poses")
    x, y = gaussian(0, N, M, K, dtype="f4")
    narrow = x.mean(axis=0) + 0.4 * (x - x.mean(axis=0))
    about = {"unit": "mm", "joints": JOINTS, "frame_id": np.array([f"f{m:02}" for m in range(M)])}
    for name, hypotheses in (("right", x), ("narrow", narrow), ("fewer", x[:5])):
        np.savez(path / f"{name}.npz", hypotheses=hypotheses, axes="NMKD", **about, allow_pickle=False)
    labels = {"sequence": sequences(M, S)}
    np.savez(path / "gt.npz", truth=y, axes="MKD", **labels, **about, allow_pickle=False)
    np.savez(path / "other.npz", truth=y + 7, axes="MKD", **labels, **about, allow_pickle=False)
    (path / "own.py").write_text(
        "def height(pool):\n    return pool[..., 2].max(axis=1)\n\n\nbroken = lambda pool: 1 / 0\n"
    )
    return path


def run(folder: Path, command: str) -> Result:
    """Run a command; words that end in a known suffix are files of the folder."""
    words = [str(folder / w) if re.search(r"\.(npz|json|py|svg|png)(:|$)", w) else w for w in command.split()]
    return CliRunner().invoke(app, [*words, "--root-joint", "none"] if "--root-joint" not in words else words)


def done(folder: Path, command: str) -> str:
    result = run(folder, command)
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(folder: Path, command: str) -> str:
    result = run(folder, command)
    assert result.exit_code == 3, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("posecal: ")
    return " ".join(result.stderr.split())


# --- compare ----------------------------------------------------------------------------------------------------------


def test_compare_says_which_of_two_is_better_by_how_much_and_how_sure(folder: Path) -> None:
    text = done(folder, "compare right.npz narrow.npz gt.npz")
    assert "right against narrow" in text
    assert "paired by 12 sequences" in text
    assert "signature:" in text
    assert "energy score: right is best beyond chance." in text
    assert "Not miscalibrated beyond chance: right." in " ".join(text.split())


def test_saved_results_compare_as_their_files_do(folder: Path) -> None:
    for name in ("right", "narrow"):
        (folder / name).mkdir()
        done(folder, f"evaluate {name}.npz gt.npz --scores --save {name}/{name}.npz")
    files = done(folder, "compare right.npz narrow.npz gt.npz --format json")
    saved = [str(folder / name / f"{name}.npz") for name in ("right", "narrow")]
    assert CliRunner().invoke(app, ["compare", *saved, "--format", "json"]).stdout == files


def test_three_models_are_ranked(folder: Path) -> None:
    shutil.copy(folder / "narrow.npz", folder / "same.npz")
    text = done(folder, "compare right.npz narrow.npz same.npz gt.npz --format markdown")
    assert text.startswith("right against narrow against same")
    row = next(line for line in text.splitlines() if line.startswith("| energy score |"))
    assert re.findall(r"\((\d)\)", row) == ["1", "2", "2"]


def test_single_poses_are_compared_by_their_accuracy(folder: Path) -> None:
    for name in ("right", "narrow"):
        with np.load(folder / f"{name}.npz") as file:
            np.savez(folder / f"one-{name}.npz", hypotheses=file["hypotheses"][:1], axes="NMKD", joints=JOINTS)
    text = done(folder, "compare one-right.npz one-narrow.npz gt.npz --format markdown")
    assert "| MPJPE |" in text
    assert "energy" not in text


def test_an_option_says_what_is_compared(folder: Path) -> None:
    found = json.loads(done(folder, "compare right.npz narrow.npz gt.npz --set metrics=median_mpjpe --format json"))
    assert {value["metric"] for value in found["values"]} == {"median_mpjpe"}


def test_a_comparison_without_its_truth_is_a_wrong_call(folder: Path) -> None:
    result = run(folder, "compare right.npz narrow.npz")
    assert result.exit_code == 2
    assert "and, last, the truth" in " ".join(result.stderr.replace("│", " ").split())


def test_files_of_one_name_are_called_by_their_paths(folder: Path) -> None:
    (folder / "b").mkdir()
    shutil.copy(folder / "narrow.npz", folder / "b/right.npz")
    text = done(folder, "compare right.npz b/right.npz gt.npz --format markdown")
    assert re.match(r"\S*right against \S*b/right ", text)


def test_a_comparison_is_drawn(folder: Path) -> None:
    done(folder, "compare right.npz narrow.npz gt.npz --plot axes.svg")
    assert (folder / "axes.svg").read_text().startswith("<?xml")


def test_models_that_were_not_made_alike_are_refused(folder: Path) -> None:
    assert "N 9 against 5" in refused(folder, "compare right.npz fewer.npz gt.npz")
    assert "right against narrow" not in done(folder, "compare right.npz fewer.npz gt.npz --hypotheses 5")


# --- recalibrate ------------------------------------------------------------------------------------------------------


def test_a_spread_is_fitted_judged_on_held_out_sequences_and_applied(folder: Path) -> None:
    text = " ".join(done(folder, "recalibrate fit narrow.npz gt.npz -o map.json --split --folds 3").split())
    factor = float(re.search(r"Spread factor (\d\.\d+) for all joints, fitted on 48 poses", text)[1])  # type: ignore[index]
    assert 2 < factor < 3
    assert "held out, 3 parts" in text
    done(folder, "recalibrate apply narrow.npz map.json -o mended.npz")
    with np.load(folder / "mended.npz") as mended, np.load(folder / "narrow.npz") as narrow:
        expected = stretched(narrow["hypotheses"], read_map(folder / "map.json").factors)  # type: ignore[union-attr]
        np.testing.assert_array_equal(mended["hypotheses"].swapaxes(0, 1), expected)
        np.testing.assert_array_equal(mended["frame_id"], narrow["frame_id"])
    assert "energy score: mended is best beyond chance" in done(folder, "compare mended.npz narrow.npz gt.npz")


def test_what_a_file_says_of_its_hypotheses_goes_with_them(folder: Path) -> None:
    done(folder, "recalibrate fit narrow.npz gt.npz -o map.json")
    said = {"scores": np.arange(N * M, dtype="f4").reshape(N, M), "occluded": np.arange(M * K).reshape(M, K) % 3 == 0}
    said |= {"action": np.repeat(["walk", "sit"], M // 2), "fps": np.array(25.0)}
    with np.load(folder / "narrow.npz") as narrow:
        np.savez(folder / "scored.npz", hypotheses=narrow["hypotheses"], joints=JOINTS, axes="NMKD", **said)
    done(folder, "recalibrate apply scored.npz map.json -o mended.npz")
    with np.load(folder / "mended.npz") as mended:
        for name, values in said.items():
            np.testing.assert_array_equal(mended[name], values)


def test_each_joint_gets_its_factor(folder: Path) -> None:
    text = done(folder, "recalibrate fit narrow.npz gt.npz -o joints.json --per-joint")
    assert "A spread factor for each of 4 joints" in text
    assert all(joint in text for joint in JOINTS)
    assert "Not judged: --split says" in " ".join(text.split())


def test_radii_are_fitted_judged_and_applied(folder: Path) -> None:
    text = done(folder, "recalibrate fit right.npz gt.npz -o radii.json --radius 0.2 --split --folds 3")
    assert "80%" in text
    assert "held-out coverage" in text
    done(folder, "recalibrate apply right.npz radii.json -o balls.npz")
    with np.load(folder / "balls.npz") as balls:
        assert balls["centre"].shape == (M, K, 3)
        assert balls["radius"].shape == (M, K)


def test_an_impossible_alpha_is_refused_with_the_smallest(folder: Path) -> None:
    said = refused(folder, "recalibrate fit right.npz gt.npz -o none.json --radius 0.001")
    assert "alpha: 0.001 needs more than 48 poses; the smallest possible with them is 0.02041" in said
    assert not (folder / "none.json").exists()


def test_a_broken_map_is_refused_and_nothing_is_written(folder: Path) -> None:
    (folder / "bad.json").write_text('{"format": 1}')
    said = refused(folder, "recalibrate apply narrow.npz bad.json -o out.npz")
    assert "bad.json: no map of posecal recalibrate fit" in said
    assert not (folder / "out.npz").exists()


@pytest.mark.parametrize(
    "options", ["--scaled", "--radius 0.1 --per-joint", "--split --folds 1"], ids=["scaled", "per joint", "one part"]
)
def test_options_that_do_not_go_together_are_a_wrong_call(folder: Path, options: str) -> None:
    assert run(folder, f"recalibrate fit right.npz gt.npz -o none.json {options}").exit_code == 2


def test_more_parts_than_sequences_are_refused(folder: Path) -> None:
    said = refused(folder, "recalibrate fit right.npz gt.npz -o none.json --split --folds 13")
    assert "folds: 13; expected 2 to 12" in said
    assert not (folder / "none.json").exists()


# --- battery, scores, skill, prerank ----------------------------------------------------------------------------------


def numbers(folder: Path, command: str) -> dict[str, dict[str, object]]:
    rows = json.loads(done(folder, f"evaluate {command} --format json"))["rows"]
    return {row["metric"]: row for row in rows if row["group"] is None and row["joint"] is None}


def test_the_battery_has_p_values_adjusted_together_and_says_what_fires(folder: Path) -> None:
    text = " ".join(done(folder, "evaluate narrow.npz gt.npz --rank-tests --plot battery.svg").split())
    assert "The battery fires as well" in text
    assert "Mahalanobis" in text
    assert numbers(folder, "narrow.npz gt.npz --rank-tests")["mahalanobis_p"]["value"] < 0.05  # type: ignore[operator]


def test_a_prerank_of_ones_own_joins_the_battery(folder: Path) -> None:
    found = numbers(folder, "right.npz gt.npz --prerank own.py:height")
    assert {"height", "height_p", "tarp"} <= set(found)


def test_a_prerank_that_fails_is_refused(folder: Path) -> None:
    assert "prerank: it fails on a pool of 10 poses (ZeroDivisionError" in refused(
        folder, "evaluate right.npz gt.npz --prerank own.py:broken"
    )
    assert "has no function 'other'" in refused(folder, "evaluate right.npz gt.npz --prerank own.py:other")


def test_a_skill_is_against_climatology_or_another_model(folder: Path) -> None:
    against_others = numbers(folder, "right.npz gt.npz --skill climatology")["energy_skill"]
    assert 0.5 < against_others["value"] < 1  # type: ignore[operator]
    against_itself = numbers(folder, "right.npz gt.npz --skill right.npz")["energy_skill"]
    assert against_itself["value"] == 0
    assert against_itself["low"] == against_itself["high"] == 0


def test_without_scores_or_battery_there_are_none(folder: Path) -> None:
    found = numbers(folder, "right.npz gt.npz")
    assert "energy_score" not in found
    assert "tarp" not in found
    assert "energy_score" in numbers(folder, "right.npz gt.npz --scores")


# --- explain ----------------------------------------------------------------------------------------------------------


def test_a_metric_is_explained() -> None:
    result = CliRunner().invoke(app, ["--explain", "ece"])
    assert result.exit_code == 0
    for part in ("definition", "range", "direction", "how to read", "source"):
        assert part in result.stdout


def test_an_unknown_metric_is_refused_with_the_nearest() -> None:
    result = CliRunner().invoke(app, ["--explain", "ecee"])
    assert result.exit_code == 2
    assert "Did you mean ece" in " ".join(result.stderr.replace("│", " ").split())

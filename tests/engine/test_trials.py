"""Trials of an action, and the best hypothesis of a sequence that groups cut."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.presets import PRESETS
from tests.helpers.samplers import gaussian

LABELS = np.repeat(["Walking", "Walking 1", "Jog 1 chunk0", "Jog 2", "Box"], [20, 6, 10, 4, 15])


def report_of(**options: Any) -> posecal.Report:
    x, y = gaussian(3, 6, len(LABELS), 5)
    x[:, LABELS == "Walking 1"] += 90
    how = posecal.Protocol(metrics="min_mpjpe, mpjpe", **options)
    return posecal.evaluate(x, y, unit="mm", axes="NMKD", root_joint="none", labels={"action": LABELS}, protocol=how)


def right(values: np.ndarray[Any, Any]) -> float:
    x, y = gaussian(3, 6, len(LABELS), 5)
    x[:, LABELS == "Walking 1"] += 90
    errors = np.linalg.norm(x - y, axis=-1).mean(axis=-1).min(axis=0)
    return float(np.mean([errors[values == value].mean() for value in np.unique(values)]))


def test_trials_are_one_action_where_the_protocol_says_so() -> None:
    first = np.array([label.split()[0] for label in LABELS])
    together = report_of(average="action", trials="together")
    assert together["min_mpjpe"] == pytest.approx(right(first), rel=1e-9)
    assert "numbers are means over 3 values of action (Box, Jog, Walking)." in together.remarks
    assert not [remark for remark in together.remarks if remark.startswith("average:")]


def test_trials_that_are_apart_are_remarked_on() -> None:
    apart = report_of(average="action")
    assert apart["min_mpjpe"] == pytest.approx(right(LABELS), rel=1e-9)
    assert (
        "average: values of action that differ after their first word alone (Jog 1 chunk0, Jog 2). "
        'trials="together" takes those as one.'
    ) in apart.remarks


@pytest.mark.parametrize(
    ("spellings", "shown"),
    [
        (["Eat", "Eat_1", "Sit"], "Eat, Eat_1"),
        (["Eat", "Sit-1", "Sit-22"], "Sit-1, Sit-22"),
        (["eat.54138969", "Eat", "Sit"], "Eat, eat.54138969"),
        (["TS1", "TS2", "TS3"], ""),  # all have numbers for names
        (["1", "2", "3"], ""),
        (["Eat", "Sit", "Stand"], ""),
    ],
)
@pytest.mark.parametrize("trials", ["apart", "together"])
def test_trials_in_other_spellings_are_remarked_on(spellings: list[str], shown: str, trials: Any) -> None:
    x, y = gaussian(3, 6, 30, 5)
    how = posecal.Protocol(average="action", trials=trials, metrics="mpjpe")
    labels = {"action": np.repeat(spellings, 10)}
    said = posecal.evaluate(x, y, unit="mm", axes="NMKD", root_joint="none", labels=labels, protocol=how).remarks
    found = [remark.split("(")[1].split(")")[0] for remark in said if remark.startswith("average:")]
    assert found == ([shown] if shown else [])


def test_sequences_are_never_taken_together() -> None:
    x, y = gaussian(3, 6, len(LABELS), 5)
    how = posecal.Protocol(average="sequence", trials="together", metrics="min_mpjpe")
    report = posecal.evaluate(x, y, unit="mm", axes="NMKD", labels={"sequence": LABELS}, protocol=how)
    assert report.totals.n_sequences == 5


def test_presets_that_average_over_actions_take_trials_together() -> None:
    averaged = [preset.options for preset in PRESETS.values() if preset.options.get("average") == "action"]
    assert len(averaged) > 3
    assert {options.get("trials") for options in averaged} == {"together"}


def test_the_best_of_a_sequence_is_chosen_over_all_of_it_also_in_groups() -> None:
    random = np.random.default_rng(4)
    sequence, step = np.repeat(np.arange(12), 10).astype(str), np.tile(np.arange(10) // 5, 12)
    y = random.normal(0, 300, (120, 5, 3))
    x = y + random.normal(0, 60, (8, 120, 5, 3)) * random.uniform(0.3, 2, (8, 120, 1, 1))
    labels = {"sequence": sequence, "half": step.astype(str)}
    how = posecal.Protocol(best="sequence", metrics="min_mpjpe")
    report = posecal.evaluate(x, y, unit="mm", axes="NMKD", root_joint="none", labels=labels, by="half", protocol=how)
    errors = np.linalg.norm(x - y, axis=-1).mean(axis=-1).reshape(8, 12, 10)
    chosen = errors[errors.mean(axis=2).argmin(axis=0), np.arange(12)]
    assert report["min_mpjpe"] == pytest.approx(chosen.mean(), rel=1e-9)
    for half in (0, 1):
        part = chosen[:, 5 * half : 5 * half + 5]
        assert report.value("min_mpjpe", f"half={half}") == pytest.approx(part.mean(), rel=1e-9)
        low, high = report.interval("min_mpjpe", f"half={half}")
        without = np.array([np.delete(part, clip, axis=0).mean() for clip in range(12)])
        assert np.sqrt(low * high) == pytest.approx(part.mean(), rel=1e-9)  # on the log scale
        error = np.sqrt(11 / 12 * ((np.log(without) - np.log(without).mean()) ** 2).sum())
        assert np.log(high / low) == pytest.approx(2 * 2.200985 * error, rel=1e-4)


@pytest.mark.parametrize("average", ["poses", "action"])
def test_the_best_of_a_batch_is_chosen_over_all_of_it_also_in_groups(average: str) -> None:
    random = np.random.default_rng(4)
    clip, action, half = (
        np.repeat(np.arange(6), 10),
        np.repeat(["sit", "walk", "sit"], 20),
        np.tile(np.arange(10) // 5, 6),
    )
    y = random.normal(0, 300, (60, 5, 3))
    x = y + random.normal(0, 60, (8, 60, 5, 3)) * random.uniform(0.3, 2, (8, 60, 1, 1))
    labels = {"sequence": clip.astype(str), "action": action, "half": half.astype(str)}
    how = posecal.Protocol(best="batch:4", average=average, metrics="min_mpjpe")
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "labels": labels, "protocol": how}
    report = posecal.evaluate(x, y, by=("half", "action"), **options)
    errors = np.linalg.norm(x - y, axis=-1).mean(axis=-1)
    best = np.zeros(60)
    # batches of the first four clips and of the last two; with averages over actions of clips 0, 1, 4, 5 and of 2, 3
    for batch in ([0, 1, 2, 3], [4, 5]) if average == "poses" else ([0, 1, 4, 5], [2, 3]):
        poses = np.isin(clip, batch)
        best[poses] = errors[errors[:, poses].mean(axis=1).argmin(), poses]

    def mean(poses: Any) -> float:
        groups = [action == "sit", action == "walk"] if average == "action" else [np.ones(60, dtype=bool)]
        return float(np.mean([best[poses & group].mean() for group in groups if (poses & group).any()]))

    assert report["min_mpjpe"] == pytest.approx(mean(np.ones(60, dtype=bool)), rel=1e-9)
    for group, poses in {"half=0": half == 0, "half=1": half == 1, "action=sit": action == "sit"}.items():
        assert report.value("min_mpjpe", group) == pytest.approx(mean(poses), rel=1e-9)


@pytest.mark.parametrize(
    ("label", "values", "number"), [("subject", ["S1", "S2", "TS1"], 0), ("camera", ["cam0", "cam1", "gopro"], 0),
                                    ("action", ["Eat_1", "Eat_2", "Walk"], 1)]
)  # fmt: skip
def test_names_with_numbers_may_be_trials_but_of_people_and_cameras(label: str, values: list[str], number: int) -> None:
    x, y = gaussian(3, 6, 12, 5)
    how = posecal.Protocol(metrics="mpjpe", average=label)
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD", "root_joint": "none", "protocol": how}
    report = posecal.evaluate(x, y, labels={label: np.repeat(values, 4)}, **options)
    assert sum("trials of one" in remark for remark in report.remarks) == number

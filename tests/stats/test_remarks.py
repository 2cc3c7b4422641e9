"""A comparison says what its numbers rest on, as a report does."""

from __future__ import annotations

import numpy as np

import posecal

LABELS = {"sequence": np.repeat(np.arange(10), 4)}
TRUTH = np.random.default_rng(0).normal(0, 300, (40, 4, 3))


def models(n: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(1)
    return {name: TRUTH + random.normal(0, 40, (n, 40, 4, 3)) for name in "ab"}


def test_few_hypotheses_and_frames_without_sequences_are_remarked_on_as_in_a_report() -> None:
    some = models(5)
    remarks = posecal.compare(some, TRUTH, unit="mm").remarks
    report = posecal.evaluate(some["a"], TRUTH, unit="mm")
    for start in ("no sequence labels: 40 frames", "N = 5 hypotheses are few: an ECE lies between 0 and 0.4"):
        (remark,) = (remark for remark in remarks if remark.startswith(start))
        assert remark in report.remarks


def test_enough_hypotheses_and_sequences_need_no_remark() -> None:
    remarks = posecal.compare(models(20), TRUTH, unit="mm", labels=LABELS).remarks
    assert not [remark for remark in remarks if "few" in remark or "no sequence labels" in remark]


def test_scores_that_calibration_does_not_use_are_named_of_the_models_that_have_them() -> None:
    some = models(20)
    scores = np.random.default_rng(2).random((20, 40)) + 0.1
    data = {name: posecal.PoseData(x, TRUTH, unit="mm", labels=LABELS) for name, x in some.items()}
    data["b"] = posecal.PoseData(some["b"], TRUTH, unit="mm", labels=LABELS, scores=scores)
    remarks = posecal.compare(data, metrics="min_mpjpe, ece, energy_score").remarks
    assert [remark for remark in remarks if remark.startswith("b: scores are not used by calibration")]

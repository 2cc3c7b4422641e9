"""Names under which a metric of the user's own is registered, and forgotten."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.metric import Metric
from posecal.errors import PoseDataError
from posecal.registry import registered_metrics
from tests.helpers.own_metrics import DEPTH, RMS, depth_error
from tests.helpers.random_worlds import World, world

pytestmark = pytest.mark.usefixtures("nothing_stays_registered")


@pytest.fixture
def some() -> World:
    return world(4, M=40)


def test_a_metric_is_registered_once_and_forgotten(some: World) -> None:
    assert posecal.register(DEPTH) is DEPTH
    assert registered_metrics() == (DEPTH,)
    with pytest.raises(PoseDataError, match=r"^metric: depth_error is registered already; pass replace=True to"):
        posecal.register(DEPTH)
    other = Metric.from_function(depth_error, by_joint=True, label="another")
    assert posecal.register(other, replace=True) is other
    assert posecal.evaluate(some.pairs, metrics="depth_error").metrics["depth_error"].label == "another"
    posecal.unregister("depth_error")
    assert registered_metrics() == ()
    with pytest.raises(PoseDataError, match=r"^metric: 'depth_error' is not registered\. Known: none\."):
        posecal.unregister("depth_error")
    assert "depth_error" not in posecal.evaluate(some.pairs).metrics


def test_a_metric_that_was_not_registered_is_named_with_the_nearest() -> None:
    posecal.register(DEPTH)
    with pytest.raises(PoseDataError, match=r"'depth_eror' is not registered\. Did you mean depth_error\?"):
        posecal.unregister("depth_eror")
    with pytest.raises(PoseDataError, match=r"^metrics: depth_eror not known\. Did you mean depth_error\?"):
        posecal.Evaluation(metrics="depth_eror")


@pytest.mark.parametrize("name", ["mpjpe", "ece", "energy_score", "min_mpjpe_at_5", "brier_skill"])
def test_names_of_posecal_s_own_metrics_can_not_be_taken(name: str) -> None:
    with pytest.raises(PoseDataError, match=rf"^metric: {name} is one of posecal's own names; expected another\."):
        posecal.register(Metric.from_function(depth_error, name=name), replace=True)


@pytest.mark.parametrize(
    "name", ["all", "default", "scores", "rank_tests", "ece_p", "ece_null", "tarp_p_adjusted", "effective_poses"]
)
def test_names_of_groups_and_of_numbers_beside_metrics_can_not_be_taken(name: str) -> None:
    with pytest.raises(PoseDataError, match=rf"^metric: {name} is one of posecal's own names; expected another\."):
        posecal.register(Metric.from_function(depth_error, name=name))
    with pytest.raises(PoseDataError, match=rf"^preranks: '{name}'; expected a name of letters, digits and under"):
        posecal.Evaluation(preranks={name: lambda pool: pool[:, 0, 0]})


@pytest.mark.parametrize("name", ["ece", "depth_error", "two words", "", "a_p"])
def test_a_pre_rank_has_a_name_of_its_own(name: str) -> None:
    posecal.register(DEPTH)
    with pytest.raises(PoseDataError, match=rf"^preranks: '{name}'; expected a name of letters, digits and under"):
        posecal.Evaluation(preranks={"a": lambda pool: pool[:, 0, 0], name: lambda pool: pool[:, 0, 0]})


def test_a_metric_s_name_can_be_a_column_s() -> None:
    with pytest.raises(PoseDataError, match=r"^metric: 'two words'; expected a name of letters, digits and under"):
        posecal.register(replace(RMS, name="two words"))


def test_a_report_keeps_its_metric_when_another_is_registered_under_its_name(some: World, tmp_path: Path) -> None:
    posecal.register(RMS)
    report = posecal.evaluate(some.pairs)
    report.save(tmp_path / "result.npz")
    value = report["rms"]
    posecal.register(replace(RMS, unit="cm", definition="another", finish=np.square), replace=True)
    again = posecal.Report(report.totals)
    assert (again["rms"], again.metrics["rms"].unit, again.definition("rms")) == (value, "mm", RMS.definition)
    saved = posecal.Report(posecal.load_totals(tmp_path / "result.npz"))
    assert saved.definition("rms") == RMS.definition
    with pytest.raises(PoseDataError, match=r"^metric: the functions of rms are not available here"):
        saved["rms"]
    posecal.register(RMS, replace=True)
    assert posecal.Report(saved.totals)["rms"] == value


@pytest.mark.parametrize("what", [depth_error, "mpjpe", None])
def test_what_is_no_metric_is_not_registered(what: Any) -> None:
    with pytest.raises(PoseDataError, match=r"^metric: \w+; expected a Metric, such as Metric\.from_function gives\."):
        posecal.register(what)

"""PVE is the MPJPE of vertices: of meshes by itself, of other points where it is asked for."""

from __future__ import annotations

import numpy as np
import pytest

import posecal
from posecal.engine.protocol import Protocol
from posecal.engine.scope import MESHES, DataSpec, Scope
from posecal.metrics import mpjpe
from posecal.metrics.vertices import vertex_metrics

N, M, K = 3, 6, 778


@pytest.fixture(scope="module")
def hands() -> tuple[np.ndarray, np.ndarray]:
    r = np.random.default_rng(0)
    y = r.normal(0, 90, (M, K, 3))
    return y + r.normal(0, 9, (N, M, K, 3)) + r.normal(0, 9, (N, M, 1, 3)), y


@pytest.mark.parametrize("k", MESHES)
def test_it_is_a_headline_of_meshes_of_a_known_number_of_vertices(k: int) -> None:
    found = list(vertex_metrics(Scope(Protocol(), DataSpec(5, tuple(map(str, range(k)))))))
    assert [(metric.name, metric.label, metric.headline) for metric in found] == [
        ("pve", "PVE", True),
        ("pa_pve", "PA-PVE", True),
    ]
    assert not any(metric.in_joint_table for metric in found)  # MPJPE stands there
    error = f"mean over poses of the mean of the N=5 errors; error: mean over the {k} vertices of ‖x − y‖"
    assert found[0].definition == error
    assert found[1].definition == f"{error} after Procrustes alignment (scale, rotation, translation)"


def test_of_other_points_it_is_given_where_it_is_asked_for() -> None:
    spec = DataSpec(5, ("a", "b", "c", "d"))
    assert not list(vertex_metrics(Scope(Protocol(metrics="all, mpjpe"), spec)))
    (metric,) = vertex_metrics(Scope(Protocol(metrics="mpjpe, pve"), spec))
    assert (metric.name, metric.headline) == ("pve", False)
    assert metric.definition.endswith("mean over the 4 vertices of ‖x − y‖")


def test_the_report_of_a_mesh_has_it_and_speaks_of_vertices(hands: tuple[np.ndarray, np.ndarray]) -> None:
    report = posecal.evaluate(*hands, unit="mm", axes="NMKD", root_joint="none", labels={"sequence": list("aabbcc")})
    assert report["pve"] == pytest.approx(mpjpe(*hands, unit="mm").mean(), rel=1e-6)
    assert report["pa_pve"] == pytest.approx(mpjpe(*hands, unit="mm", align="similarity").mean(), rel=1e-6)
    assert report["pve"] == report["mpjpe"]
    text = str(report)
    assert "K = 778 vertices" in text
    assert "778 joints" not in text
    assert "778 joints" not in " ".join(metric.definition for metric in report.metrics.values())


def test_it_may_be_all_that_is_asked(hands: tuple[np.ndarray, np.ndarray]) -> None:
    x, y = hands[0][:, :, :50], hands[1][:, :50]
    report = posecal.evaluate(x, y, unit="mm", axes="NMKD", metrics="pve")
    assert report.scalars() == {"pve": pytest.approx(mpjpe(x, y, unit="mm").mean(), rel=1e-6)}

"""Poses are logged for a viewer as they are evaluated, or one message says what is missing."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.shell import refused

TRUTH = np.random.default_rng(0).normal(0, 300, (4, 3, 3)).round()
HYPOTHESES = TRUTH + np.array([10.0, 20.0])[:, None, None, None]


def data(d: int = 3) -> posecal.PoseData:
    names = ["Hip", "RHip", "RKnee"]
    return posecal.PoseData(
        HYPOTHESES[..., :d], TRUTH[..., :d], joints=names, axes="NMKD", unit="mm" if d > 1 else "deg"
    )


@pytest.fixture
def logged(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """A stand-in for the library that keeps what is logged."""
    calls: list[Any] = []
    stream = SimpleNamespace(
        spawn=lambda: calls.append("spawn"),
        binary_stream=lambda: SimpleNamespace(read=lambda: b"recording"),
        set_time=lambda name, sequence: calls.append((name, sequence)),
        log=lambda name, entity: calls.append((name, entity)),
        flush=lambda: None,
    )
    kinds = {f"{kind}{d}D": lambda points, **_: points for kind in ("LineStrips", "Points") for d in (2, 3)}
    rerun = SimpleNamespace(RecordingStream=lambda name: stream, TextLog=lambda text: text, **kinds)
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    return calls


@pytest.mark.parametrize("d", [2, 3])
def test_hypotheses_and_truth_are_logged_relative_to_the_root(logged: list[Any], d: int) -> None:
    posecal.plot.view(data(d), frames=[2])
    assert logged[:3] == ["spawn", ("pose", 2), ("frame", "2")]
    found = dict(logged[3:])
    length = np.linalg.norm((TRUTH[2, 1:] - TRUTH[2, :1])[:, :d], axis=1)
    np.testing.assert_allclose(np.linalg.norm(found["truth/joints"], axis=1), [0, *length])
    np.testing.assert_allclose(np.linalg.norm(found["hypotheses/joints"], axis=1), [0, *length] * 2)
    assert found["truth/bones"].shape == (2, 2, d)
    assert found["hypotheses/bones"].shape == (4, 2, d)


def test_all_frames_and_a_file_are_written(logged: list[Any], tmp_path: Path) -> None:
    posecal.plot.view(data(), most=1, path=tmp_path / "poses.rrd")
    assert [entry[1] for entry in logged if entry[0] == "pose"] == [0, 1, 2, 3]
    assert "spawn" not in logged
    assert len(dict(logged)["hypotheses/joints"]) == 3
    assert (tmp_path / "poses.rrd").read_bytes() == b"recording"


def test_without_the_extra_one_message_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.chdir(tmp_path)
    np.save("h.npy", HYPOTHESES.astype(np.float32))
    np.save("t.npy", TRUTH.astype(np.float32))
    found = refused("view", "h.npy", "t.npy", "--axes", "NMKD")
    assert found == "posecal: view: rerun is not installed. pip install 'posecal[view]' brings it."


def test_one_coordinate_and_other_endings_are_refused(logged: list[Any], tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^truth: D = 1; expected 2 or 3 coordinates to show\.$"):
        posecal.plot.view(data(1))
    with pytest.raises(PoseFileError, match=r"expected a name that ends with \.rrd\.$"):
        posecal.plot.view(data(), path=tmp_path / "poses.png")
    assert logged == []

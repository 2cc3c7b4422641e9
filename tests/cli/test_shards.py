"""Many files on the command line: patterns, processes, results that are kept, and faults of single ones."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.helpers.sharded import cuts, frames
from tests.helpers.shell import run


@pytest.fixture(autouse=True)
def _shards(tmp_path: Path) -> None:
    world = frames()
    for n, rows in enumerate(cuts()["7 that cut sequences"]):
        world.save(tmp_path, f"{n}", rows)
    world.save(tmp_path, "whole")
    (tmp_path / "hyps-whole.npz").rename(tmp_path / "hyps.all.npz")
    (tmp_path / "gt-whole.npz").rename(tmp_path / "gt.all.npz")


@pytest.mark.slow
def test_a_pattern_with_workers_prints_what_one_run_prints(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def width(poses):\n    return poses[..., 0].max(axis=1)\n")
    options = ("--prerank", "own.py:width", "--skill", "climatology", "--by", "predicted_spread", "--format", "csv")
    one = run("evaluate", "hyps.all.npz", "gt.all.npz", *options)
    many = run("evaluate", "hyps-*.npz", "gt-*.npz", *options, "--workers", "2")
    assert one.exit_code == many.exit_code == 0
    found, expected = (pd.read_csv(io.StringIO(text.stdout)) for text in (many, one))
    pd.testing.assert_frame_equal(found, expected, rtol=1e-10)
    assert "width" in many.stdout


def test_results_are_kept_beside_the_saved_one_until_all_are_done(tmp_path: Path) -> None:
    whole = (tmp_path / "hyps-3.npz").read_bytes()
    members = dict(np.load(tmp_path / "hyps-3.npz"))
    members["hypotheses"][0, 0, 1, 0] = np.inf
    np.savez(tmp_path / "hyps-3.npz", **members)
    command = ("evaluate", "hyps-*.npz", "gt.all.npz", "--metrics", "ece", "--save", "all.npz")
    failed = run(*command)
    assert failed.exit_code == 3
    assert "6 of 7 shards are done, in all.shards: the same call goes on from there." in failed.stderr
    (tmp_path / "hyps-3.npz").write_bytes(whole)
    assert run(*command).exit_code == 0
    assert (tmp_path / "all.npz").exists()
    assert not (tmp_path / "all.shards").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("none-*.npz", "gt-*.npz"), "posecal: none-*.npz: no file; expected some of names like it."),
        (("hyps-*.npz", "gt-*.npz", "--workers", "2", "--scheduler", "tcp://a:1"), "expected one of the two."),
        (("hyps-[0]*.npz", "gt-*.npz"), "posecal: hyps-[0]*.npz: no file; expected some of names like it."),
    ],
)
def test_wrong_patterns_are_one_message(words: tuple[str, ...], message: str) -> None:
    done = run("evaluate", *words)
    assert done.exit_code == 3
    assert message in done.stderr
    assert done.stdout == ""

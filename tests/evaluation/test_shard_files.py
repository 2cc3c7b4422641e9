"""Files of shards: pairs by stars, one truth, addresses, faults of single ones, and results that are kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.evaluation.pairs import is_pattern, pair_files
from tests.helpers.sharded import cuts, frames, largest_difference

WORLD = frames()
PARTS = cuts()["6 uneven"]
OPTIONS: dict[str, Any] = {"metrics": "min_mpjpe, ece", "threads": 1}


@pytest.fixture
def pairs(tmp_path: Path) -> list[tuple[str, str]]:
    return [WORLD.save(tmp_path, f"{n}", rows) for n, rows in enumerate(PARTS)]


@pytest.fixture(scope="module")
def one() -> posecal.Report:
    return posecal.evaluate(WORLD.data(), **OPTIONS)


def break_hypotheses(path: str) -> bytes:
    """Plant a coordinate that is none, and give what was there."""
    before = Path(path).read_bytes()
    members = dict(np.load(path))
    members["hypotheses"][0, 1, 2, 0] = np.nan
    np.savez(path, **members)
    return before


# --- pairs ------------------------------------------------------------------------------------------------------------


def test_files_are_paired_by_what_the_stars_stand_for_in_natural_order(tmp_path: Path) -> None:
    for name in ("a/10", "a/9", "b/2"):
        for kind in ("hyps", "gt"):
            path = tmp_path / kind / f"{name}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    found = pair_files(f"{tmp_path}/hyps/*/*.npz", f"{tmp_path}/gt/*/*.npz", "other.npz")
    names = [tuple(path.removeprefix(f"{tmp_path}/") for path in pair) for pair in found]
    assert names == [(f"hyps/{n}.npz", f"gt/{n}.npz", "other.npz") for n in ("a/9", "a/10", "b/2")]
    assert is_pattern(f"{tmp_path}/hyps/*.npz")
    assert not is_pattern(f"{tmp_path}/hyps")
    assert pair_files("a.npz", "b.npz") == [("a.npz", "b.npz")]


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        (("hyps/*.npz", "truth/*.npz"), r"^truth/\*\.npz: no file; expected some of names like it\.$"),
        (
            ("hyps/*.npz", "gt/*.npz"),
            r"^gt/\*\.npz: no file for 1 of 3 values of the stars \(first: 2\); expected one for",
        ),
        (("hyps/*.npz", "*/*.npz"), r"^hyps/\*\.npz has 1 and \*/\*\.npz has 2 stars; expected as many, which"),
    ],
)
def test_files_without_a_partner_are_refused(
    patterns: tuple[str, str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("hyps/1", "hyps/2", "hyps/3", "gt/1", "gt/3"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.npz").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(posecal.PoseDataError, match=words):
        pair_files(*patterns)


def test_one_truth_is_joined_by_frame_id(pairs: list[tuple[str, str]], tmp_path: Path, one: posecal.Report) -> None:
    _, truth = WORLD.save(tmp_path, "all")
    found = posecal.evaluate_shards([(hypotheses, truth) for hypotheses, _ in pairs], **OPTIONS)
    assert largest_difference(found, one)[1] < 1e-10
    with pytest.raises(posecal.PoseDataError, match=r"^gt-all\.npz: 12 of 192 frames are in no shard; expected all\."):
        posecal.evaluate_shards([(hypotheses, truth) for hypotheses, _ in pairs[1:]], **OPTIONS)
    fewer = posecal.evaluate_shards([(h, truth) for h, _ in pairs[1:]], missing="skip", **OPTIONS)
    assert fewer.totals.poses.sum() == 180


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_addresses_are_read_by_fsspec(pairs: list[tuple[str, str]], one: posecal.Report) -> None:
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    for pair in pairs:
        for path in pair:
            memory.put_file(path, f"/shards/{Path(path).name}")
    found = pair_files("memory://shards/hyps-*.npz", "memory://shards/gt-*.npz")
    assert len(found) == 6
    keep = Path(pairs[0][0]).parent / "kept"
    for _ in range(2):  # the second time they are known
        report = posecal.evaluate_shards([(h, y) for h, y in found], keep=keep, **OPTIONS)
    assert len([*keep.iterdir()]) == 6
    assert largest_difference(report, one)[1] < 1e-10
    alone = posecal.evaluate(*found[2], **OPTIONS)
    assert alone["min_mpjpe"] == posecal.evaluate(*pairs[2], **OPTIONS)["min_mpjpe"]
    with pytest.raises(posecal.PoseFileError, match=r"^memory://shards/none\.npz: no such file\.$"):
        posecal.evaluate("memory://shards/none.npz", found[0][1])
    with pytest.raises(posecal.PoseDataError, match=r"^nowhere://a\.npz: can't be opened \(Protocol not known"):
        posecal.evaluate("nowhere://a.npz", found[0][1])


# --- what belongs to the whole set ------------------------------------------------------------------------------------


def test_poses_of_several_shards_are_refused_or_counted_once(one: posecal.Report) -> None:
    shards = [WORLD.data(rows) for rows in (*PARTS, np.arange(50, 60), np.arange(185, 192))]
    with pytest.raises(posecal.PoseDataError, match=r"^duplicates: 17 poses .* \(10 of shard 7, 7 of shard 8\); exp"):
        posecal.evaluate_shards(shards, **OPTIONS)
    found = posecal.evaluate_shards(shards, duplicates="drop", **OPTIONS)
    assert largest_difference(found, one)[1] < 1e-10
    assert "17 poses came in several shards; each is counted once." in found.remarks
    halves = [WORLD.data(np.arange(100)), WORLD.data(np.arange(60, 192))]
    options: dict[str, Any] = {"metrics": "energy_skill, mpjve", "reference": "climatology", "threads": 1}
    found = posecal.evaluate_shards(halves, duplicates="drop", **options)
    assert largest_difference(found, posecal.evaluate(WORLD.data(), **options))[1] < 1e-10


def test_a_shard_of_as_many_hypotheses_as_poses_has_the_layout_of_the_others() -> None:
    pairs = [(WORLD.hypotheses[:, rows], WORLD.truth[rows]) for rows in np.split(np.arange(192), [100, 106])]
    found = posecal.evaluate_shards(pairs, unit="mm", **OPTIONS)
    one = posecal.evaluate(WORLD.hypotheses, WORLD.truth, unit="mm", **OPTIONS)
    assert largest_difference(found, one)[1] < 1e-10
    with pytest.raises(posecal.PoseDataError, match="the shapes don't tell the axes apart"):
        posecal.evaluate_shards([pairs[1]], unit="mm", **OPTIONS)


def test_shards_that_are_described_otherwise_are_named() -> None:
    shards = [WORLD.data(PARTS[0]), WORLD.data(PARTS[1], n_hypotheses=4), WORLD.data(PARTS[2], labels=None)]
    with pytest.raises(
        posecal.PoseDataError, match=r"shard 2: n_hypotheses 4 against 6 of shard 1; expected the same"
    ) as e:
        posecal.evaluate_shards(shards, **OPTIONS)
    assert "shard 3 and shard 1: only one has sequence labels" in str(e.value)


@pytest.mark.parametrize(
    ("pairs", "options", "words"),
    [
        ([], {}, r"^pairs: expected at least one pair"),
        ("hyps.npz", {}, r"^pairs: expected at least one pair"),
        ([WORLD.truth], {}, r"^pairs: number 1 is of type ndarray; expected a pair\.$"),
        ([("a.npz", "b.npz")], {"labels": {"sequence": "a"}}, r"^labels: an array of poses; expected it in PoseData"),
        ([("a.npz", "b.npz")], {"duplicates": "keep"}, r"^duplicates: 'keep' is not known"),
        ([("a.npz", "b.npz")], {"axis": "NMKD"}, r"^option: 'axis' is not known\. Did you mean axes\?"),
        ([("a.npz", "b.npz")], {"map": 3}, r"^map: 3; expected a callable\.$"),
        ([("a.npz", "b.npz")], {"reference": ["a"] * 2, "metrics": "scores"}, r"^reference: expected climatology, or "),
    ],
)
def test_wrong_calls_are_refused(pairs: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(posecal.PoseDataError, match=words):
        posecal.evaluate_shards(pairs, **options)


def test_files_of_another_model_are_paired_as_well(pairs: list[tuple[str, str]]) -> None:
    options: dict[str, Any] = {"metrics": "energy_skill", "threads": 1}
    found = posecal.evaluate_shards(pairs, reference=[hypotheses for hypotheses, _ in pairs], **options)
    assert found["energy_skill"] == pytest.approx(0, abs=1e-12)


# --- faults, and results that are kept --------------------------------------------------------------------------------


def test_a_shard_that_fails_is_named_and_the_same_call_goes_on(
    pairs: list[tuple[str, str]], tmp_path: Path, one: posecal.Report
) -> None:
    keep = tmp_path / "kept"
    before = break_hypotheses(pairs[3][0])
    with pytest.raises(
        posecal.PoseDataError, match=r"^hyps-3\.npz has non-finite coordinates .* 5 of 6 shards are done"
    ):
        posecal.evaluate_shards(pairs, keep=keep, **OPTIONS)
    times = {path: path.stat().st_mtime_ns for path in keep.iterdir()}
    assert len(times) == 5
    Path(pairs[3][0]).write_bytes(before)
    steps: list[tuple[str, int, int]] = []

    def progress(what: str, total: int) -> Any:
        return lambda done: steps.append((what, done, total))

    found = posecal.evaluate_shards(pairs, keep=keep, progress=progress, **OPTIONS)
    assert largest_difference(found, one)[1] < 1e-10
    assert steps == [("summing up", n, 6) for n in range(1, 7)] + [("evaluating", 1, 1)]
    assert {path: path.stat().st_mtime_ns for path in times} == times
    posecal.evaluate_shards(pairs, keep=keep, **{**OPTIONS, "metrics": "ece"})  # other options
    assert len([*keep.iterdir()]) == 12
    next(iter(times)).write_bytes(b"PK")  # what can't be read is made anew
    assert largest_difference(posecal.evaluate_shards(pairs, keep=keep, **OPTIONS), one)[1] < 1e-10


def test_a_changed_byte_of_hypotheses_is_found_before_they_count(pairs: list[tuple[str, str]]) -> None:
    path = Path(pairs[2][0])
    stored = bytearray(path.read_bytes())
    stored[len(stored) // 3] ^= 1  # in the first member, whose checksum the first pass leaves to the last one
    path.write_bytes(bytes(stored))
    with pytest.raises(posecal.PosecalError, match=r"^hyps-2\.npz.*Bad CRC-32.*5 of 6 shards are done"):
        posecal.evaluate_shards(pairs, **OPTIONS)


def test_all_shards_that_fail_are_named(pairs: list[tuple[str, str]]) -> None:
    Path(pairs[1][1]).unlink()
    Path(pairs[4][0]).write_bytes(b"PK")
    with pytest.raises(posecal.PosecalError, match=r"^2 problems:") as error:
        posecal.evaluate_shards(pairs, **OPTIONS)
    assert "hyps-1.npz: " in str(error.value)
    assert "gt-1.npz: no such file" in str(error.value)
    assert "hyps-4.npz: can't be read" in str(error.value)


def test_an_executor_that_fails_is_one_error(pairs: list[tuple[str, str]]) -> None:
    def broken(function: Any, items: Any) -> Any:
        yield function(items[0])
        raise RuntimeError("a worker was killed")

    with pytest.raises(
        posecal.PoseDataError, match=r"^map: the executor failed while summing up \(RuntimeError: a wor"
    ):
        posecal.evaluate_shards(pairs, map=broken, **OPTIONS)

    def short(function: Any, items: Any) -> Any:
        return [function(item) for item in items[:2]]

    with pytest.raises(posecal.PoseDataError, match=r"^map: 2 results while summing up; expected one for each of 6"):
        posecal.evaluate_shards(pairs, map=short, **OPTIONS)


def test_shards_of_which_nothing_is_scored_count_nothing(one: posecal.Report) -> None:
    hard = np.where(np.arange(192) < 100, "yes", "no")
    shards = [
        WORLD.data(rows, labels={"sequence": WORLD.sequence[rows], "hard": hard[rows]})
        for rows in np.split(np.arange(192), [60, 120, 130])
    ]
    options: dict[str, Any] = {**OPTIONS, "protocol": posecal.Protocol(frames="hard")}
    found = posecal.evaluate_shards(shards, **options)
    assert found.totals.poses.sum() == 100
    assert found.totals.n_frames == 192
    with pytest.raises(posecal.PoseDataError, match=r"^frames: no pose of truth has the label hard; expected some\.$"):
        posecal.evaluate_shards(shards[2:], **options)

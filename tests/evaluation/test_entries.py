"""Entries of a leaderboard: what is written is what is read, and everything that is wrong is said at once."""

from __future__ import annotations

import hashlib
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.data.gaussian import GaussianPrediction
from posecal.engine.storage import save_totals
from posecal.errors import PosecalError, PoseFileError
from posecal.evaluation.entries import Entry, checked_entry, read_entry
from tests.helpers.boards import ABOUT, METRICS, board_of, saved
from tests.helpers.comparisons import LABELS, MODELS, M, Y, totals_of

RIGHT, NARROW, OFF = "right-16-people", "narrow-16-people", "off-16-people"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return board_of(tmp_path_factory.mktemp("board"))


@pytest.fixture
def board(made: Path, tmp_path: Path) -> Path:
    """A copy to be broken."""
    return shutil.copytree(made, tmp_path / "board")


def refusal(folder: Path) -> str:
    with pytest.raises(PosecalError) as caught:
        posecal.leaderboard(folder)
    return str(caught.value)


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


# --- one entry ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words", ["plain", 'quotes " and \\ and \\n', "lines\nof\n\ncommands \\\n", "é ω\t\x7f\x1b", '"""', "\n"]
)
def test_an_entry_is_read_as_it_was_written(words: str, tmp_path: Path) -> None:
    texts = {**ABOUT, "name": f"a{words}b", "command": f"a{words}b"}
    entry = Entry(**texts, hypotheses_sha256="0" * 64, result_sha256="f" * 64, preset="cgnf")
    path = tmp_path / "entry.toml"
    path.write_text(entry.toml, encoding="utf-8")
    assert read_entry(path) == entry


def test_files_are_named_by_model_and_test_set() -> None:
    entry = Entry(**{**ABOUT, "name": "cGNF (L_sample)"}, hypotheses_sha256="", result_sha256="")
    assert entry.stem == "cgnf-l-sample-16-people"


def test_an_added_entry_holds_the_hashes_of_both_files(board: Path) -> None:
    table = tomllib.loads((board / f"{RIGHT}.toml").read_text(encoding="utf-8"))
    assert table.items() >= {**ABOUT, "name": "right"}.items()
    assert table["hypotheses_sha256"] == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # of abc
    assert table["result_sha256"] == hashlib.sha256((board / f"{RIGHT}.npz").read_bytes()).hexdigest()
    assert "preset" not in table


def test_all_that_is_wrong_with_an_entry_is_said_at_once() -> None:
    table = {**ABOUT, "name": " ", "commit": 3, "sourc": "x", "hypotheses_sha256": "A" * 64, "preset": "cgnff"}
    with pytest.raises(PoseFileError) as caught:
        checked_entry(table, "a.toml")
    assert str(caught.value).split("\n  - ") == [
        "6 problems:",
        "a.toml: unknown key 'sourc'. Did you mean source?",
        "a.toml: name is ' '; expected the name of the model.",
        "a.toml: commit is 3; expected the commit or release of the source.",
        f"a.toml: hypotheses_sha256 is '{'A' * 64}'; expected the SHA-256 of the file of the hypotheses, 64 digits of "
        "0-9 and a-f.",
        "a.toml: no result_sha256; expected the SHA-256 of the saved result, 64 digits of 0-9 and a-f.",
        "a.toml: preset 'cgnff' is not known. Did you mean cgnf?",
    ]


def test_a_name_is_text_that_a_file_can_hold() -> None:
    table = {**ABOUT, "name": "a\udce9", "hypotheses_sha256": "0" * 64, "result_sha256": "0" * 64}
    with pytest.raises(PoseFileError, match=r"^a\.toml: name is 'a.udce9'; expected text in UTF-8\.$"):
        checked_entry(table, "a.toml")


# --- a folder of them ---------------------------------------------------------------------------------------------


def test_a_folder_is_needed_and_holds_an_entry(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none").endswith("none: no such folder; expected the folder of a leaderboard.")
    (tmp_path / "file").touch()
    assert refusal(tmp_path / "file").endswith("file: is no folder; expected the folder of a leaderboard.")
    assert "no entries; expected a .toml and a .npz of each model" in refusal(tmp_path)


def test_problems_of_all_files_are_said_at_once(board: Path) -> None:
    (board / f"{RIGHT}.npz").rename(board / "stray.npz")
    replaced(board / f"{NARROW}.toml", 'name = "narrow"', "name = ")
    (board / f"{OFF}.npz").write_bytes((board / f"{OFF}.npz").read_bytes()[:100])
    assert refusal(board).split("\n  - ") == [
        "4 problems:",
        f"{NARROW}.toml: no TOML (Invalid value (at line 1, column 8)).",
        f"{OFF}.npz: no result of posecal evaluate --save, or not a whole one.",
        f"{RIGHT}.toml: no {RIGHT}.npz beside it; expected its saved result.",
        "stray.npz: no stray.toml beside it; expected one. posecal leaderboard add writes it.",
    ]


def test_a_result_is_the_one_that_its_entry_was_written_for(board: Path) -> None:
    shutil.copy(board / f"{NARROW}.npz", board / f"{RIGHT}.npz")
    assert f"{RIGHT}.npz: another file than {RIGHT}.toml says (SHA-256 " in refusal(board)


def test_models_of_a_test_set_have_names_of_their_own(board: Path) -> None:
    replaced(board / f"{NARROW}.toml", '"narrow"', '"Right"')
    said = f"{NARROW}.toml and {RIGHT}.toml: both are 'right' on '16 people'; expected other names."
    assert refusal(board) == said
    replaced(board / f"{NARROW}.toml", '"16 people"', '"17 people"')
    assert {name: len(entries) for name, entries in posecal.leaderboard(board).entries.items()} == {
        "17 people": 1,
        "16 people": 2,
    }


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"align": "rigid"}, "were not made alike: align similarity against rigid."),
        ({"joints": "all but Head"}, "were not made alike: joints all against all_but_Head."),
    ],
)
def test_models_of_a_test_set_were_made_alike(board: Path, options: dict[str, str], words: str) -> None:
    add(board, saved(board.parent / "other.npz", **options), name="another", test_set="new")
    path = board / "another-new.toml"
    replaced(path, '"new"', '"16 people"')
    assert f"test set '16 people': {NARROW}.npz and another-new.npz {words}" in refusal(board)


def test_models_of_a_test_set_hold_the_same_poses_and_as_many_hypotheses(board: Path) -> None:
    half = {"sequence": LABELS["sequence"][: M // 2]}
    for name, totals in {
        "half": totals_of(MODELS["right"][:, : M // 2], Y[: M // 2], METRICS, half),
        "few": totals_of(MODELS["right"][:5], Y, METRICS),
        "moved": totals_of(MODELS["right"] + 5.0, Y + 5.0, METRICS),
    }.items():
        save_totals(totals, board.parent / "other.npz")
        add(board, board.parent / "other.npz", name=name, test_set=name)
    for name in ("half", "few", "moved"):
        replaced(board / f"{name}-{name}.toml", f'test_set = "{name}"', 'test_set = "16 people"')
    lines = refusal(board).split("\n  - ")
    assert lines[0] == "3 problems:"  # against what most of them hold
    assert f"{NARROW}.npz and few-few.npz were not made alike: N 12 against 5." in lines[1]
    assert f"{NARROW}.npz and half-half.npz hold other poses: 48 in 8 sequences and 24 in 4" in lines[2]
    assert f"{NARROW}.npz and moved-moved.npz were evaluated against different true poses" in lines[3]


def add(folder: Path, result: Path, **changed: str) -> Path:
    return posecal.add_entry(folder, result, hypotheses=result, **{**ABOUT, **changed})


# --- adding -------------------------------------------------------------------------------------------------------


def test_an_entry_of_the_same_model_is_replaced(board: Path) -> None:
    number = len(list(board.iterdir()))
    result = saved(board.parent / "other.npz", "narrow")
    add(board, result, name="right", commit="v2")
    assert len(list(board.iterdir())) == number
    assert (board / f"{RIGHT}.npz").read_bytes() == result.read_bytes()
    (entry,) = (one for one in posecal.leaderboard(board).entries["16 people"] if one.name == "right")
    assert entry.commit == "v2"


def test_an_entry_that_is_refused_leaves_the_folder_as_it_was(board: Path) -> None:
    before = {path.name: path.read_bytes() for path in board.iterdir()}
    other = saved(board.parent / "other.npz", align="rigid")
    for changed, words in (
        ({"name": "new"}, "were not made alike"),
        ({"name": "new", "source": ""}, "entry: source is ''; expected where"),
        (
            {"name": "RIGHT!"},
            "is the entry of 'right' on '16 people'; expected a name that differs in letters or digit",
        ),
        (
            {"name": "new", "test_set": "other", "preset": "cgnf"},
            "made with joints=all for h36m-17, align=rigid for similarity",
        ),
    ):
        with pytest.raises(PosecalError, match=words):
            add(board, other, **changed)
    with pytest.raises(PoseFileError, match="no result of posecal evaluate --save"):
        add(board, board / "hypotheses", name="new")
    assert {path.name: path.read_bytes() for path in board.iterdir()} == before


def test_commands_are_lines(board: Path) -> None:
    result = saved(board.parent / "other.npz")
    path = posecal.add_entry(
        board, result, hypotheses=result, **{**ABOUT, "name": "new", "command": ["sample", "evaluate"]}
    )
    assert read_entry(path).command == "sample\nevaluate"


def test_a_preset_is_that_of_the_result(board: Path) -> None:
    options = {name: text for name, text in posecal.PRESETS["gfpose"].options.items() if name != "metrics"}
    totals = totals_of(MODELS["right"], Y, METRICS)
    result = board.parent / "other.npz"
    save_totals(replace(totals, protocol=totals.protocol.changed(options)), result)
    assert 'preset = "gfpose"' in add(board, result, name="new", test_set="other", preset="gfpose").read_text()


# --- true poses ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frames", "given_away"), [(9, True), (10, False)])
def test_moments_of_short_sequences_would_give_true_poses_away(frames: int, given_away: bool, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 100, (4 * frames, 3, 3))
    prediction = GaussianPrediction(truth + 1.0, covariance=np.broadcast_to(np.eye(3), (4 * frames, 3, 3, 3)))
    labels = {"sequence": np.repeat(["a", "b", "c", "d"], frames)}
    report = posecal.evaluate(prediction, truth, unit="mm", labels=labels, metrics="nll", root_joint="none")
    report.save(tmp_path / "result.npz", gallery=False)
    board = tmp_path / "board"
    board.mkdir()
    if not given_away:
        add(board, tmp_path / "result.npz", name="new")
        return
    with pytest.raises(
        PosecalError, match=r"sequences of 9, which give them away; expected more than d = 9 poses in each"
    ):
        add(board, tmp_path / "result.npz", name="new")


def test_a_saved_result_holds_no_pose(made: Path) -> None:
    """No number of a result is a coordinate of a true pose, not even rounded."""
    coordinates = np.unique(np.abs(Y).round(2))
    with np.load(made / f"{RIGHT}.npz") as members:
        numbers = [members[name].ravel() for name in members if members[name].dtype.kind == "f"]
    found = np.isin(np.abs(np.concatenate(numbers)).round(2), coordinates[coordinates > 1])
    assert found.mean() < 0.01


def test_a_result_that_keeps_poses_for_pictures_is_refused(tmp_path: Path) -> None:
    totals = posecal.evaluate(MODELS["right"], Y, unit="mm", axes="NMKD", metrics="ece").totals
    assert totals.gallery is not None
    save_totals(totals, tmp_path / "result.npz")
    with pytest.raises(
        PosecalError, match=r"holds poses for pictures; expected sums alone\. gallery=False leaves them out"
    ):
        add(tmp_path / "board", tmp_path / "result.npz", name="new")
    assert not (tmp_path / "board").exists()

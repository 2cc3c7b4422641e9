"""Damaged files of every format: one error message, and no other exception."""

from __future__ import annotations

import io
import pickle
import random
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posecal.data.pickles import read_object_npz
from posecal.errors import PosecalError, PoseFileError
from posecal_models.cli import main
from posecal_models.data.cameras import Camera, read_cameras
from posecal_models.data.human36m import read_human36m
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.npz import read_npz
from posecal_models.data.prohpe import read_prohpe
from posecal_models.data.videopose3d import read_videopose3d
from tests.models.test_data_formats import cdf, numbers, prohpe, videopose3d
from tests.models.test_data_mocap import mocap
from tests.models.test_data_pairs import pairs_file

# --- damage at random ---------------------------------------------------------------------------------------------


def compressed(path: Path) -> None:
    with np.load(path) as file:
        members = {name: file[name] for name in file.files}
    np.savez_compressed(path, **members)


def a_pairs_file(folder: Path) -> Path:
    pairs_file(folder / "a.npz")
    return folder / "a.npz"


def a_packed_pairs_file(folder: Path) -> Path:
    compressed(a_pairs_file(folder))
    return folder / "a.npz"


def a_motion_file(folder: Path) -> Path:
    mocap(folder / "a.npz")
    return folder / "a.npz"


def a_pickle_of_prohpe(folder: Path) -> Path:
    prohpe(folder, frames=1, flagged=(0, "RWrist"))
    return folder / "merged.pickle"


def a_file_of_videopose3d(folder: Path) -> Path:
    videopose3d(folder)
    return folder / "3d.npz"


def the_keypoints_of_videopose3d(folder: Path) -> Path:
    videopose3d(folder)
    return folder / "2d.npz"


def a_file_of_cameras(folder: Path) -> Path:
    np.savez(folder / "c.npz", subject=["S1"], rotation=[np.eye(3)], position=[[0, 0, 0.5]])
    return folder / "c.npz"


def a_folder_of_human36m(folder: Path) -> Path:
    for kind, columns in (("D3_Positions_mono", 3), ("D2_Positions", 2)):
        cdf(folder / "S1" / kind / "Walking 1.54138969.cdf", numbers(2, 32, columns))
    return folder / "S1" / "D3_Positions_mono" / "Walking 1.54138969.cdf"


CAMERA = Camera(np.eye(3), np.zeros(3))
READERS: list[tuple[Callable[[Path], Path], Callable[[Path], object]]] = [
    (a_pairs_file, LiftingSet.load),
    (a_packed_pairs_file, LiftingSet.load),
    (a_packed_pairs_file, KeypointSet.load),
    (a_motion_file, lambda path: MocapPoses(path).project(views=1)),
    (a_pickle_of_prohpe, read_prohpe),
    (a_file_of_videopose3d, lambda path: read_videopose3d(path, path.with_name("2d.npz"), {"S1": [CAMERA] * 2})),
    (the_keypoints_of_videopose3d, lambda path: read_videopose3d(path.with_name("3d.npz"), path, {"S1": [CAMERA] * 2})),
    (a_file_of_cameras, read_cameras),
]


def repacked(contents: bytes, chance: random.Random) -> bytes:
    """One member of a zip is damaged, and its checksum is right."""
    changed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(contents)) as stored, zipfile.ZipFile(changed, "w") as archive:
        spoilt = chance.choice(stored.namelist())
        for name in stored.namelist():
            member = stored.read(name)
            archive.writestr(name, damaged(member, chance) if name == spoilt else member)
    return changed.getvalue()


def damaged(contents: bytes, chance: random.Random) -> bytes:
    """Some bytes are others, and now and then the end is missing."""
    changed = bytearray(contents)
    if chance.random() < 0.2:
        changed = changed[: chance.randrange(len(changed))]
    for _ in range(chance.choice([1, 3, 20])):
        if changed:
            changed[chance.randrange(len(changed))] = chance.randrange(256)
    return bytes(changed)


@pytest.mark.slow
@pytest.mark.parametrize(("write", "read"), READERS)
def test_a_file_damaged_at_random_is_read_or_refused(tmp_path, write, read):
    path = write(tmp_path)
    read(path)
    whole, chance, refused = path.read_bytes(), random.Random(0), 0
    for turn in range(200):
        inside = turn % 2 and whole.startswith(b"PK")
        path.write_bytes(repacked(whole, chance) if inside else damaged(whole, chance))
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of numbers that became too large
            try:
                read(path)
            except PosecalError:
                refused += 1
    assert refused > 0


# --- damage of a known kind ---------------------------------------------------------------------------------------


def spoiled(path: Path, at: bytes, offset: int, value: bytes) -> None:
    contents = bytearray(path.read_bytes())
    place = contents.index(at) + offset
    contents[place : place + len(value)] = value
    path.write_bytes(contents)


def packed_data(path: Path) -> None:
    np.savez_compressed(path, poses=numbers(50, 3))
    spoiled(path, b"poses.npy", 60, bytes(40))


def unknown_method(path: Path) -> None:
    np.savez(path, poses=numbers(3))
    spoiled(path, b"PK\x01\x02", 10, b"\x63")


def encrypted(path: Path) -> None:
    np.savez(path, poses=numbers(3))
    spoiled(path, b"PK\x01\x02", 8, b"\x01")


def no_npy_inside(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("poses.npy", b"words")


def one_array(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, numbers(3))


def lengths_that_are_no_numbers(path: Path) -> None:
    np.savez(path, poses=numbers(3))
    spoiled(path, b"(3,)", 0, b"(3(,")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (packed_data, "."),
        (unknown_method, "compression method"),
        (encrypted, "encrypted"),
        (no_npy_inside, "."),
        (one_array, "array without a name|not a zip"),
        (lengths_that_are_no_numbers, "."),
    ],
)
@pytest.mark.parametrize("read", [read_npz, read_object_npz])
def test_a_broken_npz_is_refused(tmp_path, read, spoil, words):
    spoil(tmp_path / "a.npz")
    with pytest.raises(PoseFileError, match=rf"a\.npz.*({words})"):
        read(tmp_path / "a.npz")


@pytest.mark.parametrize("spoil", [lambda whole: b"", lambda whole: b"words", lambda whole: whole[: len(whole) // 2]])
def test_a_broken_cdf_is_refused(tmp_path, spoil):
    path = a_folder_of_human36m(tmp_path)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(PoseFileError, match=r"Walking 1\.54138969\.cdf: can't be read as \.cdf"):
        read_human36m(tmp_path)


@pytest.mark.parametrize("key", ["3d_gt", "2d_hrnet", "gaussfit", "imgpath"])
def test_a_table_of_prohpe_without_a_key_is_named(tmp_path, key):
    path = a_pickle_of_prohpe(tmp_path)
    tree = pickle.loads(path.read_bytes())
    del tree["S9"]["Directions"]["0"]["54138969"][key]
    path.write_bytes(pickle.dumps(tree))
    with pytest.raises(PoseFileError, match=rf"S9/Directions/0/54138969 lacks {key}\); expected ProHPE's merged"):
        read_prohpe(path)


def test_a_table_of_prohpe_in_metres_is_refused(tmp_path):
    path = a_pickle_of_prohpe(tmp_path)
    tree = pickle.loads(path.read_bytes())
    tree["S9"]["Directions"]["0"]["54138969"]["3d_gt"] /= 1000
    path.write_bytes(pickle.dumps(tree))
    with pytest.raises(PosecalError, match=r"3d_gt looks like metres"):
        read_prohpe(path)


def test_a_table_of_prohpe_with_pixels_beyond_single_precision_is_refused(tmp_path):
    path = a_pickle_of_prohpe(tmp_path)
    tree = pickle.loads(path.read_bytes())
    tree["S9"]["Directions"]["0"]["54138969"]["2d_hrnet"][0, 3] = 1e200
    path.write_bytes(pickle.dumps(tree))
    with pytest.raises(PosecalError, match=r"2d_hrnet holds numbers beyond single precision; expected pixels"):
        read_prohpe(path)


@pytest.mark.parametrize(
    ("room", "views", "words"),
    [
        (numbers(5, 17, 3), [numbers(4, 17, 2)], r"3d\.npz: S1 Walking 1 \(5, 17, 3\); expected \(F, 32, 3\)"),
        (numbers(5, 32, 3), [numbers(4, 16, 2)], r"2d\.npz: S1 Walking 1, view 0 \(4, 16, 2\); expected \(F, 17, 2\)"),
        (numbers(5, 32, 3), [numbers(4, 34)], r"view 0 \(4, 34\); expected \(F, 17, 2\)"),
        (numbers(5, 32, 3), 3, r"2d\.npz: S1 Walking 1 is no list of views"),
        ("poses", [numbers(4, 17, 2)], "S1 Walking 1: dtype <U5; expected real numbers"),
        ([[1.0], [1.0, 2.0]], [numbers(4, 17, 2)], "S1 Walking 1: .*; expected an array of real numbers"),
    ],
)
def test_files_of_videopose3d_with_other_arrays_are_refused(tmp_path, room, views, words):
    np.savez(tmp_path / "3d.npz", positions_3d={"S1": {"Walking 1": room}})
    np.savez(tmp_path / "2d.npz", positions_2d={"S1": {"Walking 1": views}})
    with pytest.raises(PosecalError, match=words):
        read_videopose3d(tmp_path / "3d.npz", tmp_path / "2d.npz", {"S1": [CAMERA]})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"subject": "S1"}, r"subject \(\); expected \(1,\)"),
        ({"rotation": [np.full((3, 3), np.nan)]}, "rotation is not finite"),
        ({"position": [["a", "b", "c"]]}, "position: dtype <U1; expected real numbers"),
        ({"focal": [np.inf]}, "focal is not finite"),
        ({"rotation": [np.diag([1, 1, -1])]}, r"rotation of camera 0 is none .*det R is -1"),
    ],
)
def test_cameras_that_are_none_are_refused(tmp_path, changes, words):
    members = {"subject": ["S1"], "rotation": [np.eye(3)], "position": [[0, 0, 0]], **changes}
    np.savez(tmp_path / "c.npz", **members)
    with pytest.raises(PosecalError, match=words):
        read_cameras(tmp_path / "c.npz")


# --- the command --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("import", "prohpe", "lacking.pickle"), "lacks gaussfit"),
        (("import", "prohpe", "large.pickle"), "large.pickle"),
        (("import", "videopose3d", "17.npz", "--keypoints", "2d.npz", "--cameras", "c.npz"), "expected (F, 32, 3)"),
        (("project", "one.npy"), "one array without a name"),
        (("project", "packed.npz"), "packed.npz: poses: no .npy header"),
    ],
)
def test_a_broken_file_gives_one_message_exit_3_and_no_file(tmp_path, monkeypatch, capsys, arguments, words):
    path = a_pickle_of_prohpe(tmp_path)
    tree = pickle.loads(path.read_bytes())
    del tree["S9"]["Directions"]["0"]["54138969"]["gaussfit"]
    (tmp_path / "lacking.pickle").write_bytes(pickle.dumps(tree))
    (tmp_path / "large.pickle").write_bytes(b"\x80\x04\x8e" + b"\xff" * 7 + b"\x0f.")
    videopose3d(tmp_path)
    a_file_of_cameras(tmp_path)
    np.savez(tmp_path / "17.npz", positions_3d={"S1": {"Walking 1": numbers(5, 17, 3)}})
    one_array(tmp_path / "one.npy")
    packed_data(tmp_path / "packed.npz")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["posecal-models", *arguments, "-o", "o.npz"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == 3
    assert words in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "o.npz").exists()


def test_human36m_is_imported_at_the_paper_s_rates_by_default(tmp_path, monkeypatch):
    for subject in ("S1", "S9"):
        for kind, columns in (("D3_Positions_mono", 3), ("D2_Positions", 2)):
            cdf(tmp_path / "h36m" / subject / kind / "Walking 1.54138969.cdf", numbers(130, 32, columns))
    monkeypatch.chdir(tmp_path)
    found = {}
    for words in ((), ("--every", "13")):
        monkeypatch.setattr(sys, "argv", ["posecal-models", "import", "human36m", "h36m", "-o", "o.npz", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        assert not ended.value.code
        subject = LiftingSet.load("o.npz").subject
        found[words] = [int((subject == name).sum()) for name in ("S1", "S9")]
    assert found == {(): [33, 3], ("--every", "13"): [10, 3]}  # 130 / 4 and 130 / 64, rounded up

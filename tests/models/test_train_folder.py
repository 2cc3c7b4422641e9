"""The folder of a training: no file overwritten, problems reported before training, no resuming with other data."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import notes_of, read_tensors, write_tensors
from posecal_models.cli import main
from posecal_models.config import Config
from posecal_models.preparation import prepare
from posecal_models.progress import read_losses
from posecal_models.training_folder import CHECKPOINT, LOSSES, WEIGHTS, digests

TABLE = {
    "model": {"kind": "simple-baseline", "width": 8, "residuals": 0},
    "data": {"test_subjects": ["S4"], "validation_subjects": ["S3"], "views": 1},
    "train": {"objective": "squared-error", "epochs": 2, "batch": 16, "steps_per_epoch": 2},
}


def training(motion, folder, *, resume=False, **data):
    table = {**TABLE, "data": {**TABLE["data"], **data}}
    return prepare(Config.from_table(table), motion, folder, resume=resume)


def modified(motion: Path, to: Path, **members) -> Path:
    with np.load(motion) as file:
        np.savez(to, **{**{name: file[name] for name in file.files}, **members})
    return to


# --- existing files ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("name", [WEIGHTS, LOSSES])
def test_files_without_a_checkpoint_are_not_overwritten(motion_file, tmp_path, name, resume):
    (tmp_path / "keep").mkdir()
    (tmp_path / "keep" / name).write_bytes(b"precious")
    with pytest.raises(PoseFileError, match=rf"keep: holds {name}, but no {CHECKPOINT} to resume from"):
        training(motion_file, tmp_path / "keep", resume=resume)
    assert (tmp_path / "keep" / name).read_bytes() == b"precious"


@pytest.mark.parametrize("name", [CHECKPOINT, WEIGHTS, LOSSES])
def test_a_folder_in_the_place_of_a_file_is_noticed_before_any_work(tmp_path, name):
    (tmp_path / "run" / name).mkdir(parents=True)
    with pytest.raises(PoseFileError, match=rf"run/{name}: is a folder; expected the name of a file"):
        training(tmp_path / "no such data.npz", tmp_path / "run")


def test_a_file_in_the_place_of_the_folder_is_noticed_before_any_work(tmp_path):
    (tmp_path / "run").write_text("a file")
    with pytest.raises(PoseFileError, match=r"run: can't be made \(a file of that name is there\)"):
        training(tmp_path / "no such data.npz", tmp_path / "run")
    with pytest.raises(PoseFileError, match=r"b: can't be made \(the folder .*a does not exist\)"):
        training(tmp_path / "no such data.npz", tmp_path / "a" / "b")


def test_a_folder_that_can_t_be_written_into_is_noticed_before_any_work(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / LOSSES).symlink_to(tmp_path / "nowhere" / LOSSES)
    with pytest.raises(PoseFileError, match=rf"run/{LOSSES}: the folder .*nowhere does not exist"):
        training(tmp_path / "no such data.npz", tmp_path / "run")


# --- other data -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_other_data_are_refused_and_the_differences_named(motion_file, tmp_path, monkeypatch, capsys):
    training(motion_file, tmp_path / "run").run(max_steps=2)
    with np.load(motion_file) as file:
        poses, subject = file["poses"].copy(), file["subject"]
    poses[7, 3, 1] += 1
    other = modified(motion_file, tmp_path / "other.npz", poses=poses)
    with pytest.raises(
        PoseDataError, match=rf"run/{CHECKPOINT}: of other data \(poses differ\)\. Give the data it was"
    ):
        training(other, tmp_path / "run", resume=True)
    both = modified(other, tmp_path / "both.npz", subject=subject[::-1])
    with pytest.raises(PoseDataError, match=r"of other data \(poses, subject differ\)"):
        training(both, tmp_path / "run", resume=True)

    (tmp_path / "settings.toml").write_text(
        "\n".join(
            f"[{table}]\n" + "\n".join(f"{name} = {json.dumps(value)}" for name, value in settings.items())
            for table, settings in TABLE.items()
        )
    )
    arguments = [
        "train",
        str(tmp_path / "settings.toml"),
        "--data",
        str(other),
        "-o",
        str(tmp_path / "run"),
        "--resume",
    ]
    monkeypatch.setattr(sys, "argv", ["posecal-models", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 3
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.slow
def test_the_same_data_in_another_file_go_on(motion_file, tmp_path):
    training(motion_file, tmp_path / "run").run(max_steps=2)
    with np.load(motion_file) as file:
        poses = file["poses"]
    big_endian = poses.astype(poses.dtype.newbyteorder(">"))
    same = modified(motion_file, tmp_path / "same.npz", poses=big_endian, remark=np.array("a copy"))
    assert digests(same) == digests(motion_file)
    assert training(same, tmp_path / "run", resume=True).step == 2


def test_a_checkpoint_from_before_data_had_digests_goes_on_and_then_has_them(motion_file, tmp_path):
    training(motion_file, tmp_path / "run").run(max_steps=2)
    tensors, about = read_tensors(tmp_path / "run" / CHECKPOINT)
    del about["training"]["data"]
    write_tensors(tmp_path / "run" / CHECKPOINT, tensors, about)
    run = training(motion_file, tmp_path / "run", resume=True)
    assert run.step == 2
    run.run()
    assert read_tensors(tmp_path / "run" / CHECKPOINT)[1]["training"]["data"] == digests(motion_file)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda about: about["training"]["config"].update(train=[]),
        lambda about: about.pop("schedule"),
        lambda about: about.update(training=5),
    ],
    ids=["a list as table", "no schedule", "a number as training"],
)
def test_a_checkpoint_that_lacks_what_a_training_needs_is_refused(motion_file, tmp_path, spoil):
    training(motion_file, tmp_path / "run").run(max_steps=2)
    tensors, about = read_tensors(tmp_path / "run" / CHECKPOINT)
    spoil(about)
    write_tensors(tmp_path / "run" / CHECKPOINT, tensors, about)
    with pytest.raises(PoseFileError, match=r"checkpoint\.safetensors: holds no complete training \("):
        training(motion_file, tmp_path / "run", resume=True)


@pytest.mark.parametrize("text", ["", "epoch,step\n1,2\n", "epoch,step,training_loss,validation_loss\n1,2,inf,nan\n"])
def test_losses_that_are_none_are_refused(tmp_path, text):
    (tmp_path / "losses.csv").write_text(text)
    with pytest.raises(PoseFileError, match=r"losses\.csv: can't be read \(.*\); expected the losses\.csv of"):
        read_losses(tmp_path)


# --- numbers that are not finite ----------------------------------------------------------------------------------


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_validation_loss_that_is_not_finite_stops_the_training_and_says_where(motion_file, tmp_path, broken):
    run = training(motion_file, tmp_path / "run")
    run.run(max_steps=3)
    before = (tmp_path / "run" / CHECKPOINT).read_bytes()
    run.validation.poses[5] = broken
    words = rf"validation: after step 4 \(epoch 2\) loss is {broken}\. The checkpoint in .*run is from before\. Lower"
    with pytest.raises(PoseDataError, match=words):
        run.run()
    assert (tmp_path / "run" / CHECKPOINT).read_bytes() == before


def test_no_checkpoint_is_mentioned_where_there_is_none(motion_file, tmp_path):
    run = training(motion_file, tmp_path / "run")
    run.data.poses[:] = math.nan
    with pytest.raises(PoseDataError, match=r"at step 0 \(epoch 1\).*\. Lower train\.learning_rate") as caught:
        run.run()
    assert "checkpoint" not in str(caught.value)


def test_without_validation_the_training_loss_selects_the_weights(motion_file, tmp_path):
    run = training(motion_file, tmp_path / "run", validation_subjects=[])
    losses = []
    run.run(on_step=lambda progress: losses.append(progress.validation))
    assert losses == [None] * 4
    rows = np.genfromtxt(tmp_path / "run" / LOSSES, delimiter=",", names=True)
    assert np.isnan(rows["validation_loss"]).all()
    best = rows["step"][rows["training_loss"].argmin()]
    assert notes_of(tmp_path / "run" / WEIGHTS)["weights_of_step"] == best


def test_the_weights_note_their_step(motion_file, tmp_path):
    """The one of the lowest validation loss, not the last."""
    run = training(motion_file, tmp_path / "run")
    run.run()
    rows = np.genfromtxt(tmp_path / "run" / LOSSES, delimiter=",", names=True)
    best = rows["step"][rows["validation_loss"].argmin()]
    assert notes_of(tmp_path / "run" / WEIGHTS)["weights_of_step"] == best


@pytest.mark.parametrize("name", ["gt", "axes", "root_relative", "occluded", "keypoint_joints", "unit"])
def test_digests_cover_every_member_that_a_reader_reads(tmp_path, name):
    members = {member: np.zeros(2) for member in ("gt", "axes", "root_relative", "occluded", "keypoint_joints", "unit")}
    np.savez(tmp_path / "one.npz", **members)
    np.savez(tmp_path / "two.npz", **{**members, name: np.ones(2)})
    one, two = digests(tmp_path / "one.npz"), digests(tmp_path / "two.npz")
    assert {member for member in members if one[member] != two[member]} == {name}

"""Scalars for TensorBoard."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest

from posecal.errors import PoseFileError
from posecal_models.cli import main
from posecal_models.config import Config
from posecal_models.preparation import prepare
from posecal_models.tensorboard import tensorboard_log
from posecal_models.training_folder import LOSSES

TABLE = {
    "model": {"kind": "simple-baseline", "width": 8, "residuals": 0},
    "data": {"validation_subjects": ["S3"], "views": 1},
    "train": {"objective": "squared-error", "epochs": 2, "batch": 16, "steps_per_epoch": 2, "schedule": "cosine"},
}


class Writer:
    """What ``SummaryWriter`` is called with."""

    made: list[Writer]

    def __init__(self, folder: str, purge_step: int) -> None:
        self.folder, self.purge_step, self.scalars, self.open = folder, purge_step, [], True
        Writer.made.append(self)

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, *_: object) -> None:
        self.open = False

    def add_scalar(self, name: str, value: float, step: int) -> None:
        self.scalars.append((name, value, step))


@pytest.fixture
def writers(monkeypatch) -> list[Writer]:
    module = ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    monkeypatch.setattr(Writer, "made", [], raising=False)
    return Writer.made


def train(motion_file, folder, tensorboard, *, max_steps: int | None = None) -> None:
    run = prepare(Config.from_table(TABLE), motion_file, folder, resume=True)
    with tensorboard_log(run, tensorboard) as on_step:
        run.run(on_step=on_step, max_steps=max_steps)


def test_losses_and_learning_rate_of_every_step_are_written_and_a_resumed_training_goes_on(
    motion_file, tmp_path, writers
):
    train(motion_file, tmp_path / "run", tmp_path / "log", max_steps=3)
    train(motion_file, tmp_path / "run", tmp_path / "log")
    first, second = writers
    assert [(w.folder, w.purge_step, w.open) for w in writers] == [(str(tmp_path / "log"), n, False) for n in (1, 4)]
    written = first.scalars + second.scalars
    by_name = {name: [(step, value) for n, value, step in written if n == name] for name, *_ in written}
    assert sorted(by_name) == ["learning rate", "training/loss", "validation/loss"]
    assert [step for step, _ in by_name["training/loss"]] == [1, 2, 3, 4]
    np.testing.assert_allclose([rate for _, rate in by_name["learning rate"]][:3:2], [1e-3, 5e-4])
    rows = np.genfromtxt(tmp_path / "run" / LOSSES, delimiter=",", names=True)
    np.testing.assert_allclose(by_name["validation/loss"], [*zip((2, 4), rows["validation_loss"], strict=True)], 1e-6)
    means = np.reshape([loss for _, loss in by_name["training/loss"]], (2, 2)).mean(1)
    np.testing.assert_allclose(means, rows["training_loss"], 1e-6)


def test_without_a_folder_nothing_is_written(motion_file, tmp_path, writers):
    train(motion_file, tmp_path / "run", None, max_steps=1)
    assert writers == []


def test_without_the_package_the_command_says_how_to_install_it_before_any_work(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    command = ["train", "cgnf-tiny", "--data", "nothing.npz", "-o", str(tmp_path / "run"), "--tensorboard", "log"]
    monkeypatch.setattr(sys, "argv", ["posecal-models", *command])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 3
    assert 'Install it with pip install "posecal[tensorboard]"' in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_files_are_tensorboard_s(motion_file, tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    train(motion_file, tmp_path / "run", tmp_path / "log", max_steps=3)
    train(motion_file, tmp_path / "run", tmp_path / "log")
    events = EventAccumulator(str(tmp_path / "log")).Reload()
    assert [event.step for event in events.Scalars("training/loss")] == [1, 2, 3, 4]
    assert [event.step for event in events.Scalars("validation/loss")] == [2, 4]
    with pytest.raises(PoseFileError, match=r"losses\.csv: can't be written"):
        train(motion_file, tmp_path / "run", tmp_path / "run" / LOSSES)

"""The progress of a training on a terminal of 80 columns."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from posecal_models.config import Config
from posecal_models.preparation import prepare
from posecal_models.progress import TrainingProgressBar, note_on_selection


def bar_of(motion_file, folder, width: int) -> tuple[TrainingProgressBar, Console]:
    table = {
        "model": {"kind": "cgnf", "size": "tiny"},
        "data": {"validation_subjects": ["S3"], "views": 1},
        "train": {"epochs": 2, "batch": 8, "sample_weight": 0.1, "steps_per_epoch": 1},
    }
    console = Console(width=width, file=io.StringIO(), force_terminal=True, color_system=None)
    return TrainingProgressBar(prepare(Config.from_table(table), motion_file, folder), console), console


@pytest.mark.parametrize("selection", ["loss", "energy-score"])
@pytest.mark.parametrize("mirrors_hips", [True, False])
def test_a_likelihood_without_bound_that_selects_the_weights_is_named(motion_file, tmp_path, selection, mirrors_hips):
    with np.load(motion_file) as file:
        members = dict(file)
    hip, right, left = (members["joints"].tolist().index(name) for name in ("Hip", "RHip", "LHip"))
    if mirrors_hips:
        members["poses"][:, left] = 2 * members["poses"][:, hip] - members["poses"][:, right]
    np.savez(tmp_path / "motion.npz", **members)
    table = {
        "model": {"kind": "cgnf", "size": "tiny"},
        "data": {"validation_subjects": ["S3"], "views": 2},
        "train": {"selection": selection},
    }
    note = note_on_selection(prepare(Config.from_table(table), tmp_path / "motion.npz", tmp_path / "run"))
    assert ("don't vary in 3 of 48 directions" in note) == (mirrors_hips and selection == "loss")
    assert bool(note) == (mirrors_hips and selection == "loss")


def lines(bar: TrainingProgressBar, console: Console) -> list[str]:
    with console.capture() as captured:
        console.print(bar.get_renderable())
    return captured.get().splitlines()


def test_before_the_first_step_there_is_one_line(motion_file, tmp_path):
    (line,) = lines(*bar_of(motion_file, tmp_path / "run", 80))
    assert line.split()[:3] == ["epoch", "1", "of"]
    assert "learning rate 0.001" in line


def test_every_loss_is_shown_and_the_epoch_is_at_most_the_last(motion_file, tmp_path):
    bar, console = bar_of(motion_file, tmp_path / "run", 80)
    screens = []

    def show(progress):
        bar.show(progress)
        screens.append(lines(bar, console))

    bar._run.run(on_step=show)
    assert [len(screen) for screen in screens] == [2, 2]
    for (first, second), epoch, step in zip(screens, (2, 2), (1, 2), strict=True):
        assert len(first) <= 80
        assert len(second) <= 80
        assert first.startswith(f"epoch {epoch} of 2 ")
        for words in (" left learning rate ", f" {step}/2 ", "━━━"):
            assert words in first
        assert first.split()[4].count(":") == 2, "the time left"
        assert [part.split()[0] for part in second.split(", ")] == ["loss", "prior", "posterior", "mode", "validation"]


@pytest.mark.parametrize("width", [80, 72])
def test_long_numbers_leave_all_but_the_bar_as_it_is(motion_file, tmp_path, width):
    bar, console = bar_of(motion_file, tmp_path / "run", width)
    bar.update(bar._steps, total=1_200_000, completed=999_999, description="epoch 199 of 200", rate=1.2e-05)
    (line,) = lines(bar, console)
    assert len(line) <= width
    assert line.startswith("epoch 199 of 200 ")
    assert "left learning rate 1.2e-05 " in line
    assert " 999999/1200000" in line

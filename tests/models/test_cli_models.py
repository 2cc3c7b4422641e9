"""The command line: results, messages and exit codes."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from typer.testing import CliRunner

from posecal_models.cli import app, main

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def posecal_models(*arguments: object, cwd: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "posecal_models.cli", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)


def in_this_process(*arguments: object, cwd: Path) -> subprocess.CompletedProcess:
    """The same without starting a process."""
    command, output, errors = ["posecal-models", *map(str, arguments)], io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(cwd),
        mock.patch.object(sys, "argv", command),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    return subprocess.CompletedProcess(command, ended.value.code or 0, output.getvalue(), errors.getvalue())


COMMANDS = (
    ("motion", "-o", "motion.npz", "--subjects", 3, "--clips", 2, "--frames", 20),
    ("train", "cgnf-tiny", "--data", "motion.npz", "-o", "tiny", "--set", 'data.test_subjects=["S3"]',
     "--set", "train.epochs=1", "--threads", 1),
    ("project", "motion.npz", "-o", "test.npz", "--subject", "S3"),
    ("sample", "tiny/weights.safetensors", "test.npz", "-o", "hyps.npz", "--n", 5),
)  # fmt: skip
"""Commands of the page on models, smaller: motion, a training, images of the test subject, hypotheses."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with the results of these commands."""
    where = tmp_path_factory.mktemp("readme")
    for arguments in COMMANDS:
        done = in_this_process(*arguments, cwd=where)
        assert done.returncode == 0, done.stderr
        assert done.stdout == ""
    return where


@pytest.mark.slow
def test_a_training_s_commands_end_in_a_file_that_posecal_evaluates(tmp_path):
    for arguments in COMMANDS:
        done = posecal_models(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout == ""
    command = [sys.executable, "-m", "posecal", "evaluate", "hyps.npz", "test.npz", "--format", "json"]
    done = subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=True)
    report = json.loads(done.stdout)
    assert (report["hypotheses"], report["poses"]) == (5, 2 * 20 * 4)


@pytest.mark.slow
def test_a_line_per_epoch_is_printed_where_there_is_no_terminal(folder):
    done = in_this_process(
        "train", "cgnf-tiny", "--data", "motion.npz", "-o", "run", "--set", "train.epochs=2", "--set", "data.every=10",
        cwd=folder,
    )  # fmt: skip
    assert [line.split(":")[0] for line in done.stderr.splitlines()] == ["step 2 of 4, epoch 1", "step 4 of 4, epoch 2"]
    assert "learning rate" in done.stderr


@pytest.mark.slow
def test_losses_are_drawn(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert CliRunner().invoke(app, ["losses", "tiny=tiny", "-o", "losses.png"]).exit_code == 0
    assert (folder / "losses.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_describing_weights_gives_json(folder):
    about = json.loads(in_this_process("describe", "tiny/weights.safetensors", cwd=folder).stdout)
    assert about["estimator"]["kind"] == "cgnf"
    assert about["notes"]["config"]["data"]["test_subjects"] == ["S3"]


def test_help_is_quick_and_needs_no_torch():
    script = "import sys; sys.argv=['posecal-models','--help']\nfrom posecal_models.cli import main\n"
    script += "try: main()\nexcept SystemExit: pass\nassert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", script], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "train" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("train", "cgnf-smal", "--data", "motion.npz", "-o", "x"), "Did you mean cgnf-small?"),
        (("train", "cgnf-tiny", "--data", "none.npz", "-o", "x"), "none.npz: no such file"),
        (("train", "cgnf-tiny", "--data", "motion.npz", "-o", "tiny"), "holds a training already. Pass --resume"),
        (("train", "cgnf-tiny", "--data", "motion.npz", "-o", "a/b/c"), "can't be made"),
        (("train", "cgnf-tiny", "--data", "motion.npz", "-o", "x", "--device", "cuda"), "sees no such GPU"),
        (("train", "cgnf-tiny", "--data", "motion.npz", "-o", "x", "--set", 'data.test_subjects=["S9"]'), "S9 not"),
        (("sample", "none.safetensors", "test.npz", "-o", "h.npz"), "none.safetensors: no such weights"),
        (("sample", "tiny/checkpoint.safetensors", "test.npz", "-o", "h.npz"), "holds the state of a training"),
        (("sample", "tiny/weights.safetensors", "motion.npz", "-o", "h.npz"), "motion.npz: lacks keypoints_2d"),
        (("sample", "tiny/weights.safetensors", "test.npz", "-o", "no/h.npz"), "no"),
        (("losses", "a=nowhere", "-o", "l.png"), "losses.csv: no such file"),
        (("project", "motion.npz", "-o", "t.npz", "--subject", "S9"), "subjects: S9 not there"),
        (("import", "prohpe", "motion.npz", "-o", "p.npz"), "motion.npz"),
        (("convert", "motion.npz", "-o", "w.safetensors"), "motion.npz: "),
    ],
)  # fmt: skip
def test_bad_input_gives_one_message_exit_3_and_no_file(folder, monkeypatch, capsys, arguments, words):
    before = sorted(path.name for path in folder.iterdir())
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["posecal-models", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert ended.value.code == 3
    assert words in said.err
    assert len(said.err.strip().splitlines()) == 1
    assert said.out == ""
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.slow
def test_bad_input_shows_no_traceback_in_a_process_of_its_own(folder):
    done = posecal_models("sample", "none.safetensors", "test.npz", "-o", "h.npz", cwd=folder)
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("posecal-models: none.safetensors: no such weights.")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "left"),
    [
        ("sample tiny/weights.safetensors test.npz -o full/hyps.npz", []),
        ("train cgnf-tiny --data motion.npz -o full/run --set train.epochs=1 --set data.every=10", ["run"]),
    ],
)
def test_a_full_disk_gives_one_message_and_nothing_half_written(folder, arguments, left):
    """In a process of its own whose files may not grow beyond 20 kB, as on a disk without space."""
    (folder / "full").mkdir(exist_ok=True)
    script = """
import resource, signal
from posecal_models.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
main()
"""
    command = [sys.executable, "-c", script, *arguments.split()]
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 3
    assert done.stderr.endswith("can't be written (File too large).\n")
    assert len(done.stderr.splitlines()) == 1
    assert sorted(path.name for path in (folder / "full").rglob("*")) == left
    shutil.rmtree(folder / "full")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("trian", "No such command"),
        ("sample a", "Missing argument"),
        ("sample a b -o c --n 0", "--n"),
        ("import bvh a -o b", "bvh"),
        ("sample cgnf-small a.npz -o ./a.npz", "a.npz is read already"),
        ("sample w.safetensors a.npz -o w.safetensors", "w.safetensors is read already"),
        ("project a.npz -o a.npz", "a.npz is read already"),
        ("import prohpe a.pkl -o a.pkl", "a.pkl is read already"),
        ("convert a.pt -o a.pt", "a.pt is read already"),
        ("losses a=b -o a.gif", "a.gif: .gif; expected a name that ends with .svg, .png or .pdf"),
        ("losses A=b a=c -o a.png", "'A': given more than once"),
        ("benchmark --data d.npz --subject S1 -o o --model x=a --model x=b", "'x': given more than once"),
    ],
)
def test_a_wrong_call_exits_with_2(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, arguments.split(), env={"COLUMNS": "200"})
    assert done.exit_code == 2
    assert words in done.output


@pytest.mark.slow
def test_keypoints_that_a_file_lacks_are_named(folder):
    with np.load(folder / "test.npz") as whole:
        members = dict(whole)
    keep = [k for k, name in enumerate(members["joints"]) if name not in {"LWrist", "Spine"}]
    np.savez(folder / "fewer\x1b[1m.npz", keypoints_2d=members["keypoints_2d"][:, keep], joints=members["joints"][keep])
    done = in_this_process(
        "sample", "tiny/weights.safetensors", "fewer\x1b[1m.npz", "-o", "fewer-h.npz", "--n", 2, cwd=folder
    )
    assert done.returncode == 0
    assert r"note: fewer\x1b[1m.npz has no keypoint Spine, LWrist: missing in every image." in done.stderr.splitlines()
    twice = members["joints"].copy()
    twice[5] = twice[2]
    np.savez(folder / "twice.npz", keypoints_2d=members["keypoints_2d"], joints=twice)
    done = in_this_process("sample", "tiny/weights.safetensors", "twice.npz", "-o", "twice-h.npz", cwd=folder)
    assert (done.returncode, done.stderr) == (
        3,
        "posecal-models: twice.npz: names of the keypoints name RKnee more than once; expected each joint once.\n",
    )


@pytest.mark.slow
def test_a_benchmark_on_training_subjects_prints_a_note(folder, tmp_path):
    done = in_this_process(
        "benchmark", "--data", "motion.npz", "--model", "t=tiny/weights.safetensors", "--subject", "S3",
        "--subject", "S1", "-o", tmp_path / "out", "--n", 2, "--every", 10, "--seeds", 1, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0
    assert "note: the training of t did not hold out S1; on the same data this is no test." in done.stderr.splitlines()


@pytest.mark.slow
def test_ctrl_c_exits_with_130_and_leaves_a_checkpoint_that_is_whole(folder):
    command = [
        sys.executable,
        "-m",
        "posecal_models.cli",
        "train",
        "cgnf-tiny",
        "--data",
        "motion.npz",
        "-o",
        "stopped",
    ]
    command += ["--set", "train.checkpoint_seconds=0.05", "--set", "train.epochs=1000", "--threads", "1"]
    with subprocess.Popen(command, cwd=folder, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        while not (folder / "stopped" / "checkpoint.safetensors").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        try:
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not list((folder / "stopped").glob(".*"))
    from posecal_models.checkpoint import read_tensors

    assert read_tensors(folder / "stopped" / "checkpoint.safetensors")[1]["training"]["step"] > 0


@pytest.mark.slow
def test_converting_a_released_checkpoint_lists_its_unused_tensors(tmp_path):
    import torch

    with np.load(ROOT / "tests" / "fixtures" / "reference_models" / "tiny_state.npz") as file:
        torch.save({name: torch.from_numpy(file[name]) for name in file.files}, tmp_path / "model.pt")
    done = in_this_process("convert", "model.pt", "-o", "w.safetensors", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "transform_net.layers.1.layers.c.weight (8, 8)" in done.stderr
    # per block: child to parent (2·8 + 8) + (8·8 + 8), last updates 2·(8·8 + 8), attention (4 + 1) + (16 + 1)
    assert "24 tensors with 524 unused parameters" in done.stderr
    assert in_this_process("describe", "w.safetensors", cwd=tmp_path).returncode == 0

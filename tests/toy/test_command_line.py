"""The command ``python -m toy``: figures, printed numbers, messages and exit codes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import toy
from toy.__main__ import app
from toy.faults import FAULTS

SMALL = {
    "sigma-map": ["--grid", "3", "--poses", "50"],
    "landscape": ["--poses", "50"],
    "collapse": ["--poses", "50"],
    "mean": ["--poses", "50"],
    "curves": ["--poses", "50"],
    "pose-world": ["--sequences", "4", "--frames", "2", "--hypotheses", "10"],
    "motion": ["--clips", "5"],
    "pendulum": ["--pendulums", "4"],
}
SLOW = ("sigma-map", "landscape", "mean", "pendulum")
NUMBERS = {
    "sigma-map": ["0.1973", "3.06478", "3.55927", "112.83", "32.66"],
    "landscape": ["4.0003", "4.538"],
    "collapse": ["1.414", "0.4524", "0.6931"],
    "mean": ["1.539", "-0.4919"],
    "curves": ["0.331"],
    "pose-world": ["nats per pose", "minMPJPE of 10 exact hypotheses"],
    "motion": ["calibrated, frame 25", "whole clips"],
    "pendulum": ["drift"],
}


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "command", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in SMALL]
)
def test_every_command_prints_its_numbers_and_writes_a_figure(command: str) -> None:
    result = run(command, *SMALL[command])
    assert result.exit_code == 0, result.output
    for number in NUMBERS[command]:
        assert number in result.stdout
    assert Path(f"{command}.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert result.stderr == ""


@pytest.mark.parametrize(
    ("ending", "magic"),
    [("svg", b"<?xml"), ("png", b"\x89PNG"), pytest.param("pdf", b"%PDF", marks=pytest.mark.slow)],
)
def test_the_ending_chooses_the_format(ending: str, magic: bytes) -> None:
    assert run("collapse", "--poses", "50", "-o", f"here.{ending}").exit_code == 0
    assert Path(f"here.{ending}").read_bytes().startswith(magic)


@pytest.mark.slow
def test_the_seed_decides_the_check_and_the_figure_is_the_same_again() -> None:
    first = run("collapse", "--poses", "500")
    figure = Path("collapse.svg").read_bytes()
    assert run("collapse", "--poses", "500").stdout == first.stdout
    assert Path("collapse.svg").read_bytes() == figure
    assert run("collapse", "--poses", "500", "--seed", "1").stdout != first.stdout


@pytest.mark.slow
def test_pose_world_writes_files_of_the_named_fault() -> None:
    assert run("pose-world", *SMALL["pose-world"], "--fault", "spread-0.5", "--data", "half").exit_code == 0
    assert run("pose-world", *SMALL["pose-world"], "--data", "whole").exit_code == 0
    with np.load("half/hyps.npz") as half, np.load("whole/hyps.npz") as whole:
        ratio = np.ptp(half["hypotheses"], axis=0) / np.ptp(whole["hypotheses"], axis=0)
    np.testing.assert_allclose(ratio, 0.5, rtol=1e-3)
    with np.load("half/gt.npz") as half, np.load("whole/gt.npz") as whole:
        np.testing.assert_array_equal(half["truth"], whole["truth"])


@pytest.mark.slow
def test_pose_world_writes_all_faults_into_a_folder_each() -> None:
    result = run("pose-world", *SMALL["pose-world"], "--fault", "all", "--world", "independent-joints")
    assert result.exit_code == 0, result.output
    assert {folder.name for folder in Path("pose-world").iterdir()} == set(FAULTS)
    for fault in FAULTS.values():
        assert (Path("pose-world") / fault.name / "hyps.npz").exists()
        assert fault.description in result.stdout


@pytest.mark.slow
def test_the_table_of_faults_names_the_joint_correlation() -> None:
    small = ("fault-table", "--hypotheses", "5", "--poses", "12")
    independent, correlated = (run(*small, *options).stdout for options in ((), ("--joint-correlation", "0.3")))
    assert independent.startswith("N = 5, M = 12 independent poses. Cells")
    assert correlated.startswith("N = 5, M = 12 independent poses, joints correlated 0.3. Cells")
    for table in (independent, correlated):
        assert [f"| `{name}` |" in table for name in FAULTS] == [True] * len(FAULTS)
    # The faults of correlations have their own; the last one depends on the option
    assert independent.splitlines()[-1] != correlated.splitlines()[-1]


def test_pose_world_lists_its_faults_and_writes_nothing(tmp_path: Path) -> None:
    result = run("pose-world", "--list")
    assert result.exit_code == 0
    assert all(fault.description in result.stdout for fault in FAULTS.values())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_pendulum_writes_its_data() -> None:
    assert run("pendulum", "--pendulums", "4", "--timesteps", "6", "--data", "four.npz").exit_code == 0
    with np.load("four.npz", allow_pickle=False) as stored:
        assert {name: stored[name].shape for name in stored} == {
            "time": (6,),
            "positions": (4, 6, 4, 2),
            "observed": (4, 6, 3, 2),
            "energy": (4, 6),
        }


def test_rank_law_writes_a_table_that_posecal_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    from toy import rank_law

    monkeypatch.setattr(rank_law, "SIZES", (2, 3))
    assert run("rank-law", "--draws", "500", "-o", "law.json").exit_code == 0
    assert '"paper"' in Path("law.json").read_text(encoding="utf-8")


@pytest.mark.parametrize("arguments", [["-o", "figure.jpg"], ["--seed", "-1"], ["--poses", "1"], ["--nonsense"]])
def test_a_wrong_call_ends_in_2(arguments: list[str], tmp_path: Path) -> None:
    assert run("collapse", *arguments).exit_code == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["collapse", "--poses", "50", "-o", "no/such/a.svg"], "no/such/a.svg: the folder no/such does not exist"),
        (["pose-world", "--fault", "shiftd"], "fault: 'shiftd' is not known. Did you mean shifted?"),
        (["pose-world", "--joints", "h36m-99"], "joint set: 'h36m-99' is not known"),
        (["pose-world", *SMALL["pose-world"], "--data", "no/such"], "no/such: can't be made"),
        (["pendulum", "--pendulums", "2", "--data", "no/such.npz"], "no/such.npz: the folder no does not exist"),
    ],
)
def test_bad_data_end_in_3_with_one_message_and_nothing_written(
    arguments: list[str], words: str, tmp_path: Path
) -> None:
    result = run(*arguments)
    assert result.exit_code == 3
    assert result.stderr.startswith(f"toy: {words}")
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_ends_in_130(monkeypatch: pytest.MonkeyPatch) -> None:
    from toy.experiments import collapse

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(collapse, "run", interrupted)
    result = run("collapse")
    assert result.exit_code == 130
    assert "Traceback" not in result.output


@pytest.mark.slow
def test_it_runs_from_a_checkout_as_a_module(tmp_path: Path) -> None:
    checkout = Path(toy.__file__).parents[1]
    arguments = [sys.executable, "-m", "toy", "curves", "--poses", "50", "-o", str(tmp_path / "curves.png")]
    done = subprocess.run(arguments, cwd=checkout, capture_output=True, text=True, check=False, env={**os.environ})
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert (tmp_path / "curves.png").exists()


def test_help_names_every_command_and_imports_nothing_heavy() -> None:
    checkout = Path(toy.__file__).parents[1]
    code = (
        "import sys; from typer.testing import CliRunner; from toy.__main__ import app; "
        "print(CliRunner().invoke(app, ['--help']).stdout); "
        "print([m for m in ('matplotlib', 'scipy', 'torch', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=checkout, capture_output=True, text=True, check=True)
    for command in SMALL:
        assert command in done.stdout
    assert done.stdout.strip().endswith("[]")

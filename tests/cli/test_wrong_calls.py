"""Wrong calls are refused before any work; help."""

import re
from pathlib import Path

import pytest

import posecal
from tests.helpers.shell import EVALUATE, done, refused, run


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["evalute"], "No such command 'evalute'. Did you mean 'evaluate'?"),
        (["evaluate", "hyps.npz"], "Missing argument"),
        ([*EVALUATE, "more.npz"], "Got unexpected extra argument"),
        ([*EVALUATE, "--bye", "action"], "No such option"),
        ([*EVALUATE, "--where", "hidden"], "'hidden' is not one of 'all', 'occluded', 'visible'"),
        ([*EVALUATE, "--format", "xml"], "'xml' is not one of 'text', 'markdown', 'csv', 'json'"),
        ([*EVALUATE, "--preset", "cgn"], "preset: 'cgn' is not known. Did you mean cgnf?"),
        ([*EVALUATE, "--set", "besst=frame"], "option: 'besst' is not known. Did you mean best?"),
        ([*EVALUATE, "--set", "best=fram"], "best: 'fram'; expected frame, sequence, batch:k (k sequences) or joint."),
        ([*EVALUATE, "--set", "best"], "'best': expected OPTION=VALUE, such as best=sequence."),
        ([*EVALUATE, "--set", "pck_threshold=wide"], "pck_threshold: 'wide'; expected a length in mm."),
        ([*EVALUATE, "--metrics", "mpjp"], "metrics: mpjp not known. Did you mean mpjpe?"),
        ([*EVALUATE, "--metrics", ""], "metrics: ''; expected default, rank_tests, scores, all, or names with commas."),
        ([*EVALUATE, "--axes", "NMKK"], "axes: 'NMKK' is no layout; expected each letter of NMKD once"),
        ([*EVALUATE, "--unit", "inch"], "unit: 'inch'; expected mm, cm, m, or the millimetres in one unit"),
        ([*EVALUATE, "--hypotheses", "0"], "'--hypotheses'"),
        ([*EVALUATE, "--threads", "0"], "'--threads'"),
        ([*EVALUATE, "--plot", "p.jpg"], "p.jpg: .jpg; expected a name that ends with .svg, .png or .pdf."),
        ([*EVALUATE, "--plot", "p"], "p: no ending; expected a name that ends with .svg, .png or .pdf."),
        ([*EVALUATE, "--html", "gt.npz"], "gt.npz is read already; expected another name."),
        ([*EVALUATE, "--skill", "r.npz", "--save", "r.npz"], "r.npz is read already; expected another name."),
        ([*EVALUATE, "--prerank", "p.py:height", "--save", "p.py"], "p.py is read already; expected another name."),
        ([*EVALUATE, "--save", "x", "--html", "./x"], "x is written already; expected another name."),
        (["merge", "result.npz", "-o", "./result.npz"], "result.npz is read already; expected another name."),
        (["merge", "result.npz"], "Missing option '--output'"),
        (["plot", "joint", "result.npz", "-o", "x.svg"], "No such command 'joint'. Did you mean 'joints'?"),
    ],
    ids=lambda value: "-".join(value)[-40:] if isinstance(value, list) else "",
)
def test_a_wrong_call_is_refused_before_any_work(words: list[str], said: str) -> None:
    assert said in refused(*words, code=2)


def test_a_missing_argument_and_an_unknown_option_are_named() -> None:
    """In the words of whatever version of typer and click."""
    assert "'truth'" in refused("evaluate", "hyps.npz", code=2).replace("TRUTH", "truth")
    assert "--bye" in refused(*EVALUATE, "--bye", "action", code=2)


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("nowhere/x", r"nowhere/x: the folder nowhere does not exist\. Make it first\."),
        ("folder", r"folder: is a folder; expected the name of a file\."),
        ("/proc/x", r"/proc/x: can't be written \(.+\)\."),
        ("/dev/full", r"/dev/full: is a device or a pipe; expected the name of a file\."),
    ],
)
@pytest.mark.parametrize("option", ["--save", "--html"])
def test_an_output_that_can_not_be_written_is_refused_before_any_work(option: str, path: str, words: str) -> None:
    Path("folder").mkdir()
    said = refused("evaluate", "nothing.npz", "nothing.npz", option, path)
    assert re.fullmatch(f"posecal: {words}", said), said


@pytest.mark.parametrize(
    "command", ["merge nothing.npz", "plot errors nothing.npz", "plot poses nothing.npz nothing.npz"]
)
def test_so_does_every_other_command(command: str) -> None:
    said = refused(*command.split(), "-o", "nowhere/x.svg")
    assert said == "posecal: nowhere/x.svg: the folder nowhere does not exist. Make it first."


def test_no_file_is_written_where_one_of_them_can_not_be_made() -> None:
    """The diagram needs two hypotheses; the result would not."""
    Path("s.npz").write_text("what was here before")
    said = refused(*EVALUATE, "--hypotheses=1", "--save=s.npz", "--html=h.html", "--plot=p.svg")
    assert said == "posecal: reliability: calibration needs at least 2 hypotheses; there is 1."


# --- help -----------------------------------------------------------------------------------------------------

COMMANDS = ["", "evaluate", "report", "compare", "merge", "presets", "demo", "plot", "plot poses", "plot reliability"]


@pytest.mark.parametrize("command", [*COMMANDS, "recalibrate", "recalibrate fit", "recalibrate apply"])
def test_help_explains_every_option_in_a_sentence(command: str) -> None:
    text = done(*command.split(), "--help")
    assert text.count("Usage: posecal") == 1
    lines = [line.strip("│ ") for line in text.splitlines()]
    options = [line for line in lines if re.match(r"\*? *--", line)]
    assert options
    for line in options:
        assert re.search(r"[A-Za-z,)…]\.( |$)", line), line


@pytest.mark.parametrize("width", ["60", "80", "120"])
def test_help_fits_the_terminal(width: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", width)
    assert max(map(len, done("evaluate", "--help").splitlines())) <= int(width)


def test_the_version_is_shown() -> None:
    assert done("--version") == f"posecal {posecal.__version__}\n"


def test_without_a_command_help_is_shown() -> None:
    found = run()
    assert found.exit_code == 2
    assert "evaluate" in found.output


def test_options_of_evaluate_come_before_those_of_reading_and_writing() -> None:
    text = done("evaluate", "--help")
    headings = ["Arguments", "Options", "Many files", "How the files are read", "What is written"]
    assert re.findall(r"╭─ (.+?) ─", text) == headings
    at = [
        text.index(option)
        for option in ("--by", "--metrics", "--threads", "--axes", "--hypotheses", "--format", "--save")
    ]
    assert at == sorted(at)


def test_every_command_is_listed() -> None:
    text = done("--help")
    for name in ("evaluate", "report", "compare", "merge", "presets", "demo", "recalibrate", "plot"):
        assert re.search(rf"^│ {name} ", text, re.MULTILINE)


def test_every_picture_of_a_report_has_a_command() -> None:
    from posecal.cli.plots import KINDS
    from posecal.plot import KINDS as PICTURES

    assert {kind.replace("-", "_") for kind in KINDS} == set(PICTURES)


@pytest.mark.parametrize("kind", ["reliability", "comparison", "poses", "intervals"])
def test_every_plot_command_takes_the_same_options_of_a_figure(kind: str) -> None:
    text = done("plot", kind, "--help")
    for flag in ("--title", "--size", "--style", "--output"):
        assert flag in text

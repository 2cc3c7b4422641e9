"""Messages: one sentence or all of them at once, options as parameters or flags, and the nearest word."""

import pickle
from dataclasses import fields
from typing import Any

import pytest

from posecal import errors
from posecal.engine.protocol import Protocol
from posecal.errors import (
    PosecalError,
    PoseDataError,
    PoseFileError,
    attempt,
    did_you_mean,
    first_few,
    for_command_line,
    for_python,
    option,
    raise_all,
    refuse_unreadable,
)


def test_errors_are_what_python_calls_them() -> None:
    assert issubclass(PoseDataError, ValueError)
    assert issubclass(PoseFileError, OSError)
    assert issubclass(PoseDataError, PosecalError)
    assert issubclass(PoseFileError, PosecalError)


def test_no_problem_is_no_error() -> None:
    raise_all(iter(()))


def test_one_problem_is_said_as_it_is() -> None:
    with pytest.raises(PoseDataError, match=r"^truth: 0 poses\.$"):
        raise_all(["truth: 0 poses."])


def test_several_problems_are_counted_and_listed() -> None:
    with pytest.raises(PoseFileError, match=r"^2 problems:\n  - one\.\n  - two\.$"):
        raise_all(["one.", "two."], PoseFileError)


def test_errors_are_listed_by_their_messages_and_a_file_makes_it_an_error_of_files() -> None:
    with pytest.raises(PoseFileError, match=r"^3 problems:\n  - one\.\n  - two\.\n  - three\.$"):
        raise_all([PoseDataError("one."), PoseFileError("two."), "three."])


def test_a_list_of_problems_within_another_is_one_list() -> None:
    with pytest.raises(PoseDataError) as inner:
        raise_all(["one.", "two."])
    with pytest.raises(PoseDataError, match=r"^3 problems:\n  - one\.\n  - two\.\n  - three\.$"):
        raise_all([inner.value, "three."])


def test_a_call_that_is_refused_adds_to_the_problems() -> None:
    def halved(number: int) -> int:
        if number % 2:
            raise PoseDataError(f"number: {number}; expected an even one.")
        return number // 2

    problems: list[str | PosecalError] = []
    assert [attempt(problems, halved, number) for number in (4, 5, 7)] == [2, None, None]
    assert [str(problem) for problem in problems] == [f"number: {n}; expected an even one." for n in (5, 7)]
    with pytest.raises(ZeroDivisionError):
        attempt(problems, lambda: 1 / 0)


# --- options --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "parameter", "flag"),
    [
        (("axes",), "axes", "--axes"),
        (("axes", "MNKD"), 'axes="MNKD"', "--axes MNKD"),
        (("truth_axes", "M(DK)"), 'truth_axes="M(DK)"', "--truth-axes 'M(DK)'"),
        (("truth_unit", "1/0.0036"), 'truth_unit="1/0.0036"', "--truth-unit 1/0.0036"),
        (("unit", 25.4), "unit=25.4", "--unit 25.4"),
        (("root_joint", "it's"), 'root_joint="it\'s"', "--root-joint 'it'\"'\"'s'"),
        (("missing", "skip"), 'missing="skip"', "--missing skip"),
        (("n_hypotheses", 5), "n_hypotheses=5", "--hypotheses 5"),
        (("shared_joints", "common"), 'shared_joints="common"', "--joints common"),
        (("joints", "h36m-17"), 'joints="h36m-17"', "--joint-names h36m-17"),
        (("joints",), "joints", "--joint-names"),
        (("best", "sequence"), 'best="sequence"', "--set best=sequence"),
        (("pck_threshold", 150.0), "pck_threshold=150.0", "--set pck_threshold=150.0"),
        (("velocity",), "velocity", "--set velocity"),
        (("metrics", "scores"), 'metrics="scores"', "--scores"),
        (("metrics", "rank_tests"), 'metrics="rank_tests"', "--rank-tests"),
        (("metrics", "ece"), 'metrics="ece"', "--metrics ece"),
        (("where", "visible"), 'where="visible"', "--where visible"),
        (("by", "occlusion"), 'by="occlusion"', "--by occlusion"),
        (("reference", "climatology"), 'reference="climatology"', "--skill climatology"),
        (("per_joint", True), "per_joint=True", "--per-joint"),
    ],
)
def test_an_option_is_a_parameter_in_python_and_a_flag_on_the_command_line(
    arguments: tuple[Any, ...], parameter: str, flag: str
) -> None:
    message = f"h.npz: wrong. Pass {option(*arguments)}, or {option(*arguments)}."
    assert for_python(message) == f"h.npz: wrong. Pass {parameter}, or {parameter}."
    assert for_command_line(message) == f"h.npz: wrong. Pass {flag}, or {flag}."


def test_text_without_options_stays_as_it_is() -> None:
    text = "a = b; --axes 'NMKD'"
    assert for_python(text) == for_command_line(text) == text


def test_options_of_a_protocol_are_those_without_a_flag_of_their_own() -> None:
    flags = {"joints", "where", "metrics"}
    assert {field.name for field in fields(Protocol)} - flags == errors._PROTOCOL


@pytest.mark.parametrize("kind", [PosecalError, PoseDataError, PoseFileError])
def test_an_error_speaks_python_and_keeps_what_it_was_made_of(kind: type[PosecalError]) -> None:
    error = kind(f"Pass {option('truth_axes', 'MDK')}.")
    for copy in (error, pickle.loads(pickle.dumps(error))):
        assert str(copy) == f"{copy}" == 'Pass truth_axes="MDK".'
        assert for_command_line(copy.message) == "Pass --truth-axes MDK."
    with pytest.raises(kind, match=r'^2 problems:\n  - Pass truth_axes="MDK"\.\n  - one\.$') as several:
        raise_all([error, "one."], kind)
    assert "--truth-axes MDK" in for_command_line(several.value.message)


@pytest.mark.parametrize(
    ("items", "words"),
    [
        ([], ""),
        ([1], "1"),
        ([1, 2, 3], "1, 2, 3"),
        ([1, 2, 3, 4], "1, 2, 3 and 1 more"),
        (range(2003), "0, 1, 2 and 2,000 more"),
    ],
)
def test_many_things_are_named_by_the_first_and_their_number(items: list[object], words: str) -> None:
    assert first_few(items) == words


@pytest.mark.parametrize(
    ("word", "known", "words"),
    [
        ("mpjp", ["pck", "mpjpe"], "Did you mean mpjpe?"),
        ("xyz", ["pck", "mpjpe"], "Known: pck, mpjpe."),
        ("xyz", [], "Known: none."),
        ("minMPJPE", ["mpjpe", "min_mpjpe", "median_mpjpe"], "Did you mean min_mpjpe?"),
        ("PCK@150-mm", ["pck", "pck_150_mm"], "Did you mean pck_150_mm?"),
        ("xyz", [*"mlkjihgfedcba"], "Known: a, b, c, d, e, f, g, h, i, j, k, l, …, and 1 more."),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest_or_all(word: str, known: list[str], words: str) -> None:
    assert did_you_mean(word, iter(known)) == words


def test_characters_that_steer_a_terminal_are_written_out() -> None:
    error = PoseDataError("joints: R\x1b[31mWrist\n  - and \u202efoot")
    assert str(error) == "joints: R\\x1b[31mWrist\n  - and \\u202efoot"


def test_a_message_is_at_most_some_lines_long() -> None:
    with pytest.raises(PoseDataError) as refused:
        raise_all(f"problem {number}" for number in range(500))
    lines = str(refused.value).splitlines()
    assert len(lines) == 14
    assert lines[0] == "500 problems:"
    assert lines[-1] == "  - 488 more."
    assert len(str(PoseDataError("x" * 10_000))) < 300


@pytest.mark.parametrize(
    ("raised", "words"),
    [
        (MemoryError(), "f.npz: can't be read (it needs more memory than there is)"),
        (RecursionError("deep"), "f.npz: can't be read (it is nested too deeply)"),
        (NotImplementedError("method 97"), "f.npz: can't be read (method 97)"),
        (EOFError(), "f.npz: can't be read (it is cut off or damaged)"),
        (PermissionError(13, "Permission denied"), "f.npz: can't be read (Permission denied)."),
        (FileNotFoundError(2, "No such file"), "f.npz: no such file."),
    ],
    ids=lambda value: type(value).__name__,
)
def test_whatever_a_file_makes_a_library_raise_is_a_refusal(raised: Exception, words: str) -> None:
    with pytest.raises(PoseFileError) as refused, refuse_unreadable("f.npz"):
        raise raised
    assert str(refused.value).startswith(words)

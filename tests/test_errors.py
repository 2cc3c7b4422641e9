"""Messages: one sentence, or all of them at once, and the nearest word that is known."""

import pytest

from posecal.errors import PosecalError, PoseDataError, PoseFileError, did_you_mean, first_few, raise_all


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
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest_or_all(word: str, known: list[str], words: str) -> None:
    assert did_you_mean(word, iter(known)) == words

"""Any declared order of axes, read in any pieces, is the paper's (N, M, K, D) and (M, K, D)."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from posecal.data.layout import HYPOTHESES, TRUTH, Layout, MemoryArray, plausible_layouts
from posecal.data.read import read_poses
from posecal.errors import PoseDataError


@st.composite
def stored_arrays(draw: st.DrawFn, core: str) -> tuple[str, np.ndarray, np.ndarray]:
    """A layout, an array stored in it, and what it must be read as, by reshaping and transposing alone."""
    sizes = {letter: draw(st.integers(1, 4), label=letter) for letter in "NMTKI"} | {"D": 3}
    letters = [*core, *(["T"] if draw(st.booleans(), label="clips") else [])]
    letters += ["I"] if draw(st.booleans(), label="iterations") else []
    group = draw(st.sampled_from(["", "KD", "DK"]), label="group")
    if group:
        letters = [letter for letter in letters if letter not in group] + [group]
    letters = draw(st.permutations(letters))
    alone = "".join(letters)
    full = np.arange(np.prod([sizes[letter] for letter in alone]), dtype=np.float64)
    full = full.reshape([sizes[letter] for letter in alone])
    stored = full.reshape([int(np.prod([sizes[letter] for letter in group])) for group in letters])
    text = "".join(f"({letter})" if len(letter) > 1 else letter for letter in letters)
    if "I" in alone:
        full = full.take(-1, axis=alone.index("I"))
        alone = alone.replace("I", "")
    if "T" in alone:
        wanted = core.replace("M", "MT")
        full = full.transpose([alone.index(letter) for letter in wanted])
        shape = [sizes["M"] * sizes["T"] if letter == "M" else sizes[letter] for letter in core]
        return text, stored, full.reshape(shape)
    return text, stored, full.transpose([alone.index(letter) for letter in core])


@pytest.mark.slow
@pytest.mark.parametrize("core", [HYPOTHESES, TRUTH])
@given(data=st.data())
@settings(max_examples=60)
def test_every_layout_read_in_any_pieces_is_the_transposed_array(core: str, data: st.DataObject) -> None:
    text, stored, expected = data.draw(stored_arrays(core))
    layout, axis = Layout(text, core), core.index("M")
    assert layout.shape(stored.shape) == expected.shape
    poses = expected.shape[axis]
    cuts = sorted({0, poses, *data.draw(st.lists(st.integers(0, poses), max_size=3))})
    pieces = [layout.read(MemoryArray(stored), np.arange(a, b)) for a, b in pairwise(cuts)]
    np.testing.assert_array_equal(np.concatenate(pieces, axis=axis), expected)


@given(data=st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_poses_of_a_file_are_those_poses(tmp_path: Path, data: st.DataObject) -> None:
    text, stored, expected = data.draw(stored_arrays(HYPOTHESES))
    np.save(tmp_path / "h.npy", np.asarray(stored, order=data.draw(st.sampled_from("CF"))))
    poses = np.array(data.draw(st.lists(st.integers(0, expected.shape[1] - 1), min_size=1, max_size=6)))
    found = Layout(text, HYPOTHESES).read(read_poses(tmp_path / "h.npy", "hypotheses").array, poses)
    np.testing.assert_array_equal(found, expected[:, poses])


def test_consecutive_poses_in_memory_are_a_view() -> None:
    array = np.zeros((5, 7, 4, 3))
    found = Layout("NMKD", HYPOTHESES).read(MemoryArray(array), np.arange(2, 6))
    assert np.shares_memory(found, array)


def test_sizes_are_read_off_the_letters() -> None:
    assert Layout("MNDK", HYPOTHESES).sizes((7, 5, 3, 17)) == {"M": 7, "N": 5, "D": 3, "K": 17}
    assert Layout("NM(KD)", HYPOTHESES).sizes((5, 7, 51)) == {"N": 5, "M": 7, "K": 17, "D": 3}


def test_clips_and_frames_multiply_to_poses() -> None:
    layout = Layout("MTKD", TRUTH)
    assert layout.shape((2, 27, 17, 3)) == (54, 17, 3)
    assert layout.clip_length((2, 27, 17, 3)) == 27
    assert Layout("MKD", TRUTH).clip_length((2, 17, 3)) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("NMD", r"axes: 'NMD' lacks K; expected each letter of NMKD once, such as MNKD or MN\(DK\)\."),
        ("", r"axes: '' lacks N, M, K, D; expected"),
        ("nmkd", r"axes: 'nmkd' lacks N, M, K, D; expected"),
        ("NMKDX", r"axes: 'NMKDX' is no layout; expected"),
        ("NMKDD", r"axes: 'NMKDD' is no layout; expected"),
        ("NM(KD", r"axes: 'NM\(KD' is no layout; expected"),
        ("NM((KD))", r"axes: 'NM\(\(KD\)\)' is no layout; expected"),
        ("(NM)KD", r"axes: '\(NM\)KD' is no layout; expected"),
        ("NM(KDT)", r"axes: 'NM\(KDT\)' is no layout; expected"),
        ("N M K D", r"axes: 'N M K D' is no layout; expected"),
    ],
)
def test_an_impossible_layout_is_refused_with_the_form_of_one(text: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{words}"):
        Layout(text, HYPOTHESES)


def test_the_truth_has_no_hypotheses_axis() -> None:
    with pytest.raises(PoseDataError, match=r"^axes: 'NMKD' is no layout; expected each letter of MKD once, such as M"):
        Layout("NMKD", TRUTH)


def test_an_array_of_other_axes_than_declared_is_refused_with_both() -> None:
    with pytest.raises(PoseDataError, match=r"^axes: NM\(KD\) names 3 axes; the array has 4: \(5, 7, 17, 3\)\.$"):
        Layout("NM(KD)", HYPOTHESES).sizes((5, 7, 17, 3))


def test_a_joined_axis_must_be_a_multiple_of_the_coordinates() -> None:
    with pytest.raises(PoseDataError, match=r"^axes: \(KD\) has length 50; expected a multiple of 3 coordinates\.$"):
        Layout("NM(KD)", HYPOTHESES).sizes((5, 7, 50))


@pytest.mark.parametrize(
    ("shape", "layouts"),
    [
        ((5, 7, 17, 3), ["NMKD"]),
        ((7, 5, 17, 3), ["MNKD"]),
        ((7, 17, 5, 3), ["MKND"]),
        ((5, 7, 3, 17), ["NMDK"]),
        ((7, 7, 17, 3), ["NMKD", "MNKD"]),
        ((7, 17, 17, 3), ["MNKD", "MKND"]),
        ((5, 6, 17, 3), []),
        ((7, 17, 3), []),
    ],
)
def test_the_layouts_that_fit_are_named_and_none_is_guessed(shape: tuple[int, ...], layouts: list[str]) -> None:
    assert plausible_layouts(shape, (7, 17, 3)) == layouts

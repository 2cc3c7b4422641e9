"""The same errors and remarks, with parameters for Python and with flags on the command line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PosecalError, for_command_line
from tests.helpers.reports import world
from tests.helpers.shell import done, hypotheses, hyps_members, refused


def bare() -> None:
    np.save("h.npy", hypotheses())
    np.save("g.npy", world().truth)


def metres() -> None:
    np.save("h.npy", hypotheses() / 1000)
    np.save("g.npy", world().truth / 1000)


def turned() -> None:
    np.save("h.npy", hypotheses().swapaxes(0, 1))
    np.save("g.npy", world().truth)


def square() -> None:
    np.save("h.npy", np.repeat(hypotheses(), 6, axis=0))
    np.save("g.npy", world().truth)


def other_joints() -> None:
    members = hyps_members()
    names = [*members["joints"][:-1], "Tail"]
    np.savez("h.npz", **{**members, "joints": names})


def few() -> None:
    members = hyps_members()
    some = {"hypotheses": members["hypotheses"][:, 3:], "frame_id": members["frame_id"][3:]}
    np.savez("h.npz", **{**members, **some})


ERRORS: list[tuple[Any, str, dict[str, Any], str, str]] = [
    (metres, "h.npy g.npy", {}, 'Pass unit="m"', "Pass --unit m"),
    (turned, "h.npy g.npy", {}, 'The shapes fit axes="MNKD".', "The shapes fit --axes MNKD."),
    (square, "h.npy g.npy", {}, 'Pass axes="NMKD" or axes="MNKD".', "Pass --axes NMKD or --axes MNKD."),
    (bare, "h.npy g.npy", {"root_joint": "Tail"}, "root_joint: 'Tail' is not", "--root-joint: 'Tail' is not"),
    (bare, "h.npy g.npy", {"n_hypotheses": 9}, "n_hypotheses: 9; expected 1 to", "--hypotheses: 9; expected 1 to"),
    (other_joints, "h.npz gt.npz", {}, 'Pass shared_joints="common" to score', "Pass --joints common to score"),
    (few, "h.npz gt.npz", {}, 'Pass missing="skip" to score', "Pass --missing skip to score"),
    (bare, "hyps.npz gt.npz", {"axes": "MNKD"}, 'expected no axes="MNKD".', "expected no --axes MNKD."),
    (bare, "hyps.npz gt.npz", {"unit": "cm"}, 'expected no unit="cm".', "expected no --unit cm."),
]

FLAGS = {"root_joint": "--root-joint", "n_hypotheses": "--hypotheses"}


@pytest.mark.parametrize(("make", "names", "options", "in_python", "in_flags"), ERRORS)
def test_an_error_names_parameters_in_python_and_flags_on_the_command_line(
    make: Any, names: str, options: dict[str, Any], in_python: str, in_flags: str
) -> None:
    make()
    with pytest.raises(PosecalError) as refusal:
        posecal.evaluate(*names.split(), **options)
    assert in_python in str(refusal.value)
    words = [f"{FLAGS.get(name, f'--{name}')}={value}" for name, value in options.items()]
    said = refused("evaluate", *names.split(), *words)
    assert in_flags in said
    assert said == " ".join(f"posecal: {for_command_line(refusal.value.message)}".split())


@pytest.mark.parametrize("form", ["text", "markdown", "json", "csv", "latex"])
def test_a_remark_names_parameters_in_python_and_flags_on_the_command_line(form: Any) -> None:
    np.save("h.npy", np.add(hypotheses(), (100, 50, 20)))
    np.save("g.npy", np.add(world().truth, (100, 50, 20)))
    report = posecal.evaluate("h.npy", "g.npy", axes="NMKD", unit="mm", metrics="mpjpe")
    written = report.render(form)
    assert "root_joint names one." in report.remarks[0]
    assert "root_joint names one." in written.replace("\\_", "_")
    text = done("evaluate", "h.npy", "g.npy", "--axes=NMKD", "--unit=mm", "--metrics=mpjpe", "--format", form)
    assert "--root-joint names one." in text
    assert text == written.replace("; root_joint names", "; --root-joint names") + "\n"


def test_a_result_without_numbers_by_occlusion_says_how_to_get_them() -> None:
    with pytest.raises(PosecalError, match=r'Evaluate with by="occlusion"\.'):
        posecal.Report(posecal.load_totals("result.npz"), "occlusion")
    assert "Evaluate with --by occlusion." in refused("report", "result.npz", "--by=occlusion")

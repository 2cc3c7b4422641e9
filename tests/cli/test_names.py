"""Names from files and of files, with characters that steer a terminal or are no text: shown escaped everywhere."""

import csv
import io
import json
import os
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.storage import load_totals
from posecal.plot import KINDS, draw, draw_poses, figure_bytes
from tests.helpers.shell import done, gt_members, hyps_members, refused, run, spawned

ODD = '\x1b[31m\r\n\x07\x85\x9b2J\u202e\u2066\ud8ff\ufffe<&"|'
"""Escapes of C0 and C1, a line break, reversed text, half a surrogate pair, no character; and markup."""

SHOWN = r"\x1b[31m\r\n\x07\x85\x9b2J\u202e\u2066\ud8ff\ufffe"
"""As it is shown, up to the markup."""

JOINTS = [*posecal.JOINT_SETS["h36m-17"][:-1], f"RWrist{ODD}"]


@pytest.fixture(autouse=True)
def _odd_names() -> None:
    actions = {"walking": f"walking{ODD}"}
    truth = gt_members()
    truth["action"] = np.array([actions.get(action, action) for action in truth["action"].tolist()])
    truth["horizon"] = np.arange(len(truth["action"])) % 2
    np.savez("odd_h.npz", **{**hyps_members(), "joints": np.array(JOINTS)})
    np.savez("odd_g.npz", **{**truth, "joints": np.array(JOINTS)})


WORDS = [
    "evaluate",
    "odd_h.npz",
    "odd_g.npz",
    "--by=action",
    "--metrics=mpjpe, ece, signed_area",
    "--per-joint",
    "--definitions",
]


def assert_shown(text: str, markup: str = SHOWN) -> None:
    """It holds the names as they are shown, and nothing that a terminal would follow."""
    assert markup in text
    assert text.replace("\n", "").replace("\u00a0", " ").isprintable()


def test_terminals_and_files_of_text_show_names_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    assert_shown(done(*WORDS, "--format=markdown"), SHOWN.replace("\\", "\\\\"))
    assert_shown(done(*WORDS, "--format=latex"), r"\textbackslash x1b[31m\textbackslash r\textbackslash n")
    monkeypatch.setenv("COLUMNS", "300")
    assert_shown(done(*WORDS, "--format=text"))


def test_csv_shows_names_escaped_and_json_holds_them_as_they_are() -> None:
    """CSV has no escapes of its own, and many of its readers stop at some of these characters."""
    text = done(*WORDS, "--format=csv")
    assert_shown(text)
    rows = list(csv.DictReader(io.StringIO(text)))
    assert {f"RWrist{SHOWN}{ODD[-4:]}"} == {row["joint"] for row in rows if row["joint"].startswith("RWrist")}
    text = done(*WORDS, "--format=json")
    assert text.replace("\n", "").replace("\u00a0", " ").isprintable()
    found = json.loads(text)
    assert found["joints"] == JOINTS
    assert f"action=walking{ODD}" in {row["group"] for row in found["rows"]}


def posecal_report() -> posecal.Report:
    done(*WORDS, "--by=horizon", "--metrics=all", "--save=odd.npz")
    return posecal.Report(load_totals("odd.npz"), "action")


@pytest.mark.slow
def test_a_page_holds_names_escaped_and_pictures_that_are_xml() -> None:
    done(*WORDS, "--by=horizon", "--metrics=all", "--html=page.html")
    page = Path("page.html").read_text(encoding="utf-8")
    assert_shown(page)
    pictures = [part.split("</svg>")[0] for part in page.split("<svg")[1:]]
    assert len(pictures) > len(KINDS)  # diagrams, and small ones within tables
    for picture in pictures:
        ET.fromstring(f"<svg{picture}</svg>")


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(KINDS))
def test_every_picture_is_well_formed(kind: str) -> None:
    whole = kind in {"rank_tests", "horizon"}
    figure = draw(posecal_report(), kind, **({} if whole else {"title": f"hyps{ODD}"}))
    text = figure_bytes(figure, ".svg").decode()
    ET.fromstring(text)
    assert text.replace("\n", "").isprintable()
    if not whole:
        assert f"hyps{SHOWN}" in text
    assert figure_bytes(figure, ".pdf").startswith(b"%PDF")
    assert figure_bytes(figure, ".png").startswith(b"\x89PNG")


def test_pictures_of_poses_and_of_comparisons_are_well_formed() -> None:
    data = posecal.PoseData("odd_h.npz", "odd_g.npz")
    text = figure_bytes(draw_poses(data, [0, 1], cloud=JOINTS[-1]), ".svg").decode()
    ET.fromstring(text)
    assert SHOWN in text
    models = {f"{name}{ODD}": "result.npz" for name in "ab"}
    comparison = posecal.compare(models)
    text = figure_bytes(posecal.plot.draw_comparison(comparison), ".svg").decode()
    ET.fromstring(text)
    assert f"a{SHOWN}" in text
    for shown in (str(comparison), repr(comparison), comparison._repr_html_()):
        assert_shown(shown)
    for form in ("csv", "markdown", "json"):
        assert comparison.render(form).replace("\n", "").isprintable()
    assert json.loads(comparison.render("json"))["models"] == list(models)


NAME = os.fsdecode(b"caf\xe9\x1b[31m")
"""A file whose name is no UTF-8, and steers a terminal."""

NAME_SHOWN = r"caf\udce9\x1b[31m"


@pytest.mark.parametrize("form", ["text", "markdown", "latex", "csv", "json"])
def test_hypotheses_whose_file_has_an_odd_name_are_evaluated(form: str) -> None:
    os.rename("hyps.npz", f"{NAME}.npz")
    outputs = [f"--save={NAME}s.npz", f"--plot={NAME}.svg", f"--html={NAME}.html"]
    text = done("evaluate", f"{NAME}.npz", "gt.npz", "--metrics=min_mpjpe, ece", f"--format={form}", *outputs)
    assert text.replace("\n", "").replace("\u00a0", " ").isprintable()
    assert f"<h1>{NAME_SHOWN}.npz</h1>" in Path(f"{NAME}.html").read_text(encoding="utf-8")
    picture = Path(f"{NAME}.svg").read_text(encoding="utf-8")
    ET.fromstring(picture)
    assert f"{NAME_SHOWN}.npz" in picture
    done("compare", f"{NAME}s.npz", "result.npz", f"--format={form}", f"--plot={NAME}2.svg")
    ET.fromstring(Path(f"{NAME}2.svg").read_text(encoding="utf-8"))
    said = run("merge", f"{NAME}s.npz", "-o", f"{NAME}m.npz")
    assert (said.exit_code, said.stderr) == (0, f"{NAME_SHOWN}m.npz: 36 poses of 1 result.\n")


def test_a_process_shows_such_names_too() -> None:
    Path(f"{NAME}.npz").write_bytes(b"no archive")
    done_ = spawned("report", f"{NAME}.npz", stdout=-1, stderr=-1)
    out, err = done_.communicate()
    assert (done_.returncode, out) == (3, b"")
    assert NAME_SHOWN.encode() in err
    assert b"\x1b" not in err


def test_a_name_that_is_read_already_is_shown_escaped() -> None:
    os.rename("hyps.npz", f"{NAME}.npz")
    said: Any = refused("evaluate", f"{NAME}.npz", "gt.npz", f"--save={NAME}.npz", code=2)
    assert f"{NAME_SHOWN}.npz is read already" in said

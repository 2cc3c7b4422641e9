"""The page is one file that needs no other, and nothing from the data can act in it."""

import base64
import hashlib
import json
import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.demo import sample
from posecal.errors import PoseFileError, for_command_line
from posecal.report.html import as_html, write_html
from posecal.report.text import report_sheet
from tests.helpers.reports import report_of, unlabelled, world

VOID = {"meta", "br", "link", "img", "input", "hr"}


class Page(HTMLParser):
    """What a page holds: tags that close in order, the text of its cells, scripts, and whatever points elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.cells: list[list[str]] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag == "tr":
            self.cells.append([])
        if tag in {"td", "th"}:
            self.cells[-1].append("")
        if tag == "script":
            self.scripts.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "script" in self.open:
            self.scripts[-1] += data
            return
        self.text += data
        if {"td", "th"} & set(self.open):
            self.cells[-1][-1] += data

    @property
    def labels(self) -> list[str]:
        """What is said of its pictures."""
        return [value for name, value in self.attributes if name == "aria-label"]

    @property
    def poses(self) -> dict[str, Any]:
        """The data of its poses."""
        found: dict[str, Any] = json.loads(self.scripts[0])
        return found


def outward(page: Page) -> list[str]:
    """Everything that a browser would fetch or run."""
    attributes = [value for name, value in page.attributes if name in {"src", "href", "xlink:href", "action", "data"}]
    return [value for value in attributes if not value.startswith("#")]


@cache
def written() -> str:
    """A page with all pictures."""
    return as_html(report_of(metrics="all", by=("action", "occlusion")), "hyps.npz", command="posecal evaluate a b")


@pytest.mark.slow
def test_the_page_is_well_formed_and_closes_what_it_opens() -> None:
    text = written()
    assert text.startswith("<!DOCTYPE html>")
    page = Page(text)
    assert page.open == []
    assert page.tags.count("html") == page.tags.count("body") == page.tags.count("h1") == 1
    assert ("charset", "utf-8") in page.attributes


@pytest.mark.slow
def test_the_page_needs_no_other_file_and_is_small() -> None:
    text = written()
    page = Page(text)
    assert outward(page) == []
    assert not {"iframe", "link", "img", "object", "embed"} & set(page.tags)
    assert not [name for name, _ in page.attributes if name.startswith("on")]
    assert not re.search(r"@import|url\((?!#)", text)
    assert len(text.encode()) < 600_000


@pytest.mark.slow
def test_a_policy_allows_the_scripts_of_the_page_alone_and_no_request() -> None:
    page = Page(written())
    policy = next(value for name, value in page.attributes if name == "content" and "default-src" in value)
    data, script = page.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy.split("; ") == [
        "default-src 'none'",
        "style-src 'unsafe-inline'",
        f"script-src 'sha256-{digest}'",
        "img-src data:",
    ]
    assert json.loads(data)["joints"][0] == "Hip"


@pytest.mark.slow
def test_the_tables_hold_the_numbers_of_the_report() -> None:
    report, cells = report_of(metrics="all", by=("action", "occlusion")), Page(written()).cells
    first = [row[0] for row in cells]
    for metric in report.headline_metrics.values():
        assert metric.label in first
    for name in (*report.totals.spec.joints, "sitting", "occluded", "sequence 03"):
        assert name in first
    head = next(row for row in cells if row[0] == "Head")
    assert head[1:3] == [f"{report.value(name, joint='Head'):.1f}" for name in ("min_mpjpe", "mpjpe")]


@pytest.mark.slow
def test_the_pictures_are_within_the_page_and_say_what_they_show() -> None:
    page = Page(written())
    assert [label for label in page.labels if label.startswith("calibration curves")] == [
        f"calibration curves against the diagonal, {poses}"
        for poses in ("all poses", "action sitting", "action standing", "action walking")
    ]
    assert {
        "the signed area of every joint, on a skeleton",
        "minMPJPE against the number of hypotheses",
        "PCK and CPS against the threshold",
        "the error left when the most uncertain poses are dropped",
        "the error of the poses that are kept by their predicted spread",
        "reliability of: the median pose is right at every joint",
        "rank tests for what the ECE can't see",
    } <= set(page.labels)
    assert [value for name, value in page.attributes if (name, value) == ("class", "wide")] == ["wide"]


@pytest.mark.slow
def test_each_part_has_a_name_of_its_own_and_each_link_leads_to_one() -> None:
    text = written()
    page = Page(text)
    names = [value for name, value in page.attributes if name == "id"]
    assert len(names) == len(set(names))
    used = {value[1:] for name, value in page.attributes if name.endswith("href")} | set(
        re.findall(r"url\(#([^)]*)\)", text)
    )
    assert {"calibration", "poses", "sequences", "metrics", "group-0", "group-1", "joints", "pictures", "how"} <= used
    assert used <= set(names)


@pytest.mark.slow
def test_the_signature_the_command_and_every_definition_are_there() -> None:
    report, text = report_of(metrics="all", by=("action", "occlusion")), Page(written()).text
    assert report.signature in text
    assert "posecal evaluate a b" in text
    for metric in ("min_mpjpe", "ece", "ece_paper", "diversity"):
        assert report.definition(metric) in text


@pytest.mark.slow
def test_the_curves_name_joint_count_and_area() -> None:
    report, page = report_of(metrics="all", by=("action", "occlusion")), Page(written())
    said = dict(
        zip(*([v for n, v in page.attributes if n == f"data-{key}"][:16] for key in ("joint", "said")), strict=True)
    )
    assert said.keys() == {*report.totals.spec.joints} - {"Hip"}
    area = report.value("signed_area", joint="Head")
    assert said["Head"] == f"36 poses, signed area {area:+.3f}".replace("-", "−")


@pytest.mark.slow
def test_the_poses_are_those_of_the_gallery_upright() -> None:
    report, poses = report_of(metrics="all", by=("action", "occlusion")), Page(written()).poses
    gallery = report.totals.gallery
    assert gallery is not None
    points = np.frombuffer(base64.b64decode(poses["poses"]), "<i2").reshape(poses["shape"])
    np.testing.assert_array_equal(np.linalg.norm(points, axis=-1), np.linalg.norm(gallery.poses, axis=-1))
    head = poses["joints"].index("Head")
    assert (points[:, 0, head, 2] > 0).mean() > 0.5  # the third axis points upwards
    assert [frame["sequence"] for frame in poses["frames"]] == gallery.sequence.tolist()
    assert poses["orders"]["error"] == gallery.orders[1].tolist()
    assert poses["sides"][poses["joints"].index("RFoot")] == "right"


@pytest.mark.slow
def test_a_page_that_must_hold_no_poses_holds_none() -> None:
    page = as_html(report_of(), "x", gallery=False)
    assert "pose-data" not in page
    assert "The poses are left out of this page." in Page(page).text
    assert "pose-canvas" not in "".join(Page(page).scripts)


@pytest.mark.slow
def test_whatever_a_file_says_is_text_and_nothing_more() -> None:
    here = world()
    odd = '<script>alert("1")</script>&amp;\'"<!--'
    report = posecal.evaluate(
        sample(here, 4),
        here.truth,
        joints=[f"<i>joint</i>{odd}", *(f"j{number}" for number in range(16))],
        root_joint="none",
        labels={"sequence": np.char.add(here.sequence, odd), "action": np.char.add(here.action, odd)},
        frame_id=[f"{number}{odd}" for number in range(36)],
        by=["action"],
        axes="NMKD",
        unit="mm",
    )
    text = as_html(report, f"<img src=x onerror=alert(1)>{odd}", command=f"posecal {odd}")
    page = Page(text)
    assert outward(page) == []
    assert page.tags.count("script") == 2
    assert not {"img", "i"} & set(page.tags)
    assert "<" not in page.scripts[0]
    assert page.poses["joints"][0] == f"<i>joint</i>{odd}"
    assert page.poses["frames"][0]["frame"].endswith(odd)
    assert any(f"sitting{odd}" in row for row in page.cells)
    assert any(f"<i>joint</i>{odd}" in row for row in page.cells)
    assert f"<img src=x onerror=alert(1)>{odd}" in page.text
    fragment = Page(report._repr_html_())
    assert not {"script", "i"} & set(fragment.tags)
    assert any(f"sitting{odd}" in row for row in fragment.cells)


@pytest.mark.slow
def test_a_name_that_is_no_utf8_can_be_written(tmp_path: Path) -> None:
    write_html(report_of(), tmp_path / "page.html", "h\udcff.npz")
    assert "h\\udcff.npz" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_remarks_stand_on_the_page_and_name_flags_where_they_are_asked_to() -> None:
    report = unlabelled()
    assert report.remarks
    assert all(f"note: {remark}" in Page(as_html(report, "x")).text for remark in report.remarks)
    assert "--root-joint" in Page(as_html(report, "x", for_command_line)).text


@pytest.mark.slow
def test_a_report_that_lacks_pictures_is_a_page_all_the_same() -> None:
    page = Page(as_html(unlabelled(n=1), "hyps.npz"))
    assert {"minMPJPE against the number of hypotheses", "PCK and CPS against the threshold"} <= set(page.labels)
    assert not [label for label in page.labels if "calibration" in label]
    assert page.poses["orders"]["calibration"] == []
    assert "minMPJPE" in {cell for row in page.cells for cell in row}
    assert "calibration and spread need at least 2 hypotheses; there is 1." in page.text


@pytest.mark.slow
def test_the_page_is_written_whole_and_is_the_same_each_time(tmp_path: Path) -> None:
    write_html(report_of(), tmp_path / "page.html", "hyps.npz")
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == as_html(report_of(), "hyps.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.slow
def test_a_page_that_can_not_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"the folder .*nowhere does not exist\. Make it first\."):
        write_html(report_of(), tmp_path / "nowhere" / "page.html", "hyps.npz")


def test_a_sheet_of_a_notebook_has_what_a_terminal_has() -> None:
    report = report_of(by=("action",))
    page = Page(report._repr_html_())
    assert page.open == []
    assert not {"html", "head", "body", "h1", "style", "script"} & set(page.tags)
    assert [value[:22] for name, value in page.attributes if name == "src"] == ["data:image/png;base64,"]
    for line in (*report.summary, *(f"note: {remark}" for remark in report.remarks), report.signature):
        assert line in page.text
    for table in report_sheet(report).tables:
        assert list(table.headings) in page.cells
        assert all(list(row) in page.cells for row in table.rows)

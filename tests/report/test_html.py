"""The page is one file that needs no other, and nothing from the data can act in it."""

import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

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
    """What a page holds: tags that close in order, the text of its cells, and whatever points elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.cells: list[list[str]] = []
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
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if {"td", "th"} & set(self.open):
            self.cells[-1][-1] += data


def outward(page: Page) -> list[str]:
    """Everything that a browser would fetch or run."""
    attributes = [value for name, value in page.attributes if name in {"src", "href", "xlink:href", "action", "data"}]
    return [value for value in attributes if not value.startswith("#")]


@cache
def written() -> str:
    """A page with all pictures."""
    return as_html(report_of(metrics="all", by=("action",)), "hyps.npz")


@pytest.mark.slow
def test_the_page_is_well_formed_and_closes_what_it_opens() -> None:
    text = written()
    assert text.startswith("<!DOCTYPE html>")
    page = Page(text)
    assert page.open == []
    assert page.tags.count("html") == page.tags.count("body") == page.tags.count("h1") == 1
    assert ("charset", "utf-8") in page.attributes


@pytest.mark.slow
def test_the_page_needs_no_other_file_and_runs_nothing() -> None:
    text = written()
    page = Page(text)
    assert outward(page) == []
    assert not {"script", "iframe", "link", "img", "object", "embed"} & set(page.tags)
    assert not [name for name, _ in page.attributes if name.startswith("on")]
    assert not re.search(r"@import|url\((?!#)", text)


def test_the_tables_hold_the_cells_of_the_report() -> None:
    report, cells = report_of(metrics="all", by=("action",)), Page(written()).cells
    for table in report_sheet(report, all=True, joints=True).tables:
        assert list(table.headings) in cells
        for row in table.rows:
            assert list(row) in cells


def test_the_pictures_are_within_the_page_and_say_what_they_show() -> None:
    page = Page(written())
    said = [value for name, value in page.attributes if name == "aria-label"]
    assert said == [
        "calibration curves against the diagonal",
        "the signed area of every joint, on a skeleton",
        "minMPJPE against the number of hypotheses",
        "PCK and CPS against the threshold",
        "the error left when the most uncertain poses are dropped",
        "the error of the poses that are kept by their predicted spread",
        "reliability of: the median pose is right at every joint",
        "rank tests for what the ECE can't see",
    ]
    assert page.tags.count("svg") == len(said)
    assert [value for name, value in page.attributes if (name, value) == ("class", "wide")] == ["wide"]


def test_each_part_of_a_picture_has_a_name_of_its_own() -> None:
    text = written()
    page = Page(text)
    names = [value for name, value in page.attributes if name == "id"]
    assert len(names) == len(set(names))
    used = {value[1:] for name, value in page.attributes if name.endswith("href")} | set(
        re.findall(r"url\(#([^)]*)\)", text)
    )
    assert len(used) > len({"clip path", "mark"})
    assert used == set(names)


def test_the_signature_and_every_definition_are_there() -> None:
    report, text = report_of(metrics="all", by=("action",)), Page(written()).text
    assert report.signature in text
    for metric in ("min_mpjpe", "ece", "ece_paper", "diversity"):
        assert report.definition(metric) in text


def test_whatever_a_file_says_is_text_and_nothing_more() -> None:
    here = world()
    odd = '<script>alert("1")</script>&amp;\'"'
    report = posecal.evaluate(
        sample(here, 4),
        here.truth,
        joints=["<i>joint</i>", *(f"j{number}" for number in range(16))],
        root_joint="none",
        labels={"sequence": here.sequence, "action": np.char.add(here.action, odd)},
        by=["action"],
        axes="NMKD",
        unit="mm",
    )
    text = as_html(report, f"<img src=x onerror=alert(1)>{odd}")
    page = Page(text)
    assert outward(page) == []
    assert not {"script", "img", "i"} & set(page.tags)
    assert any(f"sitting{odd}" in row for row in page.cells)
    assert any("<i>joint</i>" in row for row in page.cells)
    assert f"<img src=x onerror=alert(1)>{odd}" in page.text
    fragment = Page(report._repr_html_())
    assert outward(fragment) == []
    assert not {"script", "img", "i"} & set(fragment.tags)
    assert any(f"sitting{odd}" in row for row in fragment.cells)


def test_a_name_that_is_no_utf8_can_be_written(tmp_path: Path) -> None:
    write_html(report_of(), tmp_path / "page.html", "h\udcff.npz")
    assert "h\\udcff.npz" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_notebooks_show_sentences_remarks_and_tables() -> None:
    report = report_of(by=("action",))
    page = Page(report._repr_html_())
    assert page.open == []
    assert not {"html", "head", "body", "h1", "svg", "style"} & set(page.tags)
    for line in (*report.summary, *(f"note: {remark}" for remark in report.remarks), report.signature):
        assert line in page.text
    for table in report_sheet(report).tables:
        assert list(table.headings) in page.cells
        assert all(list(row) in page.cells for row in table.rows)


@pytest.mark.slow
def test_remarks_stand_on_the_page_and_name_flags_where_they_are_asked_to() -> None:
    report = unlabelled()
    assert report.remarks
    assert all(f"note: {remark}" in Page(as_html(report, "x")).text for remark in report.remarks)
    assert "--root-joint" in Page(as_html(report, "x", for_command_line)).text


def test_a_report_that_lacks_pictures_is_a_page_all_the_same() -> None:
    page = Page(as_html(unlabelled(n=1), "hyps.npz"))
    said = [value for name, value in page.attributes if name == "aria-label"]
    assert said == ["minMPJPE against the number of hypotheses", "PCK and CPS against the threshold"]
    assert "minMPJPE" in {cell for row in page.cells for cell in row}
    assert "calibration and spread need at least 2 hypotheses; there is 1." in page.text


@pytest.mark.slow
def test_the_page_is_written_whole_and_is_the_same_each_time(tmp_path: Path) -> None:
    write_html(report_of(metrics="all", by=("action",)), tmp_path / "page.html", "hyps.npz")
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == written()
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.slow
def test_a_page_that_can_not_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"the folder .*nowhere does not exist\. Make it first\."):
        write_html(report_of(), tmp_path / "nowhere" / "page.html", "hyps.npz")

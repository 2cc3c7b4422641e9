"""Sheets: readable at any width, as text, Markdown and LaTeX; nothing is lost, and no text is taken for markup."""

import re

import pandas as pd
import pytest
from rich.cells import cell_len

from posecal.report.sheet import Sheet, Table

NUMBERS = Table(
    "Numbers",
    ("a long name", "first number", "second", "what it is"),
    [
        ("alpha beta gamma delta", "1234567.125", "-3.0", "some words that may be folded over several lines"),
        ("omega", "0.5", "12.5 mm", "more"),
    ],
    ["what it is"],
)


def test_a_wide_enough_sheet_has_a_line_per_row() -> None:
    sheet = Sheet("title", ["a sentence."], ["a remark."], [NUMBERS], [("term", "meaning")], "the end")
    lines = sheet.text(200).splitlines()
    assert lines[:3] == ["title", "a sentence.", "note: a remark."]
    assert lines[4].split() == ["a", "long", "name", "first", "number", "second", "what", "it", "is"]
    assert lines[6].startswith("alpha beta gamma delta   1234567.125")
    assert lines[7].split() == ["omega", "0.5", "12.5", "mm", "more"]
    assert lines[-3:] == ["term: meaning", "", "the end"]


def test_numbers_are_aligned_at_their_right() -> None:
    lines = Sheet("", tables=[NUMBERS]).text(200).splitlines()
    first, second = lines[-2:]
    assert first.index("1234567.125") + len("1234567.125") == second.index("0.5") + len("0.5")


@pytest.mark.parametrize("width", [30, 40, 60, 80, 100, 120])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    words = ["words " * 30]
    lines = Sheet("title " * 30, words, words, [NUMBERS], [("term", "meaning " * 30)]).text(width).splitlines()
    assert max(map(cell_len, lines)) <= width


@pytest.mark.parametrize("width", [30, 40, 60, 80])
def test_no_number_is_broken_over_lines(width: int) -> None:
    lines = Sheet("", tables=[NUMBERS]).text(width).splitlines()
    for cell in ("1234567.125", "-3.0", "0.5", "12.5 mm"):
        assert any(re.search(rf"(^|\s){re.escape(cell)}(\s|$)", line) for line in lines), cell


@pytest.mark.parametrize("width", range(20, 60))
def test_a_number_stays_with_its_sign_of_per_cent_and_a_p_value_whole(width: int) -> None:
    words = "ECE 0.047 (p = 0.130), of others p < 0.001. The 90 % balls hold 85 % of the truths, and more words."
    text = Sheet("", [words], more=words).text(width)
    assert [text.count(found) for found in ("p = 0.130", "p < 0.001", "90 %", "85 %")] == [2, 2, 2, 2]
    assert " ".join(text.split()) == f"{words} {words}"


@pytest.mark.parametrize("width", [30, 60, 200])
def test_nothing_is_lost_at_any_width(width: int) -> None:
    words = {word for row in NUMBERS.rows for cell in row for word in cell.split()}
    assert words <= set(Sheet("", tables=[NUMBERS]).text(width).split())


def test_a_table_that_is_too_wide_is_cut_into_some_with_the_same_first_column() -> None:
    columns = ("name", *(f"column{number}" for number in range(8)))
    table = Table("Wide", columns, [("first row", *(f"{number}.125" for number in range(8)))])
    text = Sheet("", tables=[table]).text(40)
    headings = [line.split() for line in text.splitlines() if "column" in line]
    assert len(headings) > 1
    assert all(heading[0] == "name" for heading in headings)
    assert [word for heading in headings for word in heading[1:]] == [f"column{number}" for number in range(8)]


def test_text_is_never_taken_for_markup() -> None:
    odd = "[bold]x[/bold] [link=http://a] :smile: a\\[b"
    sheet = Sheet(odd, [odd], [odd], [Table("t", (odd,), [(odd,)])], [(odd, odd)], odd)
    text = sheet.text(200)
    assert text.count(odd) == 8  # title, sentence, remark, heading, cell, term, meaning, footer


@pytest.mark.parametrize("colour", [False, True])
def test_colours_are_for_terminals_only(colour: bool) -> None:
    assert ("\x1b[" in Sheet("title", tables=[NUMBERS]).text(100, colour=colour)) is colour


def test_a_footer_stays_one_line() -> None:
    footer = "signature: " + " ".join(f"option{number}=value" for number in range(40))
    assert Sheet("", footer=footer).text(60).splitlines()[-1] == footer


def test_lines_have_no_blanks_at_their_ends() -> None:
    assert not re.search(r" +$", Sheet("title", tables=[NUMBERS]).text(80), re.MULTILINE)


def test_markdown_escapes_what_would_end_a_cell_or_begin_a_tag() -> None:
    sheet = Sheet("a|b", tables=[Table("c|d", ("e|f", "g"), [("1|2\n3", "<b>\\")], breaks=True)])
    lines = sheet.markdown().splitlines()
    assert lines[:4] == ["a\\|b", "", "### c\\|d", ""]
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in (lines[4], lines[6])]
    assert rows == [["e\\|f", "g"], ["1\\|2 3", "&lt;b>\\\\"]]
    assert re.fullmatch(r"\|:-+\|-+:\|", lines[5])


def test_a_sheet_shows_control_characters_escaped_but_for_breaks_that_are_asked_for() -> None:
    raw, shown = "\x1b[1m\n\u202e", r"\x1b[1m\n\u202e"
    table = Table(f"t{raw}", (f"h{raw}", "i"), [(f"c{raw}", "1")], [f"h{raw}"])
    assert table == Table(f"t{shown}", (f"h{shown}", "i"), [(f"c{shown}", "1")], [f"h{shown}"])
    sheet = Sheet(raw, [raw], [raw], [table], [(raw, raw)], raw)
    assert sheet == Sheet(shown, [shown], [shown], [table], [(shown, shown)], shown)
    assert Table("", ("", ""), [("a\nb\x1b", "")], breaks=True).rows == [("a\nb\\x1b", "")]


def test_markdown_ends_with_definitions_and_the_footer_as_code() -> None:
    lines = Sheet("t", definitions=[("term", "meaning")], footer="a=b").markdown().splitlines()
    assert lines[-4:] == ["", "- **term**: meaning", "", "`a=b`"]


def test_headings_are_on_one_line_where_there_is_room() -> None:
    table = Table("t", ("name", "a long heading"), [("a", "1")])
    assert "a long heading" in Sheet("", tables=[table]).text(40)
    assert "a long heading" not in Sheet("", tables=[table]).text(16)


def test_columns_stand_two_blanks_apart() -> None:
    lines = Sheet("", tables=[Table("t", ("name", "x", "note"), [("a", "1.5", "b")], ["note"])]).text(40).splitlines()
    assert lines[2:] == ["name    x  note", "───────────────", "a     1.5  b"]


LONG = Table("t", ("n", "first second"), [("a", "1")])


@pytest.mark.parametrize(("width", "one_line"), [(15, True), (14, False)])
def test_a_table_that_just_fits_is_not_squeezed(width: int, one_line: bool) -> None:
    lines = Sheet("", tables=[LONG]).text(width).splitlines()
    assert ("n  first second" in lines) is one_line
    assert max(map(len, lines)) <= width


WIDE = Table("t", ("name", "aaaa", "bbbb"), [("x", "1", "2")])


@pytest.mark.parametrize(("width", "parts"), [(16, 1), (15, 2)])
def test_a_table_that_just_fits_is_not_cut(width: int, parts: int) -> None:
    text = Sheet("", tables=[WIDE]).text(width)
    assert text.count("name") == parts
    assert max(map(len, text.splitlines())) <= width
    assert {"1", "2"} <= set(text.split())


def test_a_number_stands_beside_the_first_column_however_narrow() -> None:
    assert Sheet("", tables=[WIDE]).text(5).count("a") >= 4


def test_text_is_a_hundred_and_twenty_columns_wide_by_default() -> None:
    assert [len(line) for line in Sheet(" ".join(["x"] * 120)).text().splitlines()] == [119, 119]


def test_numbers_have_no_colour_of_their_own() -> None:
    text = Sheet("title 1", tables=[NUMBERS]).text(200, colour=True)
    assert set(re.findall(r"\x1b\[([\d;]*)m", text)) == {"0", "1"}


def test_numbers_in_markdown_stay_as_they_are_written() -> None:
    text = Sheet("", tables=[Table("t", ("n", "x"), [("1e3", "0.500"), ("b", "1,234")])]).markdown()
    assert {"1e3", "0.500", "1,234"} <= set(text.split())


def test_an_empty_table_has_its_headings() -> None:
    assert "first number" in Sheet("", tables=[Table("t", NUMBERS.headings, [])]).text(200)


def test_a_table_is_a_data_frame_of_text() -> None:
    frame = NUMBERS.frame()
    assert isinstance(frame, pd.DataFrame)
    assert list(frame.columns) == list(NUMBERS.headings)
    assert [tuple(row) for row in frame.to_numpy()] == NUMBERS.rows


def test_markdown_has_sentences_and_remarks_under_the_title() -> None:
    blocks = Sheet("t", ["said."], ["noted."], [NUMBERS]).markdown().split("\n\n")
    assert blocks[:4] == ["t", "said.", "note: noted.", "### Numbers"]


def test_latex_is_a_tabular_per_table_with_all_else_as_comments() -> None:
    table = Table("Title", ("50 % & more", "x_1", ""), [("−1 √2 ω", "0.5", "↓"), ("a#b", "< 1", "0")], [""])
    lines = Sheet("t\nu", ["said."], ["noted."], [table], [("term", "meaning")], "a=b").latex().splitlines()
    assert lines[:3] == [r"% t\nu", "% said.", "% note: noted."]
    assert lines[4:6] == ["% Title", r"\begin{tabular}{@{}lrl@{}}"]
    assert r"50 \% \& more & x\_1 &  \\" in lines
    assert r"$-$1 $\surd$2 $\omega$ & 0.5 & $\downarrow$ \\" in lines
    assert r"a\#b & $<$ 1 & 0 \\" in lines
    assert [line for line in lines if "rule" in line] == [r"\toprule", r"\midrule", r"\bottomrule"]
    assert lines[-2:] == ["% term: meaning", "% a=b"]
    assert all(line.isascii() for line in lines)

"""A sheet is readable at any width: nothing is lost, no number is broken, and no text is taken for markup."""

import re

import pytest
from rich.cells import cell_len

from posecal.report.sheets import presets_sheet, report_sheet
from posecal.report.tables import Sheet, Table
from tests.helpers.reports import report_of

NUMBERS = Table(
    "Numbers",
    (("a long name", False), ("first number", True), ("second", True), ("what it is", False)),
    [
        ("alpha beta gamma delta", "1234567.125", "-3.0", "some words that may be folded over several lines"),
        ("omega", "0.5", "12.5 mm", "more"),
    ],
)


def squeezed(text: str) -> str:
    """Text without its spaces and lines."""
    return re.sub(r"[\s─━]+", "", text)


def test_a_wide_enough_sheet_has_a_line_per_row() -> None:
    lines = Sheet("title", ["a sentence."], [NUMBERS], [("term", "meaning")], "the end").text(200).splitlines()
    assert lines[0] == "title"
    assert lines[1] == "a sentence."
    assert lines[3].split() == ["a", "long", "name", "first", "number", "second", "what", "it", "is"]
    assert lines[5].startswith("alpha beta gamma delta    1234567.125")
    assert lines[6].split() == ["omega", "0.5", "12.5", "mm", "more"]
    assert lines[-3:] == ["term: meaning", "", "the end"]


def test_numbers_are_aligned_at_their_right() -> None:
    lines = Sheet("", tables=[NUMBERS]).text(200).splitlines()
    first, second = lines[-2:]
    assert first.index("1234567.125") + len("1234567.125") == second.index("0.5") + len("0.5")


@pytest.mark.parametrize("width", [30, 40, 60, 80, 100, 120])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    lines = Sheet("title " * 30, ["words " * 30], [NUMBERS], [("term", "meaning " * 30)]).text(width).splitlines()
    assert max(map(cell_len, lines)) <= width


@pytest.mark.parametrize("width", [30, 40, 60, 80])
def test_no_number_is_broken_over_lines(width: int) -> None:
    lines = Sheet("", tables=[NUMBERS]).text(width).splitlines()
    for cell in ("1234567.125", "-3.0", "0.5", "12.5 mm"):
        assert any(re.search(rf"(^|\s){re.escape(cell)}(\s|$)", line) for line in lines), cell


@pytest.mark.parametrize("width", [30, 60, 200])
def test_nothing_is_lost_at_any_width(width: int) -> None:
    words = {word for row in NUMBERS.rows for cell in row for word in cell.split()}
    assert words <= set(Sheet("", tables=[NUMBERS]).text(width).split())


def test_a_table_that_is_too_wide_is_cut_into_some_with_the_same_first_column() -> None:
    columns = (("name", False), *((f"column{number}", True) for number in range(8)))
    table = Table("Wide", columns, [("first row", *(f"{number}.125" for number in range(8)))])
    text = Sheet("", tables=[table]).text(40)
    headings = [line.split() for line in text.splitlines() if "column" in line]
    assert len(headings) > 1
    assert all(heading[0] == "name" for heading in headings)
    assert [word for heading in headings for word in heading[1:]] == [f"column{number}" for number in range(8)]


def test_text_is_never_taken_for_markup() -> None:
    odd = "[bold]x[/bold] [link=http://a] :smile: a\\[b"
    sheet = Sheet(odd, [odd], [Table("t", ((odd, False),), [(odd,)])], [(odd, odd)], odd)
    text = sheet.text(200)
    assert text.count(odd) == 7  # title, sentence, heading, cell, term, meaning, footer


@pytest.mark.parametrize("colour", [False, True])
def test_colours_are_for_terminals_only(colour: bool) -> None:
    assert ("\x1b[" in Sheet("title", tables=[NUMBERS]).text(100, colour=colour)) is colour


def test_a_footer_stays_one_line() -> None:
    footer = "signature: " + " ".join(f"option{number}=value" for number in range(40))
    assert Sheet("", footer=footer).text(60).splitlines()[-1] == footer


def test_lines_have_no_blanks_at_their_ends() -> None:
    assert not re.search(r" +$", Sheet("title", tables=[NUMBERS]).text(80), re.MULTILINE)


def test_markdown_escapes_what_would_end_a_cell_or_begin_a_tag() -> None:
    sheet = Sheet("a|b", tables=[Table("c|d", (("e|f", False), ("g", True)), [("1|2\n3", "<b>\\")])])
    assert sheet.markdown().splitlines() == [
        "a\\|b",
        "",
        "### c\\|d",
        "",
        "| e\\|f | g |",
        "|---|---:|",
        "| 1\\|2 3 | &lt;b>\\\\ |",
    ]


def test_markdown_ends_with_definitions_and_the_footer_as_code() -> None:
    lines = Sheet("t", definitions=[("term", "meaning")], footer="a=b").markdown().splitlines()
    assert lines[-4:] == ["", "- **term**: meaning", "", "`a=b`"]


@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_report_is_whole_on_a_narrow_terminal(width: int) -> None:
    sheet = report_sheet(report_of(by=("action", "occlusion")), joints=True, definitions=True)
    narrow, wide = sheet.text(width), sheet.text(400)
    assert max(map(cell_len, narrow.splitlines()[:-1])) <= width
    numbers = re.compile(r"(?<![\w.])-?\d+\.\d+(?![\w.])")
    assert sorted(numbers.findall(narrow)) == sorted(numbers.findall(wide))


@pytest.mark.parametrize("width", [80, 100])
def test_the_default_report_fits_a_screen_of_a_hundred_columns(width: int) -> None:
    lines = report_sheet(report_of()).text(width).splitlines()
    assert max(map(cell_len, lines[:-1])) <= width
    assert len(lines) <= {80: 60, 100: 45}[width]


def test_the_presets_are_all_listed_with_what_they_set() -> None:
    from posecal.engine.presets import PRESETS

    text = squeezed(presets_sheet().text(600))
    for preset in PRESETS.values():
        assert preset.name in text
        assert all(f"{key}={value}".replace(" ", "") in text for key, value in preset.options.items())

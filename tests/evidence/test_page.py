"""The tables of docs/evidence.md and the simulations that make them are the same ones."""

from tests.evidence.__main__ import PAGE, markers, tables, with_table


def test_each_table_has_its_markers_once():
    assert sorted(markers(PAGE.read_text(encoding="utf-8"))) == sorted(tables())


def test_a_table_replaces_what_stands_between_its_markers():
    page = "a\n<!-- table: x -->\n\n| old |\n\n<!-- end -->\nb\n<!-- table: y -->\n<!-- end -->\n"
    changed = with_table(page, "x", "| new |")
    assert changed == page.replace("| old |", "| new |")

"""Tables of text hold what UTF-8 can't write, as names of files may."""

from posecal.data.texts import frame_of, printable_table


def test_a_table_holds_text_that_is_no_utf8_whatever_libraries_are_installed() -> None:
    table = frame_of([["h\udcff", 1.5]], ["name", "value"])
    assert table["name"].tolist() == ["h\udcff"]
    assert table["value"].dtype == "float64"
    assert printable_table(table).to_csv(index=False) == "name,value\nh\\udcff,1.5\n"

"""A report shows itself in notebooks: its figures by name, and its page within a frame."""

import html
import re
import webbrowser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from posecal.errors import PoseDataError
from posecal.report.html import as_html
from tests.helpers.reports import report_of, unlabelled


def test_a_figure_is_drawn_by_its_name() -> None:
    figure = report_of().plot("errors", title="ours")
    assert isinstance(figure, Figure)
    assert figure.get_suptitle() == "ours"
    assert figure._repr_png_().startswith(b"\x89PNG")  # what a notebook shows that has not imported pyplot


def test_a_figure_of_another_name_is_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^kind: 'reliabilty' is not known\. Did you mean reliability\?"):
        report_of().plot("reliabilty")


@pytest.mark.slow
def test_the_page_stands_within_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    view = report_of().view(height=500)
    frame = view._repr_html_()
    found = re.fullmatch(r'<iframe title="posecal report" style="([^"]*)" srcdoc="([^"]*)"></iframe>', frame)
    assert found is not None
    assert "height:500px" in found[1]
    assert html.unescape(found[2]) == as_html(report_of(), "report")
    assert re.fullmatch(r"<posecal page, \d+ kB; \.open\(\) shows it in a browser>", repr(view))
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    view.open()
    (path,) = tmp_path.iterdir()
    assert opened == [path.as_uri()]
    assert path.read_text(encoding="utf-8") == view.page


def test_a_height_that_is_none_is_refused() -> None:
    with pytest.raises(PoseDataError, match="height"):
        report_of().view(height=0)


def test_a_report_without_curves_has_tables_and_no_figure() -> None:
    shown = unlabelled(n=1)._repr_html_()
    assert "<img" not in shown
    assert "minMPJPE" in shown

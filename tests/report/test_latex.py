"""Tables of LaTeX fit the text of a plain article: by estimated widths, and by LaTeX itself where it is installed."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from posecal.report.comparison import Comparison, comparison_sheet
from posecal.report.latex import SMALLEST, TEXT, Grid, fitted, grid_of
from posecal.report.sheet import Sheet, Table
from tests.helpers.latex import rows_of
from tests.helpers.reports import report_of

HEADINGS = ("action", "poses", "minMPJPE [mm] ↓", "MPJPE [mm] ↓", "PA-minMPJPE [mm] ↓", "PCK 150 mm [%] ↑", "ECE ↓")
VALUES = ("1,000", "59.2", "105.5", "45.3", "99.8", "0.027")


def fitted_rows(actions: int) -> list[Grid]:
    headings = (*HEADINGS, "signed area", "coverage at 90 %", "radius of 50 % [mm]")
    rows = [(f"action {number}", *VALUES, "-0.028", "0.920", "74.7") for number in range(actions)]
    return fitted(grid_of([(heading, at > 0) for at, heading in enumerate(headings)], rows, {(0, 2)}))


def test_what_fits_stays_as_it_is() -> None:
    table = Table("t", HEADINGS[:4], [("walking", "200", "59.2 (50 to 70)", "-1")], best=[(0, 2)])
    lines = Sheet("", tables=[table]).latex().splitlines()
    assert r"\begin{tabular}{@{}lrrr@{}}" in lines
    head = r"action & poses & minMPJPE [mm]~$\downarrow$ & \shortstack[r]{MPJPE\\{}[mm]~$\downarrow$} \\"
    assert head in lines
    assert r"walking & 200 & \textbf{59.2 {\footnotesize (50 to 70)}} & $-$1 \\" in lines
    assert not any("small\n" in line for line in lines)


def test_few_groups_of_many_metrics_have_a_row_for_each_metric() -> None:
    (transposed,) = fitted_rows(3)
    assert [cells[0] for cells in transposed.columns] == ["action", "action 0", "action 1", "action 2"]
    assert transposed.columns[0][2] == "minMPJPE [mm]\u00a0↓"
    assert transposed.columns[1][1:3] == ["1,000", "59.2"]
    assert transposed.best == {(2, 1)}


def test_many_groups_of_many_metrics_are_cut_in_parts_of_like_width() -> None:
    parts = fitted_rows(15)
    assert [len(part.columns) for part in parts] == [6, 5]
    assert all(part.fits() and part.columns[0][15] == "action 14" for part in parts)
    assert [part.best for part in parts] == [{(1, 2)}, set()]
    assert [cells[1] for part in parts for cells in part.columns[1:]] == [*VALUES, "−0.028", "0.920", "74.7"]


def test_long_words_are_folded_and_a_name_that_can_t_be_stays_whole() -> None:
    pair = "a model with a long name − another model"
    (folded,) = fitted(grid_of([("models", False), ("difference", True)], [(pair, "+0.1 (-0.2 to +0.4)")], ()))
    assert folded.columns[0][1] == pair  # it fits
    (folded,) = fitted(
        grid_of([("models", False), ("difference", True)], [(f"{pair} with a long name", "+0.1 (-0.2 to +0.4)")], ())
    )
    assert "\n" in folded.columns[0][1]
    assert folded.fits()
    (row,) = rows_of(folded.tabular())[1:]
    assert row == [f"{pair} with a long name".replace("−", "$-$"), "+0.1 ($-$0.2 to +0.4)"]
    name = 70 * "x"
    parts = fitted(grid_of([("model", False), ("ECE", True), ("CRPS", True)], [(name, "0.1", "0.2")], ()))
    assert {part.columns[0][1] for part in parts} == {name}


def test_a_table_that_hardly_fits_has_small_letters() -> None:
    def width(letters: int) -> tuple[bool, bool]:
        grid = grid_of([("n", False), ("x", True)], [(letters * "0", 20 * "0")], ())
        return grid.fits(), grid.tabular().startswith("{\\small\n")

    most = int(2 * (TEXT - 1.1)) - 20
    assert width(most) == (True, False)
    assert width(most + 1) == (True, True)
    assert width(int(2 * (TEXT - 1.1) / SMALLEST) - 19) == (False, True)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
def test_latex_sets_every_table_within_the_text_of_an_article(tmp_path: Path) -> None:
    names = ["calibrated", "overconfident", "underconfident"]
    reports = [report_of(spread, metrics="all", by=("action",)) for spread in (1.0, 0.5, 2.5)]
    comparison = Comparison(tuple(names), tuple(report.totals for report in reports))
    pages = [
        comparison_sheet(comparison, paper=True).latex(),
        reports[0].render("latex", all=True, joints=True),
        report_of(by=("action", "sequence")).render("latex"),
        *(f"{part.tabular()}\n\n" for part in fitted_rows(15)),
    ]
    text = "\n\n".join(pages)
    (tmp_path / "t.tex").write_text(
        r"\documentclass[a4paper,11pt]{article}\usepackage{booktabs}\begin{document}\setlength{\parindent}{0pt}"
        + re.sub(r"(?m)^(\\end\{tabular\}\}?)$", r"\1\n\n", text)
        + r"\end{document}",
        encoding="utf-8",
    )
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"],
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    log = done.stdout.decode(errors="replace")
    assert done.returncode == 0, log
    assert "Overfull" not in log, log

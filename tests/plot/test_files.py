"""Pictures become files: with a caption that holds definition and signature, whole, and the same bytes each time."""

from itertools import combinations
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import posecal
from posecal.demo import sample
from posecal.errors import PoseDataError, PoseFileError
from posecal.plot import TOGETHER, caption_of, check_suffix, draw, figure_bytes, save
from posecal.report.report import Report
from tests.helpers.reports import report_of, unlabelled, world

STARTS = {".svg": b"<?xml", ".png": b"\x89PNG\r\n", ".pdf": b"%PDF-"}
KINDS = ("reliability", "joints", "errors", "pck")


def words_of(kind: str, **how: str) -> str:
    """The caption."""
    return caption_of(draw(report_of(**how), kind))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", STARTS)
def test_a_picture_is_written_in_the_form_of_its_ending(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"picture{suffix.upper()}"
    save(draw(report_of()), path)
    assert path.read_bytes().startswith(STARTS[suffix])
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [path.name, f"{path.name}.txt"]
    assert (tmp_path / f"{path.name}.txt").read_text(encoding="utf-8") == f"{words_of('reliability')}\n"


def test_the_caption_is_beside_the_picture_and_in_its_metadata_not_in_it() -> None:
    figure = draw(report_of())
    assert figure.texts == []
    text = figure_bytes(figure, ".svg").decode()
    about, _, picture = text.partition("</metadata>")
    assert report_of().signature in about
    assert report_of().signature not in picture


def test_a_figure_without_a_caption_has_no_text_file(tmp_path: Path) -> None:
    figure = draw(report_of(), "pck")
    figure.set_label("")
    save(figure, tmp_path / "picture.svg")
    assert [entry.name for entry in tmp_path.iterdir()] == ["picture.svg"]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", STARTS)
def test_the_same_report_gives_the_same_bytes(suffix: str) -> None:
    assert figure_bytes(draw(report_of()), suffix) == figure_bytes(draw(report_of()), suffix)


@pytest.mark.parametrize("name", ["picture", "picture.jpg", "picture.svgz", ".png.txt"])
def test_another_ending_is_refused_with_those_that_can_be_drawn(name: str, tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"expected a name that ends with \.svg, \.png or \.pdf\.$"):
        check_suffix(tmp_path / name)
    with pytest.raises(PoseFileError, match=r"expected a name that ends with"):
        save(draw(report_of()), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"the folder .*nowhere does not exist\. Make it first\.$"):
        save(draw(report_of()), tmp_path / "nowhere" / "picture.svg")


@pytest.mark.parametrize("kind", KINDS)
def test_every_picture_carries_the_signature(kind: str) -> None:
    assert report_of().signature in words_of(kind)


def test_the_reliability_diagram_s_caption_gives_the_ece_its_definition_and_the_chance() -> None:
    report, words = report_of(), words_of("reliability")
    assert words.startswith(f"ECE {report.value('ece'):.4f} (of a calibrated sampler {report.test('ece').mean:.4f}")
    assert f"ECE: {report.definition('ece')}." in words
    assert f"p = {report.test('ece').p:.3f}" in words
    assert "Grey: each joint; dashed: a calibrated sampler." in words


def test_a_diagram_of_another_definition_says_so() -> None:
    report = report_of(metrics="ece_paper")
    words = words_of("reliability", metrics="ece_paper")
    assert words.startswith(f"ECE (paper) {report.value('ece_paper'):.4f}. ")
    assert f"ECE (paper): {report.definition('ece_paper')}." in words
    assert "Band" not in words


def test_a_title_stands_above() -> None:
    assert draw(report_of(), title="[model] $x_1$").get_suptitle() == "[model] $x_1$"


def test_a_dollar_in_a_title_is_a_dollar() -> None:
    """Names of files are no formulas."""
    assert b"model $x_1$ and $y" in figure_bytes(draw(report_of(), title="model $x_1$ and $y"), ".svg")


def test_an_unknown_picture_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"^kind: 'reliabilty' is not known\. Did you mean reliability\?$"):
        draw(report_of(), "reliabilty")
    with pytest.raises(PoseDataError, match=r"^kind: \['pck'\] is not known\. Did you mean pck\?$"):
        draw(report_of(), ["pck"])  # type: ignore[arg-type]


@pytest.mark.parametrize("what", [5, report_of().totals])
def test_what_is_no_report_is_not_drawn(what: object) -> None:
    with pytest.raises(PoseDataError, match=rf"^report: {type(what).__name__}; expected Report\.$"):
        draw(what)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (
            "reliability",
            r'^reliability: the report has no calibration curves\. Evaluate with metrics="ece"\.$',
        ),
        ("joints", r"^metric: 'signed_area' was not measured\. Evaluate with metrics=\"min_mpjpe, signed_area\"\.$"),
        ("errors", r"^curve: the report has no errors_by_n; it is among the default metrics\.$"),
        ("pck", r"^curve: the report has no pck_curve; it is among the default metrics\.$"),
        (
            "sparsification",
            r"^sparsification: the report has no spreads and errors; they are among the default metrics\.$",
        ),
        (
            "risk_coverage",
            r"^risk_coverage: the report has no spreads and errors; they are among the default metrics\.$",
        ),
        ("event", r'^event: the report has no Brier score\. Evaluate with metrics="scores"\.$'),
        ("rank_tests", r'^rank_tests: the report has none\. Evaluate with metrics="rank_tests"\.$'),
    ],
)
def test_what_a_picture_lacks_is_said_with_what_to_ask_for(kind: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        draw(report_of(metrics="min_mpjpe"), kind)


def test_a_report_of_unnamed_joints_is_drawn_all_the_same() -> None:
    assert figure_bytes(draw(unlabelled(), "reliability"), ".svg").startswith(STARTS[".svg"])


@pytest.mark.parametrize("kind", ["reliability", "errors"])
def test_drawing_leaves_the_user_s_style_and_figures_alone(kind: str) -> None:
    from matplotlib import pyplot as plt

    before, open_before = dict(mpl.rcParams), plt.get_fignums()
    figure_bytes(draw(report_of(), kind), ".svg")
    assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == open_before


@pytest.mark.parametrize("kind", KINDS)
def test_no_text_of_a_picture_lies_outside_it_or_over_another(kind: str) -> None:
    figure = draw(report_of(), kind, title="a title")
    FigureCanvasAgg(figure).draw()
    whole = figure.bbox
    boxes = [text.get_window_extent() for text in figure.texts]
    (ax,) = figure.axes
    boxes += [label.get_window_extent() for label in (ax.xaxis.label, ax.yaxis.label) if label.get_text()]
    boxes += [text.get_window_extent() for text in ax.texts]
    for box in boxes:
        assert whole.x0 <= box.x0
        assert box.x1 <= whole.x1
        assert whole.y0 <= box.y0
        assert box.y1 <= whole.y1
    assert not any(one.overlaps(other) for number, one in enumerate(boxes) for other in boxes[:number])


def test_a_label_of_the_data_is_no_formula_either() -> None:
    here = world()
    names = ["a$b$_1", *posecal.JOINT_SETS["h36m-17"][1:]]
    report = posecal.evaluate(sample(here, 3), here.truth, joints=names, root_joint="none")
    assert figure_bytes(draw(report), ".png").startswith(STARTS[".png"])


# --- several models, sizes and styles ---------------------------------------------------------------------------


def three() -> dict[str, Report]:
    return {"narrow": report_of(0.5), "right": report_of(), "wide": report_of(2.0)}


@pytest.mark.parametrize("kind", TOGETHER)
def test_several_models_are_in_one_panel_each_in_its_colour_with_its_name(kind: str) -> None:
    figure = draw(three(), kind)
    (ax,) = figure.axes
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["narrow", "right", "wide"]
    colours = [line.get_color() for line in ax.lines if line.get_label() in three()]
    assert len({*colours}) == 3
    assert colours == [handle.get_color() for handle in legend.legend_handles]  # type: ignore[union-attr]


def test_the_models_lines_are_those_of_their_own_figures_and_the_band_is_the_widest() -> None:
    (ax,) = draw(three()).axes
    for name, report in three().items():
        (line,) = (line for line in ax.lines if line.get_gid() == f"summary {name}")
        np.testing.assert_array_equal(line.get_ydata(), report.summary_curve())
    widest = max(report.test("ece").band for report in three().values())
    (band,) = (c for c in ax.collections if c.get_gid() == "band")
    corners = np.asarray(band.get_paths()[0].vertices)
    lowest = corners[np.isclose(corners[:, 0], 0.5), 1].min()
    np.testing.assert_allclose(lowest, max(0.0, 0.5 - widest * 0.5))


def test_panels_are_even_with_ticks_below_each_column_and_long_names_in_lines() -> None:
    name = "a-name-that-is-longer-than-its-panel-is-wide"
    figure = draw({f"{name}-{number}": report_of() for number in range(5)}, panels=True)
    places = [ax.get_subplotspec() for ax in figure.axes[:5]]
    assert [(place.rowspan.start, place.colspan.start) for place in places] == [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1)]
    below = [bool(ax.get_xlabel()) for ax in figure.axes[:5]]
    assert below == [any(tick.label1.get_visible() for tick in ax.xaxis.get_major_ticks()) for ax in figure.axes[:5]]
    assert below == [False, False, True, True, True]
    assert [bool(ax.get_ylabel()) for ax in figure.axes[:5]] == [True, False, False, True, False]
    figure.draw_without_rendering()
    extents = [ax.title.get_window_extent() for ax in figure.axes[:3]]
    assert not any(one.overlaps(other) for one, other in combinations(extents, 2))


@pytest.mark.parametrize(("kind", "panels"), [("reliability", True), ("errors", True), ("joints", False)])
def test_several_models_have_panels_where_asked_and_where_one_can_not_hold_them(kind: str, panels: bool) -> None:
    figure = draw(three(), kind, panels=panels)
    assert [ax.get_title() for ax in figure.axes] == ["narrow", "right", "wide"]
    tops = {ax.get_ylim() for ax in figure.axes}
    assert len(tops) == 1
    if kind == "errors":
        assert tops.pop()[1] > max(report.curve("errors_by_n")[1].max() for report in three().values())


def test_the_caption_of_several_models_has_the_numbers_of_each_and_one_signature_where_they_agree() -> None:
    words = caption_of(draw(three()))
    for name, report in three().items():
        assert f"{name}: ECE {report['ece']:.4f} " in words
    assert words.count(report_of().signature) == 1
    other = caption_of(draw({"few": report_of(n=11), "many": report_of()}))
    assert f"\nfew: {report_of(n=11).signature}\nmany: {report_of().signature}" in other


def test_rank_tests_are_those_of_one_model() -> None:
    with pytest.raises(PoseDataError, match=r"^report: 3 models; expected one, since its numbers have a panel each\.$"):
        draw(three(), "rank_tests")
    with pytest.raises(PoseDataError, match=r"^report: none; expected at least one\.$"):
        draw({})


def test_a_size_is_that_of_the_file() -> None:
    text = figure_bytes(draw(three(), size=(3.25, 2)), ".svg").decode()
    assert 'width="234pt" height="144pt"' in text
    with pytest.raises(PoseDataError, match=r"^size: \(3, 41\); expected inches across and down, above 0"):
        draw(report_of(), size=(3, 41))


def test_a_style_changes_fonts_and_colours_but_makes_no_name_a_formula(tmp_path: Path) -> None:
    style = tmp_path / "paper.mplstyle"
    style.write_text("font.family: monospace\nxtick.color: FF0000\ntext.usetex: True\ntext.parse_math: True\n")
    text = figure_bytes(draw({"a$b$": report_of()}, style=style), ".svg").decode()
    assert "DejaVu Sans Mono" in text
    assert "#ff0000" in text
    assert "a$b$" in text
    (ax,) = draw(report_of(), style="dark_background").axes
    assert {line.get_color() for line in ax.lines if line.get_gid() == "summary"} == {"white"}


def test_what_is_no_style_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^style: 'ggplto' is neither a file nor a style of Matplotlib\. Did you"):
        draw(report_of(), style="ggplto")
    with pytest.raises(PoseDataError, match=r"^style: 'https://[^']+' is neither a file nor a style"):
        draw(report_of(), style="https://example.org/a.mplstyle")
    (tmp_path / "broken").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PoseFileError, match=r"broken: no style file of Matplotlib \("):
        draw(report_of(), style=tmp_path / "broken")

"""Pictures become files: with a caption that holds definition and signature, whole, and the same bytes each time."""

from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import posecal
from posecal.demo import sample
from posecal.errors import PoseDataError, PoseFileError
from posecal.plot import check_suffix, draw, figure_bytes, save
from tests.helpers.reports import report_of, unlabelled, world

STARTS = {".svg": b"<?xml", ".png": b"\x89PNG\r\n", ".pdf": b"%PDF-"}
KINDS = ("reliability", "joints", "errors", "pck")


def words_of(kind: str, **how: str) -> str:
    """All text below the picture."""
    return " ".join(" ".join(text.get_text() for text in draw(report_of(**how), kind).texts).split())


@pytest.mark.slow
@pytest.mark.parametrize("suffix", STARTS)
def test_a_picture_is_written_in_the_form_of_its_ending(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"picture{suffix.upper()}"
    save(draw(report_of()), path)
    assert path.read_bytes().startswith(STARTS[suffix])
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


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
    assert f"ECE {report.value('ece'):.4f}: {report.definition('ece')}." in words
    assert f"p = {report.test('ece').p:.3f}" in words
    assert "Grey: each joint; dashed: a calibrated sampler." in words


def test_a_diagram_of_another_definition_says_so() -> None:
    report = report_of(metrics="ece_paper")
    words = words_of("reliability", metrics="ece_paper")
    assert f"{report.value('ece_paper'):.4f}: {report.definition('ece_paper')}." in words
    assert "Band" not in words


def test_a_title_stands_above() -> None:
    (ax,) = draw(report_of(), title="[model] $x_1$").axes
    assert ax.get_title() == "[model] $x_1$"


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
    boxes += [label.get_window_extent() for label in (ax.xaxis.label, ax.yaxis.label, ax.title) if label.get_text()]
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

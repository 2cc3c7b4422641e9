"""What is written, and what is made of a saved result: reports, merged shards and pictures."""

import re
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.data import write
from posecal.engine.protocol import Protocol
from posecal.engine.storage import load_totals
from posecal.report.report import Report
from tests.helpers.shell import EVALUATE, N, done, frame_ids, gt_members, hyps_members, refused, rows, run


def test_save_plot_and_html_write_these_files_and_no_others() -> None:
    before = {path.name for path in Path().iterdir()}
    plain = done("evaluate", "hyps.npz", "gt.npz")
    assert {path.name for path in Path().iterdir()} == before
    assert done("evaluate", "hyps.npz", "gt.npz", "--save=s.npz", "--plot=p.svg", "--html=h.html") == plain
    assert {path.name for path in Path().iterdir()} == before | {"s.npz", "p.svg", "p.svg.txt", "h.html"}
    assert Path("p.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert Path("h.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert load_totals("s.npz").signature == load_totals("result.npz").signature


@pytest.mark.parametrize("form", ["text", "json"])
def test_a_saved_result_is_reported_as_it_was(form: str) -> None:
    words = ("--format", form, "--per-joint", "--definitions", "--by", "action")
    one = run("evaluate", "hyps.npz", "gt.npz", "--save", "kept.npz", *words)
    later = run("report", "kept.npz", *words)
    assert (later.stdout, later.stderr, later.exit_code) == (one.stdout, "", 0)
    assert one.stderr == "kept.npz: keeps 12 of the 36 poses for pictures. --no-gallery leaves them out.\n"


def test_a_result_and_a_page_hold_no_poses_where_these_must_not_be_given_away(monkeypatch: pytest.MonkeyPatch) -> None:
    files = ("--save=none.npz", "--html=none.html")
    assert run("evaluate", "hyps.npz", "gt.npz", "--no-gallery", *files).stderr == ""
    assert load_totals("none.npz").gallery is None
    assert "pose-data" not in Path("none.html").read_text(encoding="utf-8")
    done("evaluate", "hyps.npz", "gt.npz", "--save=kept.npz")
    done("merge", "kept.npz", "-o", "merged.npz", "--no-gallery")
    assert load_totals("merged.npz").gallery is None
    monkeypatch.setattr("sys.argv", ["/bin/posecal", "report", "a file", "--html=kept.html"])
    done("report", "kept.npz", "--html=kept.html")
    assert "pose-data" in Path("kept.html").read_text(encoding="utf-8")
    assert "<code>posecal report &#39;a file&#39; --html=kept.html</code>" in Path("kept.html").read_text(
        encoding="utf-8"
    )


def test_results_of_shards_merge_into_that_of_one_run() -> None:
    """Cut within a sequence: 36 poses of three frames a sequence into 0 … 9 and 10 … 35."""
    for name, part in (("a", slice(0, 10)), ("b", slice(10, 36))):
        ours, theirs = hyps_members(), gt_members()
        ours |= {"hypotheses": ours["hypotheses"][:, part], "frame_id": ours["frame_id"][part]}
        theirs |= {key: values[part] for key, values in theirs.items() if len(values) == 36}
        np.savez(f"h{name}.npz", **ours)
        np.savez(f"g{name}.npz", **theirs)
        done("evaluate", f"h{name}.npz", f"g{name}.npz", "--save", f"{name}.npz")
    found = run("merge", "b.npz", "a.npz", "-o", "all.npz")
    assert (found.exit_code, found.stdout) == (0, "")
    assert found.stderr == "all.npz: 36 poses of 2 results.\n"
    merged, whole = (rows(done("report", name, "--format=json", "--by=action")) for name in ("all.npz", "result.npz"))
    assert merged.keys() == whole.keys()
    for key, value in whole.items():
        expected = np.nan if value is None else value
        got = merged[key]
        np.testing.assert_allclose(np.nan if got is None else got, expected, rtol=1e-6, atol=1e-9, err_msg=str(key))


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["reliability", "joints", "errors", "pck", "sparsification", "risk-coverage", "event", "rank-tests"]
)
def test_a_saved_result_is_drawn(kind: str) -> None:
    done(*EVALUATE, "--metrics=default,rank_tests,scores", "--save=all.npz")
    assert done("plot", kind, "all.npz", "-o", "picture.svg") == ""
    from posecal.plot import draw, figure_bytes

    report = Report(load_totals("all.npz"))
    assert Path("picture.svg").read_bytes() == figure_bytes(draw(report, kind.replace("-", "_")), ".svg")


def test_a_picture_of_what_the_result_lacks_is_refused() -> None:
    assert refused("plot", "rank-tests", "result.npz", "-o", "picture.svg").startswith("posecal: rank_tests: ")


def test_a_page_names_flags_in_its_remarks() -> None:
    np.save("h.npy", np.load("hyps.npz")["hypotheses"])
    np.save("g.npy", np.load("gt.npz")["truth"] + 100)
    done("evaluate", "h.npy", "g.npy", "--axes=NMKD", "--unit=mm", "--metrics=mpjpe", "--html=h.html")
    page = Path("h.html").read_text(encoding="utf-8")
    assert "--root-joint names one." in page
    assert "root_joint names one." not in page


def test_poses_are_drawn_by_frame_and_joint() -> None:
    ids = frame_ids()
    words = ("plot", "poses", "hyps.npz", "gt.npz", "-o", "poses.svg")
    done(*words, "--frames", f"{ids[4]}, 7", "--joint", "LFoot", "--most", "3")
    text = Path("poses.svg").read_text(encoding="utf-8")
    for words in (ids[4], ids[7], f"hypotheses: grey, 3 of {N}", "LFoot: pink"):
        assert words in text


def test_presets_lists_every_preset_and_option() -> None:
    text = done("presets")
    for name in posecal.PRESETS:
        assert re.search(rf"^{name} ", text, re.MULTILINE)
    for option in Protocol().options:
        assert re.search(rf"^{option} ", text, re.MULTILINE)


def test_an_existing_output_is_replaced_whole() -> None:
    Path("s.npz").write_text("old" * 10**6)
    done(*EVALUATE, "--metrics=min_mpjpe", "--save", "s.npz")
    assert b"old" not in Path("s.npz").read_bytes()


def test_where_one_output_can_not_be_written_all_stay_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("s.npz", "p.svg", "h.html"):
        Path(name).write_text("before")

    stored = write._Output.store
    calls: list[str] = []

    def store(output: write._Output) -> None:
        calls.append(output.path.name)
        if len(calls) == 4:
            raise OSError(28, "No space left on device")
        stored(output)

    monkeypatch.setattr(write._Output, "store", store)
    words = ("--metrics=ece", "--save=s.npz", "--plot=p.svg", "--html=h.html")
    assert refused(*EVALUATE, *words) == "posecal: h.html: can't be written (No space left on device)."
    assert calls == ["s.npz", "p.svg", "p.svg.txt", "h.html"]
    assert {Path(name).read_text() for name in calls if name != "p.svg.txt"} == {"before"}
    assert not Path("p.svg.txt").exists()
    assert not list(Path().glob(".posecal-*"))

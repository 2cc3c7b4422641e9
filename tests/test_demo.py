"""The demonstration: each sampler is what its name says in a world where the truth is known, and posecal finds it."""

import re
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal import demo
from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.demo import SAMPLERS, make_world, run_demo, sample, write_demo
from posecal.engine.storage import load_totals
from posecal.errors import PoseFileError

JOINTS = JOINT_SETS["h36m-17"]


@pytest.fixture(
    scope="module", params=[pytest.param((24, 25), marks=pytest.mark.slow), (16, 3)], ids=["as it is", "without pages"]
)
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The demonstration as a user sees it: the folder, and all that it writes."""
    folder = tmp_path_factory.mktemp("demo") / "made" / "anew"
    lines: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("posecal.demo.make_world", partial(make_world, *request.param))
        if request.param != (24, 25):
            patch.setattr("posecal.demo.write_html", lambda report, path, name: path.write_text(name))
        run_demo(folder, lines.append)
    return folder, "\n".join(lines)


# --- the world ------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_world_and_another_gives_another() -> None:
    np.testing.assert_array_equal(make_world(4, 3, seed=2).truth, make_world(4, 3, seed=2).truth)
    assert np.abs(make_world(4, 3, seed=2).truth - make_world(4, 3, seed=3).truth).max() > 1
    np.testing.assert_array_equal(sample(make_world(4, 3), 2, seed=4), sample(make_world(4, 3), 2, seed=4))


def test_a_world_leaves_the_global_generator_alone() -> None:
    state = np.random.get_state()  # noqa: NPY002
    sample(make_world(2, 2), 2)
    np.testing.assert_array_equal(np.random.get_state()[1], state[1])  # noqa: NPY002


def test_the_hip_is_at_the_origin_and_always_seen() -> None:
    world = make_world(5, 4)
    np.testing.assert_array_equal(world.truth[:, 0], 0)
    np.testing.assert_array_equal(sample(world, 3)[:, :, 0], 0)
    assert not world.occluded[:, 0].any()
    assert world.occluded[:, 1:].any()


def test_hidden_joints_are_uncertain_twice_as_much() -> None:
    world = make_world(40, 1)
    for action, scale in (("standing", 0.7), ("walking", 1.0), ("sitting", 1.3)):
        some = world.action == action
        hidden, seen = world.spread[some][world.occluded[some]], world.spread[some, 1:][~world.occluded[some, 1:]]
        np.testing.assert_allclose(seen, scale * np.tile([14.0, 28.0, 14.0], (len(seen), 1)))
        np.testing.assert_allclose(hidden, 2 * scale * np.tile([14.0, 28.0, 14.0], (len(hidden), 1)))


@pytest.mark.parametrize("spread", SAMPLERS.values())
def test_a_sampler_has_the_mean_and_the_spread_that_it_should(spread: float) -> None:
    """Errors add up along the tree, so variances do; some 4 standard errors of a mean and a variance of N draws."""
    world, n = make_world(3, 1), 4000
    variances = (spread * world.spread) ** 2
    for joint, parent in enumerate(Skeleton(JOINTS).parents):
        if parent >= 0:
            variances[:, joint] += variances[:, parent]
    drawn = sample(world, n, spread).astype(np.float64)
    sigma = np.sqrt(variances)
    assert (np.abs(drawn.mean(axis=0) - world.mean) <= 4.5 * sigma / np.sqrt(n) + 1e-4).all()
    assert (np.abs(drawn.var(axis=0) - variances) <= 4.5 * variances * np.sqrt(2 / n) + 1e-4).all()


def test_the_truth_is_a_draw_of_the_same_law() -> None:
    """The share of truths within the middle half of many draws is a half; 4 standard deviations of a binomial."""
    world = make_world(400, 1, seed=1)
    low, high = np.quantile(sample(world, 200)[:, :, 10, 0], [0.25, 0.75], axis=0)
    inside = ((low < world.truth[:, 10, 0]) & (world.truth[:, 10, 0] < high)).mean()
    assert abs(inside - 0.5) < 4 * np.sqrt(0.25 / 400) + 1 / 200


# --- the files ------------------------------------------------------------------------------------------------


def test_the_files_say_everything_themselves(tmp_path: Path) -> None:
    world = make_world(3, 2)
    paths = list(write_demo(tmp_path, world, n_hypotheses=4))
    assert [path.name for path in paths] == ["gt.npz", "calibrated.npz", "overconfident.npz", "underconfident.npz"]
    for path in paths[1:]:
        report = posecal.evaluate(path, paths[0], by=["action", "occlusion"])
        assert report.totals.spec.joints == JOINTS
        assert report.totals.spec.root == 0
        assert not [remark for remark in report.remarks if "unit" in remark or "axes" in remark]


def test_the_same_demonstration_gives_the_same_files(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    for one, two in zip(
        *(write_demo(tmp_path / name, make_world(2, 2), 3) for name in ("one", "two")),
        strict=True,
    ):
        assert one.read_bytes() == two.read_bytes()


# --- the run --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_it_leaves_files_pages_pictures_and_results(run: tuple[Path, str]) -> None:
    folder, _ = run
    names = {"gt.npz", "samplers.svg", "samplers.svg.txt"}
    names |= {f"{name}{ending}" for name in SAMPLERS for ending in (".npz", ".png", ".png.txt", ".html", "-result.npz")}
    assert {path.name for path in folder.iterdir()} == names


@pytest.mark.slow
def test_the_reports_name_what_each_sampler_is(run: tuple[Path, str]) -> None:
    folder, text = run
    area = {name: posecal.Report(load_totals(folder / f"{name}-result.npz")).value("signed_area") for name in SAMPLERS}
    assert area["overconfident"] < -0.1 < area["calibrated"] < 0.1 < area["underconfident"]
    assert re.search(r"^calibrated: No miscalibration shown", text, re.MULTILINE)
    assert re.search(r"^overconfident: Overconfident, beyond chance", text, re.MULTILINE)
    assert re.search(r"^underconfident: Underconfident, beyond chance", text, re.MULTILINE)


def test_it_notes_that_the_best_benchmark_number_goes_to_the_wrong_sampler(run: tuple[Path, str]) -> None:
    folder, text = run
    best = {name: posecal.Report(load_totals(folder / f"{name}-result.npz")).value("min_mpjpe") for name in SAMPLERS}
    winner = min(best, key=lambda name: best[name])
    assert winner != "calibrated"
    assert f"Notice: the {winner} sampler has the best minMPJPE." in text
    assert re.search(r"a model whose 90 % balls hold \d+ % of the truths\.", " ".join(text.split()))


def test_it_shows_the_commands_that_a_user_would_type(run: tuple[Path, str]) -> None:
    folder, text = run
    for name in SAMPLERS:
        assert f"posecal evaluate {name}.npz gt.npz --plot {name}.png --html {name}.html --save {name}-re" in text
    at = [text.index(f"posecal evaluate {name}") for name in SAMPLERS]
    assert all(one < two for one, two in pairwise(at))
    assert f"In {folder}: the files, a page (.html)" in text


def test_the_commands_can_be_pasted_where_posecal_is_not_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    for path, program in ((str(Path(sys.executable).parent), "posecal"), ("", f"{sys.executable} -m posecal")):
        monkeypatch.setenv("PATH", path)
        assert demo._program() == program


def test_a_folder_that_can_not_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here already")
    with pytest.raises(PoseFileError, match=r"file.*: can't be made \(.+\)\.$"):
        run_demo(tmp_path / "file" / "inside", print)
    with pytest.raises(PoseFileError, match=r"file: can't be made \(File exists\)\.$"):
        run_demo(tmp_path / "file", print)

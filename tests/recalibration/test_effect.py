"""What speaks against a map: scores that rise, and sides that are exchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.calibration.modes import centres_of_modes
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.recalibration import SpreadMap, find_modes, fit_spread, judge_spread, read_map, write_map
from posecal.recalibration.effect import objections
from posecal.recalibration.spread_map import rescaled
from tests.helpers.flips import depth_flips
from tests.helpers.samplers import gaussian, pairs_of, sequences

Array = np.ndarray


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ()),
        ({"energy_score": (90.0, 80.0), "crps": (18.0, 17.0), "signed_area": (-0.2, 0.01)}, ()),
        ({"energy_score": (100.0, 100.09)}, ()),
        ({"energy_score": (100.0, 100.2)}, ("the energy score rises from 100.0 to 100.2 mm",)),
        ({"energy_score": (90.0, 80.0), "crps": (18.0, 23.0)}, ("the CRPS rises from 18.0 to 23.0 mm",)),
        (
            {"signed_area": (-0.12, 0.07)},
            ("the hypotheses turn from overconfident to underconfident (signed area -0.120 to +0.070)",),
        ),
        (
            {"signed_area": (0.12, -0.07)},
            ("the hypotheses turn from underconfident to overconfident (signed area +0.120 to -0.070)",),
        ),
        ({"signed_area": (-0.12, 0.05)}, ()),
        ({"signed_area": (-0.02, 0.015)}, ()),
        ({"signed_area": (-0.12, -0.11)}, ()),
    ],
)
def test_what_gets_worse_is_an_objection(changes: dict[str, tuple[float, float]], expected: tuple[str, ...]) -> None:
    assert objections(changes, "mm") == expected


def test_changes_are_those_of_an_evaluation_before_and_after() -> None:
    x, y = gaussian(1, 12, 80, 3, spread=0.5)
    fitted = fit_spread(pairs_of(x, y), threads=1)
    assert list(fitted.changes) == ["energy_score", "crps", "ece", "signed_area", "min_mpjpe"]
    for at, hypotheses in enumerate((x, fitted.apply(x))):
        report = posecal.evaluate(pairs_of(hypotheses, y), metrics=list(fitted.changes))
        for name, pair in fitted.changes.items():
            assert pair[at] == pytest.approx(report[name])
    assert fitted.objections == ()


def test_a_factor_that_makes_depth_flips_worse_is_not_written(tmp_path: Path) -> None:
    x, y = depth_flips(0, 50, 200, 4)
    fitted = fit_spread(x, y, unit="mm", threads=1)
    assert 1.5 < fitted.factors[0] < 2.5
    assert fitted.changes["ece"][1] < fitted.changes["ece"][0]  # by the ECE alone it would look better
    assert len(fitted.objections) == 3
    assert fitted.remarks[-1].startswith("Not recommended: the energy score rises from ")
    with pytest.raises(PoseDataError, match=r"^map: on the poses .*; expected a map that helps.*pass anyway=True\.$"):
        write_map(fitted, tmp_path / "map.json")
    assert not (tmp_path / "map.json").exists()
    write_map(fitted, tmp_path / "map.json", anyway=True)
    assert read_map(tmp_path / "map.json").remarks == (fitted.remarks[-1],)


def test_about_their_modes_depth_flips_are_calibrated_on_other_poses() -> None:
    fitted = fit_spread(*depth_flips(0, 50, 200, 4), unit="mm", about="modes", threads=1)
    assert fitted.modal == fitted.joints
    # The truth is 3 times as wide about its mode; of some 25 hypotheses the median strays a little.
    assert fitted.factors[0] == pytest.approx(3, rel=0.2)
    x, y = depth_flips(1, 50, 200, 4)
    after = fitted.apply(x)
    assert posecal.ece(after, y) < 0.04 < 0.1 < posecal.ece(x, y)
    for score in (posecal.metrics.energy_score, posecal.metrics.crps):
        assert score(after, y).mean() < score(x, y).mean()
    assert fitted.objections == ()


def test_hypotheses_are_moved_about_the_mode_that_they_belong_to() -> None:
    x, y = depth_flips(2, 30, 12, 3)
    x[:, :, 1] = np.random.default_rng(0).normal(0, 40, (30, 12, 3))
    about = np.array([True, True, False])
    factors = np.array([2.0, 3.0, 0.5])
    found = rescaled(x, factors, about_modes=about)
    for pose, joint in np.ndindex(12, 3):
        points = x[:, pose, joint]
        depth = points[:, 2]
        groups = [np.ones(30, dtype=bool)]
        if joint == 0:
            middle = (depth.min() + depth.max()) / 2
            groups = [depth < middle, depth >= middle]
        for group in groups:
            centre = np.median(points[group], axis=0)
            np.testing.assert_allclose(found[group, pose, joint], centre + factors[joint] * (points[group] - centre))
    block = Block(x, y)
    moved = block.scale_dispersion(2.0, centres_of_modes(block, about))
    np.testing.assert_allclose(moved.offsets[:, 0], Block(found, y).offsets[:, 0], atol=1e-9)
    names = ("a", "b", "c")
    spread_map = SpreadMap(names, factors, 99, 0, modal=("a", "b"))
    np.testing.assert_array_equal(spread_map.apply(x), found)
    data = pairs_of(x[:, :, ::-1], y[:, ::-1], joints=["c", "b", "a"])
    np.testing.assert_allclose(spread_map.rescale(data).hypotheses.read(0, 12)[:, :, ::-1], found)


def test_modes_of_pose_data_are_found_and_what_has_none_is_refused() -> None:
    x, y = depth_flips(3, 20, 60, 4)
    modes = find_modes(x, y, unit="mm")
    assert modes is not None
    assert modes.several.all()
    assert find_modes(x[:9], y, unit="mm") is None
    assert find_modes(x, y, unit="deg") is None
    with pytest.raises(PoseDataError, match=r"^about: 'modes' of N = 9; expected at least 10 hypotheses"):
        fit_spread(x[:9], y, unit="mm", about="modes")
    with pytest.raises(PoseDataError, match=r"^about: 'modes' of angles; expected"):
        fit_spread(x, y, unit="deg", about="modes")
    with pytest.raises(PoseDataError, match=r"^about: 'modes', but no joint has several: at most \d+% .* median\.$"):
        fit_spread(pairs_of(*gaussian(4, 20, 60, 3)), about="modes")
    with pytest.raises(PoseDataError, match=r"^about: 'mean'"):
        fit_spread(x, y, unit="mm", about="mean")  # type: ignore[arg-type]


def test_held_out_sequences_of_depth_flips_object_too() -> None:
    x, y = depth_flips(0, 30, 120, 4)
    labels = {"sequence": sequences(120, 12)}
    judged = judge_spread(x, y, unit="mm", labels=labels, threads=1)
    assert judged.objections[0].startswith("the energy score rises from ")
    about = judge_spread(x, y, unit="mm", labels=labels, about="modes", threads=1)
    assert about.objections == ()
    assert about.difference("energy_score").better == "after"
    assert about.new_ece < 0.6 * judged.before["ece"]

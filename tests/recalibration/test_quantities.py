"""Recalibration of angles, pixels and numbers without a unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.recalibration import apply_map, held_out_coverage, write_map
from posecal.recalibration.radius import RadiusMap
from posecal.recalibration.spread_map import SpreadMap, rescaled
from tests.helpers.shell import run

Array = np.ndarray[Any, Any]
N, M, K = 30, 240, 2
SEQUENCE = np.repeat(np.arange(12), 20).astype(str)


def wrap(angles: Array) -> Array:
    return (angles + 180) % 360 - 180


def too_narrow(spread: float, factor: float, seed: int = 0) -> tuple[Array, Array]:
    """Angles, (N, M, K, 1) and (M, K, 1): the truth's spread is that of the hypotheses times a factor."""
    random = np.random.default_rng(seed)
    centre = random.uniform(-180, 180, (M, K, 1))
    x = centre + random.normal(0, spread, (N, M, K, 1))
    return wrap(x), wrap(centre + random.normal(0, spread * factor, (M, K, 1)))


@pytest.mark.parametrize("spread", [10.0, 40.0])
def test_a_spread_of_angles_is_calibrated_wherever_they_lie(spread: float) -> None:
    x, y = too_narrow(spread, 2)
    spread_map = posecal.fit_spread(x, y, unit="deg")
    assert 1.8 < spread_map.factors[0] < 2.2
    assert spread_map.data_unit == "deg"
    moved = spread_map.apply(x, unit="deg")
    assert posecal.ece(x, y, unit="deg") > 0.1
    assert posecal.ece(moved, y, unit="deg") < 0.03
    of_radians = posecal.fit_spread(np.radians(x), np.radians(y), unit="rad")
    np.testing.assert_allclose(of_radians.factors, spread_map.factors, rtol=1e-6)
    away = spread_map.apply(np.radians(x), unit="rad") - np.radians(moved)
    np.testing.assert_allclose(np.sin(away / 2), 0, atol=1e-6)
    data = posecal.PoseData(x, y, unit="deg")
    np.testing.assert_allclose(spread_map.rescale(data).hypotheses.read(0, M), moved)


def test_deviations_are_arcs_and_go_on_round_the_circle() -> None:
    x = np.array([350.0, 0, 20, 170, 355]).reshape(5, 1, 1, 1)  # about 0: -10, 0, 20, 170, -5
    twice = rescaled(x, np.array([2.0]), period=360.0)
    np.testing.assert_allclose(twice[:, 0, 0, 0], [340, 0, 40, -20, 350])
    np.testing.assert_array_equal(rescaled(x, np.array([1.0]), period=360.0), x)


def test_no_factor_spreads_angles_all_round_the_circle() -> None:
    """There they are calibrated always: only factors are tried that leave nine in ten within half a turn."""
    x, y = too_narrow(30, 8)
    with pytest.raises(PoseDataError, match=r"spread: no factor from 0\.1 to 3\.[0-9]+ calibrates all joints together"):
        posecal.fit_spread(x, y, unit="deg")


def test_factors_that_are_tried_on_blocks_are_those_that_are_applied() -> None:
    x, y = too_narrow(80, 1)
    spread_map = SpreadMap(("a", "b"), np.array([2.5, 2.5]), M, 0, data_unit="deg")
    block = Block(x, y, period=360.0).scale_dispersion(2.5)
    moved = Block(spread_map.apply(x, unit="deg"), y, period=360.0)
    np.testing.assert_allclose(np.sin(np.radians(block.offsets - moved.offsets) / 2), 0, atol=1e-9)


def test_held_out_sequences_of_angles_are_judged() -> None:
    x, y = too_narrow(15, 2)
    judged = posecal.judge_spread(x, y, unit="deg", labels={"sequence": SEQUENCE})
    before, after, factors = judged.before, judged.after, judged.factors
    assert after["ece"] < 0.1 < before["ece"]
    assert after.metrics["mpjpe"].unit == "deg"
    assert all(1.7 < factor[0] < 2.3 for factor in factors)


@pytest.mark.parametrize("scaled", [False, True])
def test_a_radius_of_angles_holds_the_truth_the_shorter_way_round(scaled: bool) -> None:
    x, y = too_narrow(20, 2)
    radius_map = posecal.fit_radius(x, y, unit="deg", scaled=scaled)
    centre, radius = radius_map.apply(x, unit="deg")
    assert np.abs(centre).max() <= 180
    held = np.abs(wrap(centre - y))[..., 0] <= radius
    np.testing.assert_allclose(held.mean(axis=0), 0.9, atol=0.005)
    assert radius_map.unit == ("standard deviations" if scaled else "deg")
    in_radians = radius_map.apply(np.radians(x), unit="rad")
    np.testing.assert_allclose(np.degrees(in_radians[1]), radius, rtol=1e-6)
    coverage = held_out_coverage(x, y, unit="deg", scaled=scaled, labels={"sequence": SEQUENCE})
    np.testing.assert_allclose(coverage, 0.9, atol=0.07)


@pytest.mark.parametrize("unit", ["px", "none"])
def test_pixels_and_numbers_without_a_unit_are_recalibrated_as_lengths_are(unit: str) -> None:
    random = np.random.default_rng(1)
    y = random.normal(300, 80, (M, 4, 2))
    x = y + random.normal(0, 8, (M, 4, 2)) + random.normal(0, 4, (N, M, 4, 2))
    as_lengths, found = posecal.fit_spread(x, y, unit="mm"), posecal.fit_spread(x, y, unit=unit)
    np.testing.assert_array_equal(found.factors, as_lengths.factors)
    np.testing.assert_array_equal(found.apply(x), as_lengths.apply(x))
    radii = posecal.fit_radius(x, y, unit=unit)
    np.testing.assert_array_equal(radii.radii, posecal.fit_radius(x, y, unit="mm").radii)
    assert radii.unit == unit.replace("none", "")


@pytest.mark.parametrize(("unit", "words"), [("px", "in px; expected deg"), (None, r'Pass unit="deg" or rad')])
def test_a_map_of_angles_is_for_angles_of_a_declared_unit(unit: str | None, words: str) -> None:
    x = too_narrow(10, 1)[0]
    for map_ in (
        SpreadMap(("a", "b"), np.ones(2), M, 0, data_unit="deg"),
        RadiusMap(("a", "b"), np.ones(2), 0.1, False, M, 0, data_unit="deg"),
    ):
        with pytest.raises(PoseDataError, match=words):
            map_.apply(x, unit=unit)
    with pytest.raises(PoseDataError, match="hypotheses: in mm; expected deg"):
        SpreadMap(("joint 0", "joint 1"), np.ones(2), M, 0, data_unit="deg").rescale(
            posecal.PoseData(x, x[0], unit="mm")
        )


def test_a_radius_in_mm_is_taken_to_metres() -> None:
    x = np.random.default_rng(0).normal(0, 50, (4, 7, 2, 3))
    radius_map = RadiusMap(("a", "b"), np.array([30.0, 40.0]), 0.1, False, 99, 0)
    assert radius_map.apply(x / 1000, unit="m")[1][0] == pytest.approx([0.03, 0.04])


@pytest.mark.parametrize("unit", ["deg", "rad", "px", "none"])
def test_files_of_every_quantity_are_recalibrated_and_say_their_unit(
    unit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    x, y = too_narrow(15, 2)
    if unit == "rad":
        x, y = np.radians(x), np.radians(y)
    elif unit != "deg":
        x, y = 500 + np.abs(x - y) * np.sign(x - y) + 0 * y, y * 0 + 500
    np.savez("hyps.npz", hypotheses=x, axes="NMKD", unit=unit)
    np.savez("gt.npz", truth=y, unit=unit, sequence=SEQUENCE)
    shown = {"rad": "deg", "none": ""}.get(unit, unit)
    done = run("recalibrate", "fit", "hyps.npz", "gt.npz", "-o", "map.json", "--split", "--anyway")
    assert done.exit_code == 0, done.output
    assert " mm" not in done.output
    done = run("recalibrate", "apply", "hyps.npz", "map.json", "-o", "new.npz")
    assert done.exit_code == 0, done.output
    with np.load("new.npz") as new:
        assert str(new["unit"]) == (shown or "none")
    before, after = (posecal.evaluate(name, "gt.npz", metrics="ece") for name in ("hyps.npz", "new.npz"))
    assert after["ece"] < before["ece"]
    done = run("recalibrate", "fit", "hyps.npz", "gt.npz", "-o", "radii.json", "--radius", "0.1")
    assert f"radius, {shown}".removesuffix(", ") in done.output
    assert run("recalibrate", "apply", "hyps.npz", "radii.json", "-o", "balls.npz").exit_code == 0
    write_map(SpreadMap(("joint 0", "joint 1"), np.ones(2), M, 0), "lengths.json")
    done = run("recalibrate", "apply", "hyps.npz", "lengths.json", "-o", "no.npz")
    assert done.exit_code == 3
    assert f"in {shown or 'no unit'}; expected mm" in done.output
    assert not Path("no.npz").exists()
    with pytest.raises(PoseDataError, match="expected mm, as what the map was fitted on"):
        apply_map(SpreadMap(("joint 0", "joint 1"), np.ones(2), M, 0), "hyps.npz", "no.npz")

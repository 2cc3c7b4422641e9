"""``posecal recalibrate``: a spread or radii are fitted, judged on held-out sequences, and applied."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from posecal.recalibration import SpreadMap, read_map
from tests.helpers.flips import depth_flips
from tests.helpers.samplers import sequences
from tests.helpers.shell import MODELS_JOINTS, MODELS_SHAPE, done, refused, run

N, M, K = MODELS_SHAPE
FIT = ("recalibrate", "fit")


def test_a_spread_is_fitted_judged_on_held_out_sequences_and_applied() -> None:
    text = " ".join(done(*FIT, "narrow.npz", "true.npz", "-o", "map.json", "--split", "--folds=3").split())
    factor = re.search(r"Spread factor (\d\.\d+) for all joints, fitted on 48 poses", text)
    assert factor is not None
    assert 2 < float(factor[1]) < 3
    assert "held out, 3 parts" in text
    assert "It helps held-out sequences: energy score -" in text
    applied = run("recalibrate", "apply", "narrow.npz", "map.json", "-o", "rescaled.npz")
    assert (applied.exit_code, applied.stdout, applied.stderr) == (0, "", "rescaled.npz: 48 poses.\n")
    map_ = read_map("map.json")
    assert isinstance(map_, SpreadMap)
    with np.load("rescaled.npz") as after, np.load("narrow.npz") as narrow:
        np.testing.assert_array_equal(after["hypotheses"].swapaxes(0, 1), map_.apply(narrow["hypotheses"]))
        np.testing.assert_array_equal(after["frame_id"], narrow["frame_id"])
    assert "energy score: rescaled is best beyond chance" in done("compare", "rescaled.npz", "narrow.npz", "true.npz")


def test_what_a_file_says_of_its_hypotheses_goes_with_them() -> None:
    done(*FIT, "narrow.npz", "true.npz", "-o", "map.json")
    said = {"scores": np.arange(N * M, dtype="f4").reshape(N, M), "occluded": np.arange(M * K).reshape(M, K) % 3 == 0}
    said |= {"action": np.repeat(["walk", "sit"], M // 2), "fps": np.array(25.0)}
    with np.load("narrow.npz") as narrow:
        np.savez("scored.npz", hypotheses=narrow["hypotheses"], joints=MODELS_JOINTS, axes="NMKD", **said)
    done("recalibrate", "apply", "scored.npz", "map.json", "-o", "rescaled.npz")
    with np.load("rescaled.npz") as after:
        for name, values in said.items():
            np.testing.assert_array_equal(after[name], values)


def test_flags_declare_what_the_hypotheses_don_t() -> None:
    done(*FIT, "narrow.npz", "true.npz", "-o", "map.json", "--per-joint")
    done("recalibrate", "apply", "narrow.npz", "map.json", "-o", "one.npz")
    with np.load("narrow.npz") as narrow:
        np.savez("bare.npz", hypotheses=narrow["hypotheses"].swapaxes(0, 1) / 1000)
    np.savez("named.npz", hypotheses=np.zeros((N, M, 2, 3)), joints=["Head", "Hip"])
    words = ("recalibrate", "apply", "bare.npz", "map.json", "-o", "two.npz", "--axes=MNKD", "--unit=m")
    assert refused(*words) == (
        "posecal: bare.npz has joints that the map lacks: joint 0, joint 1, joint 2, joint 3. "
        "Fit a map on these joints."
    )
    assert "named.npz has joints that the map lacks: Hip." in refused(
        *words[:2], "named.npz", *words[3:6], "--axes=NMKD"
    )
    assert "axes: 'MND' lacks K" in refused(*words[:-2], "--axes=MND", code=2)
    assert "--root-joint: 'Tail' is not among the joints." in refused(
        *words[:2], "narrow.npz", *words[3:6], "--root-joint=Tail"
    )


def test_each_joint_gets_its_factor() -> None:
    text = done(*FIT, "narrow.npz", "true.npz", "-o", "joints.json", "--per-joint")
    assert "A spread factor for each of 4 joints" in text
    assert all(joint in text for joint in MODELS_JOINTS)
    assert "Judged on these poses alone: --split says" in " ".join(text.split())


def test_radii_are_fitted_judged_and_applied() -> None:
    text = done(*FIT, "right.npz", "true.npz", "-o", "radii.json", "--radius=0.2", "--split", "--folds=3")
    assert "80%" in text
    assert "held-out coverage" in text
    done("recalibrate", "apply", "right.npz", "radii.json", "-o", "balls.npz")
    with np.load("balls.npz") as balls:
        assert balls["centre"].shape == (M, K, 3)
        assert balls["radius"].shape == (M, K)


def test_radii_may_be_in_standard_deviations() -> None:
    text = done(*FIT, "right.npz", "true.npz", "-o", "radii.json", "--radius=0.2", "--scaled")
    assert "radius, standard deviations" in text
    assert read_map("radii.json").unit == "standard deviations"  # type: ignore[union-attr]


@pytest.fixture
def flips() -> None:
    x, y = depth_flips(0, 30, 60, 4)
    np.savez("flips.npz", hypotheses=x, joints=MODELS_JOINTS, axes="NMKD", unit="mm")
    np.savez("limbs.npz", truth=y, joints=MODELS_JOINTS, unit="mm", sequence=sequences(60, 12))


@pytest.mark.usefixtures("flips")
@pytest.mark.parametrize("split", [(), ("--split", "--folds=3")])
def test_a_factor_that_makes_scores_worse_is_shown_and_written_only_anyway(split: tuple[str, ...]) -> None:
    words = (*FIT, "flips.npz", "limbs.npz", "-o", "flips.json", "--root-joint=none", *split)
    result = run(*words)
    assert result.exit_code == 3
    assert "Not recommended: " in result.stdout
    assert "--about modes rescales each about its own centre" in " ".join(result.stdout.split())
    where = "held-out sequences" if split else "the poses that it was fitted on"
    assert result.stderr.startswith(f"posecal: map: on {where}, the energy score rises from ")
    assert result.stderr.endswith(
        "; expected a map that helps. Not written; to write it all the same, pass --anyway.\n"
    )
    assert not Path("flips.json").exists()
    assert "Not recommended: " in done(*words, "--anyway")
    map_ = read_map("flips.json")
    assert isinstance(map_, SpreadMap)
    assert map_.objections


@pytest.mark.usefixtures("flips")
def test_hypotheses_are_rescaled_about_their_modes() -> None:
    fitted = (*FIT, "flips.npz", "limbs.npz", "-o", "modes.json", "--root-joint=none", "--about=modes")
    text = " ".join(done(*fitted).split())
    assert "for all joints, about the modes of Head, LWrist, RKnee and LFoot, fitted on 60 poses." in text
    done("recalibrate", "apply", "flips.npz", "modes.json", "-o", "moved.npz", "--root-joint=none")
    map_ = read_map("modes.json")
    assert isinstance(map_, SpreadMap)
    assert map_.modal == tuple(MODELS_JOINTS.tolist())
    with np.load("moved.npz") as moved, np.load("flips.npz") as flips:
        np.testing.assert_allclose(moved["hypotheses"].swapaxes(0, 1), map_.apply(flips["hypotheses"]), rtol=1e-12)
    said = refused(*FIT, "narrow.npz", "true.npz", "-o", "none.json", "--about=modes")
    assert "--about: 'modes'" in said or "about: 'modes'" in said


def test_an_impossible_alpha_is_refused_with_the_smallest() -> None:
    said = refused(*FIT, "right.npz", "true.npz", "-o", "none.json", "--radius=0.001")
    assert "alpha: 0.001 needs more than 48 poses; the smallest possible with them is 0.02041" in said
    assert not Path("none.json").exists()


def test_a_broken_map_is_refused_and_nothing_is_written() -> None:
    Path("bad.json").write_text('{"format": 4}')
    said = refused("recalibrate", "apply", "narrow.npz", "bad.json", "-o", "out.npz")
    assert "bad.json: no map of posecal recalibrate fit" in said
    assert not Path("out.npz").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--scaled"], "goes with --radius only."),
        (["--radius=0.1", "--per-joint"], "radii are per joint always."),
        (["--radius=0.1", "--about=modes"], "goes with a spread factor, not with --radius."),
        (["--radius=0.1", "--anyway"], "goes with a spread factor, not with --radius."),
        (["--about=mean"], "'--about'"),
        (["--split", "--folds=1"], "'--folds'"),
        (["--unit=inch"], "unit: 'inch'; expected mm, cm, m"),
    ],
)
def test_options_that_do_not_go_together_are_a_wrong_call(options: list[str], words: str) -> None:
    assert words in refused(*FIT, "right.npz", "true.npz", "-o", "none.json", *options, code=2)


def test_more_parts_than_sequences_are_refused() -> None:
    said = refused(*FIT, "right.npz", "true.npz", "-o", "none.json", "--split", "--folds=13")
    assert "folds: 13; expected 2 to 12" in said
    assert not Path("none.json").exists()

"""Cameras, bodies, mirror images and limbs that are drawn anew for every batch of motion capture."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posecal.data.skeleton import Skeleton, joint_set
from posecal.errors import PoseDataError
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.data.bones import Bones
from posecal_models.data.cameras import Camera
from posecal_models.data.detector import Detector
from posecal_models.data.fresh_views import FreshViews
from posecal_models.data.masks import remove_keypoints
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.training_set import seeded_generator
from posecal_models.preparation import split

JOINTS = joint_set("h36m-16")
EXACT = Detector(sigma=0.0, hidden_share=0.0)
ROWS = torch.arange(40)


def views(motion_file, **options) -> FreshViews:
    mocap = MocapPoses(motion_file)
    options = {"detector": EXACT, **options}
    return FreshViews(mocap, np.arange(len(mocap.poses)), JOINTS, JOINTS, **options)


def lengths(poses: torch.Tensor) -> torch.Tensor:
    """Lengths of the bones, the root first, (M, 17)."""
    whole = torch.cat([torch.zeros_like(poses[:, :1]), poses], dim=1)
    parents = list(Skeleton(joint_set("h36m-17")).parents)
    return torch.linalg.vector_norm(whole - whole[:, parents], dim=-1)[:, 1:]


def test_an_image_is_that_of_a_camera_that_looks_at_the_clip(motion_file):
    data = views(motion_file)
    context, truth = data.batch(ROWS, seeded_generator(1))
    rotation, position = data._cameras(ROWS, seeded_generator(1))
    mocap = MocapPoses(motion_file)
    order = [mocap.joints.index(name) for name in JOINTS]
    for m in range(0, 40, 13):
        middle = data._middles[m].numpy()
        camera = Camera.looking_at(tuple(position[m].tolist()), tuple(middle.tolist()))
        np.testing.assert_allclose(rotation[m].numpy(), camera.rotation, atol=1e-5)
        np.testing.assert_allclose(context.keypoints[m].numpy(), camera.project(mocap.poses[m][order]), atol=0.02)
        root = mocap.poses[m, mocap.joints.index("Hip")]
        np.testing.assert_allclose(truth[m].numpy(), camera.rotate(mocap.poses[m][order] - root), atol=0.02)
        distance = float(np.hypot(*(position[m].numpy() - middle)[:2]))
        assert 0.9 <= distance / float(data._radii[m]) <= 1.1
    azimuth = torch.atan2(*(position - data._middles[ROWS])[:, :2].T)
    assert azimuth.std() > 1


def test_every_batch_has_other_cameras_and_a_seed_repeats_them(motion_file):
    data = views(motion_file, mirror=True, limb_exchange=0.5, body_variation=0.06)
    first, same, other = (data.batch(ROWS, seeded_generator(step))[1] for step in (1, 1, 2))
    assert torch.equal(first, same)
    assert not torch.isclose(first, other).all(-1).all(-1).any()


def test_mirror_images_keep_the_sides_of_the_body(motion_file):
    """The turn from right to left hip, along the trunk, to the front is the same in mirror images."""
    plain, mirrored = (
        views(motion_file, mirror=mirror).batch(ROWS, seeded_generator(3))[1] for mirror in (False, True)
    )
    flipped = ~torch.isclose(plain, mirrored).all(-1).all(-1)
    assert 8 < int(flipped.sum()) < 32
    at = {name: k for k, name in enumerate(JOINTS)}
    other = [at[{"L": "R", "R": "L"}.get(name[0], name[0]) + name[1:]] for name in JOINTS]
    torch.testing.assert_close(mirrored[flipped], plain[flipped][:, other] * torch.tensor([-1.0, 1, 1]))


def test_bones_vary_alike_on_both_sides_and_by_as_much_as_is_said(motion_file):
    rows = torch.arange(40).repeat(50)
    plain, varied = (
        lengths(views(motion_file, body_variation=b).batch(rows, seeded_generator(4))[1]) for b in (0.0, 0.06)
    )
    log_ratio = (varied / plain).log()
    names = joint_set("h36m-17")[1:]
    assert 0.05 < float(log_ratio.std()) < 0.07
    for part in ("Knee", "Foot", "Elbow", "Wrist"):
        left, right = (log_ratio[:, names.index(side + part)] for side in "LR")
        torch.testing.assert_close(left, right, atol=1e-3, rtol=0)


def test_exchanged_limbs_keep_their_own_lengths_and_the_joint_they_hang_on(motion_file):
    data = views(motion_file, limb_exchange=1.0)
    before = data.poses[ROWS]
    after = data._exchange_limbs(before, seeded_generator(5))
    names = joint_set("h36m-17")
    trunk = [names.index(n) for n in ("Hip", "LHip", "RHip", "Spine", "Thorax", "Head", "LShoulder", "RShoulder")]
    assert torch.equal(after[:, trunk], before[:, trunk])
    knee, hip = names.index("LKnee"), names.index("LHip")
    thighs, before_thighs = (
        torch.linalg.vector_norm(p[:, knee] - p[:, hip], dim=-1).sort().values for p in (after, before)
    )
    torch.testing.assert_close(thighs, before_thighs)
    moved = ~torch.isclose(after[:, knee], before[:, knee]).all(-1)
    assert moved.float().mean() > 0.8


def test_people_who_are_held_out_are_not_there(motion_file):
    config = Config.from_table({"data": {"views": 0, "test_subjects": ["S4"], "validation_subjects": ["S3"]}}).data
    mocap = MocapPoses(motion_file)
    data = FreshViews.from_config(mocap, config, JOINTS, JOINTS)
    assert len(data) == int(np.isin(mocap.subject, ["S1", "S2"]).sum())
    training, validation, _ = split(motion_file, config)
    assert len(training) == len(data)
    assert set(validation.camera.tolist()) == {"0", "1", "2", "3"}


@pytest.mark.parametrize("data", [{"mirror": True}, {"limb_exchange": 0.5}])
def test_what_needs_new_cameras_is_refused_with_fixed_ones(data):
    with pytest.raises(PoseDataError, match=r"given with data\.views = 4; expected 0, a new camera"):
        Config.from_table({"data": data})


def test_limbs_that_are_not_there_are_named(motion_file, tmp_path):
    members = dict(np.load(motion_file))
    members["joints"] = np.array([str(name).replace("LWrist", "LHand") for name in members["joints"]])
    np.savez(tmp_path / "other.npz", **members)
    mocap = MocapPoses(tmp_path / "other.npz")
    with pytest.raises(PoseDataError, match=r"^data\.limb_exchange: the poses have no LWrist; expected the joints"):
        FreshViews(mocap, np.arange(3), JOINTS[:5], JOINTS[:5], detector=EXACT, limb_exchange=0.5)


def test_exchanged_limbs_lie_to_the_shoulders_as_they_lay_to_their_own(motion_file):
    """The upper arm's share along the shoulders is that of one of the poses."""
    data = views(motion_file, limb_exchange=1.0)
    names = joint_set("h36m-17")
    left, right, elbow = (names.index(name) for name in ("LShoulder", "RShoulder", "LElbow"))

    def along(poses: torch.Tensor) -> torch.Tensor:
        across = torch.nn.functional.normalize(poses[:, left] - poses[:, right], dim=-1)
        return ((poses[:, elbow] - poses[:, left]) * across).sum(-1)

    poses = data.poses[:160]  # of people who turn to all sides
    after = along(data._exchange_limbs(poses, seeded_generator(6)))
    torch.testing.assert_close(after.sort().values, along(poses).sort().values, atol=0.05, rtol=0)
    assert not torch.allclose(after, along(poses), atol=1.0)


def test_of_a_removed_keypoint_nothing_is_left():
    sigma = torch.full((4000, 16), 25.0)
    whole = Context(torch.zeros(4000, 16, 2), torch.ones(4000, 16, dtype=torch.bool), sigma)
    left = remove_keypoints(whole, 0.25, seeded_generator(7))
    assert torch.equal(left.sigma.isinf(), ~left.observed)
    assert torch.equal(left.sigma[left.observed], sigma[left.observed])
    share = float((~left.observed).float().mean())
    assert abs(share - 0.125) < 0.02


def test_bones_are_as_many_times_as_long_in_their_directions():
    bones = Bones(("Hip", "RHip", "RKnee", "LHip"))
    generator = torch.Generator().manual_seed(0)
    poses = 100 * torch.randn((5, 4, 3), generator=generator)
    factor = 0.5 + torch.rand((5, bones.kinds), generator=generator)
    found = bones.stretch(poses, factor)
    torch.testing.assert_close(found[:, 0], poses[:, 0])
    kinds = sorted({"Hip", "Knee"})
    for child, parent, kind in ((1, 0, "Hip"), (3, 0, "Hip"), (2, 1, "Knee")):
        expected = factor[:, kinds.index(kind), None] * (poses[:, child] - poses[:, parent])
        torch.testing.assert_close(found[:, child] - found[:, parent], expected)

"""What is needed before the first step? Poses split by subject, an estimator, and the constants of its standardizer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import load_estimator
from posecal_models.config import Config, DataConfig, ModelConfig
from posecal_models.contract import Context
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.npz import read_npz
from posecal_models.data.standardizer import check_pixels
from posecal_models.data.training_set import TrainingSet, seeded
from posecal_models.distributed import Crew
from posecal_models.estimators import ReferenceEstimator, describe, keypoints_of, of_config
from posecal_models.gaussian_noise import GaussianNoise
from posecal_models.simple_baseline import SimpleBaseline
from posecal_models.train import Training
from posecal_models.training_folder import CHECKPOINT, check_folder, digests

__all__ = ["prepare", "split"]

_FIT_POSES = 20_000


def split(path: str | Path, config: DataConfig) -> tuple[LiftingSet, LiftingSet | None, bool]:
    """Read poses and part them by subject.

    Parameters
    ----------
    path : str or Path
        Motion capture (:class:`posecal_models.data.mocap.MocapPoses`), seen by virtual cameras; or pairs of poses and
        keypoints (:class:`posecal_models.data.lifting_set.LiftingSet`).
    config : DataConfig
        Which subjects are for what.

    Returns
    -------
    training : LiftingSet
        All subjects but those for validation and test.
    validation : LiftingSet or None
        Evenly spread poses of the validation subjects.
    clean : bool
        Whether keypoints are exact, so that a detector's noise is yet to be drawn.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read or a subject is not there.
    """
    held_out = (*config.test_subjects, *config.validation_subjects)
    clean = "poses" in read_npz(path)
    if clean:
        mocap = MocapPoses(path)
        training = mocap.seen_by_cameras(
            views=config.views,
            every=config.every,
            but_not=held_out,
            body_variation=config.body_variation,
            seed=config.camera_seed,
        )
        rest = None
        if config.validation_subjects:
            rest = mocap.seen_by_cameras(
                views=config.views,
                every=config.every,
                subjects=config.validation_subjects,
                seed=config.camera_seed,
            )
    else:
        pairs = LiftingSet.load(path)
        known = set(pairs.subject.tolist())
        if missing := sorted(set(held_out) - known):
            raise PoseDataError(
                f"{path}: subjects {', '.join(missing)} not there; there are {', '.join(sorted(known))}."
            )
        training = pairs.take(~np.isin(pairs.subject, held_out))
        rest = pairs.take(np.isin(pairs.subject, config.validation_subjects)) if config.validation_subjects else None
    if not len(training):
        raise PoseDataError(f"{path}: no pose is left for training. Hold out fewer subjects.")
    if rest is not None and len(rest) > config.validation_poses:
        rest = rest.take(np.linspace(0, len(rest) - 1, config.validation_poses).astype(int))
    return training, rest, clean


def prepare(
    config: Config,
    path: str | Path,
    folder: Path,
    *,
    device: torch.device | str = "cpu",
    resume: bool = False,
    crew: Crew | None = None,
) -> Training:
    """Make a training ready to run.

    Parameters
    ----------
    config : Config
        How.
    path : str or Path
        The poses, as :func:`split` reads them.
    folder : Path
        Where its files go; it is made if its parent is there.
    device : torch.device or str
        Where it computes.
    resume : bool
        Go on from the folder's checkpoint if there is one.
    crew : Crew, optional
        The processes that train together.

    Returns
    -------
    Training
        At its first step, or where it was.

    Raises
    ------
    PoseFileError, PoseDataError
        Where something does not fit, a process would have no pose of a batch, a file could not be written, or the
        folder holds a training already and ``resume`` was not asked for.
    """
    crew = crew or Crew()
    crew.check_batch(config.train.batch)
    check_folder(folder, resume=resume)
    mean = _mean(config.model)
    training, validation, clean = split(path, config.data)
    estimator = _estimator(config, mean, _keypoints(config.model, training))
    order = (estimator.joints, estimator.keypoints)
    for poses in filter(None, (training, validation)):
        seen = poses.in_order_of(*order)
        estimator.check(Context(torch.from_numpy(seen.keypoints), torch.from_numpy(seen.observed)))
    detector = config.data.detector if clean else None
    data = TrainingSet(training, *order, detector=detector, device=device)
    judged = None if validation is None else TrainingSet(validation, *order, detector=detector, device=device)
    rows = torch.linspace(0, len(data) - 1, min(len(data), _FIT_POSES), device=data.device).long()
    context, truth = data.batch(rows, seeded(data.device, config.train.seed))
    context, truth = context.to("cpu"), truth.cpu()
    check_pixels(context)
    if not isinstance(estimator, GaussianNoise) and not config.model.start and config.model.units == "fitted":
        estimator.standardizer.fit(truth, context.keypoints, context.observed)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as problem:
        raise PoseFileError(f"{folder}: can't be made ({problem.strerror}).") from problem
    run = Training(
        estimator.to(device), config, data, folder=folder, validation=judged, crew=crew, digests=digests(path)
    )
    if resume and (folder / CHECKPOINT).exists():
        run.resume()
    return run


def _keypoints(config: ModelConfig, training: LiftingSet) -> tuple[str, ...] | None:
    """Name the keypoints that a SimpleBaseline can learn to read: those that some image of the training set has."""
    if config.kind != "simple-baseline":
        return None
    wanted = keypoints_of(config)
    seen = training.in_order_of(keypoint_joints=wanted).keypoints
    there = tuple(name for j, name in enumerate(wanted) if np.isfinite(seen[:, j]).any())
    if config.origin == "root" and wanted[0] not in there:
        raise PoseDataError(
            f"keypoints: no image has the {wanted[0]}'s, and model.origin = root reads the others relative to it. "
            "Give it, or leave model.origin as it is."
        )
    return there


def _mean(config: ModelConfig) -> SimpleBaseline | None:
    """Load the point estimator of a Gaussian noise model."""
    if config.kind != "gaussian-noise":
        return None
    if not config.mean:
        raise PoseDataError("model.mean: not given; expected the weights file of a trained SimpleBaseline.")
    mean = load_estimator(config.mean)
    if not isinstance(mean, SimpleBaseline):
        raise PoseDataError(f"model.mean: {config.mean} holds a {type(mean).__name__}, not a SimpleBaseline.")
    return mean


def _estimator(config: Config, mean: SimpleBaseline | None, keypoints: tuple[str, ...] | None) -> ReferenceEstimator:
    """Build what is trained, or load what training starts from."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.train.seed)
        estimator = of_config(config.model, mean=mean, keypoints=keypoints)
    if not config.model.start:
        return estimator
    started = load_estimator(config.model.start)
    wanted, found = describe(estimator), describe(started)
    differ = [name for name in wanted if wanted[name] != found.get(name)]
    if isinstance(started, GaussianNoise) and mean is not None and not differ:
        own = mean.state_dict()
        if any(not torch.equal(tensor, own[name]) for name, tensor in started.mean.state_dict().items()):
            differ = ["the weights of the mean"]
    if differ:
        raise PoseDataError(
            f"model.start: {config.model.start} differs from the configuration in {', '.join(differ)}. "
            "Say in [model] what it is of."
        )
    return started

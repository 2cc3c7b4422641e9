"""The folder of a training: checkpoint, weights and loss curve, and checks before resuming."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posecal.data.write import check_writable, write_file
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.config import Config
from posecal_models.data.npz import read_npz

__all__ = ["CHECKPOINT", "LOSSES", "WEIGHTS", "check_folder", "check_same", "digests", "write_losses"]

CHECKPOINT, WEIGHTS, LOSSES = "checkpoint.safetensors", "weights.safetensors", "losses.csv"

_MEMBERS = {
    *("joints", "keypoint_joints", "axes", "unit", "up", "subject", "clip_id", "root_relative"),
    *("poses", "truth", "gt", "occluded", "keypoints_2d", "keypoints_observed", "keypoints_sigma"),
}


def check_folder(folder: Path, *, resume: bool) -> None:
    """Check, before any computation, that a training can write its files without overwriting those of another.

    Parameters
    ----------
    folder : Path
        Output folder; its parent must exist.
    resume : bool
        Whether to resume the training in the folder.

    Raises
    ------
    PoseFileError
        Where a file can't be written, where there is a training and ``resume`` is false, or where there are weights or
        losses without a checkpoint to resume from.
    """
    if not folder.is_dir():
        if folder.exists() or not folder.parent.is_dir():
            why = "a file of that name is there" if folder.exists() else f"the folder {folder.parent} does not exist"
            raise PoseFileError(f"{folder}: can't be made ({why}).")
        check_writable(folder)
        return
    for name in (CHECKPOINT, WEIGHTS, LOSSES):
        check_writable(folder / name)
    existing = [name for name in (CHECKPOINT, WEIGHTS, LOSSES) if (folder / name).exists()]
    if CHECKPOINT in existing and not resume:
        raise PoseFileError(f"{folder}: holds a training already. Pass --resume to continue, or give another folder.")
    if existing and CHECKPOINT not in existing:
        raise PoseFileError(
            f"{folder}: holds {' and '.join(existing)}, but no {CHECKPOINT} to resume from. "
            "Give another folder; model.start starts from existing weights."
        )


def write_losses(folder: Path, epochs: Sequence[tuple[float, ...]]) -> None:
    """Write the loss curve, atomically.

    Parameters
    ----------
    folder : Path
        Output folder.
    epochs : sequence of tuple
        Epoch, step, learning rate, training loss and validation loss (NaN: no validation) of each.

    Raises
    ------
    PoseFileError
        Where it can't be written.
    """
    lines = ["epoch,step,learning_rate,training_loss,validation_loss"]
    lines += [f"{e:.0f},{s:.0f},{rate:.6g},{train:.8g},{val:.8g}" for e, s, rate, train, val in epochs]
    text = "\n".join(lines) + "\n"
    write_file(folder / LOSSES, lambda file: file.write(text.encode()))


def digests(path: str | Path) -> dict[str, str]:
    """Compute a digest of each array that a training reads, to recognise the same data.

    Digests are of the numbers as stored in the file, so that they are the same on every machine.

    Parameters
    ----------
    path : str or Path
        Motion capture, or pairs of poses and keypoints.

    Returns
    -------
    dict of str to str
        Digests by the array's name.

    Raises
    ------
    PoseFileError
        Where the file can't be read.
    """
    by_name = {}
    for name, array in read_npz(path).items():
        if name in _MEMBERS:
            digest = hashlib.blake2b(f"{array.dtype.str[1:]} {array.shape}".encode(), digest_size=8)
            digest.update(array.astype(array.dtype.newbyteorder("<")).tobytes())
            by_name[name] = digest.hexdigest()
    return by_name


def check_same(path: Path, before: Mapping[str, Any], config: Config, data: Mapping[str, str]) -> None:
    """Check that a checkpoint is of the same configuration and the same data.

    Parameters
    ----------
    path : Path
        The checkpoint.
    before : mapping
        Its training: ``config`` and the digests of its ``data``. Checkpoints of older versions lack the digests and
        resume with any data.
    config : Config
        The current configuration; its number of epochs may differ.
    data : mapping of str to str
        The current digests; empty where they are not known.

    Raises
    ------
    PoseDataError
        Where a setting or the data differ.
    """
    then, now, default = before["config"], config.table(), Config().table()
    names = [(table, name) for table in ("model", "data", "train") for name in now[table]]
    names.remove(("train", "epochs"))
    changed = [f"{t}.{n}" for t, n in names if _plain(then[t].get(n, default[t][n])) != _plain(now[t][n])]
    if changed:
        raise PoseDataError(
            f"{path}: of another configuration ({', '.join(changed)} differ). "
            "Give the configuration it was started with, or another folder."
        )
    known: Mapping[str, str] = before.get("data") or data
    if data and (other := sorted(name for name in {*known, *data} if known.get(name) != data.get(name))):
        raise PoseDataError(
            f"{path}: of other data ({', '.join(other)} differ). Give the data it was started with, or another folder."
        )


def _plain(value: Any) -> Any:
    """Convert tuples to lists, as JSON does."""
    if isinstance(value, dict):
        return {name: _plain(setting) for name, setting in value.items()}
    return [_plain(element) for element in value] if isinstance(value, (list, tuple)) else value

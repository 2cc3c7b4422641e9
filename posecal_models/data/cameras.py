"""What does a camera see of a pose in the room? Pinhole cameras, and four of them around each motion capture clip.

Rooms have z up, in mm. A camera's frame has x to the right, y down and z away from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError
from posecal_models.data.npz import labels, read_npz, real_numbers

__all__ = ["Camera", "cameras_around", "read_cameras"]

Array = npt.NDArray[np.float64]

H36M_FOCAL = 1146.0
H36M_CENTRE = (514.0, 507.0)
"""Round numbers near the intrinsics of Human3.6M's four cameras, pixels of a 1000 x 1000 image."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes
    ----------
    rotation : ndarray
        (3, 3): rows are the camera's axes in the room.
    position : ndarray
        (3,), mm: where it stands.
    focal : float
        Pixels.
    centre : tuple of float
        Where the optical axis meets the image, pixels.

    Examples
    --------
    >>> camera = Camera.looking_at((0, -5000, 0), (0, 0, 0), focal=1000, centre=(500, 500))
    >>> camera.turn(np.array([[0.0, 0, 100]]))  # up in the room is against y in the image
    array([[   0., -100.,    0.]])
    >>> camera.project(np.array([[100.0, 0, 0], [0, 0, 100]]))  # 100 mm at 5 m: 100 * 1000 / 5000 = 20 pixels
    array([[520., 500.],
           [500., 480.]])
    """

    rotation: Array
    position: Array
    focal: float = H36M_FOCAL
    centre: tuple[float, float] = H36M_CENTRE

    @classmethod
    def looking_at(
        cls,
        position: tuple[float, float, float],
        target: tuple[float, float, float],
        *,
        focal: float = H36M_FOCAL,
        centre: tuple[float, float] = H36M_CENTRE,
    ) -> Camera:
        """Point a level camera at a target.

        Parameters
        ----------
        position, target : tuple of float
            mm, z up.
        focal, centre : float, tuple of float
            Pixels.

        Returns
        -------
        Camera
            With its x axis horizontal.

        Raises
        ------
        PoseDataError
            Where the camera would look straight up or down.
        """
        ahead = np.subtract(target, position).astype(float)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        if np.linalg.norm(right) == 0:
            raise PoseDataError(f"camera at {position}: looks straight along z at {target}. Move it aside.")
        axes = np.array([right, np.cross(ahead, right), ahead])
        return cls(axes / np.linalg.norm(axes, axis=1, keepdims=True), np.array(position, float), focal, centre)

    def turn(self, vectors: npt.NDArray[np.floating]) -> Array:
        """Turn directions or root-relative positions (..., 3), mm, from the room's frame into the camera's."""
        return vectors @ self.rotation.T + 0.0

    def project(self, points: npt.NDArray[np.floating]) -> Array:
        """Project points of the room onto the image.

        Parameters
        ----------
        points : ndarray
            (..., 3), mm.

        Returns
        -------
        ndarray
            (..., 2), pixels.

        Raises
        ------
        PoseDataError
            Where a point lies behind the camera.
        """
        seen = self.turn(points - self.position)
        if (seen[..., 2] <= 0).any():
            raise PoseDataError(
                f"{int((seen[..., 2] <= 0).sum()):,} of {seen[..., 2].size:,} points lie behind the camera "
                f"at {self.position.round()}; expected all before it. Move it back."
            )
        return seen[..., :2] / seen[..., 2:] * self.focal + self.centre


def cameras_around(
    roots: npt.NDArray[np.floating],
    generator: np.random.Generator,
    *,
    views: int = 4,
    distance: float = 5000.0,
    height: float = 1500.0,
) -> list[Camera]:
    """Stand cameras around somebody who moves, as Human3.6M's stand in the corners of its room.

    Parameters
    ----------
    roots : ndarray
        (M, 3), mm: where the hip is in the frames of one clip.
    generator : numpy.random.Generator
        Turns the ring of cameras and moves each a little.
    views : int
        How many cameras, evenly spaced around.
    distance : float
        From each camera to the middle of the way, mm, and as much further as the way is wide; varied by 10 %.
    height : float
        Of the cameras above the floor, mm; varied by 10 %.

    Returns
    -------
    list of Camera
        All look at the middle of the way.
    """
    low, high = roots.min(axis=0), roots.max(axis=0)
    middle = (low + high) / 2
    radius = distance + float(np.hypot(*(high - low)[:2])) / 2
    turn = generator.uniform(0, 2 * np.pi)
    cameras = []
    for view in range(views):
        angle = turn + 2 * np.pi * view / views
        away = radius * generator.uniform(0.9, 1.1)
        position = (
            float(middle[0] + away * np.cos(angle)),
            float(middle[1] + away * np.sin(angle)),
            float(height * generator.uniform(0.9, 1.1)),
        )
        cameras.append(Camera.looking_at(position, (float(middle[0]), float(middle[1]), float(middle[2]))))
    return cameras


def read_cameras(path: str | Path) -> dict[str, list[Camera]]:
    """Read the cameras of a data set from an ``.npz``.

    Parameters
    ----------
    path : str or Path
        With ``subject`` (C,), ``rotation`` (C, 3, 3) whose rows are the camera's axes in the room, ``position``
        (C, 3) in mm, and, if there are, ``focal`` (C,) and ``centre`` (C, 2) in pixels.

    Returns
    -------
    dict of str to list of Camera
        Those of each subject, in the file's order.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read, a shape is another, a number is not finite, or a rotation is none.
    """
    members = read_npz(path, required=("subject", "rotation", "position"))
    subject = labels(members["subject"], f"{path}: subject")
    count = len(subject)
    defaults = {"focal": np.full(count, H36M_FOCAL), "centre": np.tile(H36M_CENTRE, (count, 1))}
    shapes = {"rotation": (count, 3, 3), "position": (count, 3), "focal": (count,), "centre": (count, 2)}
    stored: dict[str, Array] = {}
    for name, shape in shapes.items():
        array = real_numbers(members.get(name, defaults.get(name)), f"{path}: {name}").astype(np.float64)
        if array.shape != shape:
            raise PoseDataError(f"{path}: {name} {array.shape}; expected {shape}.")
        if not np.isfinite(array).all():
            raise PoseDataError(f"{path}: {name} is not finite everywhere; expected the numbers of {count} cameras.")
        stored[name] = array
    rotation, position, focal, centre = stored.values()
    off = np.abs(rotation @ rotation.mT - np.eye(3)).max(axis=(1, 2))
    wrong = (off > 1e-3) | (np.linalg.det(rotation) < 0)
    if wrong.any():
        first = int(wrong.argmax())
        raise PoseDataError(
            f"{path}: rotation of camera {first} is none (R R^T is {off[first]:.3g} off I, det R is "
            f"{np.linalg.det(rotation[first]):.3g})."
        )
    found: dict[str, list[Camera]] = {}
    for index, name in enumerate(subject.tolist()):
        middle = (float(centre[index, 0]), float(centre[index, 1]))
        found.setdefault(name, []).append(Camera(rotation[index], position[index], float(focal[index]), middle))
    return found

"""Pinhole cameras, and rings of virtual cameras around motion capture clips.

World coordinates have z up, in mm. A camera's frame has x to the right, y down and z away from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError
from posecal_models.data.npz import numeric_array, read_npz, text_array

__all__ = ["Camera", "cameras_around", "read_cameras", "ring_around"]

Array = npt.NDArray[np.float64]

H36M_FOCAL = 1146.0
H36M_CENTRE = (514.0, 507.0)
"""Round numbers near the intrinsics of Human3.6M's four cameras, pixels of a 1000 x 1000 image."""
CAMERA_DISTANCE, CAMERA_HEIGHT = 5000.0, 1500.0
"""Of virtual cameras: distance from the middle of a short path, and height above the floor, mm."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes
    ----------
    rotation : ndarray
        (3, 3): rows are the camera's axes in world coordinates.
    position : ndarray
        (3,), mm, in world coordinates.
    focal : float
        Focal length, pixels.
    centre : tuple of float
        Principal point, pixels.

    Examples
    --------
    >>> camera = Camera.looking_at((0, -5000, 0), (0, 0, 0), focal=1000, centre=(500, 500))
    >>> camera.rotate(np.array([[0.0, 0, 100]]))  # up in the world is against y in the image
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
        """Build a level camera that points at a target.

        Parameters
        ----------
        position, target : tuple of float
            mm, z up.
        focal, centre : float, tuple of float
            Focal length and principal point, pixels.

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
            raise PoseDataError(f"camera at {position}: points along z at {target}; expected another direction.")
        axes = np.array([right, np.cross(ahead, right), ahead])
        return cls(axes / np.linalg.norm(axes, axis=1, keepdims=True), np.array(position, float), focal, centre)

    def rotate(self, vectors: npt.NDArray[np.floating]) -> Array:
        """Rotate directions or root-relative positions (..., 3), mm, from world into camera coordinates."""
        return vectors @ self.rotation.T + 0.0

    def project(self, points: npt.NDArray[np.floating]) -> Array:
        """Project points in world coordinates onto the image.

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
        in_camera = self.rotate(points - self.position)
        behind = in_camera[..., 2] <= 0
        if behind.any():
            raise PoseDataError(
                f"{int(behind.sum()):,} of {behind.size:,} points lie behind the camera at {self.position.round()}; "
                "expected all in front of it. Move it back."
            )
        return in_camera[..., :2] / in_camera[..., 2:] * self.focal + self.centre


def ring_around(roots: npt.NDArray[np.floating], distance: float = CAMERA_DISTANCE) -> tuple[Array, float]:
    """Find where cameras stand around a moving person.

    Parameters
    ----------
    roots : ndarray
        (M, 3), mm: positions of the hip in the frames of one clip.
    distance : float
        Distance of the cameras from a person who stays in one place, mm.

    Returns
    -------
    middle : ndarray
        (3,), mm, of the path.
    radius : float
        Distance of the cameras from it, mm: half of the path's extent is added.
    """
    low, high = roots.min(axis=0), roots.max(axis=0)
    return (low + high) / 2, distance + float(np.hypot(*(high - low)[:2])) / 2


def cameras_around(
    roots: npt.NDArray[np.floating],
    generator: np.random.Generator,
    *,
    views: int = 4,
    distance: float = CAMERA_DISTANCE,
    height: float = CAMERA_HEIGHT,
) -> list[Camera]:
    """Place cameras in a ring around a moving person, similar to the four cameras of Human3.6M.

    Parameters
    ----------
    roots : ndarray
        (M, 3), mm: positions of the hip in the frames of one clip.
    generator : numpy.random.Generator
        Rotates the ring of cameras and shifts each a little.
    views : int
        Number of cameras, evenly spaced on the ring.
    distance : float
        Distance of the cameras from the middle of the path, mm, to which half of the path's extent is added; varied by
        10 %.
    height : float
        Height of the cameras above the floor, mm; varied by 10 %.

    Returns
    -------
    list of Camera
        Cameras that point at the middle of the path.
    """
    middle, radius = ring_around(roots, distance)
    offset = generator.uniform(0, 2 * np.pi)
    cameras = []
    for view in range(views):
        angle = offset + 2 * np.pi * view / views
        camera_radius = radius * generator.uniform(0.9, 1.1)
        position = (
            float(middle[0] + camera_radius * np.cos(angle)),
            float(middle[1] + camera_radius * np.sin(angle)),
            float(height * generator.uniform(0.9, 1.1)),
        )
        cameras.append(Camera.looking_at(position, (float(middle[0]), float(middle[1]), float(middle[2]))))
    return cameras


def read_cameras(path: str | Path) -> dict[str, list[Camera]]:
    """Read the cameras of a data set from an ``.npz``.

    Parameters
    ----------
    path : str or Path
        With ``subject`` (C,), ``rotation`` (C, 3, 3) whose rows are the camera's axes in world coordinates,
        ``position`` (C, 3) in mm, and optionally ``focal`` (C,) and ``centre`` (C, 2) in pixels.

    Returns
    -------
    dict of str to list of Camera
        The cameras of each subject, in the file's order.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read, a shape is wrong, a number is not finite, or a matrix is no rotation.
    """
    members = read_npz(path, required=("subject", "rotation", "position"))
    subject = text_array(members["subject"], f"{path}: subject", members["rotation"].shape[:1])
    count = len(subject)
    defaults = {"focal": np.full(count, H36M_FOCAL), "centre": np.tile(H36M_CENTRE, (count, 1))}
    shapes = {"rotation": (count, 3, 3), "position": (count, 3), "focal": (count,), "centre": (count, 2)}
    stored: dict[str, Array] = {}
    for name, shape in shapes.items():
        array = numeric_array(members.get(name, defaults.get(name)), f"{path}: {name}").astype(np.float64)
        if array.shape != shape:
            raise PoseDataError(f"{path}: {name} {array.shape}; expected {shape}.")
        if not np.isfinite(array).all():
            raise PoseDataError(f"{path}: {name} is not finite everywhere; expected the numbers of {count} cameras.")
        stored[name] = array
    rotation, position, focal, centre = stored.values()
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are those of no rotation
        error = np.abs(rotation @ rotation.mT - np.eye(3)).max(axis=(1, 2))
        determinant = np.linalg.det(rotation)
    invalid = ~(error <= 1e-3) | (determinant < 0)
    if invalid.any():
        first = int(invalid.argmax())
        raise PoseDataError(
            f"{path}: rotation of camera {first} is none (R R^T differs from I by {error[first]:.3g}, det R is "
            f"{determinant[first]:.3g}); expected an orthogonal matrix of determinant 1."
        )
    cameras: dict[str, list[Camera]] = {}
    for index, name in enumerate(subject.tolist()):
        principal_point = (float(centre[index, 0]), float(centre[index, 1]))
        camera = Camera(rotation[index], position[index], float(focal[index]), principal_point)
        cameras.setdefault(name, []).append(camera)
    return cameras

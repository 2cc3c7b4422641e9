r"""Simulation of triple pendulums, the data of the paper's zero-shot experiment (supplement B.2, Figure 4).

Nodes in a chain of rigid massless rods, the first fixed, released from the hanging position with random velocities and
observed with noise at 25 times. The equations of motion are solved in the rods' angles from the downward vertical, so
that rods keep their length exactly:

.. math::

    Σ_j c_{ij} \left(\cos(θ_i − θ_j)\, \ddot θ_j + \sin(θ_i − θ_j)\, \dot θ_j²\right)
    + \frac{g}{l} c_{ii} \sin θ_i = 0, \quad c_{ij} = n + 1 − \max(i, j)

Conventions: SI units, unit masses, x to the right, y up, the fixed node at the origin. P pendulums, T times,
n moving nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError

__all__ = ["GRAVITY", "Pendulums", "energy", "motion", "simulate"]

Floats = npt.NDArray[np.float64]

GRAVITY = 9.81
"""m/s²."""

ROD = 1.0
"""Length of each rod, m."""


@dataclass(frozen=True)
class Pendulums:
    """P pendulums at T times, and their observations.

    Attributes
    ----------
    time : ndarray, shape (T,)
        s, from 0.
    positions : ndarray, shape (P, T, n + 1, 2)
        Positions of all nodes, the fixed one first, m.
    observed : ndarray, shape (P, T, n, 2)
        Positions of the moving nodes with noise, m: the paper's c.
    energy : ndarray, shape (P, T)
        Kinetic and potential energy, J; 0 for a pendulum that hangs at rest.
    """

    time: Floats
    positions: Floats
    observed: Floats
    energy: Floats

    @property
    def energy_drift(self) -> Floats:
        """The largest relative deviation of each pendulum's energy from its first value, (P,)."""
        return np.asarray(np.abs(self.energy / self.energy[:, :1] - 1).max(axis=1))


def _chain_masses(n: int) -> Floats:
    """Return the number of unit masses below both rods, (n, n)."""
    rods = np.arange(1, n + 1)
    return n + 1.0 - np.maximum(rods[:, None], rods)


def _positions(angle: Floats) -> Floats:
    """Compute the positions of all nodes, (…, n + 1, 2), from the rods' angles (…, n)."""
    steps = ROD * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    return np.concatenate([np.zeros_like(steps[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)


def energy(angle: Floats, velocity: Floats) -> Floats:
    r"""Compute the energy of pendulums.

    .. math:: \tfrac12 Σ_i ‖v_i‖² + g Σ_i (y_i + i\, l)

    Parameters
    ----------
    angle, velocity : ndarray, shape (..., n)
        Of the rods, rad and rad/s.

    Returns
    -------
    ndarray, shape (...)
        J, of unit masses; 0 for a pendulum that hangs at rest.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    Two horizontal rods: the nodes are 1 m and 2 m above their positions at rest.

    >>> round(float(energy(np.full(2, np.pi / 2), np.zeros(2))), 6)
    29.43
    """
    n = angle.shape[-1]
    relative_velocity = ROD * np.stack([np.cos(angle), np.sin(angle)], axis=-1) * velocity[..., None]
    kinetic = (np.cumsum(relative_velocity, axis=-2) ** 2).sum(axis=(-1, -2)) / 2
    height = _positions(angle)[..., 1:, 1] + ROD * np.arange(1, n + 1)
    return np.asarray(kinetic + GRAVITY * height.sum(axis=-1))


def motion(angle: npt.ArrayLike, velocity: npt.ArrayLike, time: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Solve the equations of motion of P pendulums.

    Parameters
    ----------
    angle, velocity : array_like, shape (P, n)
        Of the rods at the first time, rad from the downward vertical and rad/s.
    time : array_like, shape (T,)
        Times of the solution, s, increasing.

    Returns
    -------
    angle, velocity : ndarray, shape (P, T, n)
        rad and rad/s.

    Raises
    ------
    PoseDataError
        Where the solver fails.

    Notes
    -----
    Dormand and Prince's method of order 8 with a relative tolerance of 1e-10.

    Differs from the published code: there a rigid-body engine simulates capsules with stiff springs between them.

    Examples
    --------
    >>> angle, _ = motion([[0.0, 0.0]], [[0.0, 0.0]], [0.0, 1.0])  # at rest
    >>> float(np.abs(angle).max())
    0.0
    """
    from scipy.integrate import solve_ivp

    start = np.stack([np.asarray(angle, float), np.asarray(velocity, float)])
    masses = _chain_masses(start.shape[-1])
    gravity = GRAVITY / ROD * np.diag(masses)

    def derivative(_: float, state: Floats) -> Floats:
        theta, omega = state.reshape(start.shape)
        difference = theta[:, :, None] - theta[:, None, :]
        centrifugal = ((masses * np.sin(difference)) @ omega[..., None] ** 2)[..., 0]
        torque = -centrifugal - gravity * np.sin(theta)
        acceleration = np.linalg.solve(masses * np.cos(difference), torque[..., None])[..., 0]
        return np.concatenate([omega, acceleration], axis=None)

    time = np.asarray(time, float)
    ends = (time[0], time[-1])
    solution = solve_ivp(derivative, ends, start.ravel(), method="DOP853", t_eval=time, rtol=1e-10, atol=1e-10)
    if not solution.success:
        raise PoseDataError(f"pendulum: {solution.message} Start it with smaller velocities.")
    theta, omega = np.moveaxis(solution.y.reshape(*start.shape, time.size), -1, 2)
    return theta, omega


def simulate(
    rng: np.random.Generator,
    *,
    pendulums: int = 50,
    timesteps: int = 25,
    nodes: int = 3,
    velocity_sigma: float = 10.0,
    noise_sigma: float = 5e-2,
    timestep: float = 0.02,
) -> Pendulums:
    """Simulate pendulums that are released from the hanging position with random velocities.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of velocities and noise.
    pendulums, timesteps, nodes : int
        P, T and n.
    velocity_sigma : float
        Standard deviation of each node's initial, horizontal velocity, m/s.
    noise_sigma : float
        Standard deviation of the observations per coordinate, m.
    timestep : float
        Time between two observations, s.

    Returns
    -------
    Pendulums
        Positions and observations; the first time is that of the release.

    Raises
    ------
    PoseDataError
        Where there is no pendulum, node or second time, or a standard deviation is negative.

    Notes
    -----
    The paper writes N(0, 10) and N(0, 5e-2). Both second numbers are read as standard deviations, in m/s and m, as in
    the released script, which also uses 25 frames of 0.02 s.

    Differs from the published code: there the noise is on the positions that a model is trained to predict, and
    the context is exact; here, as in the paper's text, the context is noisy.

    References
    ----------
    arXiv:2210.11179, supplement B.2.

    Examples
    --------
    >>> data = simulate(np.random.default_rng(0), pendulums=2, timesteps=5)
    >>> data.positions.shape, data.observed.shape, bool(data.energy_drift.max() < 1e-6)
    ((2, 5, 4, 2), (2, 5, 3, 2), True)
    """
    if pendulums < 1 or timesteps < 2 or nodes < 1 or velocity_sigma < 0 or noise_sigma < 0 or timestep <= 0:
        raise PoseDataError(
            f"pendulums {pendulums}, timesteps {timesteps} of {timestep} s, nodes {nodes}, sigmas "
            f"{velocity_sigma} and {noise_sigma}; expected at least 1, 2 of more than 0, 1, and 0 or more."
        )
    time = timestep * np.arange(timesteps, dtype=float)
    horizontal = velocity_sigma * rng.standard_normal((pendulums, nodes))
    spin = np.diff(horizontal, axis=1, prepend=0) / ROD
    angle, velocity = motion(np.zeros_like(spin), spin, time)
    positions = _positions(angle)
    noise = noise_sigma * rng.standard_normal(positions[:, :, 1:].shape)
    return Pendulums(time, positions, positions[:, :, 1:] + noise, energy(angle, velocity))

"""The triple pendulum against normal modes, an elliptic integral and conservation laws."""

import math

import numpy as np
import pytest
from scipy import special

from posecal.errors import PoseDataError
from toy.pendulum import GRAVITY, energy, motion, simulate


def test_small_swings_are_the_normal_modes_of_a_hanging_chain() -> None:
    # ω² = (g/l) x with x a root of the Laguerre polynomial L₃; the shape of a mode is L_i(x) counted from below
    for root in np.polynomial.laguerre.Laguerre.basis(3).roots():
        frequency = math.sqrt(GRAVITY * root)
        node = np.array([special.eval_laguerre(i, root) for i in (3, 2, 1, 0)])  # the fixed node's is 0
        shape = 1e-5 * np.diff(node)
        time = np.linspace(0, 2, 41)
        angle, _ = motion([shape], [np.zeros(3)], time)
        np.testing.assert_allclose(angle[0], np.outer(np.cos(frequency * time), shape), atol=1e-9)


def test_one_wide_swing_has_the_period_of_the_elliptic_integral() -> None:
    start = 2.5  # rad
    period = 4 / math.sqrt(GRAVITY) * special.ellipk(math.sin(start / 2) ** 2)
    angle, velocity = motion([[start]], [[0.0]], [0, period / 2, period])
    np.testing.assert_allclose(angle[0, :, 0], [start, -start, start], atol=1e-7)
    np.testing.assert_allclose(velocity[0, :, 0], 0, atol=1e-6)


def test_energy_is_kept_to_1e_6() -> None:
    found = simulate(np.random.default_rng(0))
    assert found.energy_drift.max() < 1e-6


def test_energy_is_that_of_the_moving_nodes() -> None:
    # Kinetic energy from finite differences of the positions, potential from their heights
    rng = np.random.default_rng(1)
    found = simulate(rng, pendulums=4, timesteps=3, timestep=1e-5)
    speed = (found.positions[:, 2] - found.positions[:, 0]) / 2e-5
    kinetic = (speed**2).sum(axis=(-1, -2)) / 2
    potential = GRAVITY * (found.positions[:, 1, 1:, 1] + [1, 2, 3]).sum(axis=-1)
    np.testing.assert_allclose(kinetic + potential, found.energy[:, 1], rtol=1e-6)


def test_a_pendulum_that_hangs_at_rest_has_no_energy() -> None:
    np.testing.assert_allclose(energy(np.zeros(3), np.zeros(3)), 0, atol=1e-12)


def test_running_backwards_leads_back() -> None:
    velocity = np.array([[3.0, -2.0, 5.0]])
    there, speed = motion(np.zeros((1, 3)), velocity, [0, 0.25, 0.5])
    back, _ = motion(there[:, -1], -speed[:, -1], [0, 0.25, 0.5])
    np.testing.assert_allclose(back[0], there[0, ::-1], atol=1e-7)


def test_a_mirrored_push_gives_the_mirrored_motion() -> None:
    velocity = np.array([[3.0, -2.0, 5.0], [-3.0, 2.0, -5.0]])
    angle, _ = motion(np.zeros((2, 3)), velocity, np.linspace(0, 1, 5))
    np.testing.assert_allclose(angle[1], -angle[0], atol=1e-8)


def test_rods_keep_their_length_and_the_first_node_its_place() -> None:
    found = simulate(np.random.default_rng(2), pendulums=5)
    np.testing.assert_allclose(np.linalg.norm(np.diff(found.positions, axis=2), axis=-1), 1, atol=1e-12)
    np.testing.assert_array_equal(found.positions[:, :, 0], 0)


def test_first_velocities_are_horizontal_with_a_standard_deviation_of_10() -> None:
    found = simulate(np.random.default_rng(3), pendulums=400, timesteps=2, timestep=1e-6)
    first = (found.positions[:, 1, 1:] - found.positions[:, 0, 1:]) / 1e-6
    # 1,200 draws: the sample standard deviation has the standard error 10/√2400 = 0.2
    np.testing.assert_allclose(first[..., 0].std(), 10, atol=4 * 0.2)
    np.testing.assert_allclose(first[..., 1], 0, atol=1e-2)


def test_observations_have_noise_of_5e_2() -> None:
    found = simulate(np.random.default_rng(4))
    noise = found.observed - found.positions[:, :, 1:]
    # 50 · 25 · 3 · 2 = 7,500 draws: standard error 0.05/√15000 = 0.0004
    np.testing.assert_allclose(noise.std(), 5e-2, atol=4 * 0.0004)
    np.testing.assert_allclose(noise.mean(), 0, atol=4 * 0.05 / math.sqrt(7500))


def test_shapes_are_those_of_the_paper() -> None:
    found = simulate(np.random.default_rng(5))
    assert found.positions.shape == (50, 25, 4, 2)
    assert found.observed.shape == (50, 25, 3, 2)


def test_the_seed_decides_everything() -> None:
    first, second = (simulate(np.random.default_rng(7), pendulums=2) for _ in range(2))
    np.testing.assert_array_equal(first.observed, second.observed)


def test_refuses_a_motion_of_one_moment() -> None:
    with pytest.raises(PoseDataError, match=r"timesteps 1 of 0\.02 s"):
        simulate(np.random.default_rng(0), timesteps=1)

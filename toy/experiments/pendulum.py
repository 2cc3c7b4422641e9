"""Supplement B.2, Figure 4: the pendulums of the zero-shot experiment."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from posecal.data.write import write_file
from toy import pose_figures
from toy.experiments.result import Result
from toy.pendulum import simulate
from toy.table import table

__all__ = ["run"]


def run(rng: np.random.Generator, data: Path, *, pendulums: int = 50, timesteps: int = 25) -> Result:
    """Simulate the pendulums and write them.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of velocities and noise.
    data : Path
        The ``.npz`` for ``time``, ``positions``, ``observed`` and ``energy``; see
        :class:`toy.pendulum.Pendulums`.
    pendulums, timesteps : int
        Number of pendulums, and of times of each.

    Returns
    -------
    Result
        Energies, rod lengths and observation noise.
    """
    data_set = simulate(rng, pendulums=pendulums, timesteps=timesteps)

    def save(file: BinaryIO) -> None:
        np.savez(
            file,
            time=data_set.time,
            positions=data_set.positions,
            observed=data_set.observed,
            energy=data_set.energy,
        )

    write_file(data, save)
    noise = (data_set.observed - data_set.positions[:, :, 1:]).std()
    rods = np.linalg.norm(np.diff(data_set.positions, axis=2), axis=-1)
    text = [
        table(
            f"{pendulums} pendulums at {timesteps} times",
            ["", "value"],
            [
                ["time between them, s", float(data_set.time[1])],
                ["median energy, J", float(np.median(data_set.energy[:, 0]))],
                ["largest drift of an energy, relative", f"{data_set.energy_drift.max():.1e}"],
                ["largest change of a rod's length, m", f"{np.abs(rods - 1).max():.1e}"],
                ["standard deviation of the observations, m", f"{noise:.4f}"],
            ],
        ),
        f"wrote {data}",
    ]
    figure = pose_figures.pendulum(data_set.time, data_set.positions, data_set.observed, data_set.energy)
    return Result("\n".join(text), figure)

"""Where do the pendulums of the zero-shot experiment go? Supplement B.2, Figure 4."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from posecal.data.write import write_file
from toy import body_pictures
from toy.experiments.result import Result
from toy.pendulum import simulate
from toy.table import table

__all__ = ["run"]


def run(rng: np.random.Generator, data: Path, *, pendulums: int = 50, timesteps: int = 25) -> Result:
    """Simulate the pendulums and write them.

    Parameters
    ----------
    rng : numpy.random.Generator
        Where velocities and noise come from.
    data : Path
        The ``.npz`` for ``time``, ``positions``, ``observed`` and ``energy``; see
        :class:`toy.pendulum.Pendulums`.
    pendulums, timesteps : int
        How many.

    Returns
    -------
    Result
        Reach, speed and drift.
    """
    found = simulate(rng, pendulums=pendulums, timesteps=timesteps)

    def save(file: BinaryIO) -> None:
        np.savez(file, time=found.time, positions=found.positions, observed=found.observed, energy=found.energy)

    write_file(data, save)
    noise = (found.observed - found.positions[:, :, 1:]).std()
    rods = np.linalg.norm(np.diff(found.positions, axis=2), axis=-1)
    text = [
        table(
            f"{pendulums} pendulums at {timesteps} times",
            ["", "value"],
            [
                ["time between them, s", float(found.time[1])],
                ["median energy, J", float(np.median(found.energy[:, 0]))],
                ["largest drift of an energy, relative", f"{found.energy_drift.max():.1e}"],
                ["largest change of a rod's length, m", f"{np.abs(rods - 1).max():.1e}"],
                ["standard deviation of the observations, m", f"{noise:.4f}"],
            ],
        ),
        f"wrote {data}",
    ]
    figure = body_pictures.pendulum(found.time, found.positions, found.observed, found.energy)
    return Result("\n".join(text), figure)

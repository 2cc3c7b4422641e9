"""Training configuration, read from TOML.

A configuration has three tables, ``[model]``, ``[data]`` and ``[train]``; settings that are not given have the defaults
of :mod:`posecal_models.settings`. Named configurations are in the folder ``configs`` beside this file.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from posecal.errors import PoseDataError, PoseFileError, did_you_mean, raise_all, refuse_unreadable
from posecal_models.config_tables import from_table
from posecal_models.settings import DataConfig, ModelConfig, TrainConfig

__all__ = ["Config", "named_configs"]

_FOLDER = Path(__file__).parent / "configs"


@dataclass(frozen=True)
class Config:
    """Complete configuration of a training.

    Attributes
    ----------
    model, data, train
        The three tables.

    Examples
    --------
    >>> Config.from_table({"model": {"size": "tiny"}}).model.size
    'tiny'
    >>> Config.from_table({"model": {"sise": "tiny"}})
    Traceback (most recent call last):
    posecal.errors.PoseDataError: config: model.sise is not known. Did you mean size?
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    data: DataConfig = field(default_factory=DataConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        if self.model.kind in ("simple-baseline", "mixture-density", "cvae") and self.train.batch == 1:
            raise PoseDataError(
                f"train.batch: 1 of a {self.model.kind}; expected 2 or more. Its batch norm needs the variance of a "
                "batch."
            )
        if self.model.units == "released" and self.model.kind in ("mixture-density", "cvae", "inn"):
            raise PoseDataError(f"model.units: released of a {self.model.kind}; expected fitted. Leave it out.")
        if self.model.kind == "cvae" and self.model.width < 4:
            raise PoseDataError(
                f"model.width: {self.model.width} of a cvae; expected 4 or more. A quarter of them are latents."
            )
        if self.model.kind == "inn" and self.train.hypotheses == 1:
            raise PoseDataError("train.hypotheses: 1 of an inn; expected 2 or more. Its losses need their spread.")
        if self.train.cuda_graph and self.model.kind != "cgnf":
            raise PoseDataError(
                f"train.cuda_graph: true of a {self.model.kind}; expected a cgnf, whose steps are thousands of short "
                "kernels. Leave it out."
            )

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> Config:
        """Build a configuration from parsed TOML.

        Parameters
        ----------
        table : dict
            Nested tables.

        Returns
        -------
        Config
            With defaults for settings that are not given.

        Raises
        ------
        PoseDataError
            Where a name is unknown or a value is invalid; all problems in one error.
        """
        problems: list[str] = []
        config = from_table(cls, table, "", problems)
        raise_all(problems)
        if config is None:
            raise PoseDataError("config: can't be read.")
        return config

    @classmethod
    def load(cls, name: str) -> Config:
        """Read a named configuration or a TOML file.

        Parameters
        ----------
        name : str
            One of :func:`named_configs`, or a path.

        Returns
        -------
        Config
            The configuration.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file is missing or not valid.
        """
        path = _FOLDER / f"{name}.toml" if name in named_configs() else Path(name)
        try:
            content = path.read_bytes()
        except OSError as problem:
            raise PoseFileError(
                f"{name}: no such configuration ({problem.strerror}). {did_you_mean(name, named_configs())}"
            ) from problem
        with refuse_unreadable(path, "not valid TOML ({})."):  # also a number of thousands of digits, in messages
            return cls.from_table(tomllib.loads(content.decode("utf-8")))

    def with_changes(self, changes: Sequence[str]) -> Config:
        """Override single settings.

        Parameters
        ----------
        changes : sequence of str
            Each ``table.name=value`` with the value as in TOML; quotes around text may be left out.

        Returns
        -------
        Config
            With these settings.

        Raises
        ------
        PoseDataError
            Where a change can't be parsed or a value is invalid.

        Examples
        --------
        >>> Config().with_changes(["model.scale=exp", "train.epochs=3"]).train.epochs
        3
        """
        table = self.table()
        for change in changes:
            name, equals, value = change.partition("=")
            *tables, last = name.strip().split(".")
            inner: Any = table
            for part in tables:
                inner = inner.get(part) if isinstance(inner, dict) else None
            if not equals or not tables or not isinstance(inner, dict):
                raise PoseDataError(f"--set {change}: expected table.name=value, such as train.epochs=20.")
            try:
                inner[last] = tomllib.loads(f"value = {value}")["value"]
            except ValueError:
                inner[last] = value.strip()
        return Config.from_table(table)

    def table(self) -> dict[str, Any]:
        """Return the configuration as nested dictionaries of plain values."""
        return dataclasses.asdict(self)


def named_configs() -> tuple[str, ...]:
    """Name the configurations that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))

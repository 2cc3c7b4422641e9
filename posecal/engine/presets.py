"""Presets: the options that published evaluations fix, each under a name."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files

from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, did_you_mean


@dataclass(frozen=True)
class Preset:
    """The explicit options of one published evaluation.

    Attributes
    ----------
    name : str
        What ``--preset`` takes.
    source : str
        The repository that it follows.
    note : str
        What no option can say.
    options : dict
        The options that it sets; all others stay at their defaults.
    """

    name: str
    source: str
    note: str
    options: dict[str, str]

    @property
    def protocol(self) -> Protocol:
        """The defaults with this preset's options."""
        return Protocol().changed(self.options)


PRESETS = {
    name: Preset(name, **fields)
    for name, fields in tomllib.loads(files(__package__).joinpath("presets.toml").read_text(encoding="utf-8")).items()
}
"""Published evaluations by name; they stand in ``presets.toml``."""


def preset(name: str) -> Preset:
    """Give a preset by its name.

    Parameters
    ----------
    name : str
        A key of :data:`PRESETS`.

    Returns
    -------
    Preset
        Its options and source.

    Raises
    ------
    PoseDataError
        Where no preset has this name.

    Examples
    --------
    >>> preset("d3dp-jbest").options["best"]
    'joint'
    """
    if name not in PRESETS:
        raise PoseDataError(f"preset: {name!r} is not known. {did_you_mean(name, PRESETS)}")
    return PRESETS[name]


def as_protocol(protocol: Protocol | str | None, metrics: str | Sequence[str] | None = None) -> Protocol:
    """Give the options of a preset or a protocol, with other metrics where they are given.

    Raises
    ------
    PoseDataError
        For what is no protocol, and for values that an option does not take.
    """
    if isinstance(protocol, str):
        protocol = preset(protocol).protocol
    if not isinstance(protocol, Protocol | None):
        raise PoseDataError(f"protocol: {type(protocol).__name__}; expected a Protocol or the name of a preset.")
    protocol = protocol or Protocol()
    return protocol if metrics is None else replace(protocol, metrics=metrics)

"""Checks of what the front door takes beside data: labels by name, and callables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from difflib import get_close_matches
from inspect import Signature

from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.evaluation.sources import DESCRIPTIONS


def label_entries(by: object) -> tuple[str, ...]:
    """Give the labels to group by as a tuple; one alone may be given as it is.

    Raises
    ------
    PoseDataError
        For what is no name of a label.
    """
    entries = (by,) if isinstance(by, str) or not isinstance(by, Iterable) else tuple(by)
    if not all(isinstance(entry, str) for entry in entries):
        raise PoseDataError(f"by: {by!r}; expected names of labels, such as action.")
    return tuple(map(str, entries))


def check_callables(name: str, functions: object) -> None:
    """Refuse what is not a mapping from names to callables.

    Raises
    ------
    PoseDataError
        For the mapping, or the first of its values that can't be called.
    """
    if not isinstance(functions, Mapping) or not all(isinstance(key, str) for key in functions):
        raise PoseDataError(f"{name}: {functions!r}; expected a mapping from names to callables.")
    for key, function in functions.items():
        check_callable(f"{name}: {key}", function)


def check_callable(name: str, function: object) -> None:
    """Refuse what can't be called; None passes.

    Raises
    ------
    PoseDataError
        Under this name.
    """
    if function is not None and not callable(function):
        raise PoseDataError(f"{name}: {function!r}; expected a callable.")


def check_label_names(labels: Mapping[str, object], update: Signature, evaluation: Signature) -> None:
    """Refuse labels of a batch whose names are options, or nearly those of ``update`` itself.

    Parameters
    ----------
    labels : mapping
        What was given by name.
    update, evaluation : Signature
        Of :meth:`Evaluation.update` and of :class:`Evaluation`.

    Raises
    ------
    PoseDataError
        With where the option belongs, or the name that is near.
    """
    own = [name for name, parameter in update.parameters.items() if parameter.kind is parameter.KEYWORD_ONLY]
    once, protocol = evaluation.parameters, {option.name for option in fields(Protocol)}
    mapping = labels.get("labels")
    if isinstance(mapping, Mapping):
        names = ", ".join(f"{name}=…" for name in mapping)
        raise PoseDataError(f"labels: a mapping; expected the labels as keywords: {names or 'sequence=…'}.")
    for name in labels:
        meant = get_close_matches(name, [*own, "sequence"], n=1, cutoff=0.8)
        if name in {"hypotheses", "truth"}:
            where = "comes first, without its name"
        elif name in once:
            where = f"belongs to Evaluation({name}=…)"
        elif name in protocol:
            where = f"belongs to Evaluation(protocol=Protocol({name}=…))"
        elif name == "labels":
            where = "are given one by one, such as sequence=…"
        elif name in {*DESCRIPTIONS, "reference", "progress"}:
            where = f"belongs to evaluate({name}=…)"
        elif meant and meant[0] != name:
            raise PoseDataError(f"update: {name!r} is no option. Did you mean {meant[0]}?")
        else:
            continue
        raise PoseDataError(f"update: {name!r} is an option and no label; it {where}.")

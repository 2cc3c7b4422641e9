"""Evaluation of many files as one test set: where they are computed, and where results of single ones are kept."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from posecal.cli import options as opt
from posecal.cli.running import progress
from posecal.errors import PosecalError, PoseDataError

if TYPE_CHECKING:
    from posecal.report.report import Report

many = partial(opt.option, panel="Many files")

Map = Callable[..., Any]


@dataclass(frozen=True)
class ShardOptions:
    """How many files are evaluated as one test set."""

    workers: Annotated[int | None, many("Processes of this machine.", min=1)] = None
    scheduler: Annotated[str | None, many("A running Dask cluster, tcp://….", metavar="ADDRESS")] = None
    keep: Annotated[Path | None, many("A folder for results of single files: the same call goes on from there.")] = None
    duplicates: Annotated[Literal["error", "drop"], many("Poses that several files hold.")] = "error"

    def are_needed(self, *sources: str) -> bool:
        """Whether these sources are many files or addresses, or an option of theirs is given."""
        from posecal.data.remote import is_address
        from posecal.evaluation.pairs import is_pattern

        asked = (self.workers, self.scheduler, self.keep, None if self.duplicates == "error" else self.duplicates)
        return (
            any(map(is_pattern, sources)) or any(map(is_address, sources)) or any(value is not None for value in asked)
        )

    def evaluate(
        self, pairs: Sequence[tuple[str, ...]], save: Path | None, metrics: list[str] | None, **options: Any
    ) -> Report:
        """Evaluate pairs of hypotheses and truth, or triples with a reference, and show how far this is.

        Results of single files are kept beside ``save`` until all are done, unless a folder is given.
        """
        import posecal
        from posecal.evaluation.kept import is_kept

        beside = None if save is None else save.with_suffix(".shards")
        keep = self.keep or beside
        if len(pairs[0]) == 3:
            options["reference"] = [reference for _, _, reference in pairs]
        with self._executor(metrics) as apply, progress() as bar:
            options |= {} if apply is None else {"map": apply}
            report = posecal.evaluate_shards(
                [(pair[0], pair[1]) for pair in pairs], keep=keep, duplicates=self.duplicates, progress=bar, **options
            )
        if keep is not None and keep is beside:
            with suppress(OSError):  # what others put there stays
                for path in filter(is_kept, keep.glob("*.npz")):
                    path.unlink()
                keep.rmdir()
        return report

    @contextmanager
    def _executor(self, metrics: list[str] | None) -> Iterator[Map | None]:
        """Give the map of an executor whose processes know the user's metrics; None for this process."""
        if self.workers is not None and self.scheduler is not None:
            raise PoseDataError("workers: given beside scheduler; expected one of the two.")
        if self.scheduler is not None:
            with _client(self.scheduler) as client:
                if metrics:
                    client.run(opt.register_all, metrics)
                yield client.get_executor().map
        elif self.workers is not None:
            spawn = multiprocessing.get_context("spawn")
            how: dict[str, Any] = {"initializer": opt.register_all, "initargs": (metrics,)}
            with ProcessPoolExecutor(self.workers, mp_context=spawn, **how) as pool:
                yield pool.map
        else:
            yield None


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """Connect to a Dask cluster."""
    try:
        connect: Any = import_module("distributed").Client
    except ImportError:
        raise PoseDataError(
            "scheduler: needs the package distributed, which is not installed: pip install 'posecal[cluster]'."
        ) from None
    try:
        client = connect(address, timeout=10)
    except (OSError, ValueError) as error:
        raise PosecalError(f"scheduler: {address} does not answer ({error}); expected tcp://HOST:PORT.") from None
    with client:
        yield client

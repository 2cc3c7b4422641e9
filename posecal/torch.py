"""Evaluation in batches as a metric of torchmetrics; ``pip install "posecal[torch]"`` brings both libraries."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posecal.errors import PoseDataError, checked_type, reason
from posecal.evaluation.batches import Evaluation
from posecal.evaluation.sources import Source
from posecal.report.report import Report

try:
    import torch
    from torchmetrics import Metric as TorchMetric
except ImportError as error:
    raise ImportError(
        f"posecal.torch: needs {error.name}, which is not installed. pip install 'posecal[torch]' brings it."
    ) from None

__all__ = ["PoseMetric"]


class PoseMetric(TorchMetric):
    """Evaluation in batches as a metric of torchmetrics: the processes of a training loop are put together by itself.

    The numbers are those of one :func:`posecal.evaluate` over all poses of all processes.

    Parameters
    ----------
    evaluation : Evaluation
        The options, such as ``posecal.Evaluation(unit="mm", axes="MNKD")``. A copy without its batches is taken.
    **options
        Of every metric of torchmetrics, such as ``process_group`` and ``dist_sync_on_step``.

    Attributes
    ----------
    evaluation : Evaluation
        The batches of this process, of all processes between ``sync`` and ``unsync``.

    Raises
    ------
    PoseDataError
        For what is no Evaluation.

    Notes
    -----
    ``forward`` evaluates a batch twice, for its own numbers and for those of all batches: ``update`` is faster.

    Which sequences and labels there are is known when the batches have come, and differs between processes. So the
    state is the whole evaluation, as bytes on ``device``; it is gathered and merged as :meth:`posecal.Evaluation.merge`
    does, which counts a frame that two processes have, by ``frame_id``, once.

    See Also
    --------
    posecal.Evaluation : the same without torchmetrics.

    Examples
    --------
    The truth is 3 mm from the only hypothesis at one joint of two.

    >>> import posecal, torch
    >>> metric = PoseMetric(posecal.Evaluation(unit="mm", metrics="mpjpe"))
    >>> hypotheses, truth = torch.zeros(1, 4, 2, 3), torch.zeros(4, 2, 3)
    >>> hypotheses[..., 1, 0] = 3
    >>> metric.update(hypotheses, truth, sequence="walk")
    >>> metric.compute()
    {'mpjpe': tensor(1.5000)}
    """

    is_differentiable = False
    higher_is_better = None
    full_state_update = True  # sums over a batch by itself lack what reaches over its ends

    def __init__(self, evaluation: Evaluation, **options: Any) -> None:
        super().__init__(**options)
        self.evaluation = copy.copy(checked_type(evaluation, "evaluation", Evaluation))
        self.add_state("state", default=[], dist_reduce_fx=None)

    @property
    def state(self) -> list[torch.Tensor]:
        """The evaluation as bytes, one tensor for each process of which it was gathered.

        Set to those of several evaluations, they are merged; set to none, all batches are forgotten.
        """
        try:
            stored = pickle.dumps(self.evaluation)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise PoseDataError(
                f"evaluation: can't be sent to other processes or copied ({reason(error)}); expected preranks and "
                "metrics whose functions stand in a module."
            ) from None
        return [torch.from_numpy(np.frombuffer(stored, dtype=np.uint8).copy()).to(self.device)]

    @state.setter
    def state(self, parts: Sequence[torch.Tensor]) -> None:
        if not parts:
            self.evaluation.reset()
            return
        first, *others = (pickle.loads(part.to("cpu", torch.uint8).numpy().tobytes()) for part in parts)  # noqa: S301
        for other in others:
            first.merge(other)
        self.evaluation = first

    def update(self, hypotheses: Source, truth: Source, /, **described: Any) -> None:
        """Add a batch, as :meth:`posecal.Evaluation.update` takes it.

        Parameters
        ----------
        hypotheses, truth : tensors or arrays
            In the layout and unit of the evaluation, on any device.
        **described
            ``where``, ``occluded``, ``scores``, ``weights``, ``log_prob``, ``frame_id``, and labels such as
            ``sequence``.

        Raises
        ------
        PoseDataError
            For a batch that does not fit. It is not counted then.
        """
        self.evaluation.update(hypotheses, truth, **described)

    def compute(self) -> dict[str, torch.Tensor]:
        """Give the headline metrics over the poses of all processes.

        Returns
        -------
        dict of scalar tensors
            The numbers of :meth:`posecal.Report.scalars`, by name.

        Raises
        ------
        PoseDataError
            As :meth:`posecal.Evaluation.compute`, and as its ``merge``.
        """
        scalars = self._result().scalars()
        return {name: torch.tensor(value, dtype=self.dtype, device=self.device) for name, value in scalars.items()}

    def report(self) -> Report:
        """Give the report over the poses of all processes; each of them must call this.

        Returns
        -------
        Report
            With intervals, tests and remarks.

        Raises
        ------
        PoseDataError
            As :meth:`compute`.
        """
        with self.sync_context(dist_sync_fn=self.dist_sync_fn, should_sync=self.sync_on_compute):
            return self._result()

    def _result(self) -> Report:
        """Give the report of what is gathered; where that fails, go back to the own batches, as a sync does not."""
        try:
            return self.evaluation.compute()
        except PoseDataError:
            if self._is_synced:
                self.unsync()
            raise

    def reset(self) -> None:
        """Forget all batches."""
        super().reset()
        self.evaluation.reset()

    def merge_state(self, incoming_state: Mapping[str, Any] | TorchMetric) -> None:
        """Add the batches of another metric, or of its ``metric_state``.

        Raises
        ------
        PoseDataError
            For what is neither, and as :meth:`posecal.Evaluation.merge`. Nothing is changed then.
        """
        state = incoming_state.metric_state if isinstance(incoming_state, PoseMetric) else incoming_state
        if not isinstance(state, Mapping) or "state" not in state:
            raise PoseDataError(f"incoming_state: {type(state).__name__}; expected a PoseMetric, or its metric_state.")
        self.state = [*self.state, *state["state"]]
        self._computed = None

    def persistent(self, mode: bool = False) -> None:
        """Refuse to be part of a ``state_dict``: checkpoints are read without pickles.

        Raises
        ------
        PoseDataError
            For ``mode=True``.
        """
        if mode:
            raise PoseDataError(
                "persistent: True; expected False. A PoseMetric is not stored in checkpoints; report().save keeps its "
                "sums in a file."
            )

    def __hash__(self) -> int:
        return id(self)  # not of the state: each reading of it makes a tensor

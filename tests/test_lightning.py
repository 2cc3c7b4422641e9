"""The Lightning callback of docs/training-loop.md, as it stands there, logs the numbers of all validation batches."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import posecal

lightning = pytest.importorskip("lightning")
torch = pytest.importorskip("torch")

from tests.helpers.two_ranks import Frames  # noqa: E402

PAGE = Path(__file__).parents[1] / "docs/training-loop.md"


class Scaled(lightning.LightningModule):  # type: ignore[misc, name-defined]
    """A factor of the images, which are hypotheses of their poses."""

    def __init__(self) -> None:
        super().__init__()
        self.factor = torch.nn.Parameter(torch.tensor(1.5))

    def training_step(self, batch: dict[str, Any], batch_idx: int) -> Any:
        return ((self.factor * batch["image"] - batch["pose"][:, None]) ** 2).mean()

    def validation_step(self, batch: dict[str, Any], batch_idx: int) -> Any:
        return self.factor * batch["image"]

    def configure_optimizers(self) -> Any:
        return torch.optim.SGD(self.parameters(), lr=1e-7)


@pytest.mark.filterwarnings("ignore")  # Lightning's advice on loaders and loggers
def test_the_callback_logs_the_numbers_of_all_validation_batches(tmp_path: Path) -> None:
    (code,) = re.findall(r"```py\n(import lightning\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)
    frames, model = Frames(), Scaled()
    loader = torch.utils.data.DataLoader(frames, batch_size=8)
    callback = names["PoseEvaluation"](posecal.Evaluation(unit="mm", axes="MNKD"))
    quiet = {"logger": False, "enable_checkpointing": False, "enable_progress_bar": False, "barebones": False}
    trainer = lightning.Trainer(
        max_epochs=2, accelerator="cpu", callbacks=[callback], default_root_dir=tmp_path, **quiet
    )
    trainer.fit(model, loader, loader)
    assert 1 < model.factor.item() < 1.5
    clips = {"sequence": [f"clip {i // 10}" for i in range(len(frames))]}
    hypotheses = model.factor.detach() * frames.hypotheses
    numbers = posecal.evaluate(hypotheses, frames.poses, unit="mm", axes="MNKD", labels=clips).scalars()
    logged = {name: value.item() for name, value in trainer.callback_metrics.items()}
    assert logged == pytest.approx({f"validation/{name}": value for name, value in numbers.items()}, rel=1e-5)

"""Evaluation of hypotheses against the truth: in one call, in batches, and of several models; leaderboards."""

from posecal.evaluation.batches import Evaluation
from posecal.evaluation.call import evaluate
from posecal.evaluation.models import compare
from posecal.evaluation.rankings import Leaderboard, add_entry, leaderboard
from posecal.evaluation.shards import evaluate_shards

__all__ = ["Evaluation", "Leaderboard", "add_entry", "compare", "evaluate", "evaluate_shards", "leaderboard"]

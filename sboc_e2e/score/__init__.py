"""Scores of a run against truth: completeness, false alarms, residuals over bounds, linking, orbits, bits, seconds.

Every figure is a value with n and an interval, or no value and the reason; `docs/scoring.md` defines each with its formula.
"""

from sboc_e2e.score.evaluation import Evaluation, evaluate
from sboc_e2e.score.score_run import score_evaluation, score_run

__all__ = ["Evaluation", "evaluate", "score_evaluation", "score_run"]

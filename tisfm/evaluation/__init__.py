"""Interpretations against known flow, depth and motion.

Here: pairs of datasets evaluated, the means of their errors, tables and files.
May import: all of `tisfm` but `tisfm.cli`.
"""

from tisfm.evaluation.pairs import Evaluation, evaluate
from tisfm.evaluation.record import PairEvaluation

__all__ = ["Evaluation", "PairEvaluation", "evaluate"]

"""Interpretations against known flow, depth and motion.

Here: pairs and whole sequences of datasets evaluated, the means of their errors, tables and files.
May import: all of `tisfm` but `tisfm.cli`.
"""

from tisfm.evaluation.masks import compare_masks
from tisfm.evaluation.pairs import Evaluation, evaluate
from tisfm.evaluation.record import PairEvaluation
from tisfm.evaluation.sequence_depth import SequenceDepthErrors
from tisfm.evaluation.sequences import PieceErrors, SequenceEvaluation, compare_sequence

__all__ = [
    "Evaluation",
    "PairEvaluation",
    "PieceErrors",
    "SequenceDepthErrors",
    "SequenceEvaluation",
    "compare_masks",
    "compare_sequence",
    "evaluate",
]

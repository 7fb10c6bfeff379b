"""Evaluation: results for pairs and sequences, compared with known flow, depth and motion.

Here: errors of pairs and sequences of datasets, their means, tables and files.
May import: all of `tisfm` but `tisfm.cli`.
"""

from tisfm.evaluation.moving_objects import compare_masks
from tisfm.evaluation.pair_errors import PairEvaluation
from tisfm.evaluation.pairs import Evaluation, evaluate
from tisfm.evaluation.sequence_depth import FrameGroupErrors, SequenceDepthErrors
from tisfm.evaluation.sequences import PieceErrors, SequenceEvaluation, compare_sequence

__all__ = [
    "Evaluation",
    "FrameGroupErrors",
    "PairEvaluation",
    "PieceErrors",
    "SequenceDepthErrors",
    "SequenceEvaluation",
    "compare_masks",
    "compare_sequence",
    "evaluate",
]

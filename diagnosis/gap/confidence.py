"""How often an answer like this one was right: a score of the evidence, mapped by cases of known cause.

The map is fitted by `python -m diagnosis.blind.calibrate` on cases that the published benchmark does not hold.
"""

import numpy as np

from diagnosis.gap.judge import Ruling
from diagnosis.gap.search import Member

# Score -> share of right names among the calibration cases, by isotonic regression; straight lines between.
SCORES = (0.0, 0.5, 0.8, 1.0)
RIGHT = (0.3, 0.6, 0.85, 0.95)


def score(member: Member, ruling: Ruling) -> float:
    """0 to 1: how much of the explainable is explained, and how far the best rival is behind."""
    lack = min((g.value for f, g in member.rivals if not f.at_bound), default=member.gain.value)
    ahead = min(max(lack / member.gain.value, 0.0), 1.0) if member.gain.value > 0 else 0.0
    return float(ruling.explained * (0.5 + 0.5 * ahead))


def confidence(score_: float) -> float:
    """The share of answers with such a score that named the cause."""
    return float(np.interp(score_, SCORES, RIGHT))

"""How often an answer like this one was right, on cases of known cause that the published benchmark does not hold.

61 robots of `softarm blind make` (seed 20): of 31 effects named without an equivalent 29 were the cause; of the two
named with one, one was. More cases of the second kind are needed; until then a set of k counts 1 / k and a little.
"""

from softarm.diagnosis.engine.search import SelectedEffect

ALONE = 0.94
OF_A_SET = 0.6


def confidence(effect: SelectedEffect) -> float:
    """The share of answers like this one that named the cause."""
    if not effect.equivalents:
        return ALONE
    return max(OF_A_SET - 0.1 * (len(effect.equivalents) - 1), 1 / (1 + len(effect.equivalents)))

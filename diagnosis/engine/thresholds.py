"""Every threshold of the engine, in one frozen table: what counts as a gap, a gain, a tie, an answer.

Energies are mean squares of a view's residual over its floor's: 1 is what no simulator is blamed for. Losses are
weighted squares, about four per second and view.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Final, Literal


@dataclass(frozen=True, slots=True)
class Thresholds:
    """What the engine compares with. A customer brings its own only where it was measured to be needed."""

    # How it searches.
    quiet: float = 0.0  # energy that nuisances alone may leave in every view without any effect being sought
    backward: bool = False  # all effects at once, then left out one at a time; else one more at a time
    effects_max: int = 3  # forward only
    starts_kept: int = 1
    rounds: int = 4  # of Gauss-Newton, to the end
    rounds_rough: int = 2  # and to see who has promise
    promising: int = 10  # candidates that are fitted to the end
    hopeless: float = 1.0  # of what the best takes away: who takes less than the rest of it is not fitted to the end
    anew: bool = False  # backward only: few effects are fitted from their own starts too, not only on from many
    simulated: bool = False  # held-out losses are simulated anew; else taken from the fit's last linearisation
    tempered: bool = False  # blocks that hold more than their share count by its logarithm

    # Weighed by the noise that a first, generous search leaves; else by the size of the nominal gap.
    whitened: bool = True
    # Held out while searching: what the verdict is held out by (kinds, else trials), whole trials, or every fifth block
    # of each trial.
    searched: Literal["unseen", "trial", "block"] = "unseen"

    # What an interval is: whether what is left counts as a law that is missing and may hide as much again.
    inexact: bool = False

    # What a gain is.
    gain_min: float = 8.0  # what an effect must add, held out
    # And in one view that it acts on: share of the residual's energy, energy, and the lower end of the gain. What moves
    # a residual within the floor is news only if it is a part of it and beyond all doubt.
    shown: tuple[tuple[float, float, float], ...] = ((0.10, 0.30, 0.0), (0.20, 0.10, 0.0), (0.10, 0.05, 10.0))
    # And beside another effect: of the energy that the whole gap had there, or most of what the other leaves. A
    # correction to another effect's law is no effect.
    further_min: float = 0.06
    further_share: float = 0.4

    # What a rival is.
    tie: float = 10.0  # what a rival lacks, held out: no more than this is no difference
    rival_share: float = 0.12  # a rival that lacks no more than this share of the gain may be the cause as well
    misfit_share: float = 0.0  # of the loss that the best leaves: what a rival may lack and still be the cause

    # What an answer is.
    stands: float = 0.85  # share of what is explainable where an effect shows that it has to explain to be named
    least_share: float = 0.1  # of all that is explainable, that the named effects explain: less is no answer to the gap
    together: bool = (
        False  # all effects of a stage and its nuisances explain that share; else each one beside the others
    )
    whole_share: float = 0.0  # of what they take away together: with no more left than this beyond the floor, all is
    whole_most: float = inf  # and of that energy no more
    # Explainable energy that may stay beside a name (structure is no share of the rest: over `random_share`); more
    # only where tolerances bend (`Setup.bent`). Where more stays no name is the whole: each has to explain more than
    # what stays, and what is taken away has to be this share of what there is.
    beside_most: float = inf
    bent_share: float = 0.01  # of what is taken away, at the most: one window that is thrown off would grant anything
    stands_over: float = 0.96
    unknown_min: float = 0.5  # energy beyond the floor that asks for an explanation
    fallen_min: float = 0.0  # and energy of an effect that was found and does not stand: that asks for another
    # Of what is left beyond the floor at least this much counts as explainable: what changes at random from tick to
    # tick no model finds, and it is not the floor's noise either.
    random_share: float = 0.5
    # Where something is left, a strength that differs more than this from excitation to excitation is another law's: a
    # part for any effect, and one for chance over the root of the energy that the effect explains. The same between
    # the trials' halves: a strength that grows or fades is no constant effect's.
    scatter: float = 0.06
    drift: float = 0.12
    chance: float = 0.10
    # A parameter that the model has already is wrong alike everywhere, however little it leaves: of scatter and drift
    # together at most this, and a part for chance. Stiffness, damping and such of the robot, where they are wrong, have
    # 0.001 to 0.004; an arm that softens as it warms up, called stiffness, 0.11.
    constant: float = 0.04
    looked_at: float = 0.6  # energy of a residual from which on a flexible model looks at it
    # Structure in what is left that refuses `none` and `named`: energy of its strongest sure sign, at least, and as a
    # share of what the effects and the nuisances take away.
    structure_min: float = 1.0
    structure_share: float = 0.15
    # What nuisances take away within their tolerance is nobody's gap; of that and what the effects explain this share
    # may be left without asking for another cause, and no more energy beyond the floor than `tolerated_most`: a
    # nuisance that takes a large gap's half away leaves the other half, which is somebody's.
    tolerated: float = 0.0
    tolerated_most: float = 0.0


ROBOT: Final = Thresholds()

# A rig's stage is cheap to simulate and has few candidates, so its search begins at the rich end: dry friction and drag
# have to come together in place of a viscous fit, which a search that adds one at a time never reaches. Its laws have
# kinks, so that a line misleads where a fold is left out; its descents are long, lag and limits lie in one valley; and
# at the fast end of a sweep a hair's breadth in a limit makes or breaks all of a block. No share of the whole gap is
# asked of a further effect: a dead time of one sample is real beside an end of the torque that makes a gap twenty times
# as large. No law of a rig is exact, and its floor is its encoder's step: what a rival may lack and what may be left
# are taken from what the best leaves. The search is held out by blocks: the end of a servo's torque shows in the fast
# end of one sweep alone, and without that sweep a fold's loss is an extrapolation that swamps the rest. Of two effects
# that nearly cancel, such as a slope and a friction that differs by direction, a search from the rich end finds both in
# any rest: within twice the floor nothing is sought.
RIG: Final = replace(
    ROBOT,
    quiet=4.0,  # twice the floor, root mean square: two thousandths of the signal are no rig's gap
    backward=True,
    rounds=12,
    rounds_rough=3,
    promising=6,
    hopeless=0.5,
    simulated=True,
    whitened=False,
    searched="block",
    tempered=True,
    inexact=True,
    shown=((0.10, 0.30, 0.0),),
    further_min=0.0,
    misfit_share=0.25,
    together=True,
    whole_share=0.07,
    whole_most=225.0,  # fifteen times the floor: a motor that tires, called a weak one, leaves 27 and scatters
    tolerated=0.15,
    tolerated_most=15.0,  # four times the floor, root mean square
    # Three times the floor, root mean square: the encoder's step is not all that two recordings differ by. Healthy rigs
    # stand at 1.4 to 3.4 floors (a driven mass at 6, a chain at 9), those with an unknown cause at ten and more.
    unknown_min=4.0,
    fallen_min=4.0,
    beside_most=15.0,  # likewise: a spring that is on no list leaves 14 floors and more beside a name
    structure_min=16.0,  # four floors: of many parts one is always further off than the whole, which may be by three
    structure_share=0.25,
)

# Where a trial's start is fitted at every point anew, a part of a trial is no stranger to the rest of it.
SHOTS: Final = replace(RIG, searched="trial")

"""Functions of vectors, shared by all stages."""

# mypy: allow-untyped-defs, allow-untyped-calls
from softarm.simulator.kernel.compiled import compiled
from softarm.simulator.simd import floor, load, magnitude, select


@compiled
def sine_cosine(x):
    """Return sin x and cos x, to float32's rounding for |x| up to ten thousand turns.

    Half of the angle is brought to -pi/2 .. pi/2, where two minimax polynomials are accurate to 5e-9. The
    double-angle rule then needs no case for the quadrant.
    """
    turns = floor(x * 0.15915494309189535 + 0.5)
    # 2 pi in two parts, the first of so few bits that its multiples are exact.
    half = 0.5 * ((x - turns * 6.28125) - turns * 0.0019353071795864769)
    z = half * half
    sine = 2.6089183613938353e-06 * z - 1.9811106825219228e-04
    sine = sine * z + 8.333088094716652e-03
    sine = sine * z - 1.6666660459915678e-01
    sine = half + half * z * sine
    cosine = -2.6076961033025607e-07 * z + 2.4761878439515466e-05
    cosine = cosine * z - 1.3888403364380765e-03
    cosine = cosine * z + 4.166664071778332e-02
    cosine = cosine * z - 4.9999999549333823e-01
    cosine = 1.0 + z * cosine
    return 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine


@compiled
def clip(x, low, high):
    """Bring x between two bounds; NaN stays NaN."""
    x = select(x < low, low, x)
    return select(x > high, high, x)


@compiled
def loss_over(x):
    """Return (1 - exp(-x)) / x for x >= 0, exactly 1 at 0, to 2e-6.

    Below 1 the Bernoulli series of its inverse, above it exp(-x) as the eighth power of exp(-x / 8).
    """
    z = x * x
    near = 1.0 / (1.0 + 0.5 * x + z * (1.0 / 12.0 + z * (-1.0 / 720.0 + z * (1.0 / 30240.0))))
    y = 0.125 * x
    grown = 1.0 + y * (1.0 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * (1 / 720))))))
    fade = 1.0 / grown
    fade = fade * fade
    fade = fade * fade
    fade = fade * fade
    return select(x < 1.0, near, (1.0 - fade) / select(x < 1.0, 1.0, x))


@compiled
def tanh_over(x):
    """Return tanh(x) / x, exactly 1 at 0."""
    y = magnitude(x)
    loss = loss_over(2.0 * y)
    return loss / (1.0 - y * loss)


@compiled
def grip(m, lanes, row, strength, reach, rate, acceleration, dt):
    """Return dry friction's force at the end of a substep, less accelerations', and its implicit inertia.

    The friction is a bristle at `row` of the block, sheared by the motion: elastic up to `reach`, then slipping at
    `strength`. Unlike a steep function of the rate it holds at standstill. In both cases it is a spring that is
    evaluated at the end of the substep; while it slips, its stiffness gives `strength` at the end that the last
    acceleration predicts. The spring is implicit and returns no more energy than it has stored, so it is stable at
    any step and for any mass.
    """
    free = load(m, row, lanes) + dt * rate
    foreseen = magnitude(free + (0.5 * dt * dt) * acceleration)
    stiffness = strength / select(foreseen > reach, foreseen, reach)
    return 0.0 - stiffness * free, (0.5 * dt * dt) * stiffness

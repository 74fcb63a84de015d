"""Variants of the independent robot of `softarm.reality`, which shares no code with the simulator.

All but the nominal one differ from the training of every policy except the robust ones.
"""

from collections.abc import Sequence
from dataclasses import replace

from softarm.common.words import did_you_mean
from softarm.reality.parameters import GROUPS, Arm, Rail, Regulator, RobotParameters
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, exemplars, validate

# Strength of the registry's examples: 50 g at the tip, a regulator 50 % slower, a drive half a tick later.
_STRONG = exemplars()
PAYLOAD = Arm(payload_kg=_STRONG["arm.payload"]["mass"])
SLOW = Regulator(inflate_s=_STRONG["pressure.lag"]["inflate"], deflate_s=_STRONG["pressure.lag"]["deflate"])
LATE = Rail(delay_s=_STRONG["rail.delay"]["delay"])
ROBOTS = {
    "nominal": RobotParameters(),
    "payload": RobotParameters(arm=PAYLOAD),
    "slow": RobotParameters(regulator=SLOW),
    "late": RobotParameters(rail=LATE),
    "changed": RobotParameters(arm=PAYLOAD, regulator=SLOW, rail=LATE),
    # Larger changes of the cart, which times a swing.
    "later": RobotParameters(rail=Rail(delay_s=0.09)),
    "weak": RobotParameters(rail=Rail(acceleration_m_s2=3.0)),
}


def with_faults(robot: RobotParameters, faults: Sequence[str]) -> RobotParameters:
    """Give the independent robot its faults, `group.quantity=value` each (docs/reference/reality.md lists them).

    Raises:
        ValueError: A fault is unknown, or its value is out of bounds.
    """
    for text in faults:
        key, equals, number = text.partition("=")
        group, _, name = key.strip().partition(".")
        part = getattr(robot, group, None) if type(getattr(robot, group, None)) in GROUPS else None
        known = part.__dataclass_fields__ if part is not None else {}
        if not equals or part is None or name not in known:
            groups = [g for g in robot.__dataclass_fields__ if type(getattr(robot, g)) in GROUPS]
            here = ", ".join(known) if part is not None else f"a group of {', '.join(groups)}"
            hint = did_you_mean(name, known) if name else ""
            raise ValueError(
                f"--fault {text}: {hint}write group.quantity=value, such as regulator.dead_time_s=0.06; allowed here: "
                f"{here}"
            )
        try:
            value = int(number) if known[name].type in (int, "int") else float(number)
        except ValueError:
            raise ValueError(f"--fault {text}: '{number}' is not a number") from None
        robot = replace(robot, **{group: replace(part, **{name: value})})
    return robot


def with_effects(model: Model, faults: Sequence[str]) -> Model:
    """Give the simulated robot faults, by the names of effects (docs/reference/effects.md).

    `arm.payload` is as strong as the registry's example, `arm.payload=0.05` sets an effect's one parameter,
    `pressure.lag.inflate=0.3` one of several.

    Raises:
        ValueError: A fault is unknown, or its value is out of bounds.
    """
    given = {name: dict(values) for name, values in model.effects.items()}
    for text in faults:
        key, equals, number = text.partition("=")
        effect, parameter = _named(key.strip(), text)
        if not equals:
            given[effect] = dict(_STRONG[effect])
            continue
        parameters = [p.name for p in REGISTRY[effect].parameters]
        if parameter is None and len(parameters) != 1:
            one = " or ".join(f"{effect}.{name}=VALUE" for name in parameters) or f"{effect} alone"
            raise ValueError(f"--fault {text}: which parameter? write {one}")
        try:
            given.setdefault(effect, {})[parameter or parameters[0]] = float(number)
        except ValueError:
            raise ValueError(f"--fault {text}: '{number}' is not a number") from None
    validate(given)
    return model.model_copy(update={"effects": given})


def _named(key: str, text: str) -> tuple[str, str | None]:
    """Split a name into an effect and its parameter, if there is one."""
    if key in REGISTRY:
        return key, None
    effect, _, parameter = key.rpartition(".")
    if effect in REGISTRY:
        return effect, parameter
    hint = did_you_mean(key, REGISTRY, cutoff=0.5)
    raise ValueError(f"--fault {text}: no such fault; {hint}`softarm twin --fault list` shows them all")

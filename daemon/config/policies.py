"""Would the policies of a configuration fly?"""

from collections.abc import Iterator

from softarm.daemon.config.configuration import Loaded
from softarm.policies import registry
from softarm.policies.base import PolicyError


def policy_problems(loaded: Loaded) -> Iterator[str]:
    """A sentence, with its place in the file, for each that would not; the one it starts with is loaded and tried."""
    config = loaded.config
    for name, entry in registry.available(config.policies).items():
        if name in config.policies and entry.error:
            yield f"{loaded.place(('policies', name))}: policies.{name}: {entry.error}"
    try:
        registry.load(config.control.policy, config.policies)
    except PolicyError as error:
        yield f"{loaded.place(('control', 'policy'))}: control.policy: {error}"

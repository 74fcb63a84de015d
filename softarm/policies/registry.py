"""Registry of policies: list them and load one by its name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from softarm.common import plugins as installed_plugins
from softarm.common.plugins import Option, Plugin
from softarm.common.words import nearest
from softarm.policies.base import GROUP, INTERFACE, MODELS, Policy, PolicyError, PolicySpec
from softarm.schemas.config import Policy as ConfiguredPolicy

_KIND = "plugin"
EXCITE = "excite-"  # before the name of an excitation: a policy that plays it, which is not listed


@dataclass(frozen=True, slots=True)
class PolicyEntry:
    """Policy that can be chosen by its name."""

    name: str
    plugin: str
    options: Mapping[str, Option] = field(default_factory=dict)
    spec: PolicySpec | None = None  # None when there is an error
    error: str | None = None  # why it cannot be used, and the remedy

    @property
    def description(self) -> str:
        """Description in one line, or why the policy cannot be used."""
        return self.spec.description if self.spec else f"cannot be used: {self.error}"


def available(configured: Mapping[str, ConfiguredPolicy] | None = None) -> dict[str, PolicyEntry]:
    """List all policies by name: installed plug-ins, shipped models and the configuration's, which take precedence.

    Imports every plug-in's module. An entry that fails states so in its `error` and does not affect the others.
    """
    plugins = installed_plugins.installed(GROUP)  # without importing them
    entries = {name: _entry(name, name, {}, plugins) for name in plugins}
    for file in sorted(MODELS.glob("*.onnx")):
        entries[file.stem] = _entry(file.stem, "onnx", {"model": file.stem}, plugins)
    for name, policy in (configured or {}).items():
        entries[name] = _entry(name, policy.plugin, policy.options, plugins)
    return dict(sorted(entries.items()))


def load(name: str, configured: Mapping[str, ConfiguredPolicy] | None = None) -> Policy:
    """Load a policy by its name, which becomes its `spec.name`; `excite-NAME` plays an excitation.

    Raises PolicyError, whose text names the policy, the problem and the available policies.
    """
    entries = available(configured)
    usable = ", ".join(n for n, entry in entries.items() if entry.error is None) or "none"
    plugins = installed_plugins.installed(GROUP)
    if name not in entries and name.startswith(EXCITE):
        entries[name] = _entry(name, "excite", {"excitation": name.removeprefix(EXCITE)}, plugins)
    if name not in entries:
        near = nearest(name, entries)
        hint = f"did you mean '{near}'? " if near else ""
        raise PolicyError(f"no policy '{name}'; {hint}available: {usable}")
    entry = entries[name]
    if entry.error is not None:
        raise PolicyError(f"policy '{name}': {entry.error}; available: {usable}")
    try:
        policy = plugins[entry.plugin]()(**entry.options)
        if not isinstance(policy, Policy):
            raise PolicyError("it lacks spec, reset or step; see docs/policies/interface.md")
        policy.spec = replace(policy.spec, name=name)
    except (Exception, SystemExit) as error:
        raise PolicyError(f"policy '{name}': {installed_plugins.said(error)}; available: {usable}") from error
    return policy


def _entry(
    name: str, plugin: str, options: Mapping[str, Option], plugins: Mapping[str, Callable[[], Plugin]]
) -> PolicyEntry:
    """Return an entry with the spec of the class's `describe(**options)` if it exists, else with its `spec`."""
    try:
        make = installed_plugins.find(_KIND, plugin, plugins)
        installed_plugins.check_interface(_KIND, plugin, make, INTERFACE)
        installed_plugins.check_options(_KIND, plugin, make, options)
        describe = getattr(make, "describe", None)
        spec = describe(**options) if describe else getattr(make, "spec", None)
        if not isinstance(spec, PolicySpec):
            raise PolicyError(f"plugin '{plugin}' lacks a class attribute `spec` (policies.base.PolicySpec)")
        return PolicyEntry(name, plugin, options, spec=replace(spec, name=name))
    except (Exception, SystemExit) as error:  # a module may even call sys.exit() while it is imported
        return PolicyEntry(name, plugin, options, error=installed_plugins.said(error))

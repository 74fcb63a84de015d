"""Tables of the diagnosis pages, from stored results to Markdown, with the targets next to the figures."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from benchmarks.markdown import Read, markdown


def blind(read: Read) -> str:
    """Return the rates of the blind benchmark next to the targets."""
    found = read("blind")["methods"]["diagnose"]
    cells = {**found["measures"], **found["coverage"]}
    aims = {
        "right in all parts": ("right in all", ""),
        "right stage": ("right stage", "98 %"),
        "a single effect named exactly": ("single, exact", "97 %"),
        "both of two effects": ("two, exact", "90 %"),
        "the same, alone or in a set of two": ("two, exact or in sets of two", ""),
        "all of three effects": ("three, exact", "60 %"),
        "an unknown effect given a name": ("unknown, given a name", "2 %"),
        "the same, as the whole answer": ("unknown, given a name as the whole answer", ""),
        "an unknown effect said to be one": ("unknown, said so", "85 %"),
        "a name when nothing is wrong": ("none, given a name", "1 %"),
        "95 % intervals of a size hold the true one": ("size", "90 to 97 %"),
        "95 % intervals of the shrink hold fresh data, stage": ("stage", "92 to 98 %"),
        "the same, chain": ("chain", "92 to 98 %"),
    }
    rows = [[title, _share(cells[key]), aim] for title, (key, aim) in aims.items()]
    seconds = f"{found['seconds_median']:.0f} s, {found['seconds_worst']:.0f} s"
    rows.append(["calibration error", f"{found['calibration']['ece']:.3f}", "0.05"])
    rows.append(["processor time of eight trials, median and worst", seconds, "8 s, 40 s"])
    return markdown(("", "reached", "aim"), rows)


_MEASURES = {
    "right in all": "right in all parts",
    "right stage": "right stage",
    "single, exact": "one effect, exact",
    "single at half strength, exact": "one at half strength, exact",
    "two, exact": "two effects, exact",
    "two, the second at half strength, exact": "two, the second at half strength, exact",
    "three, exact": "three effects, exact",
    "known, a wrong name beside": "known cause, also a wrong name",
    "unknown, given a name": "unknown cause, given a name",
    "none, given a name": "healthy robot, given a name",
}


def blind_methods(read: Read) -> str:
    """Return the main measures of the diagnosis and of simpler rules on the same robots."""
    methods = read("blind-baselines")["methods"]
    rows = [
        [title, *(_share(method["measures"][name]) for method in methods.values())] for name, title in _MEASURES.items()
    ]
    rows.append(["processor seconds a case, median", *(f"{each['seconds_median']:.0f}" for each in methods.values())])
    return markdown((f"{methods['diagnose']['cases']} cases", *methods), rows)


def _share(found: Mapping[str, Any]) -> str:
    return f"{100 * found['share']:.0f} % ({found['hits']} of {found['of']})"


def beside_sysid(read: Read) -> str:
    """Return the diagnosis next to mujoco.sysid on one campaign, with time and held-out error."""
    found = read("diagnosis")
    ours, theirs = found["diagnosis"], found["mujoco_sysid"]
    rows = []
    for title, key in (("processor time", "cpu_s"), ("wall time", "wall_s")):
        times = (f"{side['whole'][key]:.0f} s" for side in (ours, theirs))
        rows.append([f"{title}, all {found['seconds']:.0f} s of recordings", *times])
    for title, stage, scale in (("pressure, kPa", "pressure", 1.0), ("link ends, mm", "arm", 1e3)):
        pairs = ([scale * side[when][stage] for when in ("nominal", "held_out")] for side in (ours, theirs))
        rows.append([f"{title}: before, left out", *(", ".join(f"{x:.3g}" for x in pair) for pair in pairs)])
    fitted = (f"{name} {value:.3g}" for stage in theirs["found"].values() for name, value in stage["values"].items())
    rows.append(
        ["finds", f"{ours['found']['verdict']}: {'; '.join(_named(ours['found']['effects']))}", ", ".join(fitted)]
    )
    return markdown(("", "diagnosis", "mujoco.sysid"), rows)


def _named(effects: Iterable[Mapping[str, Any]]) -> Iterable[str]:
    """Yield every effect with its sizes."""
    for effect in effects:
        sizes = (f"{size['value']:.3g} {size['unit']}" for size in effect["parameters"].values())
        yield f"{effect['name']} ({', '.join(sizes)})"


TABLES: dict[str, Callable[[Read], str]] = {
    "blind": blind,
    "blind-methods": blind_methods,
    "beside-sysid": beside_sysid,
}

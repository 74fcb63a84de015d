"""The tables of the diagnosis's page: stored results in, Markdown out. The aims stand here too."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from softarm.benchmarks.markdown import Read, markdown
from softarm.diagnosis.blind import pages


def blind(read: Read) -> str:
    """How often the diagnosis is right, beside what was aimed at."""
    return _beside_aims(read("blind"))


def blind_again(read: Read) -> str:
    """The same on the robots that were drawn after the chain's interval was set anew."""
    return _beside_aims(read("blind-again"))


def _beside_aims(scored: Mapping[str, Any]) -> str:
    found = scored["methods"]["diagnose"]
    cells = {**found["measures"], **found["coverage"]}
    aims = {
        "right stage": ("right stage", "97 %"),
        "a single effect named exactly": ("single, exact", "95 %"),
        "the same at half strength": ("single at half strength, exact", "88 %"),
        "both of two effects": ("two, exact", "85 %"),
        "both of two, the second at half strength": ("two, the second at half strength, exact", "85 %"),
        "all of three effects": ("three, exact", "60 %"),
        "an unknown effect given a name": ("unknown, given a name", "3 %"),
        "an unknown effect said to be one": ("unknown, said so", "85 %"),
        "a name when nothing is wrong": ("none, given a name", "1 %"),
        "95 % intervals of the shrink hold fresh data, stage": ("stage", "92 to 98 %"),
        "the same, chain": ("chain", "92 to 98 %"),
    }
    rows = [
        [title, f"{100 * cells[key]['share']:.0f} % ({cells[key]['hits']} of {cells[key]['of']})", aim]
        for title, (key, aim) in aims.items()
    ]
    seconds = f"{found['seconds_median']:.0f} s, {found['seconds_worst']:.0f} s"
    rows.append(["calibration error", f"{found['calibration']['ece']:.3f}", "0.05"])
    rows.append(["processor time of eight trials, median and worst", seconds, "20 s, 60 s"])
    return markdown(("", "reached", "aim"), rows)


def blind_methods(read: Read) -> str:
    """The diagnosis beside simpler rules, every measure with its 95 % interval."""
    return "\n".join(pages.measures(read("blind")["methods"])) + "\n"


def strength(read: Read) -> str:
    """How clearly the weakest of every imperfection shows."""
    return pages.strength(read("strength")["causes"])


def beside_sysid(read: Read) -> str:
    """The diagnosis and mujoco.sysid on one campaign: what each takes, how far it is off where it has not looked."""
    found = read("diagnosis")
    ours, theirs = found["diagnosis"], found["mujoco_sysid"]
    rows = [
        [
            f"{title}, all {found['seconds']:.0f} s of recordings",
            *(f"{side['whole'][key]:.0f} s" for side in (ours, theirs)),
        ]
        for title, key in (("processor time", "cpu_s"), ("wall time", "wall_s"))
    ]
    for title, stage, scale in (("pressure, kPa", "pressure", 1.0), ("link ends, mm", "arm", 1e3)):
        pairs = ([scale * side[when][stage] for when in ("nominal", "held_out")] for side in (ours, theirs))
        rows.append([f"{title}: before, left out", *(", ".join(f"{x:.3g}" for x in pair) for pair in pairs)])
    fitted = (f"{name} {value:.3g}" for stage in theirs["found"].values() for name, value in stage["values"].items())
    rows.append(
        ["finds", f"{ours['found']['verdict']}: {'; '.join(_named(ours['found']['effects']))}", ", ".join(fitted)]
    )
    return markdown(("", "diagnosis", "mujoco.sysid"), rows)


def _named(effects: Iterable[Mapping[str, Any]]) -> Iterable[str]:
    """Every effect with its sizes."""
    for effect in effects:
        sizes = (f"{size['value']:.3g} {size['unit']}" for size in effect["parameters"].values())
        yield f"{effect['name']} ({', '.join(sizes)})"


TABLES: dict[str, Callable[[Read], str]] = {
    "blind": blind,
    "blind-again": blind_again,
    "blind-methods": blind_methods,
    "strength": strength,
    "beside-sysid": beside_sysid,
}

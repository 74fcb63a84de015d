"""Tables of the pages about the diagnosis, from stored results to Markdown."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.markdown import Read, markdown


def real_arm(read: Read) -> str:
    """Return the errors of all models on held-out recordings of a real arm, mrad, and the times of the fits."""
    found = read("real-arm")["held_out"]
    models = {
        "public": "public model",
        "sysid": "mujoco.sysid",
        "pace": "PACE",
        "pace_gains": "PACE, with gains",
        "diagnosis": "diagnosis",
    }
    joints = list(next(iter(found.values()))["public_rad"])
    rows = []
    for name, row in found.items():
        for model, label in models.items():
            errors = [1000 * row[f"{model}_rad"][joint] for joint in joints]
            seconds = f"{row[f'{model}_s']['processor']:.0f}" if model != "public" else "-"
            rows.append((name, label, *(f"{error:.0f}" for error in (*errors, np.mean(errors))), seconds))
    return markdown(("held-out recording", "fit", *joints, "mean", "processor time (s)"), rows)


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
    error = found["calibration"]["ece"]
    rows.append(["calibration error", "-" if error is None else f"{error:.3f}", "0.05"])
    rows.append(["processor time of eight trials, median and worst", seconds, "8 s, 40 s"])
    return markdown(("", "reached", "aim"), rows)


_MEASURES = {
    "right in all": "right in all parts",
    "right stage": "right stage",
    "single, exact": "one effect, exact",
    "two, exact": "two effects, exact",
    "three, exact": "three effects, exact",
    "known, a wrong name beside": "known cause, also a wrong name",
    "unknown, given a name": "unknown cause, given a name",
    "none, given a name": "healthy robot, given a name",
}


def blind_methods(read: Read) -> str:
    """Return the main measures of the diagnosis and of simpler rules on the same robots."""
    methods = read("blind")["methods"]
    rows = [[title, *(_share(one["measures"][key]) for one in methods.values())] for key, title in _MEASURES.items()]
    rows.append(["processor seconds a case, median", *(f"{each['seconds_median']:.0f}" for each in methods.values())])
    return markdown((f"{next(iter(methods.values()))['cases']} cases", *methods), rows)


def _share(found: Mapping[str, Any]) -> str:
    if found["share"] is None:
        return "-"
    return f"{100 * found['share']:.0f} % ({found['hits']} of {found['of']})"


_FRICTION = {
    "m1": "dry and viscous (M1; the model has it)",
    "m2": "larger at rest (M2)",
    "m3": "by load (M3)",
    "m4": "by load, larger at rest (M4)",
    "m5": "the same, by direction (M5)",
    "m6": "the same, quadratic (M6)",
}


def servos(read: Read) -> str:
    """Return how often the friction of simulated servos is named, by its law."""
    found = read("servos")["outcomes"]
    heads = ("right", "more", "silent", "wrong", "failed")
    rows = [(_FRICTION[law], *(str(counts.get(head, 0)) for head in heads)) for law, counts in found.items()]
    return markdown(("friction", *heads), rows)


def servos_held_out(read: Read) -> str:
    """Return the errors of a free simulation of a held-out motion, mrad, and the processor time of the fits, s."""
    models = {"nominal": "the model given", "m1": "BAM M1", "m6": "BAM M6", "diagnosis": "diagnosis"}
    rows = []
    for name, row in read("servos")["held_out"].items():
        errors = (f"{1000 * row[key]['rms_rad']:.1f}" for key in models)
        rows.append((name, *errors, *(f"{row[key]['processor_s']:.0f}" for key in ("m6", "diagnosis"))))
    return markdown(("servo", *models.values(), "BAM M6 (s)", "diagnosis (s)"), rows)

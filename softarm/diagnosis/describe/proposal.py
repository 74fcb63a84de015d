"""Proposal of a stage file: what the recordings show, what the user has answered, and what is still unknown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np

from softarm.common.quantity import UNITS, factor
from softarm.common.words import did_you_mean
from softarm.diagnosis.data.table_checks import ALIKE, upright_shift
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.describe import clocks, headers
from softarm.diagnosis.describe.clocks import Clock
from softarm.diagnosis.describe.columns import DRIVES, likely_unit, links_of, name_of, natural
from softarm.diagnosis.describe.survey import Signal, Survey
from softarm.schemas.stage_model import DESCRIBED, MODEL_KEYS, ModelValue, StageKind, complaints

Angles = Literal["absolute", "relative"]
# Least correlation of a command and the column that follows it.
FOLLOWS = 0.6
_PLACES = ("m", "rad", "counts")


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """Answers of the user; empty values are inferred or asked for."""

    kind: StageKind | None = None
    command: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    base: str = ""
    time: str = ""
    rate_hz: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)  # label or pattern -> unit
    nominal: Mapping[str, str] = field(default_factory=dict)  # key of the model -> its text
    angles: Angles | None = None


@dataclass(frozen=True, slots=True)
class Question:
    """Something that the recordings do not show."""

    option: str  # --unit
    prefix: str  # of the option's value: `y=` for the unit of y
    text: str
    choices: tuple[str, ...] = ()
    likely: str = ""


@dataclass(frozen=True, slots=True)
class Use:
    """One column of a stage file."""

    signal: Signal
    unit: str
    note: str  # how its unit is known
    add: float = 0.0


@dataclass(frozen=True, slots=True)
class Proposal:
    """Content of a stage file."""

    kind: StageKind
    why: str
    links: int
    angles: Angles | None
    channels: Mapping[str, Mapping[str, Use]]
    clocks: Mapping[str, Clock]  # by channel
    candidates: Mapping[str, Sequence[Signal]]  # by channel
    model: Mapping[str, ModelValue]
    notes: Sequence[str]


class Unknown(Exception):
    """Questions that the user must answer first."""

    def __init__(self, *questions: Question) -> None:
        self.questions = questions
        super().__init__(", ".join(q.option for q in questions))


def propose(survey: Survey, answers: Answers) -> Proposal:
    """Return the content of a stage file.

    Raises:
        Unknown: the recordings do not show everything.
        TrialError: an answer does not fit the recordings.
    """
    return Draft(survey, answers).proposal()


class Draft:
    """Inference from a survey and answers, one step after the other."""

    def __init__(self, survey: Survey, answers: Answers) -> None:
        self.survey, self.answers = survey, answers
        _check_units(survey, answers.units)
        self.units = {s.label: unit for s in survey.signals if (unit := self._answered(s))}
        self.times = self._times()
        taken = {each.label for own in self.times.values() for each in own}
        others = [s for s in survey.signals if not (s.label in taken or s.dates or s.header.role == "time")]
        self.readings = [s for s in others if len(s.all)]
        self.moving = [s for s in self.readings if not s.is_constant]
        self.notes: list[str] = []
        self.by_group = {k: self.clock(next(s for s in survey.signals if s.group == k)) for k in self.times}

    def proposal(self) -> Proposal:
        """Return the complete proposal."""
        kind, why = self._kind()
        chosen, candidates = self._tracking() if kind == "tracking" else self._driven(kind)
        uses = self._uses(kind, chosen)
        links = len([name for name in uses["measured"] if name.startswith("angle")]) or 1
        angles = self._angles(kind, links)
        model = self._model(kind, links, uses)
        stamps = {name: self.clock(next(iter(columns.values())).signal) for name, columns in uses.items()}
        return Proposal(kind, why, links, angles, uses, stamps, candidates, model, self.notes)

    def standard(self, signal: Signal) -> str:
        """Return the standard unit of a signal, by its unit or by the quantity in its header; maybe empty."""
        unit = self.units.get(signal.label) or signal.header.unit
        return factor(unit)[1] if unit else signal.header.quantity

    # Stamps

    def _answered(self, signal: Signal) -> str | None:
        """Return the unit that the user has given for a signal: by its name, else by a pattern."""
        given = self.answers.units
        own = [given[name] for name in signal.names if name in given]
        fitting = [unit for name, unit in given.items() if "*" in name and fnmatchcase(signal.label, name)]
        own += [unit for unit in fitting if signal.header.role != "time" or factor(unit)[1] == "s"]
        return own[0] if own else None

    def _times(self) -> dict[int, list[Signal]]:
        groups = sorted({s.group for s in self.survey.signals})
        if self.answers.rate_hz is not None:
            return {k: [] for k in groups}
        named = [s for s in self.survey.signals if self.answers.time and self.answers.time in s.names[:2]]
        if self.answers.time and not named:
            named = [self._named(self.answers.time, "--time")]
        found = {k: [s for s in named if s.group == k] or clocks.candidates(self.survey, k) for k in groups}
        if not all(found.values()):
            falling = [s.label for s in self.survey.signals if s.header.role == "time" and not found[s.group]]
            why = f"{', '.join(falling)} does not rise" if falling else "no column holds the time"
            raise Unknown(Question("--rate", "", f"rows a second, since {why}"))
        return found

    def clock(self, signal: Signal) -> Clock:
        """Return the stamps of a signal; raise Unknown without the unit of its time."""
        times = self.times[signal.group]
        found = clocks.of(signal, times, self.units, self.answers.rate_hz)
        if not found.unit and (time := found.signal) is not None:
            text = f"unit of the time in {time.label}"
            raise Unknown(Question("--unit", f"{time.label}=", text, ("s", *UNITS["s"])))
        return found

    # Kind and roles

    def _kind(self) -> tuple[StageKind, str]:
        if self.answers.kind is not None:
            return self.answers.kind, "as given"
        kind, why, sure = self._guess()
        if not sure and self.answers.command and self.answers.measured:
            sure = kind == "tracking"
        if not sure:
            raise Unknown(Question("--kind", "", f"kind of mechanism ({why})", DESCRIBED, kind))
        return kind, why

    def _guess(self) -> tuple[StageKind, str, bool]:
        """Return the likeliest kind of mechanism, the reason, and whether there is no doubt."""
        signals = self.moving
        found = {s.label: self.standard(s) for s in signals}

        def first(of: Sequence[Signal], *standards: str) -> Signal | None:
            return next((s for s in of if found[s.label] in standards), None)

        commands = [s for s in signals if self.role(s) == "command" and found[s.label] not in ("N", "N m", "A")]
        others = [s for s in signals if self.role(s) != "command"]
        for command in commands:
            for other in others:
                if found[command.label] == found[other.label] != "":
                    return "tracking", f"{command.label} is commanded and {other.label} measured, in one quantity", True
        if (pressure := first(others, "kPa")) and len(signals) > 1:
            return "tracking", f"{pressure.label} is a pressure", True
        angles = [s for s in others if found[s.label] == "rad"]
        torque, place = first(signals, "N m"), first(others, *_PLACES, *(f"{p}/s" for p in _PLACES))
        if torque and len(angles) > 1:
            return "chain", f"{torque.label} is a torque, and there are {len(angles)} angles", True
        if torque and angles:
            return "driven_mass", f"{torque.label} is a torque, and there is one angle", True
        if place and (push := first(signals, "N", "A")) and not commands:
            return "driven_mass", f"{push.label} moves {place.label}", True
        if place and (push := first(signals, *DRIVES)):
            return "driven_mass", f"{push.label} moves {place.label}", False
        if angles and not commands and all(found[s.label] in ("rad", "rad/s") for s in signals):
            one = len(angles) == 1
            return "tracking" if not one and any(map(self._leads, signals)) else "pendulum", "only angles move", one
        if len(commands) == 1 and len(others) == 1 and self.role(others[0]) == "measured":
            return "tracking", f"{commands[0].label} is commanded, {others[0].label} is measured", True
        return "tracking", "the headers do not show it", False

    def role(self, signal: Signal) -> str:
        """Return the role of a signal, by its header, else by its file's name."""
        several = len(self.times) > 1
        path = self.survey.recordings[0].files[signal.group]
        return signal.header.role or (headers.read(path.stem).role if several else "")

    def _named(self, text: str, option: str) -> Signal:
        """Return the signal that the user means."""
        every = self.survey.signals
        for names in zip(*(s.names for s in every), strict=True):  # labels, sources, names without units
            if names.count(text) == 1:
                found = every[names.index(text)]
                if not len(found.all):
                    raise TrialError(f"{option} {text}: has no reading; allowed is a column with readings; name one")
                return found
        labels = [s.label for s in every]
        near = did_you_mean(text, labels)
        raise TrialError(f"{option} {text}: no such column, or several; {near}allowed {', '.join(labels)}; name one")

    def _tracking(self) -> tuple[dict[str, list[Signal]], dict[str, list[Signal]]]:
        given = self.answers
        if len(self.moving) < 2:
            still = ", ".join(s.label for s in self.survey.signals if s.is_constant) or "none"
            path = next(iter(self.survey.recordings[0].files.values()))
            raise TrialError(
                f"{path}: a tracking rig needs a command and an output that move; moving: "
                f"{', '.join(s.label for s in self.moving) or 'none'}, constant: {still}; name other recordings"
            )
        command = [self._named(text, "--command") for text in given.command]
        measured = [self._named(text, "--measured") for text in given.measured]
        rest = [s for s in self.moving if s not in measured]
        likely = [s for s in rest if self.role(s) == "command"]
        likely = likely or [s for s in rest if self.role(s) != "measured" and self._leads(s)] or rest
        command = command or (likely if len(likely) == 1 else [])
        outputs = [s for s in self.moving if s not in command and self.role(s) != "command"]
        if command and not measured:
            measured = self._best(outputs, command[0])
            outputs = sorted(outputs, key=lambda s: s not in measured)
        questions = []
        if not command:
            questions.append(_choice("--command", "column of the command", rest, likely))
        if not measured:
            questions.append(_choice("--measured", "column of the measured output", outputs or rest, outputs))
        if questions:
            raise Unknown(*questions)
        lag, share = clocks.lead(command[0], measured[0], self.by_group)
        what = (
            f"the first leads by {lag:.3g} s"
            if lag > 0
            else f"the second leads by {-lag:.3g} s, so check both"
            if lag < 0
            else "no lag"
        )
        self.notes.append(f"Between {command[0].label} and {measured[0].label}: {what}, correlation {share:.2f}")
        return {"command": command, "measured": measured}, {"command": rest, "measured": outputs}

    def _leads(self, signal: Signal) -> bool:
        """Return whether a signal leads every other moving one that correlates with it."""
        pairs = [clocks.lead(signal, other, self.by_group) for other in self.moving if other is not signal]
        alike = [lag for lag, share in pairs if abs(share) > FOLLOWS]
        return bool(alike) and min(alike) > 0

    def _best(self, outputs: Sequence[Signal], command: Signal) -> list[Signal]:
        """Return the output that follows a command, if one is better than all others."""

        def score(signal: Signal) -> tuple[int, float]:
            same = self.standard(signal) == self.standard(command) != ""
            known = self.standard(signal) in ("rad", "m", "kPa", "counts")
            role, lag_share = self.role(signal) == "measured", clocks.lead(command, signal, self.by_group)
            return 2 * same + 2 * role + known, round(abs(lag_share[1]), 1)

        scores = {s.label: score(s) for s in outputs}
        best = [s for s in outputs if scores[s.label] == max(scores.values())]
        return best if len(best) == 1 else []

    def _driven(self, kind: StageKind) -> tuple[dict[str, list[Signal]], dict[str, list[Signal]]]:
        """Columns of a mass, a pendulum or a chain."""
        given = self.answers
        places = _PLACES if kind == "driven_mass" else ("rad",)
        found = sorted(
            (s for s in self.moving if self.standard(s) in (*places, *(f"{p}/s" for p in places))), key=natural
        )
        measured = [self._named(text, "--measured") for text in given.measured]
        drive = "force" if kind == "driven_mass" else "torque"
        pushes = [s for s in self.moving if self.standard(s) in (DRIVES if kind == "driven_mass" else ("N m",))]
        rest = [s for s in self.moving if s not in measured]
        if not measured:
            measured = [s for s in found if self.role(s) != "command"] or found
        if not measured:
            raise Unknown(_choice("--measured", "columns of the measured output, separated by commas", rest, found))
        if not given.measured and kind != "driven_mass":
            measured += self._rates(measured)
        chosen = {"measured": measured}
        if kind != "pendulum":
            count = len([s for s in measured if self.standard(s) == "rad"]) if kind == "chain" else 1
            command = [self._named(text, "--command") for text in given.command]
            by_role = [[s for s in pushes if self.role(s) == role] for role in ("measured", "command", "")]
            command = command or next((some for some in (*by_role, pushes) if len(some) == count), [])
            if command:
                chosen = {drive: sorted(command, key=natural) if not given.command else command, **chosen}
            elif kind == "driven_mass" or pushes:
                raise Unknown(_choice("--command", f"column of the {drive}", rest, pushes))
        if kind != "driven_mass":
            carts = [s for s in self.moving if self.standard(s) == "m" and s not in measured]
            base = [self._named(given.base, "--base")] if given.base else carts if len(carts) == 1 else []
            chosen |= {"base": base} if base else {}
        return chosen, {drive: pushes, "measured": found} if kind != "pendulum" else {"measured": found}

    def _rates(self, places: Sequence[Signal]) -> list[Signal]:
        """Return the columns without a unit that are the slopes of angles."""
        units = {s.label: (unit, "") for s in places if (unit := self.units.get(s.label) or s.header.unit)}
        rest = [s for s in self.moving if s not in places and not (s.header.unit or self.units.get(s.label))]
        return sorted((s for s in rest if self._of_slope(s, places, units)), key=natural)

    # Units

    def _uses(self, kind: StageKind, chosen: Mapping[str, Sequence[Signal]]) -> dict[str, dict[str, Use]]:
        units: dict[str, tuple[str, str]] = {}
        columns = [s for signals in chosen.values() for s in signals]
        for signal in columns:
            if signal.label in self.units:
                units[signal.label] = self.units[signal.label], "as given"
            elif signal.header.unit is not None:
                units[signal.label] = signal.header.unit, "from the header"
        for signal in columns:
            if signal.label not in units and (known := self._of_slope(signal, columns, units)):
                units[signal.label] = known
        if unknown := [s for s in columns if s.label not in units]:
            ranges = [f"unit of {s.label}, which goes from {s.all.min():.4g} to {s.all.max():.4g}" for s in unknown]
            likely = [likely_unit(s, self.standard(s)) for s in unknown]
            asked = zip(unknown, ranges, likely, strict=True)
            raise Unknown(*(Question("--unit", f"{s.label}=", text, (), usual) for s, text, usual in asked))
        return self._columns(kind, chosen, units)

    def _columns(
        self, kind: StageKind, chosen: Mapping[str, Sequence[Signal]], units: Mapping[str, tuple[str, str]]
    ) -> dict[str, dict[str, Use]]:
        """Return the chosen columns by channel and name; units: label -> unit, and how it is known."""
        angles = [s for s in chosen["measured"] if factor(units[s.label][0])[1] == "rad"]
        torques = chosen.get("torque", ())
        links = links_of(torques, angles)
        if links is None:
            self.notes.append(f"The headers of {', '.join(s.label for s in torques)} show no link: correct the numbers")
        found: dict[str, dict[str, Use]] = {}
        for channel, signals in chosen.items():
            own = found.setdefault(channel, {})
            for signal in signals:
                unit, note = units[signal.label]
                worth, standard = factor(unit)
                name = name_of(kind, channel, standard, own)
                if channel == "torque" and links is not None:
                    name = f"torque{links[torques.index(signal)]}"
                if name in own:
                    raise self._twice(channel, name, own[name].signal, signal)
                middle = float(np.median(signal.all)) * worth
                shift = upright_shift(middle) if kind == "pendulum" and standard == "rad" else 0.0
                own[name] = Use(signal, unit, note, shift)
        return found

    def _twice(self, channel: str, name: str, one: Signal, other: Signal) -> TrialError | Unknown:
        """Return the question, or the error of the answers, about two columns for one of a stage file."""
        both, allowed = f"{one.label} and {other.label} cannot both be the {name}", "allowed is one; name one of them"
        if channel != "measured":
            return TrialError(f"--command: {both}; {allowed}")
        if self.answers.measured:
            return TrialError(f"--measured: {both}; {allowed}")
        text = f"columns of the measured output, separated by commas, since {both}"
        return Unknown(_choice("--measured", text, (one, other), (one, other)))

    def _of_slope(
        self, signal: Signal, columns: Sequence[Signal], units: Mapping[str, tuple[str, str]]
    ) -> tuple[str, str] | None:
        """Return the unit of a rate that is the slope of a position whose unit is known."""
        for place in columns:
            if place.label not in units or place.group != signal.group or place is signal or place.elements:
                continue
            own, standard = factor(units[place.label][0])
            rates = {f"{standard}/s": 1.0, **UNITS.get(f"{standard}/s", {})}
            t = self.by_group[place.group].times_s[0]
            slope = np.gradient(place.values[0], t)
            good = np.isfinite(slope) & np.isfinite(signal.values[0])
            x, y = slope[good], signal.values[0][good]
            if not len(x) or not (x @ x) or np.corrcoef(x, y)[0, 1] < 0.8:
                continue
            ratio = float(x @ y / (x @ x))
            for unit, value in rates.items():
                if abs(ratio / own * value - 1) < 2 * ALIKE:
                    return unit, f"from the slope of {place.label}"
        return None

    # Model

    def _angles(self, kind: StageKind, links: int) -> Angles | None:
        if kind != "chain" or links == 1:
            return None
        if self.answers.angles is None:
            text = "angles are measured from the vertical (absolute) or from the link before (relative)"
            raise Unknown(Question("--angles", "", text, ("absolute", "relative")))
        return self.answers.angles

    def _model(self, kind: StageKind, links: int, uses: Mapping[str, Mapping[str, Use]]) -> dict[str, ModelValue]:
        model: dict[str, ModelValue] = {key: _value(key, text) for key, text in self.answers.nominal.items()}
        known = {key.name: key for key in MODEL_KEYS[kind]}
        needed = [key.name for key in known.values() if key.needed and key.name not in model]
        likely, per = "", ""
        if kind == "chain" and "inertia_joint_kg_m2" in model:
            needed = [key for key in needed if key != "inertia_kg_m2"]
        if links > 1 and "length_m" not in model:
            needed.append("length_m")
        units = {name: use.unit for columns in uses.values() for name, use in columns.items()}
        if kind == "tracking":
            command, (place, *_) = uses["command"]["command"], uses["measured"].values()
            if factor(command.unit)[1] != factor(place.unit)[1] and not {"gain", "map"} & model.keys():
                needed.append("gain")
                likely, per = self._slope(command.signal, place.signal), f"{place.unit} per {command.unit}"
        elif kind == "driven_mass":
            turns = any(factor(use.unit)[1].startswith("rad") for use in uses["measured"].values())
            mass = "inertia_kg_m2" if turns else "mass_kg"
            needed += [mass] * (mass not in model)
            needed += ["gain"] * ("force" not in units and "gain" not in model)
        if needed:
            each = f" ({links} numbers, separated by commas)" if links > 1 else ""
            texts = [f"of your simulator, {per or known[name].unit}: {known[name].meaning}{each}" for name in needed]
            asked = zip(needed, texts, strict=True)
            raise Unknown(*(Question("--nominal", f"{name}=", f"{name} {text}", (), likely) for name, text in asked))
        plain = dict[object, object](model.items())
        if wrong := [f"--nominal {key}: {text}" if key else text for key, text in complaints(kind, plain, links)]:
            raise TrialError("\n".join(wrong))
        return model

    def _slope(self, command: Signal, measured: Signal) -> str:
        """Return the slope of a measurement over its command, as these recordings show it."""
        clock = self.by_group[command.group].times_s[0], self.by_group[measured.group].times_s[0]
        x = np.interp(clock[1], clock[0], command.values[0])
        y = measured.values[0]
        good = np.isfinite(x) & np.isfinite(y)
        return f"{np.polyfit(x[good], y[good], 1)[0]:.3g}" if good.sum() > 2 and np.ptp(x[good]) > 0 else ""


def _check_units(survey: Survey, given: Mapping[str, str]) -> None:
    """Raise TrialError for an unknown unit, or a column that is not there."""
    known = {name for s in survey.signals for name in s.names}
    for name, unit in given.items():
        try:
            factor(unit)
        except ValueError as error:
            raise TrialError(f"--unit {name}={unit}: {error}; write one of these") from None
        if name not in known and not ("*" in name and any(fnmatchcase(s.label, name) for s in survey.signals)):
            labels = [s.label for s in survey.signals]
            near = did_you_mean(name, labels)
            raise TrialError(f"--unit {name}={unit}: no such column; {near}allowed {', '.join(labels)}; name one")


def _value(key: str, text: str) -> ModelValue:
    """Return the numbers of `0.6` or `0.6,0.5`."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise TrialError(
            f"--nominal {key}={text}: is no number; allowed a number, or one for each link separated by commas; write "
            f"e.g. --nominal {key}=0.5"
        ) from None
    return numbers[0] if len(numbers) == 1 else numbers


def _choice(option: str, text: str, signals: Sequence[Signal], likely: Sequence[Signal]) -> Question:
    first = likely[0].label if likely else ""
    return Question(option, "", text, tuple(s.label for s in signals), first)

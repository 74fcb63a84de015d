"""python -m diagnosis.rigs STAGE.yaml --data FOLDER [--stage NAME]: diagnose a table, print what was found."""

import argparse
from pathlib import Path

from diagnosis import tables
from diagnosis.gap.result import Diagnosis
from diagnosis.rigs.diagnose import diagnose_table


def text(diagnosis: Diagnosis) -> str:
    """The verdict in lines."""
    verdict = diagnosis.verdict
    lines = [f"verdict: {verdict.verdict}, {verdict.where.regime}"]
    for stage, before in verdict.gap.before.items():
        after, floor, ceiling = (
            part[stage].value for part in (verdict.gap.after, verdict.gap.floor, verdict.gap.ceiling)
        )
        lines.append(
            f"{stage}: {before.value:.4g} {before.unit} -> {after:.4g} (any model {ceiling:.4g}, floor {floor:.4g})"
        )
    for effect in verdict.effects:
        numbers = ", ".join(
            f"{k} {e.value:.4g} [{e.low:.4g}, {e.high:.4g}] {e.unit}" for k, e in effect.parameters.items()
        )
        shrink = effect.shrink.stage
        same = f"; or {', '.join(effect.equivalents)}" if effect.equivalents else ""
        lines.append(
            f"  {effect.name}: {numbers}; takes {shrink.value:.0%} [{shrink.low:.0%}, {shrink.high:.0%}]{same}"
        )
    for rival in diagnosis.rivals:
        if rival.note != "named" and rival.conditional is not None:
            lines.append(
                f"  not {rival.names[0]}: alone {rival.alone:.0%}, "
                f"beside the named {rival.conditional.value:.0%} {rival.note}"
            )
    return "\n".join([*lines, *(f"warning: {warning}" for warning in verdict.warnings), f"{diagnosis.seconds:.0f} s"])


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="stage.yaml")
    parser.add_argument("--data", type=Path, help="folder that its files lie in; default: beside it")
    parser.add_argument("--stage", help="one stage of a file with several, servo3; default: all")
    given = parser.parse_args()
    trials = tables.read(given.file, given.data)
    chosen = [t for t in trials if given.stage is None or (t.stage is not None and t.stage.name == given.stage)]
    print(text(diagnose_table(chosen)))


if __name__ == "__main__":
    main()

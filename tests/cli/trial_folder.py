"""A trial folder of one second, for verbs that read recordings."""

from pathlib import Path

from softarm.schemas.model import Model
from softarm.simulator import model_file


def write_trial(folder: Path, model: Model | None = None) -> Path:
    """Write a trial into a campaign, optionally with the campaign's model, and return its folder."""
    folder.mkdir(parents=True)
    (folder / "trial.yaml").write_text("kind: seed\n")
    rows = [f"{k / 30:.4f},{k % 7}.0" for k in range(30)]
    (folder / "pressure.csv").write_text("\n".join(("t,pressure", *rows)) + "\n")
    if model is not None:
        model_file.save(model, folder.parent / "model.yaml")
    return folder

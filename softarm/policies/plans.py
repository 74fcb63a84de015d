"""File of planned trajectories, written by `softarm dev plan` and flown by the policy `trajectory`."""

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from softarm.common import files
from softarm.policies.base import MODELS, Array, PolicyError
from softarm.schemas.robot import CONTROL_RATE_HZ

FORMAT = 1
SIZE_MAX = 256 * 1024 * 1024  # bytes, unpacked; the shipped plans have one million
_SHAPES = {"target_m": 2, "cart_start_m": 1, "steps": 1, "miss_m": 1, "command": 3, "tip_m": 3}  # dimensions


@dataclass(frozen=True, slots=True)
class Plans:
    """P plans of up to T control steps at 30 Hz, each from a straight, vented arm at rest."""

    target_m: Array  # [P, 2], y and z
    cart_start_m: Array  # [P]
    steps: NDArray[np.int64]  # [P], N: steps until the tip is nearest to the target
    miss_m: Array  # [P], smallest distance in the simulator
    command: Array  # [P, T, 2], m/s and kPa; valid for steps 0 .. N - 1
    tip_m: Array  # [P, T + 1, 2], path of the tip from the start on
    model: str = "seed"  # name of the model

    def save(self, file: Path) -> None:
        """Write the npz file, rounded to 0.1 mm/s, 1 Pa and 0.01 mm to halve its size."""
        command = np.round(self.command.astype(np.float64), 4)
        tip = np.round(self.tip_m.astype(np.float64), 5)
        arrays = {name: getattr(self, name) for name in _SHAPES}
        arrays |= {"command": command.astype(np.float32), "tip_m": tip.astype(np.float32)}
        with files.replacing(file) as opened:
            np.savez_compressed(opened, format=FORMAT, rate_hz=CONTROL_RATE_HZ, model=self.model, **arrays)

    @classmethod
    def load(cls, file: Path) -> Self:
        """Read and check a file. Raises PolicyError with the problem and the remedy."""
        again = "make one with `softarm dev plan --out FILE`"
        try:
            with zipfile.ZipFile(file) as archive:
                size = sum(member.file_size for member in archive.infolist())
            if size > SIZE_MAX:
                raise ValueError(f"it unpacks to {size / 1e6:.0f} MB; allowed are {SIZE_MAX / 1e6:.0f}")
            with np.load(file, allow_pickle=False) as opened:
                content = {name: np.asarray(opened[name]) for name in opened.files}
        except FileNotFoundError:
            raise PolicyError(f"no file {file}; {again}") from None
        except Exception as error:  # a damaged file makes zipfile and numpy raise many types
            raise PolicyError(f"{file} is not a file of plans ({error}); {again}") from error
        if missing := sorted({"format", "rate_hz", "model", *_SHAPES} - content.keys()):
            raise PolicyError(f"{file} lacks {', '.join(missing)}; {again}")
        if not (np.array_equal(content["format"], FORMAT) and np.array_equal(content["rate_hz"], CONTROL_RATE_HZ)):
            raise PolicyError(
                f"{file} has format {content['format']} at {content['rate_hz']} Hz; "
                f"this version flies format {FORMAT} at {CONTROL_RATE_HZ} Hz: {again}"
            )
        plans = cls(
            **{field.name: content[field.name] for field in fields(cls) if field.name != "model"},
            model=str(content["model"]),
        )
        if wrong := plans._wrong():
            raise PolicyError(f"{file}: {wrong}; {again}")
        return plans

    def _wrong(self) -> str | None:
        """Return the first problem of the arrays, or None."""
        for name, dimensions in _SHAPES.items():
            array = getattr(self, name)
            plans = self.steps.size
            if array.ndim != dimensions or len(array) != plans or not plans:
                return f"{name} has shape {list(array.shape)}, which does not fit {plans} plans"
            if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
                return f"{name} holds NaN or infinity"
        longest = self.command.shape[1]
        if self.tip_m.shape[1:] != (longest + 1, 2) or self.command.shape[2] != 2 or self.target_m.shape[1] != 2:
            return f"command {list(self.command.shape)} and tip_m {list(self.tip_m.shape)} do not belong together"
        if self.steps.min() < 1 or self.steps.max() > longest:
            return f"steps lie in {self.steps.min()} .. {self.steps.max()}; allowed 1 .. {longest}"
        return None


def find(name: str) -> Path:
    """Return the file of a path that ends in .npz, or of a shipped name."""
    return Path(name) if name.endswith(".npz") else MODELS / f"{name}.npz"

"""What a batch says of each data set, and of all."""

from dataclasses import dataclass
from typing import Literal

from handeye_fg.comparison import Comparison
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Stds, std_rotation_deg, std_translation_mm
from handeye_fg.io.results import Result

Status = Literal["ok", "partial", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Figures:
    """The few figures of a result that an overview has; the whole one is in its file.

    Attributes:
        matrix: X (4, 4), metres.
        std_rotation_deg, std_translation_mm: along the camera's axes; None where free.
        metres_per_world_unit: scale.
        n_images: images, or rows, of the input.
        n_registered: those that the reconstruction placed.
        n_rejected: those whose robot pose was left out as wrong.
        noise: noise levels.
    """

    matrix: Array
    std_rotation_deg: Stds
    std_translation_mm: Stds
    metres_per_world_unit: float
    n_images: int
    n_registered: int
    n_rejected: int
    noise: NoiseLevels | None


def figures_of(result: Result) -> Figures:
    """What an overview has of a result."""
    return Figures(
        matrix=result.matrix,
        std_rotation_deg=std_rotation_deg(result),
        std_translation_mm=std_translation_mm(result),
        metres_per_world_unit=result.metres_per_world_unit,
        n_images=len(result.images),
        n_registered=sum(image.registered for image in result.images),
        n_rejected=sum(image.outlier for image in result.images),
        noise=result.noise,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """One data set of a batch.

    Attributes:
        name: its name.
        status: "ok", "partial" or "failed".
        message: one sentence for a person.
        kept: whether the calibration is that of an earlier run with the same input and options.
        seconds: that the calibration took, its process included.
        worker: the machine that did it.
        figures: of the calibration; None where it failed.
        drift: the earlier calibration and this one side by side; None where there is none.
        drift_problem: why there is no drift though an earlier calibration was named; "" otherwise.
    """

    name: str
    status: Status
    message: str
    kept: bool
    seconds: float
    worker: str
    figures: Figures | None = None
    drift: Comparison | None = None
    drift_problem: str = ""

    @property
    def drifted(self) -> bool:
        """Whether it is significantly off its earlier calibration."""
        return self.drift is not None and self.drift.verdict == "differ"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """All data sets of a batch, in the order of the manifest.

    Attributes:
        rows: one for each data set.
    """

    rows: tuple[Row, ...]

    @property
    def failed(self) -> tuple[Row, ...]:
        """Without a result, or without the comparison that was asked for."""
        return tuple(row for row in self.rows if row.status == "failed" or row.drift_problem)

    @property
    def partial(self) -> tuple[Row, ...]:
        """Those whose motion left directions undetermined."""
        return tuple(row for row in self.rows if row.status == "partial")

    @property
    def drifted(self) -> tuple[Row, ...]:
        """Those that are significantly off their earlier calibration."""
        return tuple(row for row in self.rows if row.drifted)
